"""A pupil over time: several evaluations of the same dance, what became better, and what still fails every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, ClassVar

import numpy as np

from dousa.errors import OptionError
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.evaluation.words import KINDS, name_parts
from dousa.messages import Message
from dousa.notebooks import Tabular, short_repr

_KEYS = ("score", "events", "lapses")
_SIZES: Mapping[str, Callable[[Mapping[str, Any]], float | None]] = {
    "global": lambda event: event["end_s"] - event["start_s"],
    "partial": lambda event: event.get("deviation_deg"),
    "incomplete": lambda event: event.get("shortfall_deg"),
    "shift": lambda event: event.get("lag_ms"),
}
_SAID_SIZES: Mapping[str, str] = {
    "global": "progress.seconds",
    "partial": "progress.degrees",
    "incomplete": "progress.degrees",
    "shift": "progress.milliseconds",
}

Fault = tuple[str, int, str]
"""Kind of error, figure (from 0), and limb, or ``""`` for the whole body."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One evaluation, as far as it is compared with others.

    Parameters
    ----------
    name : of the performance.
    score : 0 to 100; None if it has none.
    counts : errors of each kind.
    sizes : mean size of each kind, None without errors of it: of time shifts in ms (whether late or early), of
        incomplete and partial errors in degrees, of global ones in s.
    lapses : stops, skips and so on.
    faults : what failed where.
    segments : errors of each segment; those of the whole body are not counted.
    figures : label and score of each figure, in order; None where the performance does not reach it.
    """

    name: str
    score: float | None
    counts: Mapping[str, int]
    sizes: Mapping[str, float | None]
    lapses: int
    faults: frozenset[Fault]
    segments: Mapping[str, int] = field(default_factory=dict)
    figures: tuple[tuple[str, float | None], ...] = ()


@short_repr
@dataclass(frozen=True, slots=True)
class Progress(Tabular):
    """Several attempts in order of time.

    Parameters
    ----------
    attempts : the first one is the oldest.
    summary : one sentence: the grade, what is better, what is worse, what fails every time.
    better, worse : kinds of errors, of the last attempt against the first.
    still : what failed in every attempt.
    """

    _rows: ClassVar[str] = "attempts"

    attempts: tuple[Attempt, ...]
    summary: Message
    better: tuple[str, ...]
    worse: tuple[str, ...]
    still: tuple[Fault, ...]

    def to_json(self, language: str | None = None) -> dict[str, Any]:
        """The answer of ``dousa progress --json``."""
        return {
            "says": self.summary.render(language),
            "better": list(self.better),
            "worse": list(self.worse),
            "still": [{"kind": kind, "furi": furi, "limb": limb or None} for kind, furi, limb in self.still],
            "attempts": [
                {
                    "name": one.name,
                    "score": one.score,
                    "errors": dict(one.counts),
                    "sizes": {kind: None if size is None else round(size, 1) for kind, size in one.sizes.items()},
                    "lapses": one.lapses,
                    "segments": dict(one.segments),
                    "figures": [{"label": label, "score": score} for label, score in one.figures],
                }
                for one in self.attempts
            ],
        }


def read_attempt(answer: Mapping[str, Any], name: str) -> Attempt:
    """Read one attempt from an answer of ``dousa evaluate --json``; raises OptionError for anything else."""
    try:
        events = list(answer["events"])
        counts = {kind: sum(event["kind"] == kind for event in events) for kind in KINDS}
        sizes = {kind: _measure(events, kind) for kind in KINDS}
        faults = frozenset(fault for event in events for fault in _list_faults(event))
        score = _to_score(answer["score"])
        segments = {name: sum(name in event["segments"] for event in _list_local(events)) for name in SEGMENTS}
        figures = tuple((str(furi["label"]), _to_score(furi["score"])) for furi in answer.get("furi", ()))
        return Attempt(name, score, counts, sizes, len(answer["lapses"]), faults, segments, figures)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise OptionError("progress.not_an_answer", name=name, keys=_KEYS) from error


def _list_local(events: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Errors of some segments; not those of the whole body."""
    return [event for event in events if event["kind"] != "global" and len(set(event["segments"])) < len(SEGMENTS)]


def _to_score(found: Any) -> float | None:
    return None if found is None else float(found)


def _measure(events: Sequence[Mapping[str, Any]], kind: str) -> float | None:
    sizes = [_SIZES[kind](event) for event in events if event["kind"] == kind]
    known = [abs(float(size)) for size in sizes if size is not None]
    return float(np.mean(known)) if known else None


