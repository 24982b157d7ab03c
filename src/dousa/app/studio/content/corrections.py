"""Store what people corrected in takes: each correction is a clip of the library.

In a take of the library it is a segment named by hand, which the library knows (`Library.annotations`). A take that was
only uploaded has no segments: its part is written as a clip, and its take is noted here.
"""

from __future__ import annotations

import csv
import io
import json
import secrets
import shutil
import threading
import time
import unicodedata
from collections.abc import Iterable, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from dousa.app.studio.content.motions import Address, MotionRef, Named
from dousa.app.studio.core.answers import RefusedError, say
from dousa.app.studio.core.workspace import write_file
from dousa.errors import LibraryError, LibraryLockedError
from dousa.formats.annotations.label_file import is_unknown

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio

_FILE = "corrections.json"
_LOCK = threading.Lock()  # one for all studios of a process: they seldom write


@dataclass(frozen=True, slots=True)
class Correction:
    """A part of a take that was named by hand.

    Parameters
    ----------
    motion : name of the take, such as ``clip:7``.
    start_s, end_s : s.
    category : what it shows.
    clip_id : number of the clip that was made of the part.
    batch : of the file of the clip; empty if the clip is a segment of the take.
    id : 16 hexadecimal digits.
    made_s : Unix time.
    """

    motion: str
    start_s: float
    end_s: float
    category: str
    clip_id: int
    batch: str
    id: str = field(default_factory=lambda: secrets.token_hex(8))
    made_s: float = field(default_factory=time.time)

    def to_json(self) -> dict[str, Any]:
        """The correction as a plain dictionary."""
        return asdict(self)


class Corrections:
    """All corrections of a studio in one small file."""

    def __init__(self, root: Path) -> None:
        self._path = root / _FILE

    def all(self) -> list[Correction]:
        """Return all corrections, the oldest first; none if the file is damaged."""
        try:
            rows = json.loads(self._path.read_bytes())
            return [Correction(**row) for row in rows]
        except (OSError, ValueError, TypeError):
            return []

    def of(self, names: Iterable[str]) -> list[Correction]:
        """Return the corrections of a take, which may have several names, by time."""
        wanted = set(names)
        return sorted((one for one in self.all() if one.motion in wanted), key=lambda one: one.start_s)

    def add(self, correction: Correction) -> None:
        """Store a correction."""
        with _LOCK:
            self._write([*self.all(), correction])

    def forget_missing(self, there: AbstractSet[int]) -> None:
        """Forget corrections whose clip is not among these and whose file is deleted: no undo brings them back."""
        with _LOCK:
            known = self.all()
            kept = [one for one in known if one.clip_id in there or (self._path.parent / "files" / one.batch).is_dir()]
            if len(kept) < len(known):
                self._write(kept)

    def _write(self, corrections: Sequence[Correction]) -> None:
        write_file(self._path, json.dumps([one.to_json() for one in corrections], ensure_ascii=True).encode())


def lay_over(segments: Sequence[dict[str, Any]], corrections: Sequence[Correction]) -> list[dict[str, Any]]:
    """Replace stretches of a timeline by the corrections of its take.

    Parameters
    ----------
    segments : as in ``Timeline.to_json``, one after another.
    corrections : of this take; of two that overlap, the newer is shown.

    Returns
    -------
    Stretches by time, each with ``corrected``: the number of the correction, None for those of the labeller.
    """
    stretches = [{**one, "corrected": None} for one in segments]
    for own in sorted(corrections, key=lambda one: one.made_s):
        stretches = [part for one in stretches for part in _around(one, own.start_s, own.end_s)]
        stretches.append(
            {
                "start_s": own.start_s,
                "end_s": own.end_s,
                "category": own.category,
                "unknown": False,
                "confidence": 1.0,
                "corrected": own.id,
            }
        )
    return sorted(stretches, key=lambda one: (one["start_s"], one["end_s"]))


def _around(stretch: dict[str, Any], start: float, end: float) -> list[dict[str, Any]]:
    """Return what is left of a stretch outside of a part, without its repetitions, known only of the whole."""
    if start >= stretch["end_s"] or end <= stretch["start_s"]:
        return [stretch]
    stretch = {name: value for name, value in stretch.items() if name != "repetitions"}
    left = {**stretch, "end_s": min(stretch["end_s"], start)}
    right = {**stretch, "start_s": max(stretch["start_s"], end)}
    # s of a stretch that is worth telling
    return [one for one in (left, right) if one["end_s"] - one["start_s"] > 0.02]


_LABELS = "labels.csv"


def list_corrections(studio: Studio, ref: MotionRef) -> list[Correction]:
    """List the corrections of a take under all its names, by time."""
    found = [one for one in Corrections(studio.workspace.root).of(_names(studio, ref)) if _is_there(studio, one)]
    take = find_take(studio, ref)
    if take is not None:
        known = {one.clip_id for one in found}
        found += [one for one in _list_segments(studio, [take]) if one.clip_id not in known]
    return sorted(found, key=lambda one: one.start_s)


