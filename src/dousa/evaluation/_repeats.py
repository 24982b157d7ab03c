"""What a motion does again: repetitions on its self-correlation matrix, at a coarse rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation.correlation import compute_correlation_matrix
from dousa.motion._types import FloatArray

__all__ = ["Coarse", "Repeat", "coarsen", "find_repeats"]

_RATE = 10.0  # Hz, the coarse rate at most
_MOST_POSES = 4000  # coarse poses of a very long take: 64 MB a matrix

# Tuned on synthetic dances and on the recordings that are not held out.
_BACKGROUND_S = 1.0  # a repetition has to stand out from what is so near
_NOISE = 0.005  # 1 - S between two takes of the same pose by one person: 6 degrees a segment
_MOVING = 0.2  # rad/s over all segments: from here on a person is not at rest
_TOLL = 0.45
_TOLERATED = 0.05  # 18 degrees a segment
_DROP_S = 1.5
_LEAST_GAIN = 0.45  # of a repetition, mean over its pairs
_NEAR_S = 0.4  # repetitions whose lags differ by less are one


@dataclass(frozen=True, slots=True)
class Coarse:
    """A motion at the coarse rate.

    Parameters
    ----------
    segments : (n, 9, 3) each the mean of `block` frames.
    block : frames of the motion to a coarse one.
    rate : Hz.
    similarity : (n, n) float32 self-correlation.
    speed : (n,) rad/s, change of posture, root mean square over the segments.
    """

    segments: FloatArray
    block: int
    rate: float
    similarity: NDArray[np.float32]
    speed: FloatArray


@dataclass(frozen=True, slots=True)
class Repeat:
    """A stretch of a motion that is done again.

    Parameters
    ----------
    earlier, later : (K,) coarse frames that resemble each other, in order of time.
    score : height that the alignment climbed to.
    """

    earlier: NDArray[np.int32]
    later: NDArray[np.int32]
    score: float


def coarsen(segments: FloatArray, frame_rate: float) -> Coarse:
    """The motion at a coarse rate and its self-correlation matrix.

    Parameters
    ----------
    segments : (T, 9, 3), at least one frame.
    frame_rate : Hz.
    """
    block = max(1, int(np.ceil(frame_rate / _RATE - 1e-9)), -(-len(segments) // _MOST_POSES))
    starts = np.arange(0, len(segments), block)
    means = np.add.reduceat(segments, starts, axis=0)
    lengths = np.linalg.norm(means, axis=2, keepdims=True)
    means = means / np.where(lengths > 1e-9, lengths, 1.0)
    rate = frame_rate / block
    similarity = compute_correlation_matrix(means, means)
    # Away from two poses earlier; turning on the spot is no change of posture.
    away = np.maximum(1.0 - np.diagonal(similarity, 2).astype(np.float64), 0.0)
    speed = 0.5 * rate * np.sqrt(2.0 * away)
    speed = np.pad(speed, 1, mode="edge") if len(speed) else np.zeros(len(means))
    return Coarse(means, block, rate, similarity, speed)


def find_repeats(coarse: Coarse, min_s: float) -> tuple[Repeat, ...]:
    """All stretches that are done again, the clearest first.

    Parameters
    ----------
    coarse : the motion.
    min_s : s, the shortest stretch and the shortest lag.
    """
    from dousa.evaluation._repeat_kernels import (
        accumulate_likeness,
        compute_gains,
        find_ends,
        trace_repeats,
    )

    rate, n = coarse.rate, len(coarse.segments)
    shortest = max(2, round(0.8 * min_s * rate))
    if n < 2 * shortest:
        return ()
    radius, width = max(1, round(_BACKGROUND_S * rate)), max(1, round(_NEAR_S * rate))
    moving = np.clip(coarse.speed / _MOVING, 0.0, 1.0)
    gains = compute_gains(coarse.similarity, radius, _NOISE, 4.0 * _TOLERATED)
    score, step = accumulate_likeness(
        coarse.similarity, gains, moving, shortest, _TOLL, _TOLERATED, _DROP_S * rate * _TOLL
    )
    least = _LEAST_GAIN * min_s * rate
    ends = find_ends(score, least)
    ends = ends[np.argsort(-score[ends[:, 0], ends[:, 1]], kind="stable")]
    pairs, counts = trace_repeats(score, step, ends, width, shortest, least)
    lines = np.split(pairs, np.cumsum(counts)[:-1])
    return tuple(
        Repeat(line[::-1, 0], line[::-1, 1], float(score[line[0, 0], line[0, 1]]))
        for line in lines
        if len(line)
    )
