"""Deviations of a performance from its reference over time, lag and segment.

The tensor of squared deviations is the basis of all errors: a time shift is small at another lag, a wrong limb is large
at every lag.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import Working, interpolate_segments
from dousa.evaluation.posture.yaw import rotate_yaw
from dousa.kernels import kernel

MAX_LAG_S = 1.2  # see docs/evaluation.md
YAW_WINDOW_S = 0.6  # see docs/evaluation.md
YAW_SCALE = np.radians(12.0)  # chord from which a segment loses its say in the heading, see docs/evaluation.md


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Squared deviations."""

    # (T, K, 9) squared chord between the segments of the performance at t and of the reference at the same time + lag
    # column, turned by the common yaw; 0 where either is not seen, and only there
    squared: NDArray[np.float32]
    yaw: FloatArray  # (T,) rad that turn the reference of the same time onto the performance
    judged: NDArray[np.bool_]  # (T, 9) both seen, and inside the reference
    # (T, 9, 3) unit vectors at the same time, the reference turned onto the performance, and both turned so that the
    # reference's body always faces the same way, its left +z: what is left is the motion of the limbs
    performance: FloatArray
    reference: FloatArray
    center: int  # column of no lag
    step_s: float  # s from column to column
    spread: FloatArray  # (T, 9) rad, how much takes of the reference differ at each moment; 0 of one take
    beyond: FloatArray  # (T, 9) rad by which the performance is further than all takes, in one direction from them
    apart: FloatArray  # (T, 9) rad by which one of the takes is at most beyond the others; 0 of one take

    def cut(self, frames: slice) -> Deviations:
        """Those of some frames."""
        return replace(self, **{name: getattr(self, name)[frames] for name in _BY_FRAME})

    def extend(self, more: Deviations) -> Deviations:
        """These, and those of the frames after them."""
        parts: dict[str, Any] = {name: np.concatenate([getattr(self, name), getattr(more, name)]) for name in _BY_FRAME}
        return replace(self, **parts)


# arrays with a row a frame
_BY_FRAME = ("squared", "yaw", "judged", "performance", "reference", "spread", "beyond", "apart")


def compute_deviations(reference: Working, performance: Working, frames: FloatArray, weights: FloatArray) -> Deviations:
    """Compare every frame of the performance with the reference around ``frames`` (T,), at the working rate."""

    # However slow the camera, there are lags to both sides.
    reach = max(2, round(MAX_LAG_S * performance.frame_rate))
    count = performance.n_frames
    # The reference on the performance's clock, going on before and after it.
    before = frames[0] + np.arange(-reach, 0)
    after = frames[-1] + np.arange(1, reach + 1)
    clock = np.concatenate([before, frames, after])
    inside = (clock >= -1.0) & (clock <= reference.n_frames)
    moved = interpolate_segments(reference.segments, clock)
    near = np.clip(np.rint(clock).astype(np.intp), 0, reference.n_frames - 1)
    # Before its start and after its end the reference stands still; errors are judged inside it only.
    seen = reference.seen[near]
    half = max(1, round(0.5 * YAW_WINDOW_S * performance.frame_rate))
    squared, yaw = measure_deviations(
        performance.segments,
        moved,
        performance.seen,
        seen,
        weights,
        half,
        YAW_SCALE**2,
    )
    here = slice(reach, reach + count)
    judged = performance.seen & seen[here] & inside[here, None]
    facing = np.interp(frames, np.arange(reference.n_frames), reference.heading)
    theirs = rotate_yaw(moved[here], -facing)
    ours = rotate_yaw(performance.segments, -facing - yaw)
    beyond, none = _measure_beyond((ours - theirs)[None]), np.zeros(judged.shape)
    step_s = 1.0 / performance.frame_rate
    return Deviations(squared, yaw, judged, ours, theirs, reach, step_s, none, beyond, none)


def _measure_beyond(ways: FloatArray) -> FloatArray:
    """(T, 9) rad: the least of the ways (N, T, 9, 3) from each of the takes, along the mean of them."""
    mean = ways.mean(axis=0)
    mean /= np.maximum(np.linalg.norm(mean, axis=2, keepdims=True), 1e-9)
    least = np.clip((ways * mean).sum(axis=3).min(axis=0), 0.0, 2.0)
    return np.asarray(2.0 * np.arcsin(0.5 * least))