def _is_there(studio: Studio, correction: Correction) -> bool:
    """Whether the clip is in the library: an undo may have removed it, and may bring it back."""
    now = studio.listing.now()
    if correction.clip_id not in now:
        return False
    return studio.workspace.root in PurePath(now.clips[now.row_of(correction.clip_id)].path).parents


def list_examples(studio: Studio) -> list[int]:
    """List the numbers of all clips that were named by hand in takes."""
    dropped = [one.clip_id for one in Corrections(studio.workspace.root).all() if _is_there(studio, one)]
    return list(dict.fromkeys([*dropped, *(one.clip_id for one in _list_segments(studio))]))


def find_take(studio: Studio, ref: MotionRef) -> int | None:
    """Return the number of a take of the library; None for other motions."""
    address = ref.address
    try:
        if address.clip is not None:
            clip = studio.library.clips([address.clip])[0]
        elif address.batch:
            clip = studio.library.clips([str(studio.motions.path(ref))])[0]
        else:
            return None
    except LibraryLockedError:
        raise
    except LibraryError:
        return None
    return clip.id if clip.kind == "take" else None


def _list_segments(studio: Studio, takes: Sequence[int] | None = None) -> list[Correction]:
    found = []
    for take in studio.library.annotations.read(takes):
        name = str(Address(clip=take.take_id))
        for one in take.segments:
            if one.by_hand and one.category is not None:
                number, made_s = f"{one.clip_id:016x}", float(one.clip_id)  # numbers are given out in order
                found.append(Correction(name, one.start, one.end, one.category, one.clip_id, "", number, made_s))
    return found


def _names(studio: Studio, ref: MotionRef) -> set[str]:
    """List the names of a take: an uploaded one gets another name in the library."""
    names = {ref.motion}
    files = studio.workspace.root / "files"
    if ref.address.clip is not None:
        path = studio.motions.path(ref)
        if path.is_relative_to(files):
            batch, *rest = path.relative_to(files).parts
            names.add(str(Address(batch=batch, name="/".join(rest))))
    elif ref.address.batch:
        with suppress(LibraryError):
            clip = studio.library.clips([str(studio.motions.path(ref))])[0]
            names.add(str(Address(clip=clip.id)))
    return names


def learn_correction(
    studio: Studio,
    ref: MotionRef,
    category: str,
    split_s: float | None = None,
    replaces: Sequence[str] = (),
    instead_of: str | None = None,
    *,
    least_s: float = 0.3,
) -> dict[str, Any]:
    """Make a part of a take a clip of the library, in place of its earlier labels; one step of undo.

    Raises RefusedError for a part that is empty or too short, a name that is no label, or an unknown correction, and
    DousaError if the library cannot be written.

    Parameters
    ----------
    ref : the part.
    category : what it shows.
    split_s : time of the take at which the part is split into two of the same name; None for one part.
    replaces : numbers of corrections to remove besides those of mostly the same part.
    instead_of : of several labels of mostly the same part, the category of the one to remove.
    least_s : of a part, s; shorter ones show too little of a motion to be learned.
    """
    name = _check_category(category)
    parts = _part_at(ref, split_s)
    named = [studio.motions.get(part) for part in parts]
    shortest = min(one.motion.duration for one in named)
    if shortest < least_s:
        raise RefusedError(422, "studio_takes.too_short", least=least_s, seconds=shortest)
    known = list_corrections(studio, ref)
    if missing := set(replaces) - {one.id for one in known}:
        raise RefusedError(404, "studio_takes.no_correction", number=min(missing)[:40])
    take = find_take(studio, ref)
    meant = instead_of if take is not None and _has_label(studio, take, ref, instead_of) else None

    def gives_way(one: Correction) -> bool:
        same = meant in (None, one.category) and any(_is_same(part, one.start_s, one.end_s) for part in parts)
        return same or one.id in replaces

    gone = [one for one in known if gives_way(one)]
    try:
        with studio.library.one_change("name", category=name):
            if ids := [one.clip_id for one in gone]:
                studio.library.remove(ids)
            if take is not None:
                pairs = zip(named, parts, strict=True)
                made = [_name_segment(studio, take, *pair, name, meant, least_s) for pair in pairs]
            else:
                made = [_add_clip(studio, *one, name) for one in zip(named, parts, strict=True)]
    except Exception:
        if (begun := studio.library.last_change) is not None:
            studio.library.undo(begun, n_jobs=1)
        raise
    answer = {**made[0], "is_new_category": any(one["is_new_category"] for one in made)}
    return {**answer, "corrections": [one["correction"] for one in made], "change": studio.library.last_change}