def _list_faults(event: Mapping[str, Any]) -> list[Fault]:
    if event["furi"] is None:
        return []
    wrong = set(event["segments"])
    if event["kind"] == "global" or len(wrong) == len(SEGMENTS):
        return [(event["kind"], int(event["furi"]), "")]
    limbs = [name for name, limb in LIMBS.items() if any(SEGMENTS[index] in wrong for index in limb)]
    return [(event["kind"], int(event["furi"]), limb) for limb in limbs]


def compare_attempts(attempts: Sequence[Attempt]) -> Progress:
    """Compare attempts: improvements, setbacks, and faults of every attempt.

    Parameters
    ----------
    attempts : two or more, the oldest first, of the same dance against the same reference.

    Raises
    ------
    OptionError : fewer than two.
    """
    if len(attempts) < 2:
        raise OptionError("progress.too_few", n=len(attempts))
    first, last = attempts[0], attempts[-1]
    better = tuple(kind for kind in KINDS if _is_less(last, first, kind))
    worse = tuple(kind for kind in KINDS if _is_less(first, last, kind))
    still = tuple(sorted(frozenset.intersection(*(one.faults for one in attempts)), key=_order))
    parts = [_say_grade(first, last)]
    if better:
        parts.append(Message("progress.better", kinds=tuple(_say_change(kind, first, last) for kind in better)))
    if worse:
        parts.append(Message("progress.worse", kinds=tuple(_say_change(kind, first, last) for kind in worse)))
    if still:
        parts.append(_say_still(still))
    summary = reduce(lambda one, other: Message("progress.and_also", one=one, other=other), parts)
    return Progress(tuple(attempts), summary, better, worse, still)


def _order(fault: Fault) -> tuple[int, int, str]:
    return list(KINDS).index(fault[0]), fault[1], fault[2]


def _is_less(one: Attempt, other: Attempt, kind: str, *, smaller: float = 0.75) -> bool:
    """Whether there are fewer errors of this kind, or as many that are clearly smaller."""
    # smaller: of the size before, from which an error counts as smaller
    if one.counts[kind] != other.counts[kind]:
        return one.counts[kind] < other.counts[kind]
    size, before = one.sizes[kind], other.sizes[kind]
    return size is not None and before is not None and size < smaller * before


def _say_grade(first: Attempt, last: Attempt, *, least_points: float = 1.0) -> Message:
    if first.score is None or last.score is None:
        return Message("progress.no_grade")
    change = last.score - first.score
    before, now = round_grade(first.score), round_grade(last.score)
    if abs(change) < least_points:
        return Message("progress.grade_same", last=now)
    return Message("progress.grade_up" if change > 0 else "progress.grade_down", first=before, last=now)


def _say_change(kind: str, first: Attempt, last: Attempt) -> Message:
    if first.counts[kind] != last.counts[kind]:
        return Message("progress.number", kind=KINDS[kind], first=first.counts[kind], last=last.counts[kind])
    return Message("progress.size", kind=KINDS[kind], first=_say_size(kind, first), last=_say_size(kind, last))


def _say_size(kind: str, attempt: Attempt) -> Message:
    """Mean size of the errors of a kind with its unit."""
    size = attempt.sizes[kind]
    return Message(_SAID_SIZES[kind], size=math.nan if size is None else size)


def describe_errors(kind: str, attempt: Attempt) -> Message:
    """Describe number and size of the errors of a kind: ``3 (24 deg)``."""
    count = attempt.counts[kind]
    if attempt.sizes[kind] is None:
        return Message("progress.count", n=count)
    return Message("progress.cell", n=count, size=_say_size(kind, attempt))


def describe_faults(faults: Sequence[Fault]) -> tuple[Message, ...]:
    """Describe faults in words, the limbs of one kind in one figure together."""
    groups: dict[tuple[str, int], list[str]] = {}
    for kind, furi, limb in faults:
        groups.setdefault((kind, furi), []).append(limb)
    return tuple(_say_fault(kind, furi, limbs) for (kind, furi), limbs in groups.items())


def _say_still(faults: Sequence[Fault], *, most_said: int = 4) -> Message:
    """What fails every time."""
    said = describe_faults(faults)
    if len(said) > most_said:
        return Message("progress.still_more", faults=said[:most_said], n=len(said) - most_said)
    return Message("progress.still", faults=said)


def _say_fault(kind: str, furi: int, limbs: Sequence[str]) -> Message:
    """One kind of error in one figure; no limbs stand for the whole body."""
    segments = [SEGMENTS[index] for limb in limbs if limb for index in LIMBS[limb]]
    return Message("progress.fault", kind=KINDS[kind], who=name_parts(segments), number=furi + 1)