def merge_takes(each: Iterable[Deviations], *, spread_s: float = 0.3) -> Deviations:
    """Merge deviations from several takes, along the same line, to those from the nearest take; measure their spread.

    The first take decides what is judged; where a take is not seen the others count. The merged reference is the median
    of the takes, so that one take's slip does not count; the spread is the median angle of the takes from it, averaged
    over spread_s. Of takes that are made one after the other no more than two tensors are held.
    """
    takes: list[Deviations] = []
    squared = np.empty((0, 0, 9), np.float32)
    for number, take in enumerate(each):
        squared = _take_nearest(squared, take.squared) if number else take.squared
        takes.append(replace(take, squared=squared[:0]))
    first = replace(takes[0], squared=squared)
    if len(takes) == 1:
        return first
    poses = np.stack([take.reference for take in takes])
    apart = np.max([_measure_beyond(pose - np.delete(poses, k, axis=0)) for k, pose in enumerate(poses)], axis=0)
    beyond = _measure_beyond(np.stack([take.performance - take.reference for take in takes]))
    # What is judged of no take is of no interest; any of them may stand for it.
    known = np.stack([take.judged for take in takes]) | ~np.any([take.judged for take in takes], axis=0)
    middle = _take_median(poses, known[..., None])
    middle /= np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), 1e-9)
    far = _take_median(np.linalg.norm(poses - middle, axis=3), known)
    half = max(1, round(0.5 * spread_s / first.step_s))
    total = np.cumsum(np.pad(far, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    spread = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return replace(first, reference=middle, spread=spread, beyond=beyond, apart=apart)


def _take_median(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Median over the takes (first axis) of what is known; something of each is."""
    if known.all():
        return np.asarray(np.median(values, axis=0))
    return np.asarray(np.nanmedian(np.where(known, values, np.nan), axis=0))


def _take_nearest(mine: NDArray[np.float32], its: NDArray[np.float32]) -> NDArray[np.float32]:
    """Take the smaller of two squared deviations; 0 means none."""
    return np.where((its > 0.0) & ((its < mine) | (mine == 0.0)), its, mine)


_SMALLEST_SEEN = 1e-30  # by definition 0 means not seen; this is far below rounding


@kernel
def _measure_lags(
    ours: FloatArray,
    theirs: FloatArray,
    ours_seen: NDArray[np.bool_],
    theirs_seen: NDArray[np.bool_],
    weights: FloatArray,
    half: int,
    scale: float,
    room: FloatArray,
    total: FloatArray,
    far: FloatArray,
    squared: NDArray[np.float32],
    yaw: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Do `measure_deviations` into ``squared`` and ``yaw``; room: (T, 5, 9), ``total`` (T + 1, 2), ``far`` (T, 9)."""
    n_frames, n_lags = squared.shape[:2]
    for k in range(n_lags):
        for t in range(n_frames):
            here, a, b = room[t], ours[t], theirs[k + t]
            for s in range(9):
                here[4, s] = weights[s] if ours_seen[t, s] and theirs_seen[k + t, s] else 0.0
                here[0, s] = a[s, 2] * b[s, 2] + a[s, 0] * b[s, 0]  # along
                here[1, s] = a[s, 0] * b[s, 2] - a[s, 2] * b[s, 0]  # across
                here[2, s] = 2.0 - 2.0 * a[s, 1] * b[s, 1]  # upright
                here[3, s] = here[4, s]  # trust
        total[0, 0] = total[0, 1] = 0.0
        for _ in range(4):  # each time what is off loses more of its say
            for t in range(n_frames):
                here = room[t]
                along, across = 0.0, 0.0
                for s in range(9):
                    along += here[0, s] * here[3, s]
                    across += here[1, s] * here[3, s]
                total[t + 1, 0] = total[t, 0] + along
                total[t + 1, 1] = total[t, 1] + across
            for t in range(n_frames):
                here = room[t]
                low, high = max(t - half, 0), min(t + half + 1, n_frames)
                along, across = total[high, 0] - total[low, 0], total[high, 1] - total[low, 1]
                size = max(math.sqrt(along * along + across * across), 1e-12)
                along, across = along / size, across / size
                if k == n_lags // 2:
                    yaw[t] = math.atan2(across, along)
                for s in range(9):
                    far[t, s] = max(here[2, s] - 2.0 * (here[0, s] * along + here[1, s] * across), 0.0)
                    share = 1.0 / (1.0 + far[t, s] / scale)
                    here[3, s] = here[4, s] * share * share
        for t in range(n_frames):
            for s in range(9):
                seen = ours_seen[t, s] and theirs_seen[k + t, s]
                squared[t, k, s] = max(far[t, s], _SMALLEST_SEEN) if seen else 0.0


def measure_deviations(
    ours: FloatArray,
    theirs: FloatArray,
    ours_seen: NDArray[np.bool_],
    theirs_seen: NDArray[np.bool_],
    weights: FloatArray,
    half: int,
    scale: float,
) -> tuple[NDArray[np.float32], FloatArray]:
    """Measure squared chords at every lag after a common yaw that changes slowly and that no wrong limb bends.

    Parameters
    ----------
    ours : (T, 9, 3) unit vectors of the performance.
    theirs : (T + K - 1, 9, 3) of the reference on the performance's clock; frame t at lag column k meets t + k.
    ours_seen, theirs_seen : (T, 9) and (T + K - 1, 9).
    weights : (9,).
    half : the yaw is that of ``2 half + 1`` frames at equal lag.
    scale : squared chord from which a segment loses its say.

    Returns
    -------
    squared : (T, K, 9) float32, 0 where either is not seen, and only there.
    yaw : (T,) rad, that turns the reference onto the performance at the middle lag.
    """
    n_frames, n_lags = len(ours), len(theirs) - len(ours) + 1
    motions = (np.ascontiguousarray(one) for one in (ours, theirs, ours_seen, theirs_seen))
    squared, yaw = np.empty((n_frames, n_lags, 9), np.float32), np.zeros(n_frames)
    shapes = (n_frames, 5, 9), (n_frames + 1, 2), (n_frames, 9)
    _measure_lags(*motions, weights, half, float(scale), *map(np.empty, shapes), squared, yaw)
    return squared, yaw
