"""A body to draw: canonical joints turned towards the viewer, placed on the picture, as limbs, trunk and head."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from dousa.app.drawing.markup import Svg
from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import SEGMENT_JOINTS, SEGMENTS
from dousa.motion import CANONICAL_PARENTS
from dousa.motion import JOINT_INDEX as J
from dousa.motion.types import Motion, Trajectories

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion


LIMB_JOINTS = (
    ("left_shoulder", "left_elbow", "left_wrist", "left_hand"),
    ("right_shoulder", "right_elbow", "right_wrist", "right_hand"),
    ("left_hip", "left_knee", "left_ankle", "left_toe"),
    ("right_hip", "right_knee", "right_ankle", "right_toe"),
)
_TRUNK = ("left_shoulder", "right_shoulder", "right_hip", "left_hip")

# Shares of the stature: segment lengths and half widths of a grown person (after Winter 2009, table 4.1).
_LENGTHS = {"trunk": 0.288, "upper_arm": 0.186, "forearm": 0.146, "thigh": 0.245, "shank": 0.246}
_SHOULDER, _HIP, _NECK_TO_HEAD = 0.11, 0.055, 0.1


@dataclass(frozen=True, slots=True)
class Placement:
    """How metres become places on the drawing: ``x = left + scale * metres``, ``y = bottom - scale * metres``.

    Parameters
    ----------
    scale : units of the drawing per metre.
    left, bottom : where the origin lies.
    """

    scale: float
    left: float
    bottom: float

    def to_drawing(self, points: FloatArray) -> FloatArray:
        """(..., 2) places of (..., 3) m, seen along the depth axis."""
        out = np.empty((*points.shape[:-1], 2))
        out[..., 0] = self.left + self.scale * points[..., 0]
        out[..., 1] = self.bottom - self.scale * points[..., 1]
        return out


def compute_heading(points: FloatArray) -> float:
    """Heading of one pose (20, 3): rad from +Z towards the body's left; 0 if it is undefined."""
    across = points[J["left_hip"]] - points[J["right_hip"]]
    across = across + points[J["left_shoulder"]] - points[J["right_shoulder"]]
    if not np.isfinite(across).all() or math.hypot(across[0], across[2]) < 1e-6:
        return 0.0
    return math.atan2(-across[2], across[0])


def turn(points: FloatArray, angle: float) -> FloatArray:
    """Points (..., 3) turned about the vertical by so many rad, to the left of a person who stands there."""
    cosine, sine = math.cos(angle), math.sin(angle)
    matrix = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    turned: FloatArray = points @ matrix.T
    return turned


def measure_body(positions: FloatArray) -> float:
    """Length of trunk, thigh and shank together over a motion (T, 20, 3), m: what figures are scaled by."""
    sample = positions[np.linspace(0, len(positions) - 1, min(len(positions), 32)).round().astype(int)]
    total = 0.0
    for start, end in (("pelvis", "neck"), ("left_hip", "left_knee"), ("left_knee", "left_ankle")):
        total += float(np.median(np.linalg.norm(sample[:, J[end]] - sample[:, J[start]], axis=1)))
    return total if math.isfinite(total) and total > 1e-6 else 1.0


def place(poses: Iterable[FloatArray], width: float, height: float, margin: float = 14.0) -> Placement:
    """One placement that shows all poses (K, 3) whole, standing on the lowest point of any of them."""
    points = np.concatenate([np.reshape(pose, (-1, 3)) for pose in poses])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return Placement(1.0, width / 2, height - margin)
    low, high = points.min(axis=0), points.max(axis=0)
    across, up = max(high[0] - low[0], 1e-6), max(high[1] - low[1] + 0.15, 1e-6)
    scale = min((width - 2 * margin) / across, (height - 2 * margin) / up)
    return Placement(scale, width / 2 - scale * (low[0] + high[0]) / 2, height - margin + scale * float(low[1]))