def _has_label(studio: Studio, take: int, ref: MotionRef, category: str | None) -> bool:
    """Whether mostly this part of a take has a label of a category."""
    segments = [one for known in studio.library.annotations.read([take]) for one in known.segments]
    return any(one.category == category and _is_same(ref, one.start, one.end) for one in segments)


def _part_at(ref: MotionRef, split_s: float | None) -> list[MotionRef]:
    if split_s is None:
        return [ref]
    halves = (ref.start_s, split_s), (split_s, ref.end_s)
    return [MotionRef(motion=ref.motion, start_s=start, end_s=end) for start, end in halves]


def _add_clip(studio: Studio, named: Named, ref: MotionRef, name: str) -> dict[str, Any]:
    batch = studio.workspace.new_batch()
    studio.workspace.keep(batch, by_library=True)
    path = _write_clip(studio, named, ref, batch, name)
    try:
        report = studio.library.add([path], category_from=f"csv:{path.with_name(_LABELS)}", n_jobs=1)
        if report.skipped or not report.added:
            if not report.skipped:
                raise RefusedError(422, "studio_takes.known")
            raise RefusedError(422, "studio_takes.not_learned", reason=report.skipped[0].reason)
    except Exception:
        shutil.rmtree(studio.workspace.batch_folder(batch), ignore_errors=True)
        raise
    clip = studio.library.clips(list(report.added))[0]
    start, end = ref.start_s or 0.0, ref.end_s if ref.end_s is not None else named.motion.duration
    correction = Correction(ref.motion, round(start, 3), round(end, 3), name, clip.id, batch)
    Corrections(studio.workspace.root).add(correction)
    return {
        "correction": correction.to_json(),
        "clip": str(Address(clip=clip.id)),
        "is_new_category": name in report.new_categories,
        "is_learned": report.n_learned > 0,
        "notes": [say(text) for _, text in report.warnings],
    }


def _name_segment(
    studio: Studio, take: int, named: Named, ref: MotionRef, category: str, instead_of: str | None, least_s: float
) -> dict[str, Any]:
    start = ref.start_s or 0.0
    end = ref.end_s if ref.end_s is not None else start + named.motion.duration
    trained = studio.library.stats().trained_at is not None
    is_new = category not in studio.library.categories()
    number = studio.library.annotations.name(take, start, end, category, instead_of=instead_of, n_jobs=1)
    made = [one for one in _list_segments(studio, [take]) if one.clip_id == number]
    if not made:
        raise RefusedError(422, "studio_takes.too_short", least=least_s, seconds=named.motion.duration)
    return {
        "correction": made[0].to_json(),
        "clip": str(Address(clip=made[0].clip_id)),
        "is_new_category": is_new,
        "is_learned": trained,
        "notes": [],
    }


def _check_category(category: str) -> str:
    name = unicodedata.normalize("NFC", category).strip()
    if not name or any(unicodedata.category(character) in ("Cc", "Cs") for character in name):
        raise RefusedError(422, "studio_takes.no_category")
    if is_unknown(name):  # as in tables of labels
        raise RefusedError(422, "studio_takes.unknown_category", category=name)
    return name


def _write_clip(studio: Studio, named: Named, ref: MotionRef, batch: str, category: str) -> Path:
    stem = "".join(character if character.isalnum() or character in "_-" else "_" for character in _stem(named))
    path = studio.workspace.place(batch, f"{stem[:50]}_{ref.start_s or 0:.2f}s.bvh")
    path.write_bytes(studio.motions.make_file(named, ref, ".bvh"))
    table = io.StringIO()
    csv.writer(table).writerows([("file", "category"), (path.name, category)])
    path.with_name(_LABELS).write_text(table.getvalue(), encoding="utf-8")
    return path


def _stem(named: Named) -> str:
    return PurePath(named.name).stem or "take"


def _is_same(part: MotionRef, first: float, last: float) -> bool:
    """Whether a label covers mostly this part, so that a new correction replaces it."""
    start, end = part.start_s or 0.0, part.end_s if part.end_s is not None else float("inf")
    shared = min(end, last) - max(start, first)
    # intersection over union of two corrections that mean the same part
    return shared > 0 and shared >= 0.5 * (max(end, last) - min(start, first))


def forget_correction(studio: Studio, number: str) -> tuple[Correction, int | None]:
    """Remove a correction: its clip leaves the library until an undo. Returns it with the number of the change.

    Raises RefusedError if there is no such correction, DousaError if the library cannot be written.
    """
    known = [one for one in Corrections(studio.workspace.root).all() if _is_there(studio, one)]
    found = next((one for one in (*known, *_list_segments(studio)) if one.id == number), None)
    if found is None:
        raise RefusedError(404, "studio_takes.no_correction", number=number[:40])
    studio.library.remove([found.clip_id])
    return found, studio.library.last_change
