"""A part of a take that somebody named becomes a clip of the library, and can be taken back."""

from __future__ import annotations

import csv
import io
import shutil
import unicodedata
from contextlib import suppress
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from dousa.app.studio.corrections import Correction, Corrections
from dousa.app.studio.motions import MotionRef
from dousa.app.studio.problems import RefusedError
from dousa.errors import LibraryError, LibraryLockedError

if TYPE_CHECKING:
    from pathlib import Path

    from dousa.app.studio.motions import Named
    from dousa.app.studio.studio import Studio

__all__ = ["corrections_of", "forget", "learn"]

_SAME = 0.5  # intersection over union of two corrections that mean the same part
_SHORTEST = 0.3  # s
_LABELS = "labels.csv"


def corrections_of(studio: Studio, ref: MotionRef) -> list[Correction]:
    """What was corrected in a take, under any of its names."""
    return Corrections(studio.workspace.root).of(_names(studio, ref))


def _names(studio: Studio, ref: MotionRef) -> set[str]:
    """A take that was dropped has another name once it is in the library."""
    names = {ref.motion}
    files = studio.workspace.root / "files"
    if studio.motions.clip_id(ref) is not None:
        path = studio.motions.path(ref)
        if path.is_relative_to(files):
            batch, *rest = path.relative_to(files).parts
            names.add(f"file:{batch}/{'/'.join(rest)}")
    elif ref.motion.startswith("file:"):
        with suppress(LibraryError):
            names.add(f"clip:{studio.library.clips([str(studio.motions.path(ref))])[0].id}")
    return names


def learn(studio: Studio, ref: MotionRef, category: str) -> dict[str, Any]:
    """Make a part a clip of the library.

    Parameters
    ----------
    ref : the part.
    category : what it shows.

    Returns
    -------
    The correction, and what was learned.

    Raises
    ------
    RefusedError : the part is empty, or too short to be learned from; a name that is none.
    DousaError : the library cannot be written.
    """
    name = _check_category(category)
    named = studio.motions.get(ref)
    if named.motion.duration < _SHORTEST:
        raise RefusedError(
            422,
            f"expected a part of {_SHORTEST:g} s or more to learn from, got {named.motion.duration:.2f} s",
        )
    _forget_same(studio, ref)
    batch = studio.workspace.new_batch()
    studio.workspace.keep(batch)
    path = _write_clip(studio, named, ref, batch, name)
    try:
        report = studio.library.add([path], category_from=f"csv:{path.with_name(_LABELS)}", n_jobs=1)
        if report.skipped or not report.added:
            reasons = [item.reason for item in report.skipped] or ["this very part is in the library already"]
            raise RefusedError(422, f"the part cannot be learned: {reasons[0]}")
    except Exception:
        shutil.rmtree(studio.workspace.batch_folder(batch), ignore_errors=True)
        raise
    clip = studio.library.clips(list(report.added))[0]
    start, end = ref.start_s or 0.0, ref.end_s if ref.end_s is not None else named.motion.duration
    correction = Correction(ref.motion, round(start, 3), round(end, 3), name, clip.id, batch)
    Corrections(studio.workspace.root).add(correction)
    return {
        "correction": correction.to_json(),
        "clip": f"clip:{clip.id}",
        "is_new_category": name in report.new_categories,
        "is_learned": report.n_learned > 0,
        "notes": [text for _, text in report.warnings],
    }


def _check_category(category: str) -> str:
    name = unicodedata.normalize("NFC", category).strip()
    if not name or any(unicodedata.category(character) in ("Cc", "Cs") for character in name):
        raise RefusedError(422, "category: expected a name, such as kick_left")
    return name


def _write_clip(studio: Studio, named: Named, ref: MotionRef, batch: str, category: str) -> Path:
    """The part as a file, with a table beside it that says what it shows."""
    from dousa.app.studio.bvh_files import make_bvh

    stem = "".join(
        character if character.isalnum() or character in "_-" else "_" for character in _stem(named)
    )
    path = studio.workspace.place(batch, f"{stem[:50]}_{ref.start_s or 0:.2f}s.bvh")
    path.write_bytes(make_bvh(named, studio.motions.path(ref), ref))
    table = io.StringIO()
    csv.writer(table).writerows([("file", "category"), (path.name, category)])
    path.with_name(_LABELS).write_text(table.getvalue(), encoding="utf-8")
    return path


def _stem(named: Named) -> str:
    return PurePath(named.name).stem or "take"


def _forget_same(studio: Studio, ref: MotionRef) -> None:
    """Who corrects a part once more means the last one."""
    start, end = ref.start_s or 0.0, ref.end_s if ref.end_s is not None else float("inf")
    for one in corrections_of(studio, ref):
        shared = min(end, one.end_s) - max(start, one.start_s)
        if shared > 0 and shared >= _SAME * (max(end, one.end_s) - min(start, one.start_s)):
            forget(studio, one.id)


def forget(studio: Studio, number: str) -> Correction:
    """Take a correction back: its clip leaves the library.

    Raises
    ------
    RefusedError : there is no such correction.
    DousaError : the library cannot be written.
    """
    known = {one.id: one for one in Corrections(studio.workspace.root).all()}
    if number not in known:
        raise RefusedError(404, f"no correction {number[:40]!r}; was it taken back already?")
    correction = known[number]
    if _is_ours(studio, correction):
        studio.library.remove([correction.clip_id])
    Corrections(studio.workspace.root).remove(number)
    with suppress(RefusedError):
        shutil.rmtree(studio.workspace.batch_folder(correction.batch), ignore_errors=True)
    return correction


def _is_ours(studio: Studio, correction: Correction) -> bool:
    """Whether the clip is still there; somebody may have removed it on the page of the library."""
    try:
        path = studio.library.clips([correction.clip_id])[0].path
    except LibraryLockedError:
        raise
    except LibraryError:
        return False
    return studio.workspace.root in PurePath(path).parents
