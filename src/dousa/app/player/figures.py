"""One figure as the player wants it: in place over a floor, turned to the viewer, in short integers."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.motion.canonical.anthropometry import TRUNK_SHARE, stature_of_parts
from dousa.motion.canonical.geometry import STATURE_PER_HEIGHT, chain_height
from dousa.motion.canonical.joints import CANONICAL_JOINTS, CANONICAL_PARENTS, CanonicalPoses, find_absent
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.tree_shape import compute_forward, spread_frames
from dousa.motion.resampling import fill_gaps

MILLIMETRES = 1000.0  # of a metre, by definition
HIPS = [J["left_hip"], J["right_hip"]]
FEET = [J[f"{side}_{end}"] for side in ("left", "right") for end in ("ankle", "toe")]


class Posed(Protocol):
    """Canonical joints over time, such as CanonicalMotion, Trajectories of a library, PostureSequence."""

    @property
    def positions(self) -> FloatArray: ...  # (n, 20, 3) m

    @property
    def frame_rate(self) -> float: ...  # Hz


@dataclass(frozen=True, slots=True, eq=False)
class Figure(CanonicalPoses):
    """A motion that can be drawn: no gaps.

    Parameters
    ----------
    positions : (n, 20, 3) m, canonical joints, finite.
    frame_rate : Hz.
    name : of the recording.
    missing : always None: what was not seen has been filled.
    absent : joints that the body lacks; their places mean nothing.
    """

    name: str = ""
    missing: None = None
    absent: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Placed:
    """How a figure is put on the stage.

    Parameters
    ----------
    turn : rad about +Y.
    floor : m, height of the recording that becomes 0; None finds it.
    origin : frame where its path begins.
    """

    turn: float
    floor: float | None = None
    origin: int = 0


def read_figure(motion: Posed, name: str = "") -> Figure:
    """The figure of a motion; gaps are bridged in time, and a joint never seen goes where its parent is.

    A body without hips stands on a pelvis below its neck.

    Raises
    ------
    InvalidMotionError : no frame, or anything but 20 canonical joints.
    """
    positions = np.asarray(motion.positions, np.float64)
    if positions.ndim != 3 or positions.shape[1:] != (len(CANONICAL_JOINTS), 3) or len(positions) == 0:
        raise InvalidMotionError("figures.shape", shape=positions.shape)
    if isinstance(motion, Figure):
        return motion
    absent = find_absent(positions)
    if not np.isfinite(positions.sum()):
        positions = _fill(positions)
    return Figure(positions, float(motion.frame_rate), name, absent=absent)


def _fill(positions: FloatArray) -> FloatArray:
    filled = fill_gaps(np.where(np.isfinite(positions), positions, np.nan))
    lost = np.isnan(filled[0, :, 0])  # a point that is seen once is filled in all frames
    seen_hips = [hip for hip in HIPS if not lost[hip]]
    if lost[J["pelvis"]]:
        filled[:, J["pelvis"]] = filled[:, seen_hips].mean(axis=1) if seen_hips else _find_below(filled, lost)
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if lost[joint] and parent >= 0:
            filled[:, joint] = filled[:, parent]
    return filled


def _find_below(points: FloatArray, lost: BoolArray) -> FloatArray | float:
    """(n, 3) where the pelvis of a standing body is whose hips are not seen; 0 if nothing tells."""
    tops = [J[joint] for joint in ("neck", "left_shoulder", "right_shoulder") if not lost[J[joint]]]
    if not tops:
        return points[:, int(np.flatnonzero(~lost)[0])] if not lost.all() else 0.0
    stature = _finite_or(stature_of_parts(spread_frames(np.where(lost[:, None], np.nan, points))), 1.7)
    below: FloatArray = points[:, tops[0]] - np.array([0.0, TRUNK_SHARE * stature, 0.0])
    return below


def check_max_rate(max_rate: float) -> None:
    """Raise OptionError unless it is a rate."""
    if not (math.isfinite(max_rate) and max_rate > 0):
        raise OptionError("figures.max_rate", found=max_rate)


def choose_rate(
    frame_rate: float, seconds: float, max_rate: float, most_frames: int = 13_500, lowest: float = 10.0
) -> float:
    """Hz of the stored frames: `frame_rate`, or less if so many `seconds` of figures would be too large for a page.

    A frame takes 120 B, a third more as base64: ``most_frames`` are 2.2 MB. A longer take is thinned (the player draws
    between frames), but never below the ``lowest`` rate, where fast limbs would cut corners.
    """
    affordable = max(most_frames / max(seconds, 1e-9), lowest)
    return float(min(max_rate, frame_rate, affordable))


def frames_at(sequence: Posed, rate: float) -> FloatArray:
    """Places (n,) on the sequence's own frames of the frames that are stored."""
    n_frames = len(sequence.positions)
    # A hair more, so that rounding does not lose the last frame.
    last = math.floor((n_frames - 1) / sequence.frame_rate * rate + 1e-6)
    frames = np.arange(last + 1) * (sequence.frame_rate / rate)
    return np.asarray(np.minimum(frames, n_frames - 1), np.float64)


