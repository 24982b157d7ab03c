"""Annotations of a recording: when something happens, and what is unclear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a recording.

    Parameters
    ----------
    start, stop : s.
    category : what happens; None where it has no name.
    counted : false where it is unclear.
    line : of its table, for messages; None without one. Ignored by comparisons.
    """

    start: float
    stop: float
    category: str | None
    counted: bool = True
    line: int | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Annotation:
    """All labels of a recording.

    Parameters
    ----------
    segments : with their categories, in the order of time; two may overlap.
    unclear : (start, stop) s of unclear parts.
    source : where it was read.
    tier : the chosen one of several; empty where there is only one.
    is_blank : whether the table is empty, without even a label for nothing: the recording is not annotated.
    """

    segments: tuple[Stretch, ...]
    unclear: tuple[tuple[float, float], ...] = ()
    source: str = ""
    tier: str = ""
    is_blank: bool = False


def lay_out(
    segments: Sequence[Stretch],
    unclear: Sequence[tuple[float, float]],
    duration: float,
    *,
    complete: bool = True,
    least: float = 1e-3,
) -> tuple[Stretch, ...]:
    """Divide a recording into labelled parts and the rest, without gaps; neighbours of one segment or kind join.

    Parameters
    ----------
    segments : labelled parts in any order; of overlapping ones the shortest counts: a short action within a long one.
    unclear : (start, stop) s of unclear parts; segments within them count.
    duration : s; later parts are cut off.
    complete : whether everything of note was labelled; if not, the rest is unclear.
    least : s of a part, as tables are written to the millisecond.
    """
    rest = Stretch(0.0, duration, None, counted=complete)
    spans = [Stretch(start, stop, None, counted=False) for start, stop in unclear]
    spans += sorted(segments, key=lambda one: one.start - one.stop)  # the longest first: later ones lie above
    edges = sorted({0.0, duration, *(min(max(t, 0.0), duration) for one in spans for t in (one.start, one.stop))})
    parts: list[tuple[Stretch, float, float]] = []
    for start, stop in pairwise(edges):
        if stop - start < least:
            parts[-1:] = [(one, first, stop) for one, first, _ in parts[-1:]]
            continue
        begin = start if parts else 0.0
        middle = 0.5 * (start + stop)
        top = next((one for one in reversed(spans) if one.start <= middle < one.stop), rest)
        last = parts[-1] if parts else None
        if last is not None and (last[0] is top or _is_same_rest(last[0], top)):
            parts[-1] = (top, last[1], stop)
        else:
            parts.append((top, begin, stop))
    return tuple(Stretch(start, stop, one.category, one.counted) for one, start, stop in parts)


def _is_same_rest(one: Stretch, other: Stretch) -> bool:
    return one.category is None and other.category is None and one.counted == other.counted
