"""How often each action of a take is done: neighbours that are a series are one action, and each action is counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.retrieval.counting.counter import choose_count, count_repetitions, find_usual
from dousa.retrieval.counting.tallies import measure_tallies
from dousa.retrieval.features.posed_motion import PosedMotion, check_motion
from dousa.retrieval.takes.made_takes import SERIES

_LONGEST_REST = 90  # frames between neighbours of a series


def count_clip(motion: PosedMotion, alike: Sequence[PosedMotion] = ()) -> int:
    """How often a whole clip shows its action.

    Parameters
    ----------
    motion : of any frame rate.
    alike : clips of the same action by anybody, which say what one repetition is: a cycle, or two if nearly all of them
        show two (a step left, a step right). Without any a cycle is.

    Raises
    ------
    InvalidMotionError : another shape than (n, 20, 3), positions that are not finite, no body height.
    """
    usual = find_usual([_measure(one) for one in alike])
    return choose_count(_measure(motion), usual)


def _measure(motion: PosedMotion) -> FloatArray:
    from dousa.retrieval.features.channels import sample_positions

    return measure_tallies(sample_positions(check_motion(motion), motion.frame_rate), motion.height)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """An action of a take.

    Parameters
    ----------
    start, stop : frames at ``TAKE_RATE``.
    category : number of it.
    evidence : (K,) what speaks for it in the labeller.
    repetitions : how often it is done.
    confidence : probability that the category is right.
    likely : whether it is named where nobody asks for a confidence.
    """

    start: int
    stop: int
    category: int
    evidence: FloatArray
    repetitions: int = 1
    confidence: float = 0.0
    likely: bool = True


def count_all(
    chosen: Sequence[Chosen], sampled: FloatArray, height: float, usual: FloatArray | None = None
) -> list[Chosen]:
    """How often each action is done; one that is done three times or more, with rests or without, is one action.

    Parameters
    ----------
    chosen : in the order of time.
    sampled : (n, 20, 3) m at ``TAKE_RATE``, of the take.
    height : m.
    usual : as for `TakeLabeller`.
    """
    series: list[list[Chosen]] = []
    for one in chosen:
        last = series[-1][-1] if series else None
        if last is not None and last.category == one.category and one.start - last.stop <= _LONGEST_REST:
            series[-1].append(one)
        else:
            series.append([one])
    joined = [one for some in series for one in _join(some, sampled, height)]
    return [replace(one, repetitions=_count(one, sampled, height, usual)) for one in joined]


def _count(one: Chosen, sampled: FloatArray, height: float, usual: FloatArray | None) -> int:
    known = usual[one.category] if usual is not None and one.category < len(usual) else None
    return count_repetitions(sampled[one.start : one.stop], height, known)


def _join(series: Sequence[Chosen], sampled: FloatArray, height: float) -> list[Chosen]:
    """Neighbours of one category as one where they are a series, else as they are."""
    if len(series) < SERIES:
        return list(series)
    sizes = np.array([one.stop - one.start for one in series], np.float32)
    evidence = np.average(np.stack([one.evidence for one in series]), axis=0, weights=sizes)
    confidence, likely = (
        float(np.average([getattr(one, name) for one in series], weights=sizes)) for name in ("confidence", "likely")
    )
    whole = replace(series[0], stop=series[-1].stop, evidence=evidence)
    return [replace(whole, confidence=confidence, likely=likely >= 0.5)]
