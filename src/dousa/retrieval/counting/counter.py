"""The count that the tallies of a part of a recording speak for.

Every count that could be is described: how near each tally comes to it, whether it hits it, and, where it is known what
one repetition of the category usually comes to in each tally, the same with that as the unit. A conditional logistic
regression, fitted to made series of other people and to real takes counted by hand, weighs these; the best count wins.
"""

from __future__ import annotations

import contextlib
import contextvars
import functools
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.retrieval.counting.counting_kernels import choose
from dousa.retrieval.counting.tallies import COUNTED, TALLIES, measure_tallies

_LEAST = 0.5  # of a tally: what moves has moved
_FARTHEST = 1.0  # of a log ratio: what is wrong is wrong
_MOST = 500
_SAME = 0.75  # share of the clips of a category that show the same number of cycles
_PHASES = 2  # cycles of one action, to the left and to the right, say; more are repetitions


def count_repetitions(sampled: FloatArray, height: float, usual: FloatArray | None = None) -> int:
    """Repetitions of an action in what a part of a recording shows; 1 where nothing is repeated.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints at 30 Hz.
    height : m.
    usual : (28,) what one repetition comes to in each tally, of `find_usual`; None where that is not known.
    """
    return choose_count(measure_tallies(sampled, height), usual)


def choose_count(tallies: FloatArray, usual: FloatArray | None = None) -> int:
    """The count that tallies (28,) speak for; ``usual`` as for `count_repetitions`."""
    known = usual is not None and bool(np.isfinite(usual).all())
    weights = (_IN_USE.get() or _read_weights())["known" if known else "alone"]
    unit = usual if known and usual is not None else tallies
    return int(choose(tallies, unit, known, len(COUNTED), weights, _LEAST, _FARTHEST, _MOST))


def list_counts(tallies: FloatArray, usual: FloatArray | None = None) -> IntArray:
    """The counts that are worth a thought: 1, 2, ... beyond the highest tally."""
    highest = tallies[: len(COUNTED)].max()
    if usual is not None:
        highest = max(highest, float((tallies / usual).max()))
    return np.arange(1, min(int(1.2 * highest) + 2, _MOST) + 1)


def describe_counts(tallies: FloatArray, counts: IntArray, usual: FloatArray | None = None) -> FloatArray:
    """What speaks for each count.

    Parameters
    ----------
    tallies : (28,).
    counts : (K,).
    usual : (28,), or None.

    Returns
    -------
    (K, F), as many columns as `name_evidence` has names.
    """
    values = np.maximum(tallies, _LEAST)
    counted, sizes = values[: len(COUNTED)], counts[:, None]
    alone = np.stack([_come_near(np.log(counted / sizes)), _hit(counted, sizes)], axis=2)
    parts = [np.stack([-np.log(counts), counts == 1], axis=1), alone.reshape(len(counts), -1)]
    if usual is not None:
        ratios = np.log(values / (usual * sizes))
        over = -np.minimum(np.maximum(ratios, 0.0), _FARTHEST)
        known = np.stack([_come_near(ratios), _hit(values / usual, sizes), over], axis=2)
        parts.append(known.reshape(len(counts), -1))
    return np.concatenate(parts, axis=1)


def _come_near(ratios: FloatArray) -> FloatArray:
    near: FloatArray = -np.minimum(np.abs(ratios), _FARTHEST)
    return near


def _hit(values: FloatArray, counts: IntArray) -> FloatArray:
    hit: BoolArray = np.abs(values - counts) <= 0.5
    return hit.astype(np.float64)


def name_evidence(known: bool) -> list[tuple[str, str]]:
    """The columns of `describe_counts`: (group, name) as in ``weights.toml``."""
    names = [("count", "small"), ("count", "one")]
    names += [(tally, kind) for tally in COUNTED for kind in ("near", "hit")]
    if known:
        names += [(tally, kind) for tally in TALLIES for kind in ("near_usual", "hit_usual", "over_usual")]
    return names


@contextlib.contextmanager
def use_weights(weights: Mapping[str, FloatArray]) -> Iterator[None]:
    """Count with other weights than the package's meanwhile: ``alone`` (52,) and ``known`` (136,)."""
    token = _IN_USE.set(weights)
    try:
        yield
    finally:
        _IN_USE.reset(token)


_IN_USE: contextvars.ContextVar[Mapping[str, FloatArray] | None] = contextvars.ContextVar("weights", default=None)


@functools.cache
def _read_weights() -> dict[str, FloatArray]:
    """The weights of `describe_counts`'s columns, where nothing is known of the category, and where something is."""
    table = tomllib.loads(files("dousa.retrieval.counting").joinpath("weights.toml").read_text("utf-8"))
    return {
        name: np.array([table[name][group][kind] for group, kind in name_evidence(name == "known")], np.float64)
        for name in ("alone", "known")
    }


def find_usual(tallies: Sequence[FloatArray]) -> FloatArray:
    """What one repetition of a category usually comes to in each tally.

    What the clips of a category show as one cycle, or as two as if agreed upon (a step left, a step right), is one
    repetition. Otherwise a cycle is.

    Parameters
    ----------
    tallies : (28,) of each of some clips of the category, or segments of takes.

    Returns
    -------
    (28,); NaN without clips.
    """
    if not len(tallies):
        return np.full(len(TALLIES), np.nan)
    counts = np.array([choose_count(one) for one in tallies])
    values, often = np.unique(counts, return_counts=True)
    if often.max() >= _SAME * len(counts) and values[often.argmax()] <= _PHASES:
        counts = np.ones_like(counts)
    each = np.maximum(np.stack(tallies), _LEAST) / counts[:, None]
    usual: NDArray[np.float64] = np.exp(np.log(each).mean(axis=0))
    return usual
