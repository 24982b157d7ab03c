"""Stick figures: poses of a motion side by side, in metres."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from dousa.app.pictures.canvas import BLUE, FAINT, GREY, INK, VERMILLION
from dousa.arrays import FloatArray
from dousa.motion import CANONICAL_PARENTS, JOINT_INDEX
from dousa.motion.types import Motion, Trajectories

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.motion import CanonicalMotion

Drawable: TypeAlias = "Motion | Trajectories | CanonicalMotion"
"""What a stick figure can be drawn of."""

# Where the viewer stands: degrees from the front towards the person's right.
FRONT, THREE_QUARTER, SIDE = 0.0, 35.0, 90.0

_HEAD_RADIUS = 0.055  # statures
_FARTHEST = 1e9  # m


@dataclass(frozen=True, slots=True)
class Limb:
    """How one side is drawn; colour, line and marker each suffice to tell it."""

    label: str
    side: str
    colour: str
    line: Any
    marker: str


LIMBS = (
    Limb("left arm and leg", "left_", BLUE, "-", "o"),
    Limb("right arm and leg", "right_", VERMILLION, (0, (2.4, 0.9)), "s"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Figurine:
    """A motion ready to draw: canonical joints, or bare points with the tree they hang in, if known.

    Parameters
    ----------
    positions : (T, K, 3) m, Y up, turned to face +Z in the first frame; NaN where missing.
    frame_rate : Hz.
    parents : (K,) -1 for a root; None if unknown.
    height : m, of the person, or of the cloud of points.
    canonical : whether the points are the canonical joints.
    """

    positions: FloatArray
    frame_rate: float
    parents: tuple[int, ...] | None
    height: float
    canonical: bool


def to_figurine(motion: Motion | Trajectories | CanonicalMotion) -> Figurine:
    """Canonical joints where they can be told apart, else the points as they are."""
    from dousa.errors import InvalidMotionError, JointMappingError
    from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories

    if not isinstance(motion, CanonicalMotion):
        trajectories = compute_trajectories(motion) if isinstance(motion, Motion) else motion
        with suppress(JointMappingError):
            motion = canonicalise(motion, any_skeleton=True)
    if isinstance(motion, CanonicalMotion):
        return Figurine(_face_viewer(motion.positions), motion.frame_rate, CANONICAL_PARENTS, motion.height, True)
    positions = trajectories.positions
    seen = positions[np.isfinite(positions).all(axis=2)]
    height = float(np.ptp(seen[:, 1])) if len(seen) else 1.0
    if len(seen) and not np.abs(seen).max() < _FARTHEST:
        raise InvalidMotionError("pictures.beyond_measure")
    parents = None if trajectories.parents is None else tuple(int(p) for p in trajectories.parents)
    return Figurine(positions, trajectories.frame_rate, parents, max(height, 1e-3), False)


def _face_viewer(positions: FloatArray) -> FloatArray:
    """Turned about the vertical so that the person of the first frame faces +Z."""
    first = positions[0]
    across = first[JOINT_INDEX["left_hip"]] - first[JOINT_INDEX["right_hip"]]
    across = across + first[JOINT_INDEX["left_shoulder"]] - first[JOINT_INDEX["right_shoulder"]]
    length = np.hypot(across[0], across[2])
    if not length > 1e-9:
        return positions
    c, s = across[0] / length, across[2] / length
    # x along the line from the right to the left side; z = x cross y
    turned: FloatArray = positions @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return turned


def _project(positions: FloatArray, view: float) -> FloatArray:
    """Screen coordinates (..., 2): the viewer looks at the origin, up is up."""
    angle = np.radians(view)
    x = positions[..., 0] * np.cos(angle) + positions[..., 2] * np.sin(angle)
    return np.stack((x, positions[..., 1]), axis=-1)


def _place(figurine: Figurine, frames: Sequence[int], view: float) -> FloatArray:
    """Screen coordinates (N, K, 2) of the frames: each pose about x = 0, the floor of the motion at y = 0."""
    flat = _project(figurine.positions, view)
    heights = flat[..., 1][np.isfinite(flat[..., 1])]
    floor = heights.min() if len(heights) else 0.0
    poses: FloatArray = flat[list(frames)] - np.array([0.0, floor])
    if figurine.canonical:
        centres = poses[:, 0, 0]
    else:
        x = poses[..., 0]
        known = np.isfinite(x)
        centres = np.where(known, x, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    poses[..., 0] -= centres[:, None]
    return poses


def draw_poses(axes: Any, figurine: Figurine, frames: Sequence[int], view: float, spacing: float) -> None:
    """Draw poses side by side, `spacing` m apart, on axes whose unit is the metre, over a floor line."""
    poses = _place(figurine, frames, view)
    poses[..., 0] += spacing * np.arange(len(frames))[:, None]
    axes.plot([-0.5 * spacing, (len(frames) - 0.5) * spacing], [0, 0], color=FAINT, lw=1.0, zorder=0)
    if figurine.canonical:
        _draw_people(axes, poses, figurine.height, view)
    else:
        _draw_points(axes, poses, figurine.parents)


def extent(figurine: Figurine, frames: Sequence[int], view: float) -> tuple[float, float]:
    """Spacing (m) at which neighbouring poses do not touch, and the highest point (m) above the floor."""
    poses = _place(figurine, frames, view)
    known = np.isfinite(poses).all(axis=2)
    if not known.any():
        return 1.0, 1.0
    girth = _HEAD_RADIUS * figurine.height if figurine.canonical else 0.0
    left = np.where(known, -poses[..., 0], 0.0).max(axis=1) + girth
    right = np.where(known, poses[..., 0], 0.0).max(axis=1) + girth
    between = right[:-1] + left[1:]
    spacing = max(between.max(initial=0.0), 1.7 * left[0], 1.7 * right[-1])
    return float(spacing), max(float(poses[..., 1][known].max()) + girth, 1e-3)


def _lines(axes: Any, poses: FloatArray, chains: Sequence[Sequence[int]], **style: Any) -> None:
    """The same polylines in every pose, drawn as one, which is many times faster."""
    gap = np.full((len(poses), 1, 2), np.nan)
    parts = [np.concatenate((poses[:, list(chain)], gap), axis=1).reshape(-1, 2) for chain in chains]
    x, y = np.concatenate(parts).T
    axes.plot(x, y, solid_capstyle="round", dash_capstyle="butt", **style)


def _draw_people(axes: Any, poses: FloatArray, height: float, view: float) -> None:
    from matplotlib.collections import EllipseCollection

    def indices(*names: str) -> list[int]:
        return [JOINT_INDEX[name] for name in names]

    _lines(axes, poses, [indices("pelvis", "spine", "neck", "head")], color=INK, lw=2.0, zorder=3)
    for limb in LIMBS:
        # From the side the right limbs are nearer to the viewer than the left ones.
        depth = 2.0 if view > 0 and limb.side == "left_" else 4.0
        arm, leg = (
            indices(*(limb.side + joint for joint in chain))
            for chain in (("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "toe"))
        )
        girdles = [[*indices("neck"), arm[0]], [*indices("pelvis"), leg[0]]]
        _lines(axes, poses, girdles, color=INK, lw=1.4, zorder=3)
        _lines(axes, poses, [arm, leg], color=limb.colour, ls=limb.line, lw=1.7, zorder=depth)
        tips = poses[:, [arm[-1], leg[-1]]].reshape(-1, 2)
        axes.plot(*tips.T, ls="", marker=limb.marker, ms=3.0, color=limb.colour, zorder=depth + 0.5)
    size = np.full(len(poses), 2 * _HEAD_RADIUS * height)
    heads = EllipseCollection(
        size, size, np.zeros(len(poses)), units="xy", offsets=poses[:, JOINT_INDEX["head"]],
        offset_transform=axes.transData, facecolor="white", edgecolor=INK, lw=1.4, zorder=3.5,
    )  # fmt: skip
    axes.add_collection(heads)


def _draw_points(axes: Any, poses: FloatArray, parents: Sequence[int] | None) -> None:
    bones = [(child, parent) for child, parent in enumerate(parents or ()) if parent >= 0]
    if bones:
        _lines(axes, poses, bones, color=GREY, lw=1.0, zorder=2)
    axes.plot(*poses.reshape(-1, 2).T, ls="", marker="o", ms=2.6, color=BLUE, zorder=3)
