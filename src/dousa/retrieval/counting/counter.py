"""The repetition count that best fits the tallies of a part of a recording.

Every possible count is described by how near each tally is to it, whether it is hit, and, if the usual tallies of one
repetition of the category are known, the same in units of these. A conditional logistic regression, fitted to made
series of other people and real takes counted by hand, weighs these; the best count wins.
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

from dousa.arrays import BoolArray, FloatArray, IntArray, read_only
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX, MIRRORED_JOINTS
from dousa.retrieval.counting import counting_kernels as counting
from dousa.retrieval.counting import tally_kernels as kernels
from dousa.retrieval.counting.counting_kernels import choose
from dousa.retrieval.features.channels import gaussian_weights
from dousa.retrieval.features.pose_features import HIPS, SHOULDERS
from dousa.retrieval.features.posed_motion import FRAME_JOINTS, complete_positions

COUNTED = (
    *("out", "back", "out_small", "back_small", "second_out", "crossings"),
    *("turns", "small_turns", "quick_out", "quick_crossings"),
    *("bursts", "bouts", "away", "away_crossings", "periods"),
    *("light_crossings", "light_turns", "light_quick_crossings", "light_bursts", "light_periods"),
    *("even_out", "even_crossings", "even_turns", "even_quick_crossings", "even_periods"),
)
"""Tallies that are counts themselves."""

AMOUNTS = ("duration", "way", "moving")
"""Tallies that only add up: s, body heights, s."""

TALLIES = (*COUNTED, *AMOUNTS)

_JOINTS = "head left_elbow left_hand right_elbow right_hand left_knee left_ankle right_knee right_ankle".split()
_INDEX = np.array([JOINT_INDEX[joint] for joint in _JOINTS])
_OTHERS = np.array([_JOINTS.index(CANONICAL_JOINTS[MIRRORED_JOINTS[joint]]) for joint in _INDEX])
# Curves of both sides, by definition of ``fold``.
_N_EVEN = 3 * len(_JOINTS) - sum(3 if other < k else other == k for k, other in enumerate(_OTHERS))
# Standard deviations in frames: sensor noise is quicker than people; hands that clap or wave are as quick as noise.
_WEIGHTS = gaussian_weights(3.0, reach=4.0), gaussian_weights(1.5, reach=4.0)
_PERIODS = [TALLIES.index(name) for name in ("periods", "light_periods", "even_periods")]


def measure_tallies(sampled: FloatArray, height: float) -> FloatArray:
    """Compute the tallies (28,) of a part of a recording, in the order of ``TALLIES``; 0 where nothing moves.

    ``sampled`` is (n, 20, 3) m, canonical joints at 30 Hz; ``height`` is in m.
    """
    points = complete_positions(sampled, height, (), {*_JOINTS, *FRAME_JOINTS})
    if len(points) < 2:
        return np.zeros(len(TALLIES))
    found, (first, last), (frames, speeds) = _tally_one(points, height)
    if last > 0:  # only a core was tallied, short enough for its periods
        return found
    if last < 0 and _is_repeated(_read_velocities(frames[0], len(points))[:, first:-last]):
        points = points[first:-last]
        found, _, (frames, speeds) = _tally_one(points, height, whole=True)
    for place, course, speed in zip(_PERIODS, frames, speeds.reshape(3, -1), strict=True):
        if np.isnan(found[place]):
            found[place] = _count_periods(_read_velocities(course, len(points)), speed)
    return found


def _read_velocities(course: FloatArray, n_frames: int) -> FloatArray:
    velocities: FloatArray = course.reshape(3, -1, n_frames)[1]
    return velocities


_Courses = tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray]


def _tally_one(points: FloatArray, height: float, *, whole: bool = False) -> tuple[FloatArray, list[int], _Courses]:
    """Return the tallies (28,), the frames of the core tallied alone or to check, and the courses and the speeds."""
    tallies, core = np.zeros((1, len(TALLIES))), np.zeros(2, np.int64)
    courses = _tally(points, np.array([[0, len(points)]]), height, len(points), tallies, core, whole=whole)
    return tallies[0], core.tolist(), courses


def _tally(
    points: FloatArray,
    spans: IntArray,
    height: float,
    most: int,
    tallies: FloatArray,
    core: IntArray,
    *,
    whole: bool = False,
    most_calm: int = 120,
) -> _Courses:
    """Fill ``tallies`` (N, 28) of parts of at most ``most`` frames; return courses and speeds of the last one.

    At most ``most_calm`` poses are compared for the pose at rest.
    """
    width = 3 * len(_JOINTS)
    frames = np.empty(3 * width * most), np.empty(3 * width * most), np.empty(3 * _N_EVEN * most)
    sizes = (width, width), (_N_EVEN, _N_EVEN), (6, width), (3, width), (3, _N_EVEN)
    speeds = np.empty(3 * most)
    counting.tally_all(
        read_only(np.ascontiguousarray(points, np.float64)), spans, float(height), _WEIGHTS,
        (HIPS, SHOULDERS, _INDEX, _OTHERS), np.empty(most * points[0].size), np.empty(2 * most), frames, speeds,
        np.empty(6 * most), (np.empty(most_calm), np.empty((most_calm, width))),
        tuple(np.empty(size) for size in sizes), np.empty((3, counting.SHORT + 1)), whole, core, tallies,
    )  # fmt: skip
    return frames, speeds


def measure_parts(sampled: FloatArray, spans: IntArray, height: float) -> FloatArray:
    """Compute the same (N, 28) of parts of a recording, faster than one by one.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints at 30 Hz, finite.
    spans : (N, 2) first frame of each part, and the one after its last.
    height : m.
    """
    tallies, lengths, most = np.zeros((len(spans), len(TALLIES))), np.diff(spans, axis=1)[:, 0], counting.SHORT
    short = np.flatnonzero((lengths >= 2) & (lengths <= most))
    for number in np.setdiff1d(np.arange(len(spans)), short).tolist():
        tallies[number] = measure_tallies(sampled[slice(*spans[number])], height)
    found = tallies[short]
    _tally(sampled, spans[short], height, most, found, np.zeros(2, np.int64))
    tallies[short] = found
    return tallies


def _count_periods(velocities: FloatArray, speeds: FloatArray) -> float:
    """Count periods of ``velocities`` (K, n) in the moving part, by ``speeds`` (n,); 1 where there is none."""
    places = np.flatnonzero(speeds > counting.read_moving(np.sort(speeds)))
    return _fit_periods(velocities[:, places[0] : places[-1] + 1], counting.ALIKE)


def _is_repeated(velocities: FloatArray) -> bool:
    return _fit_periods(velocities, counting.CORE_ALIKE) >= counting.ROUNDS


def _fit_periods(velocities: FloatArray, least: float) -> float:
    period = kernels.find_period(correlate(velocities.T), counting.SHORTEST, least, counting.NEARLY)
    return velocities.shape[1] / float(period) if period else 1.0


def correlate(velocities: FloatArray) -> FloatArray:
    """Return (L,) autocorrelation of velocities (n, K) at lags of 0, 1, 2 ... frames, -1 to 1; L a share of n."""
    n = len(velocities)
    most = max(round(counting.LONGEST * n), 1)
    curves, likeness = np.ascontiguousarray(velocities.T), np.zeros(most)
    if n <= counting.SHORT:
        kernels.correlate(curves, 0, n, likeness)
    else:
        size = 1 << (n + most - 1).bit_length()
        spectrum = np.fft.rfft(curves, size)
        likeness[:] = np.fft.irfft((spectrum * spectrum.conj()).real.sum(axis=0), size)[:most]
    kernels.normalise(curves, 0, n, np.empty(n + 1), likeness)
    return likeness


def count_swings(curve: FloatArray, least: float) -> tuple[int, int]:
    """Count the tops and the bottoms of a curve (n,) that differ by at least ``least`` from those before and after.

    The ends count: a curve that only rises has a bottom and a top.
    """
    tops, bottoms = kernels.count_swings(np.ascontiguousarray(curve, np.float64), 1.0, least)
    return int(tops), int(bottoms)


# The weights are fitted with these (``python -m lab.training.train_counter``).
_LEAST, _FARTHEST = 0.5, 1.0  # of a tally, whose logarithm is taken; of a log ratio: larger errors count the same


def count_repetitions(sampled: FloatArray, height: float, usual: FloatArray | None = None) -> int:
    """Count the repetitions of an action in a part of a recording; 1 where nothing is repeated.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints at 30 Hz.
    height : m.
    usual : (28,) tallies of one repetition, of `find_usual`; None where unknown.
    """
    return choose_count(measure_tallies(sampled, height), usual)


def choose_count(tallies: FloatArray, usual: FloatArray | None = None, most: int = 500) -> int:
    """Return the count, at most ``most``, that best fits tallies (28,); ``usual`` as for `count_repetitions`."""
    known = usual is not None and bool(np.isfinite(usual).all())
    weights = (_IN_USE.get() or _read_weights())["known" if known else "alone"]
    unit = usual if known and usual is not None else tallies
    return int(choose(tallies, unit, known, len(COUNTED), weights, _LEAST, _FARTHEST, most))


def describe_counts(tallies: FloatArray, counts: IntArray, usual: FloatArray | None = None) -> FloatArray:
    """Describe counts by the evidence for each.

    Parameters
    ----------
    tallies : (28,).
    counts : (K,).
    usual : (28,), or None.

    Returns (K, F), the columns of `name_evidence`.
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
    """Name the columns of `describe_counts`: (group, name) as in ``weights.toml``."""
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
    """Read the weights of `describe_counts`'s columns, without and with known usual tallies."""
    table = tomllib.loads(files("dousa.retrieval.counting").joinpath("weights.toml").read_text("utf-8"))
    return {
        name: np.array([table[name][group][kind] for group, kind in name_evidence(name == "known")], np.float64)
        for name in ("alone", "known")
    }


def find_usual(tallies: Sequence[FloatArray], same: float = 0.75, most_phases: int = 2) -> FloatArray:
    """Return the usual tallies (28,) of one repetition of a category; NaN without clips.

    If most clips show one cycle, or most show two (a step left, a step right), that is one repetition, else a cycle is.

    Parameters
    ----------
    tallies : (28,) of each of some clips of the category, or segments of takes.
    same : share of the clips that show the same number of cycles.
    most_phases : cycles of one action, such as left and right; more are repetitions.
    """
    if not len(tallies):
        return np.full(len(TALLIES), np.nan)
    counts = np.array([choose_count(one) for one in tallies])
    values, often = np.unique(counts, return_counts=True)
    if often.max() >= same * len(counts) and values[often.argmax()] <= most_phases:
        counts = np.ones_like(counts)
    each = np.maximum(np.stack(tallies), _LEAST) / counts[:, None]
    usual: NDArray[np.float64] = np.exp(np.log(each).mean(axis=0))
    return usual
