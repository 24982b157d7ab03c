"""What happens in an uncut recording, as somebody wrote it down: from when to when, and what nobody can say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

_LEAST = 1e-3  # s of a stretch: tables are written to the millisecond


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a recording.

    Parameters
    ----------
    start, stop : s.
    category : what happens there; None where it is nothing that has a name.
    counted : false where nobody can say what it is.
    line : of the table that says so, for messages; None where there is none. Stretches are equal without it.
    """

    start: float
    stop: float
    category: str | None
    counted: bool = True
    line: int | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Annotation:
    """All that somebody wrote down of a recording, from beginning to end.

    Parameters
    ----------
    segments : with their categories, in the order of time; two may overlap.
    unclear : (start, stop) s of parts of which nobody can say what they are.
    source : where it was read.
    tier : the one of several that was chosen; empty where there is only one.
    is_blank : whether a table says nothing at all, not even that nothing happens: nobody has annotated the recording.
    """

    segments: tuple[Stretch, ...]
    unclear: tuple[tuple[float, float], ...] = ()
    source: str = ""
    tier: str = ""
    is_blank: bool = False


def lay_out(
    segments: Sequence[Stretch], unclear: Sequence[tuple[float, float]], duration: float, *, complete: bool = True
) -> tuple[Stretch, ...]:
    """A recording from beginning to end: what was labelled, and the rest.

    Parameters
    ----------
    segments : labelled parts in any order; where some overlap the shortest is seen: a short action within a long one.
    unclear : (start, stop) s of parts of which nobody can say what they are; a segment that lies there is seen.
    duration : s, what lies beyond is cut off.
    complete : whether everything of note was labelled; if not, nobody can say what the rest is.

    Returns
    -------
    Stretches one after another without gaps, neighbours of one segment or one kind of rest being one.
    """
    rest = Stretch(0.0, duration, None, counted=complete)
    spans = [Stretch(start, stop, None, counted=False) for start, stop in unclear]
    spans += sorted(segments, key=lambda one: one.start - one.stop)  # the longest first: later ones lie above
    edges = sorted({0.0, duration, *(min(max(t, 0.0), duration) for one in spans for t in (one.start, one.stop))})
    parts: list[tuple[Stretch, float, float]] = []
    for start, stop in pairwise(edges):
        if stop - start < _LEAST:
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