def _path(svg: Svg, places: FloatArray, names: Sequence[str], css_class: str) -> None:
    svg.line([(float(x), float(y)) for x, y in places[[J[name] for name in names]]], css_class)


def draw_body(
    svg: Svg, pose: FloatArray, placement: Placement, css_class: str, sides: str = "", *, head: float = 0.075
) -> None:
    """Draw one pose.

    Parameters
    ----------
    svg : to draw on.
    pose : (20, 3) m, turned already so that +Z is towards the viewer.
    placement : from `place`.
    css_class : ``"reference"``, ``"performance"`` ...: colour and width of the lines.
    sides : two letters, for left and right, that are written at the hands; empty for none.
    head : radius of the head, a share of 2.6 times the trunk's length; a larger one stands out in small drawings.
    """
    places = placement.to_drawing(pose)
    if not np.isfinite(places).all():
        return
    trunk = places[[J[name] for name in _TRUNK]]
    svg.add("polygon", {"points": " ".join(f"{x:.1f},{y:.1f}" for x, y in trunk), "class": f"trunk {css_class}"})
    far_first = sorted(LIMB_JOINTS, key=lambda names: float(pose[[J[name] for name in names], 2].mean()))
    for names in far_first:
        _path(svg, places, names, f"limb {css_class}")
    _path(svg, places, ("neck", "head"), f"limb {css_class}")
    stature = float(np.linalg.norm(pose[J["neck"]] - pose[J["pelvis"]])) * 2.6
    radius = max(head * stature * placement.scale, 2.0)
    x, y = map(float, places[J["head"]])
    svg.add("circle", {"cx": x, "cy": y, "r": radius, "class": f"head {css_class}"})
    if sides:
        middle = float(places[J["neck"], 0])
        for letter, name in zip(sides, ("left_hand", "right_hand"), strict=True):
            x, y = (float(v) for v in places[J[name]])
            outward = 9.0 if x >= middle else -9.0
            svg.add("text", {"x": x + outward, "y": y + 4.0, "class": "side"}, letter)


def draw_limb(svg: Svg, pose: FloatArray, placement: Placement, segments: Iterable[str], css_class: str) -> None:
    """Draw some segments thick over a pose: an edge below, the class above it; ``"wrong"`` gets stripes too."""
    places = placement.to_drawing(pose)
    lines = [_ends(places, name) for name in segments]
    for layer in ("edge", css_class, *(("stripes",) if css_class == "wrong" else ())):
        for line in lines:
            svg.line(line, layer)


def _ends(places: FloatArray, segment: str) -> tuple[tuple[float, float], tuple[float, float]]:
    start, end = (places[J[name]] for name in SEGMENT_JOINTS[SEGMENTS.index(segment)])
    return (float(start[0]), float(start[1])), (float(end[0]), float(end[1]))


def hang_segments(segments: FloatArray) -> FloatArray:
    """A pose (20, 3) m of a typical person 1.7 m tall out of nine unit segments (9, 3) that face +Z.

    Hands and toes lie on wrists and ankles, since the nine segments do not contain them.
    """
    size = np.linalg.norm(segments, axis=1, keepdims=True)
    unit = segments / np.where(size > 1e-9, size, 1.0)
    part = {name: unit[k] * _LENGTHS.get(name, 0.0) for k, name in enumerate(SEGMENTS)}
    for name in SEGMENTS[1:]:
        part[name] = unit[SEGMENTS.index(name)] * _LENGTHS[name.split("_", 1)[1]]
    left = np.array([1.0, 0.0, 0.0])
    pose = np.zeros((20, 3))
    pose[J["neck"]] = part["trunk"]
    pose[J["spine"]] = part["trunk"] / 2
    pose[J["head"]] = part["trunk"] + _NECK_TO_HEAD * unit[0]
    for sign, side in ((1.0, "left"), (-1.0, "right")):
        shoulder = pose[J["neck"]] + sign * _SHOULDER * left - 0.02 * unit[0]
        chain = (("shoulder", shoulder), ("hip", sign * _HIP * left))
        for root, start in chain:
            upper, lower, middle, end, tip = (
                ("upper_arm", "forearm", "elbow", "wrist", "hand")
                if root == "shoulder"
                else ("thigh", "shank", "knee", "ankle", "toe")
            )
            pose[J[f"{side}_{root}"]] = start
            pose[J[f"{side}_{middle}"]] = start + part[f"{side}_{upper}"]
            pose[J[f"{side}_{end}"]] = pose[J[f"{side}_{middle}"]] + part[f"{side}_{lower}"]
            pose[J[f"{side}_{tip}"]] = pose[J[f"{side}_{end}"]]
    hung: FloatArray = 1.7 * pose
    return hung


