"""What an injected error is in truth: when it can be seen, which segments, how much; and whether it counts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation._injection_body import (
    Take,
    measure_angles,
    measure_segments,
    put_together,
    turn,
    turn_onto,
)
from dousa.evaluation._injection_edits import Edit, Window
from dousa.evaluation.posture import SEGMENTS
from dousa.motion._types import FloatArray
from dousa.motion.joints import JOINT_INDEX as J

__all__ = ["Error", "Limits", "find_truth", "measure_range"]

_CORE = 0.9  # weight from which an error is wholly there
_MOST_FRAMES = 100  # of a window, for the range: more change it by less than a degree
_OTHER_TIMES_S = np.linspace(-1.0, 1.0, 21)
_WITHIN_S = 0.5  # a limb that is where it was within this time is early or late rather than wrong

# What joints allow, heading-free (left +X, front +Z): generous, against arms through the trunk and legs that
# no hip lets go there. The clean motion is never held to it.
_TRUNK_RADIUS = 0.07  # of the body height
_BEHIND_ARM, _ACROSS_ARM = -0.75, 0.7
_BEHIND_LEG, _ACROSS_LEG, _RAISED_LEG = -0.6, 0.45, 0.35


@dataclass(frozen=True, slots=True)
class Error:
    """One injected error: the truth that an assessment is held to.

    Parameters
    ----------
    kind : ``"global"``, ``"partial"``, ``"incomplete"`` or ``"shift"``.
    variant : what it looks like, of `VARIANTS`.
    start_s, end_s : first and last moment at which it can be seen.
    segments : names of the segments that are wrong; all nine for a shift and a global error.
    lag_ms : how late at the most (positive) or early (negative), of a shift.
    shortfall_deg, shortfall_percent : how much range the most affected segment lost, of an incomplete motion.
    """

    kind: str
    variant: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None
    shortfall_percent: float | None = None

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class Limits:
    """What an error must be to count as one that a teacher would see; smaller ones are not injected.

    All angles are in degrees between the segments of the injected and the clean motion, before any performer
    noise, after the yaw between the two is taken out (shift, global, stops short).

    Parameters
    ----------
    seen_deg : a moment counts as seen if some segment is off by this; the truth runs from the first such moment
        to the last, where the error is at least a quarter there.
    seen_share : of the moments between them that must be seen.
    shortest_s : what must be left of the window.
    shift_rms, shift_peak : root mean square over all segments and moments; the most moved segment's 90th
        percentile.
    shortfall_deg, shortfall_percent : loss of range of the most affected segment.
    partial_mean, partial_low, partial_share : mean of the most wrong segment, and what it exceeds for this
        share of the time.
    partial_outside : median distance of the limb from all that it does within half a second: a limb in its
        own place at another time would be a shift.
    global_mean, global_segment, n_global : mean over segments; what this many segments exceed.
    global_elsewhen : mean distance to the clean motion shifted by up to 1 s, at the best shift.
    most_share : of the motion's length, the longest window.
    """

    seen_deg: float = 8.0
    seen_share: float = 0.6
    shortest_s: float = 0.4
    shift_rms: float = 6.0
    shift_peak: float = 15.0
    shortfall_deg: float = 15.0
    shortfall_percent: float = 20.0
    partial_mean: float = 25.0
    partial_low: float = 12.0
    partial_share: float = 0.7
    partial_outside: float = 15.0
    global_mean: float = 25.0
    global_segment: float = 15.0
    n_global: int = 5
    global_elsewhen: float = 20.0
    most_share: float = 0.45


def measure_range(directions: FloatArray) -> FloatArray:
    """The largest angle between any two directions over time, degrees.

    Parameters
    ----------
    directions : (T, K, 3) unit vectors.

    Returns
    -------
    (K,) degrees; at most 100 evenly spread frames are looked at.
    """
    few = directions[
        np.linspace(0, len(directions) - 1, min(len(directions), _MOST_FRAMES)).round().astype(int)
    ]
    cosines = np.einsum("tkc,ukc->ktu", few, few)
    widest: FloatArray = np.degrees(np.arccos(np.clip(cosines.min(axis=(1, 2)), -1.0, 1.0)))
    return widest


@dataclass(frozen=True, slots=True, eq=False)
class _Compared:
    """Injected and clean segments over the seen part of a window."""

    kind: str
    take: Take
    first: int  # frame of the take
    wrong: FloatArray  # (n, 9, 3) world
    clean: FloatArray  # (n, 9, 3) world
    angles: FloatArray  # (n, 9) degrees
    core: NDArray[np.bool_]  # (n,) where the error is wholly there
    segments: tuple[int, ...]


def find_truth(
    kind: str, variant: str, take: Take, window: Window, edit: Edit, limits: Limits
) -> Error | None:
    """The error that an edit makes; None if it cannot be seen, or cannot be done by a body."""
    positions = put_together(edit.body)
    wrong, clean = measure_segments(positions), take.segments[window.start : window.stop]
    turned = kind in ("shift", "global") or variant == "stops short"
    angles = measure_angles(turn_onto(wrong, clean) if turned else wrong, clean)
    seen = (angles[:, edit.segments].max(axis=1) >= limits.seen_deg) & (edit.weight >= 0.25)
    moments = np.flatnonzero(seen)
    if len(moments) < max(limits.shortest_s * take.frame_rate, 2.0):
        return None
    first, last = moments[0], moments[-1] + 1
    if seen[first:last].mean() < limits.seen_share:
        return None
    if kind == "partial" and not _is_possible(take, window, edit, positions):
        return None
    part = slice(first, last)
    compared = _Compared(
        kind,
        take,
        window.start + int(first),
        wrong[part],
        clean[part],
        angles[part],
        edit.weight[part] >= _CORE,
        edit.segments,
    )
    changed = compared.angles.max(axis=0)[list(edit.segments)] >= limits.seen_deg
    whole = kind in ("shift", "global")
    error = Error(
        kind,
        variant,
        start_s=compared.first / take.frame_rate,
        end_s=(window.start + int(last)) / take.frame_rate,
        segments=SEGMENTS
        if whole
        else tuple(SEGMENTS[s] for s, off in zip(edit.segments, changed, strict=True) if off),
        lag_ms=None if edit.lag_s is None else 1000.0 * edit.lag_s,
    )
    return _JUDGES[kind](error, compared, limits)


def _judge_shift(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    rms = np.sqrt((compared.angles**2).mean())
    peak = np.percentile(compared.angles, 90, axis=0).max()
    return error if rms >= limits.shift_rms and peak >= limits.shift_peak else None


def _judge_incomplete(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    heading = compared.take.heading[compared.first : compared.first + len(compared.wrong)]
    full = measure_range(turn(compared.clean, -heading))
    loss = full - measure_range(turn(compared.wrong, -heading))
    most = max(compared.segments, key=lambda segment: loss[segment])
    percent = 100.0 * loss[most] / max(full[most], 1e-6)
    if loss[most] < limits.shortfall_deg or percent < limits.shortfall_percent:
        return None
    return replace(error, shortfall_deg=float(loss[most]), shortfall_percent=float(percent))


def _judge_partial(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    if not compared.core.any():
        return None
    angles = compared.angles[:, compared.segments]
    most = int(angles.mean(axis=0).argmax())
    low = (angles.max(axis=1) >= limits.partial_low).mean()
    if angles[:, most].mean() < limits.partial_mean or low < limits.partial_share:
        return None
    reach = int(_WITHIN_S * compared.take.frame_rate)
    around = compared.take.segments[max(compared.first - reach, 0) : compared.first + len(angles) + reach]
    wrong = compared.wrong[compared.core][:, None, compared.segments]
    step = max(len(around) // 60, 1)
    nearest = measure_angles(wrong, around[None, ::step, compared.segments]).max(axis=2).min(axis=1)
    return error if np.median(nearest) >= limits.partial_outside else None


def _judge_global(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    if not compared.core.any():
        return None
    means = compared.angles.mean(axis=0)
    if means.mean() < limits.global_mean or (means >= limits.global_segment).sum() < limits.n_global:
        return None
    frames = compared.first + np.flatnonzero(compared.core)
    wrong = compared.wrong[compared.core]
    for time in _OTHER_TIMES_S:
        there = np.clip(frames + round(time * compared.take.frame_rate), 0, compared.take.n_frames - 1)
        clean = compared.take.segments[there]
        if measure_angles(turn_onto(wrong, clean), clean).mean() < limits.global_elsewhen:
            return None
    return error


_JUDGES = {
    "shift": _judge_shift,
    "incomplete": _judge_incomplete,
    "partial": _judge_partial,
    "global": _judge_global,
}


def _is_possible(take: Take, window: Window, edit: Edit, positions: FloatArray) -> bool:
    """Whether joints could do this, as far as a rough look tells."""
    clean = put_together(take.body.cut(window.start, window.stop))
    height = float(np.median(clean[..., 1].max(axis=1) - clean[..., 1].min(axis=1)))
    radius = _TRUNK_RADIUS * height
    for name in ("left_elbow", "right_elbow", "left_wrist", "right_wrist"):
        before, after = _from_trunk(clean, name).min(), _from_trunk(positions, name).min()
        if after < min(radius, before):
            return False
    heading = take.heading[window.start : window.stop]
    after, before = (turn(points, -heading) for points in (positions, clean))
    return not any(_bends_too_far(after, before, side) for side in ("left", "right"))


def _from_trunk(positions: FloatArray, name: str) -> FloatArray:
    """(T,) distance of a joint from the line from pelvis to neck."""
    base, top = positions[:, J["pelvis"]], positions[:, J["neck"]]
    along = top - base
    point = positions[:, J[name]] - base
    share = (point * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-9)
    distance: FloatArray = np.linalg.norm(point - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)
    return distance


def _bends_too_far(after: FloatArray, before: FloatArray, side: str) -> bool:
    outward = np.array([1.0 if side == "left" else -1.0, 0.0, 0.0])
    back, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    checks = (
        ("shoulder", "elbow", back, -_BEHIND_ARM),
        ("shoulder", "elbow", -outward, _ACROSS_ARM),
        ("hip", "knee", back, -_BEHIND_LEG),
        ("hip", "knee", -outward, _ACROSS_LEG),
        ("hip", "knee", up, _RAISED_LEG),
    )
    for start, end, way, most in checks:
        far = []
        for positions in (before, after):
            bone = positions[:, J[f"{side}_{end}"]] - positions[:, J[f"{side}_{start}"]]
            far.append(((bone @ way) / np.maximum(np.linalg.norm(bone, axis=1), 1e-9)).max())
        if far[1] > max(most, far[0]) + 1e-6:
            return True
    return False
