"""Repetitions of a movement in a recording: how many, when, and how sure that is; the one counter without a reference.

The body is seen in its own frame and folded: the mean of the pose and its mirror image, in which two sides in turn are
one movement done twice. Its strongest direction is one curve, free of what drifts more slowly than people repeat
themselves; a repetition crosses the middle of its range and comes back. Nothing is learned.

Chosen on half of the films of Countix (lab/trials/count_repetitions.py), see docs/takes.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion, check_positions
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.resampling import fill_gaps, smooth_gaussian
from dousa.motion.runs import find_runs

_LEFT, _RIGHT = (
    np.array([JOINT_INDEX[f"{side}_{joint}"] for joint in ("elbow", "hand", "knee", "ankle")])
    for side in ("left", "right")
)

_SMOOTH_S, _DRIFT_S = 0.1, 5.0  # standard deviations: of sensor noise, of what is no repetition (lab/trials/)
_HYSTERESIS = 0.1  # share of the range on either side of its middle (lab/trials/count_repetitions.py)
_STILL = 0.045  # body heights: by geometry the range where one arm of two segments turns by 10 degrees
_ONSET = 0.12  # share of the way at which a repetition has begun, see docs/exercises.md


@dataclass(frozen=True, slots=True)
class RepetitionCount:
    """The repetitions of a recording, whatever they are of.

    Parameters
    ----------
    spans : (start, end) in s of each, in order of time.
    certainty : 0 to 1: the least of the counts that stricter rules give, as a share of the largest.
    duration : s, of the recording.
    """

    spans: tuple[tuple[float, float], ...]
    certainty: float
    duration: float

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.spans)

    def to_json(self) -> dict[str, Any]:
        """Return count, spans (s), certainty and duration (s), as `dousa count --json` does."""
        spans = [{"start_s": round(start, 3), "end_s": round(end, 3)} for start, end in self.spans]
        numbers = {"certainty": round(self.certainty, 3), "duration_s": round(self.duration, 3)}
        return {"count": self.count, **numbers, "repetitions": spans}


def count_repetitions(motion: CanonicalMotion) -> RepetitionCount:
    """Count the repetitions of the strongest movement of a recording; none where nothing moves.

    Two sides in turn count one each. ``certainty`` tells how far stricter rules agree.

    Parameters
    ----------
    motion : of any frame rate; what is missing is filled from its neighbours in time.

    Raises
    ------
    InvalidMotionError : no frame, another shape, or infinite positions.
    """
    rate = motion.frame_rate
    curve = trace_movement(fold_poses(check_positions(motion.positions), rate), rate)
    low, high = _find_range(curve)
    if high - low < _STILL * motion.height:
        return RepetitionCount((), 1.0, len(curve) / rate)
    counts = [count_crossings(curve, share) for share in (0.0, _HYSTERESIS, 2 * _HYSTERESIS)]
    spans = tuple((start / rate, end / rate) for start, end in find_spans(curve))
    return RepetitionCount(spans, min(counts) / max(counts), len(curve) / rate)


def count_cycles(poses: FloatArray, frame_rate: float) -> int:
    """Count the cycles of the strongest movement in a part of `fold_poses` (n, 14) that is one action, at least 1.

    That something is repeated is known here, as its bounds are, and people tire: every crossing counts.
    """
    return max(count_crossings(trace_movement(poses, frame_rate), 0.0), 1)


def fold_poses(positions: FloatArray, frame_rate: float) -> FloatArray:
    """Compute the pose in the body's frame, the mean of both sides.

    Parameters
    ----------
    positions : (n, 20, 3) m, canonical joints, NaN where missing.
    frame_rate : Hz.

    Returns
    -------
    (n, 14) m: the head up and to the front, then elbow, hand, knee and ankle to the outside, up and to the front.
    """
    if np.isnan(positions).any():
        positions = np.nan_to_num(fill_gaps(positions))
    at = {
        name: positions[:, JOINT_INDEX[name]] for name in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
    }
    across = at["left_hip"] - at["right_hip"] + at["left_shoulder"] - at["right_shoulder"]
    deviation = max(_SMOOTH_S * frame_rate, 0.3)
    across = smooth_gaussian(across[:, [0, 2]], deviation)
    x, z = (across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)).T[:, :, None]
    left, right = positions[:, _LEFT] - positions[:, :1], positions[:, _RIGHT] - positions[:, :1]
    head = positions[:, JOINT_INDEX["head"]] - positions[:, 0]
    mean = np.sqrt(0.5) * (left + right)
    outside = np.sqrt(0.5) * (left - right)
    poses = np.empty((len(positions), 2 + 3 * len(_LEFT)))
    poses[:, 0], poses[:, 1] = head[:, 1], head[:, 2] * x[:, 0] - head[:, 0] * z[:, 0]
    poses[:, 2::3] = outside[..., 0] * x + outside[..., 2] * z
    poses[:, 3::3] = mean[..., 1]
    poses[:, 4::3] = mean[..., 2] * x - mean[..., 0] * z
    return smooth_gaussian(poses, deviation)


def trace_movement(poses: FloatArray, frame_rate: float) -> FloatArray:
    """Compute the strongest movement of `fold_poses` (n, 14) as one curve (n,) in m; it begins low."""
    if len(poses) > _DRIFT_S * frame_rate:
        poses = poses - _find_drift(poses, frame_rate)
    poses = poses - poses.mean(axis=0)
    curve: FloatArray = poses @ np.linalg.eigh(poses.T @ poses)[1][:, -1]
    low, high = _find_range(curve)
    return curve if curve[0] <= 0.5 * (low + high) else -curve


def _find_drift(poses: FloatArray, frame_rate: float, coarse_rate: float = 2.0) -> FloatArray:
    """(n, K) the slow course of poses (n, K), smoothed at ``coarse_rate`` Hz, since nothing in it is quicker."""
    stride = max(round(frame_rate / coarse_rate), 1)
    places = np.arange(0, len(poses), stride)
    slow = smooth_gaussian(
        np.add.reduceat(poses, places) / np.diff(places, append=len(poses))[:, None], _DRIFT_S * frame_rate / stride
    )
    middles = places + 0.5 * (np.diff(places, append=len(poses)) - 1)
    frames = np.arange(len(poses))
    return np.stack([np.interp(frames, middles, column) for column in slow.T], axis=1)


def _find_range(curve: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(curve, (0.05, 0.95))
    return float(low), float(high)


def _find_high(curve: FloatArray, share: float) -> BoolArray:
    """(n,) whether the curve was last seen above, not below, the middle of its range by ``share`` of it."""
    low, high = _find_range(curve)
    side = np.sign(curve - 0.5 * (low + high)) * (np.abs(curve - 0.5 * (low + high)) > share * (high - low))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(side)), -1))
    return np.asarray((last >= 0) & (side[np.maximum(last, 0)] > 0))


def count_crossings(curve: FloatArray, share: float = _HYSTERESIS) -> int:
    """Count how often a curve that begins low rises above the middle of its range by ``share`` of it."""
    return len(find_runs(_find_high(curve, share)))


def find_spans(curve: FloatArray) -> list[tuple[int, int]]:
    """Frames, half-open, from where each repetition has left the lowest place before it to where it is back."""
    runs = find_runs(_find_high(curve, _HYSTERESIS)).tolist()
    spans = []
    for number, (start, end) in enumerate(runs):
        before = runs[number - 1][1] if number else 0
        after = runs[number + 1][0] if number + 1 < len(runs) else len(curve)
        top = float(curve[start:end].max())
        rise, fall = curve[before : start + 1], curve[end - 1 : after]
        begun = np.flatnonzero(rise <= rise.min() + _ONSET * (top - rise.min()))[-1]
        ended = np.flatnonzero(fall <= fall.min() + _ONSET * (top - fall.min()))[0]
        spans.append((before + int(begun), end + int(ended)))
    return spans
