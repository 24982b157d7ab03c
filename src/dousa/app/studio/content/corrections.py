"""What people corrected in takes: segments that are named by hand, which the library keeps (`Library.annotations`).

A take that was only uploaded or estimated joins the library with its first correction.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from dousa.app.studio.content.motions import Address, MotionRef
from dousa.app.studio.core.answers import RefusedError
from dousa.errors import LibraryError, LibraryLockedError
from dousa.formats.annotations.label_file import is_unknown

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio


@dataclass(frozen=True, slots=True)
class Correction:
    """A part of a take that was named by hand.

    Parameters
    ----------
    motion : name of the take, such as ``clip:7``.
    start_s, end_s : s.
    category : what it shows.
    clip_id : number of the clip of the part; later ones have higher numbers.
    id : 16 hexadecimal digits.
    """

    motion: str
    start_s: float
    end_s: float
    category: str
    clip_id: int
    id: str

    def to_json(self) -> dict[str, Any]:
        """The correction as a plain dictionary."""
        return asdict(self)


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
    for own in sorted(corrections, key=lambda one: one.clip_id):
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


def list_corrections(studio: Studio, ref: MotionRef) -> list[Correction]:
    """List the corrections of a take by time."""
    take = find_take(studio, ref)
    return [] if take is None else sorted(_list_segments(studio, [take]), key=lambda one: one.start_s)


def list_examples(studio: Studio) -> list[int]:
    """List the numbers of all clips that were named by hand in takes."""
    return [one.clip_id for one in _list_segments(studio)]


def find_take(studio: Studio, ref: MotionRef) -> int | None:
    """Return the number of a take of the library; None for other motions."""
    address = ref.address
    chosen = [address.clip if address.clip is not None else str(studio.motions.path(ref))]
    try:
        clip = studio.library.clips(chosen)[0]
    except LibraryLockedError:
        raise
    except LibraryError:
        return None
    return clip.id if clip.kind == "take" else None


def _list_segments(studio: Studio, takes: Sequence[int] | None = None) -> list[Correction]:
    return [
        Correction(
            str(Address(clip=take.take_id)), one.start, one.end, one.category, one.clip_id, f"{one.clip_id:016x}"
        )
        for take in studio.library.annotations.read(takes)
        for one in take.segments
        if one.by_hand and one.category is not None
    ]


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
    """Name a part of a take, in place of its earlier labels; one step of undo.

    Raises RefusedError for a part that is empty or too short, a name that is no label, an unknown correction, or a
    motion that is no take, and DousaError if the library cannot be written.

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
    lengths = [studio.motions.get(part).motion.duration for part in parts]
    if min(lengths) < least_s:
        raise RefusedError(422, "studio_takes.too_short", least=least_s, seconds=min(lengths))
    known = list_corrections(studio, ref)
    if missing := set(replaces) - {one.id for one in known}:
        raise RefusedError(404, "studio_takes.no_correction", number=min(missing)[:40])
    is_learned, is_new = studio.library.stats().trained_at is not None, name not in studio.library.categories()
    try:
        with studio.library.one_change("name", category=name):
            take = find_take(studio, ref) or _add_take(studio, ref)
            meant = instead_of if _has_label(studio, take, ref, instead_of) else None
            gone = [one.clip_id for one in known if one.id in replaces or _gives_way(one, parts, meant)]
            if gone:
                studio.library.remove(gone)
            made = [
                _name_part(studio, take, part, length, name, meant) for part, length in zip(parts, lengths, strict=True)
            ]
    except Exception:
        if (begun := studio.library.last_change) is not None:
            studio.library.undo(begun, n_jobs=1)
        raise
    return {
        "corrections": [one.to_json() for one in made],
        "correction": made[0].to_json(),
        "clip": str(Address(clip=made[0].clip_id)),
        "is_new_category": is_new,
        "is_learned": is_learned,
        "change": studio.library.last_change,
    }


def _name_part(studio: Studio, take: int, part: MotionRef, length: float, name: str, meant: str | None) -> Correction:
    start = part.start_s or 0.0
    end = start + length if part.end_s is None else part.end_s
    number = studio.library.annotations.name(take, start, end, name, instead_of=meant, n_jobs=1)
    return next(one for one in _list_segments(studio, [take]) if one.clip_id == number)


def _gives_way(one: Correction, parts: Sequence[MotionRef], meant: str | None) -> bool:
    return meant in (None, one.category) and any(_is_same(part, one.start_s, one.end_s) for part in parts)


def _add_take(studio: Studio, ref: MotionRef) -> int:
    """Add a take that was uploaded or estimated to the library."""
    path = studio.motions.path(ref)
    if ref.address.batch:
        studio.workspace.keep(ref.address.batch, by_library=True)
    report = studio.library.add([path], kind="take", n_jobs=1)
    if report.skipped:
        raise RefusedError(422, "studio_takes.not_learned", reason=report.skipped[0].reason)
    if report.duplicates:
        raise RefusedError(409, "studio_takes.known", path=report.duplicates[0].same_as)
    take = find_take(studio, ref)
    if take is None:
        raise RefusedError(409, "studio_takes.not_a_take")
    return take


def _has_label(studio: Studio, take: int, ref: MotionRef, category: str | None) -> bool:
    """Whether mostly this part of a take has a label of a category."""
    segments = [one for known in studio.library.annotations.read([take]) for one in known.segments]
    return any(one.category == category and _is_same(ref, one.start, one.end) for one in segments)


def _part_at(ref: MotionRef, split_s: float | None) -> list[MotionRef]:
    if split_s is None:
        return [ref]
    halves = (ref.start_s, split_s), (split_s, ref.end_s)
    return [MotionRef(motion=ref.motion, start_s=start, end_s=end) for start, end in halves]


def _check_category(category: str) -> str:
    name = unicodedata.normalize("NFC", category).strip()
    if not name or any(unicodedata.category(character) in ("Cc", "Cs") for character in name):
        raise RefusedError(422, "studio_takes.no_category")
    if is_unknown(name):  # as in tables of labels
        raise RefusedError(422, "studio_takes.unknown_category", category=name)
    return name


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
    found = next((one for one in _list_segments(studio) if one.id == number), None)
    if found is None:
        raise RefusedError(404, "studio_takes.no_correction", number=number[:40])
    studio.library.remove([found.clip_id])
    return found, studio.library.last_change