def interpolate(values: FloatArray, frames: FloatArray) -> FloatArray:
    """Values (n, ...) in a straight line between frames, at places (m,)."""
    before = np.minimum(frames.astype(int), len(values) - 1)
    after = np.minimum(before + 1, len(values) - 1)
    share = (frames - before).reshape(-1, *[1] * (values.ndim - 1))
    mixed: FloatArray = (1 - share) * values[before] + share * values[after]
    return mixed


def mean_heading(positions: FloatArray) -> float:
    """Heading, rad about +Y from +Z, that the body has on average."""
    forward = compute_forward(positions)
    total = np.nansum(forward[:, 2] + 1j * forward[:, 0])
    return float(np.angle(total)) if abs(total) > 0 else 0.0


def find_floor(positions: FloatArray, below: float = 0.5) -> float:
    """Height, m, with the feet below it in so many percent of frames: single bad ones do not lift the body."""
    return float(np.percentile(positions[:, FEET, 1].min(axis=1), below))


def turn_about_y(positions: FloatArray, turn: float) -> None:
    """Turn points (..., 3) about +Y by so many rad, in place."""
    cos, sin = math.cos(turn), math.sin(turn)
    x, z = positions[..., 0].copy(), positions[..., 2].copy()
    positions[..., 0], positions[..., 2] = cos * x + sin * z, cos * z - sin * x


def encode_figure(sequence: Posed, name: str, rate: float, placed: Placed) -> dict[str, Any]:
    """Positions turned about +Y, over the floor, about the hips' middle; the path of that middle apart."""
    figure = read_figure(sequence)
    absent = [J[joint] for joint in figure.absent]
    positions = np.array(figure.positions)
    positions[..., 1] -= find_floor(positions) if placed.floor is None else placed.floor
    turn_about_y(positions, placed.turn)
    path = positions[:, HIPS][..., [0, 2]].mean(axis=1)
    positions[..., [0, 2]] -= path[:, None]
    path = path - path[min(max(placed.origin, 0), len(path) - 1)]
    frames = frames_at(sequence, rate)
    stored = MILLIMETRES * interpolate(positions, frames)
    return {
        "name": name,
        "n_frames": len(frames),
        "shape": [len(frames), len(CANONICAL_JOINTS), 3],
        "positions": encode_array(np.clip(np.rint(stored), -32767, 32767), "<i2"),
        "path": encode_array(np.rint(np.clip(MILLIMETRES * interpolate(path, frames), -2e9, 2e9)), "<i4"),
        "stature": round(_find_stature(positions, absent), 4),
        "absent": absent,
    }


def _find_stature(positions: FloatArray, absent: Sequence[int]) -> float:
    """Height over the joints, m, of a body that may lack some."""
    if not absent:
        return _finite_or(chain_height(positions), 1.6)
    seen = spread_frames(positions).copy()
    seen[:, absent] = np.nan
    return _finite_or(stature_of_parts(seen) / STATURE_PER_HEIGHT, 1.6)