Drawable: TypeAlias = "Motion | Trajectories | CanonicalMotion"
"""What a stick figure can be drawn of."""

# Where the viewer stands: degrees from the front towards the person's right.
FRONT, THREE_QUARTER, SIDE = 0.0, 35.0, 90.0


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
    """Convert a motion to canonical joints where they are recognised, else to its points as they are."""
    from dousa.errors import InvalidMotionError, JointMappingError
    from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories

    if not isinstance(motion, CanonicalMotion):
        trajectories = compute_trajectories(motion) if isinstance(motion, Motion) else motion
        with suppress(JointMappingError):
            motion = canonicalise(motion, any_skeleton=True)
    if isinstance(motion, CanonicalMotion):
        return Figurine(face_viewer(motion.positions), motion.frame_rate, CANONICAL_PARENTS, motion.height, True)
    positions = trajectories.positions
    seen = positions[np.isfinite(positions).all(axis=2)]
    height = float(np.ptp(seen[:, 1])) if len(seen) else 1.0
    if len(seen) and not np.abs(seen).max() < 1e9:
        raise InvalidMotionError("pictures.beyond_measure")
    parents = None if trajectories.parents is None else tuple(int(p) for p in trajectories.parents)
    return Figurine(positions, trajectories.frame_rate, parents, max(height, 1e-3), False)


def face_viewer(positions: FloatArray) -> FloatArray:
    """Positions (T, 20, 3) turned about the vertical so that the person of the first frame faces +Z."""
    return turn(positions, -compute_heading(positions[0]))


def project(positions: FloatArray, view: float) -> FloatArray:
    """Places (..., 2) on the picture of (..., 3) m, seen from so many degrees towards the person's right."""
    return turn(positions, np.radians(view))[..., :2]


def place_poses(figurine: Figurine, frames: Sequence[int], view: float) -> FloatArray:
    """Screen coordinates (N, K, 2) of the frames: each pose about x = 0, the floor of the motion at y = 0."""
    flat = project(figurine.positions, view)
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


def head_radius(height: float, share: float = 0.055) -> float:
    """The radius (m) of a stick figure's head: ``share`` of its stature, more for one that hides more behind it."""
    return share * height


def extent(figurine: Figurine, frames: Sequence[int], view: float) -> tuple[float, float]:
    """Spacing (m) at which neighbouring poses do not touch, and the highest point (m) above the floor."""
    poses = place_poses(figurine, frames, view)
    known = np.isfinite(poses).all(axis=2)
    if not known.any():
        return 1.0, 1.0
    girth = head_radius(figurine.height) if figurine.canonical else 0.0
    left = np.where(known, -poses[..., 0], 0.0).max(axis=1) + girth
    right = np.where(known, poses[..., 0], 0.0).max(axis=1) + girth
    between = right[:-1] + left[1:]
    spacing = max(between.max(initial=0.0), 1.7 * left[0], 1.7 * right[-1])
    return float(spacing), max(float(poses[..., 1][known].max()) + girth, 1e-3)
