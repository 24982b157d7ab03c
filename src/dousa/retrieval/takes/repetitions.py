"""Count how often each action of a take is done, with series of neighbours joined into one action."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.repetitions import count_cycles, fold_poses
from dousa.retrieval.takes.made_takes import SERIES
from dousa.retrieval.takes.windows import TAKE_RATE


def count_part(sampled: FloatArray) -> int:
    """Count the cycles of a part of a recording (n, 20, 3) m at ``TAKE_RATE``, at least 1."""
    return count_cycles(fold_poses(sampled, TAKE_RATE), TAKE_RATE)


def find_phases(counts: Sequence[int], same: float = 0.75, most: int = 2) -> int:
    """Find how many cycles one repetition of a category is, from those of some of its clips; 1 without any.

    If most clips show two (a step left, a step right), that is one repetition, else a cycle is.

    Parameters
    ----------
    counts : cycles of each clip.
    same : share of the clips that show the same number.
    most : cycles of one action, such as left and right; more are repetitions.
    """
    if not len(counts):
        return 1
    values, often = np.unique(counts, return_counts=True)
    usual = int(values[often.argmax()])
    return usual if often.max() >= same * len(counts) and usual <= most else 1


def divide_cycles(cycles: int, phases: int) -> int:
    """Return how many repetitions of ``phases`` cycles each so many cycles are, at least 1."""
    return max((2 * cycles + phases) // (2 * phases), 1)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """An action of a take.

    Parameters
    ----------
    start, stop : frames at ``TAKE_RATE``.
    category : its number.
    evidence : (K,) evidence of the labeller.
    repetitions : how often it is done.
    confidence : probability that the category is right.
    likely : whether it is named by default.
    possible : whether its category is a guess if it is not named.
    shares : (C,) mean share of each category, by the labeller.
    parts : first and last frames of its repetitions if much longer than usual; else empty.
    mirrored : whether it was found in the mirror image of the recording.
    """

    start: int
    stop: int
    category: int
    evidence: FloatArray
    repetitions: int = 1
    confidence: float = 0.0
    likely: bool = True
    shares: FloatArray = field(default_factory=lambda: np.empty(0))
    parts: tuple[tuple[int, int], ...] = ()
    mirrored: bool = False
    possible: bool = False


# Log odds by which a mirrored action must lead, and that doubtful actions count as (lab/notes/takes.md).
_LEAD, _LEAST = 1.5, 1.0


def lay_mirrored(chosen: Sequence[Chosen], mirrored: Sequence[Chosen], shortest: int) -> list[Chosen]:
    """Add the actions of the mirror image of a recording where they are clearly likelier.

    Parameters
    ----------
    chosen, mirrored : in the order of time, with their confidence.
    shortest : frames; shorter rests of covered actions are dropped.

    Returns
    -------
    Actions in the order of time.
    """
    laid = list(chosen)
    for one in sorted((one for one in mirrored if one.likely), key=lambda one: -one.confidence):
        if not is_clearer(one, laid):
            continue
        first, last = _find_shared(one, laid)
        parts = [replace(one, mirrored=True)]
        for other in laid[first:last]:
            if one.start - other.start >= shortest:
                parts.append(replace(other, stop=one.start, parts=()))
            if other.stop - one.stop >= shortest:
                parts.append(replace(other, start=one.stop, parts=()))
        laid[first:last] = sorted(parts, key=lambda part: part.start)
    return laid


def is_clearer(one: Chosen, laid: Sequence[Chosen]) -> bool:
    """Return whether an action of the mirror image is clearly likelier than those in its place, and not the same."""
    length, odds, same = one.stop - one.start, 0.0, 0
    first, last = _find_shared(one, laid)
    for other in laid[first:last]:
        if other.likely:
            shared = min(one.stop, other.stop) - max(one.start, other.start)
            odds += shared * (_find_odds(other) - _LEAST)
            same += shared * (other.category == one.category)
    return 2 * same <= length and _find_odds(one) > odds / length + _LEAST + _LEAD


def _find_shared(one: Chosen, laid: Sequence[Chosen]) -> tuple[int, int]:
    return (
        bisect.bisect_right(laid, one.start, key=lambda other: other.stop),
        bisect.bisect_left(laid, one.stop, key=lambda other: other.start),
    )


def _find_odds(one: Chosen, least: float = 1e-3) -> float:
    chance = min(max(one.confidence, least), 1.0 - least)
    return float(np.log(chance / (1.0 - chance)))


def count_all(chosen: Sequence[Chosen], sampled: FloatArray, phases: Sequence[int] = ()) -> list[Chosen]:
    """Count the repetitions of each action, with series of three or more joined into one.

    Parameters
    ----------
    chosen : in the order of time.
    sampled : (n, 20, 3) m at ``TAKE_RATE``, of the take.
    phases : cycles of one repetition of each category (`find_phases`); 1 for those beyond.
    """
    poses = fold_poses(sampled, TAKE_RATE)

    def count(one: Chosen) -> int:
        cycles = count_cycles(poses[one.start : one.stop], TAKE_RATE)
        return divide_cycles(cycles, phases[one.category] if one.category < len(phases) else 1)

    return [replace(one, repetitions=count(one)) for some in _find_series(chosen) for one in _join(some)]


def _find_series(chosen: Sequence[Chosen], longest_rest: int = 90, longest_slip: int = 45) -> list[list[Chosen]]:
    """Group neighbours of one category with short gaps, and the doubtful actions between them.

    Gaps of up to ``longest_rest`` frames lie between neighbours, of ``longest_slip`` across a doubtful action.
    """
    series: list[list[Chosen]] = []
    first = 0
    while first < len(chosen):
        last = first
        for k in range(first + 1, len(chosen)):
            rest = chosen[k].start - chosen[last].stop
            if rest > (longest_rest if k == last + 1 else longest_slip):
                break
            if chosen[k].category == chosen[first].category:
                last = k
            elif chosen[k].likely:
                break
        some = list(chosen[first : last + 1])
        same = [one for one in some if one.category == some[0].category]
        # An action much longer than usual counts as a series.
        if len(same) < 2 or sum(max(len(one.parts), 1) for one in same) < SERIES:
            some = some[:1]
        series.append(some)
        first += len(some)
    return series


def _join(series: Sequence[Chosen]) -> list[Chosen]:
    if len(series) == 1:
        return list(series)
    same = [one for one in series if one.category == series[0].category]
    sizes = np.array([one.stop - one.start for one in same], np.float32)
    evidence = np.average(np.stack([one.evidence for one in same]), axis=0, weights=sizes)
    surest = max(same, key=lambda one: (one.likely, one.confidence))
    possible = any(one.possible for one in same)
    spanned = replace(surest, start=series[0].start, stop=series[-1].stop, evidence=evidence, parts=())
    return [replace(spanned, possible=possible)]
