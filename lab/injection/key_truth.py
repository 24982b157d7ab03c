"""What can be seen of an error made over key poses: its class, its span and its size, or that it is too small.

Everything is measured between the motion before and after the error, never taken from what was intended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, compute_segments
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.injection.injection import Error
from lab.injection.key_poses import Rig, limbs_of, measure_speed, sample

VISIBLE_DEG = 8.0
"""Less than this is not seen."""
LEAST_LAG_S = 0.06
"""Less than this is not seen."""

_MOVING = np.radians(30.0)  # rad/s
_SEEN_S, _SUSTAINED_S = 0.3, 0.2
_SHIFT_DEG, _SHIFT_S = 12.0, 0.1
_SHORT_DEG, _SHORT_PERCENT = 12.0, 15.0
_PARTIAL_DEG, _PARTIAL_UNLAGGED_DEG = 20.0, 12.0
_GLOBAL_DEG, _GLOBAL_UNLAGGED_DEG = 25.0, 18.0
_LAGS_S = np.linspace(-0.4, 0.4, 17)
_POSES = 60  # of a range

_FASTEST = 15.0  # rad/s
_BENT_DEG = 155.0
_INSIDE = 0.055  # of the body height


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """An error that may turn out too small, or impossible for a body.

    Parameters
    ----------
    kind, variant : of the error.
    group : limb, pair of limbs, or ``"body"``.
    start : first frame that changes.
    positions : (N, 20, 3) m, of the frames from there on.
    lag_s : (N,) how late each is, of a shift.
    """

    kind: str
    variant: str
    group: str
    start: int
    positions: FloatArray
    lag_s: FloatArray | None = None

    @property
    def stop(self) -> int:
        """Frame behind the last that changes."""
        return self.start + len(self.positions)


def segments_of(group: str) -> list[int]:
    """Indices of the segments of a group."""
    return [index for limb in limbs_of(group) for index in LIMBS[limb]]


def measure_angles(before: FloatArray, after: FloatArray) -> FloatArray:
    """(...) deg between unit vectors (..., 3); 0 where there is none."""
    cosine = np.nan_to_num(np.sum(before * after, axis=-1), nan=1.0)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def measure_range(directions: FloatArray) -> float:
    """Largest angle in deg between any two of (T, 3) unit vectors."""
    chosen = np.nan_to_num(directions[np.unique(np.linspace(0, len(directions) - 1, _POSES).round().astype(np.intp))])
    return float(np.degrees(np.arccos(np.clip((chosen @ chosen.T).min(), -1.0, 1.0))))


def judge_draft(rig: Rig, before: FloatArray, draft: Draft) -> Error | None:
    """The truth of an error, None if it is too small to be one.

    Parameters
    ----------
    rig, before : the motion without this error, (T, 20, 3) m.
    draft : the error.
    """
    known = compute_segments(before)
    wrong = compute_segments(draft.positions)
    if not _is_possible(rig, before, known, wrong, draft):
        return None
    if draft.kind == "shift":
        return _judge_shift(rig, known, wrong, draft)
    if draft.kind == "incomplete":
        return _judge_incomplete(rig, known, wrong, draft)
    return _judge_other(rig, known, wrong, draft)


def _span(draft: Draft, seen: BoolArray, rate: float) -> tuple[float, float] | None:
    """First and last moment in s, None if too short."""
    frames = np.flatnonzero(seen)
    if len(frames) < 2 or len(frames) < _SEEN_S * rate:
        return None
    return float(draft.start + frames[0]) / rate, float(draft.start + frames[-1]) / rate


def _judge_shift(rig: Rig, known: FloatArray, wrong: FloatArray, draft: Draft) -> Error | None:
    rate = rig.frame_rate
    lag = draft.lag_s
    assert lag is not None
    speed = measure_speed(rig, draft.group)
    frames = np.arange(draft.start, draft.stop)
    moving = np.maximum(speed[frames], sample(speed, frames - lag * rate)) >= _MOVING
    span = _span(draft, (np.abs(lag) >= LEAST_LAG_S) & moving, rate)
    chosen = segments_of(draft.group)
    angles = measure_angles(known[draft.start : draft.stop, chosen], wrong[:, chosen])
    largest = _sustained(np.where(moving, np.abs(lag), 0.0), max(1, round(_SUSTAINED_S * rate)))
    if span is None or largest < _SHIFT_S or angles.max() < _SHIFT_DEG:
        return None
    late = float(lag[np.abs(lag).argmax()])
    names = tuple(SEGMENTS[index] for index in chosen)
    return Error("shift", draft.variant, *span, names, lag_ms=float(np.copysign(1e3 * largest, late)))


def _sustained(size: FloatArray, width: int) -> float:
    """The largest value that is kept for ``width`` values on end."""
    if len(size) < width:
        return 0.0
    return float(np.lib.stride_tricks.sliding_window_view(size, width).min(axis=1).max())


def _judge_incomplete(rig: Rig, known: FloatArray, wrong: FloatArray, draft: Draft) -> Error | None:
    chosen = segments_of(draft.group)
    here = slice(draft.start, draft.stop)
    angles = measure_angles(known[here, chosen], wrong[:, chosen])
    span = _span(draft, angles.max(axis=1) >= VISIBLE_DEG, rig.frame_rate)
    if span is None:
        return None
    axes = rig.heading[here]  # a turn of the body is no range of a limb
    worst = (0.0, 0.0)
    for index in chosen:
        full, left = (
            measure_range(np.asarray(np.einsum("tij,tj->ti", axes, part[:, index]))) for part in (known[here], wrong)
        )
        worst = max(worst, (full - left, 100.0 * (full - left) / max(full, 1.0)))
    if worst[0] < _SHORT_DEG or worst[1] < _SHORT_PERCENT:
        return None
    names = tuple(SEGMENTS[i] for i, column in zip(chosen, angles.T, strict=True) if column.max() >= VISIBLE_DEG)
    return Error("incomplete", draft.variant, *span, names, shortfall_deg=worst[0], shortfall_percent=worst[1])


def _judge_other(rig: Rig, known: FloatArray, wrong: FloatArray, draft: Draft) -> Error | None:
    """Partial and global errors: another movement, whatever the lag."""
    whole = draft.kind == "global"
    chosen = list(range(len(SEGMENTS))) if whole else segments_of(draft.group)
    frames = np.arange(draft.start, draft.stop)
    angles = _compare(known[frames], wrong, chosen)
    seen = angles.max(axis=1) >= VISIBLE_DEG
    span = _span(draft, seen, rig.frame_rate)
    if span is None:
        return None
    least = (_GLOBAL_DEG, _GLOBAL_UNLAGGED_DEG) if whole else (_PARTIAL_DEG, _PARTIAL_UNLAGGED_DEG)
    if _measure_size(angles[seen], whole) < least[0]:
        return None
    frames, wrong = frames[seen], wrong[seen]
    for lag in _LAGS_S:
        asked = np.clip(frames + round(lag * rig.frame_rate), 0, len(known) - 1)
        if _measure_size(_compare(known[asked], wrong, chosen), whole) < least[1]:
            return None
    named = chosen if whole else [i for i, column in zip(chosen, angles.T, strict=True) if column.max() >= VISIBLE_DEG]
    return Error(draft.kind, draft.variant, *span, tuple(SEGMENTS[index] for index in named))


def _measure_size(angles: FloatArray, whole: bool) -> float:
    """Mean over time, of all segments or of the worst."""
    return float((angles.mean(axis=1) if whole else angles.max(axis=1)).mean())


def _compare(known: FloatArray, wrong: FloatArray, chosen: list[int]) -> FloatArray:
    """(T, S) deg of the chosen segments; of all nine, under the best turn about the vertical."""
    if len(chosen) == len(SEGMENTS):
        across, other = (np.nan_to_num(part[..., 0] + 1j * part[..., 2]) for part in (known, wrong))
        phase = np.sum(across * np.conj(other), axis=1, keepdims=True)
        turned = other * phase / np.maximum(np.abs(phase), 1e-12)
        wrong = np.stack([turned.real, wrong[..., 1], turned.imag], axis=-1)
    return measure_angles(known[:, chosen], wrong[:, chosen])


def _is_possible(rig: Rig, before: FloatArray, known: FloatArray, wrong: FloatArray, draft: Draft) -> bool:
    """No joint faster, no limb more bent and none deeper in the trunk than bodies, or this one, can be."""
    here = slice(draft.start, draft.stop)
    steps = [np.radians(measure_angles(part[1:], part[:-1])).max(initial=0.0) for part in (wrong, known[here])]
    if steps[0] * rig.frame_rate > max(_FASTEST, 2.6 * steps[1] * rig.frame_rate):
        return False
    if draft.kind == "shift":
        return True
    for near, far in ((1, 2), (3, 4), (5, 6), (7, 8)):
        bends = [measure_angles(part[:, near], part[:, far]).max() for part in (wrong, known[here])]
        if bends[0] > max(_BENT_DEG, bends[1]):
            return False
    depths = [_measure_depth(part) for part in (draft.positions, before[here])]
    height = np.median(before[here, J["neck"], 1] - before[here, [J["left_ankle"]], 1])
    return bool(depths[0] >= min(_INSIDE * max(1.2 * height, 0.5), depths[1] - 1e-9))


def _measure_depth(positions: FloatArray) -> float:
    """Smallest distance in m of elbows and wrists from the axis of the trunk."""
    low = 0.5 * (positions[:, J["left_hip"]] + positions[:, J["right_hip"]])
    axis = positions[:, J["neck"]] - low
    points = positions[:, [J[f"{side}_{name}"] for side in ("left", "right") for name in ("elbow", "wrist")]]
    along = np.einsum("tkj,tj->tk", points - low[:, None], axis) / np.maximum((axis**2).sum(axis=1), 1e-9)[:, None]
    nearest = low[:, None] + np.clip(along, 0.0, 1.0)[..., None] * axis[:, None]
    return float(np.linalg.norm(points - nearest, axis=2).min())