def encode_match(times: FloatArray, frames: FloatArray, end: float) -> np.ndarray:
    """Reference times (n,) ms of stored frames; -1 - the nearest valid one's where there is none.

    Parameters
    ----------
    times : (m,) s of the reference at the performance's frames, nan where there is none.
    frames : (n,) places on those frames.
    end : s, of the reference's last frame.
    """
    times = np.asarray(times, dtype=float)
    good = np.flatnonzero(np.isfinite(times) & (times >= 0) & (times <= end))
    if len(good) == 0:
        nearest = np.clip(frames / max(len(times) - 1, 1) * end, 0, end)
        return (-1 - np.rint(nearest * MILLIMETRES)).astype(np.int64)
    wanted = np.rint(frames).astype(int)
    valid = np.isin(wanted, good)
    middles = (good[1:] + good[:-1]) / 2
    nearest = times[good[np.searchsorted(middles, wanted)]]
    # Between frames the curve is straight, unless a gap lies there.
    smooth = np.where(valid, np.interp(frames, good, times[good]), nearest)
    milliseconds = np.rint(np.clip(smooth, 0, end) * MILLIMETRES).astype(np.int64)
    return np.where(valid, milliseconds, -1 - milliseconds)


def encode_array(values: np.ndarray, kind: str) -> str:
    """Base64 of the values in another type."""
    return base64.b64encode(np.ascontiguousarray(values.astype(kind)).tobytes()).decode("ascii")


def _finite_or(value: float, otherwise: float) -> float:
    return float(value) if math.isfinite(value) and value > 0 else otherwise


MINIATURE_FRAMES = 24
"""Poses of a loop, by definition of `encode_miniature`, whose bytes miniature_figure.js reads."""

MINIATURE_BYTES = 16 + MINIATURE_FRAMES * len(CANONICAL_JOINTS) * 3
"""Length of every loop, 1,456, by definition of `encode_miniature`: a header and the positions."""


def encode_miniature(motion: Posed, facing: float = -0.6) -> bytes:
    """A motion as a loop of 24 poses, evenly spread over the whole of it, in place, in a three-quarter view.

    Parameters
    ----------
    motion : canonical joints; gaps are bridged.
    facing : rad; on average the body looks past the viewer, to the left of the picture.

    Returns
    -------
    1,456 bytes, little-endian:

    ====== ============ =====================================================================================
    offset type         what
    ====== ============ =====================================================================================
    0      float32      metres per unit of the positions
    4      float32      duration, s, from the first pose to the last
    8      float32      height, m over the floor, where y is 0
    12     float32      the most telling pose (farthest from the mean pose), as a share of the loop, 0 to 1
    16     int8 x 1,440 positions (24, 20, 3): poses, canonical joints, x right, y up, z to the viewer, from
                        the point over the middle of the hips; -127 to 127, all -128 of a joint that is absent
    ====== ============ =====================================================================================

    Raises
    ------
    InvalidMotionError : no frame, or anything but 20 canonical joints.
    """
    figure = read_figure(motion)
    poses = interpolate(figure.positions, np.linspace(0, figure.n_frames - 1, MINIATURE_FRAMES))
    turn_about_y(poses, facing - mean_heading(poses))
    hips = 0.5 * (poses[:, HIPS[0]] + poses[:, HIPS[1]])
    poses[..., [0, 2]] -= hips[:, None, [0, 2]]
    poses[..., 1] -= poses[:, FEET, 1].min()
    middle = 0.5 * (poses[..., 1].min() + poses[..., 1].max())
    away = poses - poses.mean(axis=0)
    still = np.einsum("tjk,tjk->t", away, away).argmax() / (MINIATURE_FRAMES - 1)
    poses[..., 1] -= middle
    unit = max(float(np.abs(poses).max()), 1e-3) / 127
    duration = (figure.n_frames - 1) / figure.frame_rate
    header = np.array([unit, duration, middle, still], "<f4")
    stored = np.rint(poses / unit).astype(np.int8)
    stored[:, [J[joint] for joint in figure.absent]] = -128
    return header.tobytes() + stored.tobytes()
