"""How near estimated poses come to the truth.

Conventions:

- Joints are matched by name; what only one side has is left out. Where either side is NaN nothing is compared, and
  `Accuracy.share_compared` tells how much of the truth was.
- Means are over all joints and frames that were compared, so that each counts the same.
- Nothing to compare gives NaN, never an error of zero.
- A frame is lost where its mean error exceeds `LOSS_BOUND`: by then some limb is found where another one is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, Mask
from dousa.errors import OptionError
from dousa.experiments.table import Result
from dousa.motion.canonical.joints import CANONICAL_JOINTS

if TYPE_CHECKING:
    from dousa.estimation.cameras.camera import Camera

Flags = NDArray[np.bool_]

LOSS_BOUND = 0.15
"""m, mean error of a frame above which the track counts as lost."""


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy(Result):
    """How far an estimate is from the truth.

    Parameters
    ----------
    joints : (N,) that both have.
    errors : (T, N) m, distance; NaN where nothing is compared, as in all of these arrays.
    root_errors : (T, N) m, after the hips were moved onto the true ones.
    rigid_errors : (T, N) m, after the best rotation and translation of each frame.
    segments, segment_errors : (L,) and (T, L) rad, between the directions of a segment.
    angles, angle_errors : (A,) and (T, A) rad, of the flexion of elbows and knees.
    acceleration_errors : (T - 2, N) m/s^2, length of the difference of the accelerations: how much the estimate
        trembles.
    n_true : joints times frames that the truth knows.
    frame_rate : Hz.
    loss_bound : m, mean error of a frame above which it counts as lost.
    occluded : (T, N) true where inertia alone placed a joint; None if not known.
    """

    joints: tuple[str, ...]
    errors: FloatArray
    root_errors: FloatArray
    rigid_errors: FloatArray
    segments: tuple[str, ...]
    segment_errors: FloatArray
    angles: tuple[str, ...]
    angle_errors: FloatArray
    acceleration_errors: FloatArray
    n_true: int
    frame_rate: float
    loss_bound: float = LOSS_BOUND
    occluded: Flags | None = None

    @property
    def mean_mm(self) -> float:
        """Mean joint error (MPJPE)."""
        return mean_of(self.errors) * 1e3

    @property
    def root_mm(self) -> float:
        """Mean joint error with the hips in the right place."""
        return mean_of(self.root_errors) * 1e3

    @property
    def rigid_mm(self) -> float:
        """Mean joint error of the posture alone."""
        return mean_of(self.rigid_errors) * 1e3

    @property
    def joint_mm(self) -> dict[str, float]:
        """Mean error of each joint."""
        return {name: mean_of(self.errors[:, k]) * 1e3 for k, name in enumerate(self.joints)}

    @property
    def frame_errors(self) -> FloatArray:
        """(T,) m, mean error of each frame."""
        return np.array([mean_of(row) for row in self.errors])

    @property
    def segment_deg(self) -> float:
        """Mean error of the directions of the segments."""
        return float(np.rad2deg(mean_of(self.segment_errors)))

    @property
    def angle_deg(self) -> float:
        """Mean error of the flexion of elbows and knees."""
        return float(np.rad2deg(mean_of(self.angle_errors)))

    @property
    def jitter(self) -> float:
        """Mean error of the acceleration, m/s^2."""
        return mean_of(self.acceleration_errors)

    @property
    def visible_mm(self) -> float:
        """Mean error of joints that the silhouettes told something about; NaN if not known."""
        return float("nan") if self.occluded is None else mean_of(self.errors[~self.occluded]) * 1e3

    @property
    def occluded_mm(self) -> float:
        """Mean error of joints that inertia alone placed; NaN if there was none, or if not known."""
        return float("nan") if self.occluded is None else mean_of(self.errors[self.occluded]) * 1e3

    @property
    def share_compared(self) -> float:
        """Share of the truth that the estimate has a place for."""
        return float(np.isfinite(self.errors).sum() / self.n_true) if self.n_true else float("nan")

    @property
    def lost(self) -> Flags:
        """(T,) frames whose mean error exceeds the bound."""
        return self.frame_errors > self.loss_bound

    @property
    def loss_rate(self) -> float:
        """Share of the frames compared that are lost."""
        compared = np.isfinite(self.frame_errors)
        return float(self.lost.sum() / compared.sum()) if compared.any() else float("nan")

    @property
    def recovery_s(self) -> float:
        """Mean length in seconds of the stretches of lost frames that the track came back from; NaN without any."""
        ended = [stop - first for first, stop in list_stretches(self.lost) if stop < len(self.errors)]
        return float(np.mean(ended)) / self.frame_rate if ended else float("nan")

    @property
    def is_lost(self) -> bool:
        """Whether the whole is lost: more than half of its frames are, or its last one is."""
        return bool(self.loss_rate > 0.5 or (len(self.errors) and self.lost[-1]))

    def compute_pck(self, bound: float) -> float:
        """Share of correct keypoints, 0 to 1.

        Parameters
        ----------
        bound : m, greatest error of a joint that is correct.
        """
        compared = np.isfinite(self.errors)
        return float((self.errors[compared] <= bound).mean()) if compared.any() else float("nan")

    def to_json(self) -> dict[str, Any]:
        """The numbers that sum it up, in mm, degrees, seconds and m/s^2."""
        return {
            "mean_mm": self.mean_mm,
            "root_mm": self.root_mm,
            "rigid_mm": self.rigid_mm,
            "joints_mm": self.joint_mm,
            "frames_mm": (self.frame_errors * 1e3).tolist(),
            "segment_deg": self.segment_deg,
            "angle_deg": self.angle_deg,
            "angles_deg": {
                name: float(np.rad2deg(mean_of(self.angle_errors[:, k]))) for k, name in enumerate(self.angles)
            },
            "pck_50": self.compute_pck(0.05),
            "pck_100": self.compute_pck(0.1),
            "loss_bound_mm": self.loss_bound * 1e3,
            "loss_rate": self.loss_rate,
            "is_lost": self.is_lost,
            "recovery_s": self.recovery_s,
            "visible_mm": self.visible_mm,
            "occluded_mm": self.occluded_mm,
            "jitter_m_s2": self.jitter,
            "share_compared": self.share_compared,
        }


@dataclass(frozen=True, slots=True, eq=False)
class ImageAccuracy(Result):
    """How far an estimate is from the truth in the images.

    Parameters
    ----------
    joints : (N,) that both have.
    pixels : (V, T, N) px, NaN where nothing is compared.
    shares : (V, T, N) of the stature as it measures in the image at the depth of the body.
    """

    joints: tuple[str, ...]
    pixels: FloatArray
    shares: FloatArray

    @property
    def mean_px(self) -> float:
        """Mean error in pixels."""
        return mean_of(self.pixels)

    @property
    def mean_percent(self) -> float:
        """Mean error in percent of the stature."""
        return mean_of(self.shares) * 1e2

    @property
    def view_px(self) -> tuple[float, ...]:
        """Mean error in pixels of each view."""
        return tuple(mean_of(view) for view in self.pixels)

    def to_json(self) -> dict[str, Any]:
        """The numbers that sum it up."""
        return {"mean_px": self.mean_px, "percent_of_stature": self.mean_percent, "views_px": self.view_px}


def mean_of(values: FloatArray) -> float:
    """Mean of the numbers that are no NaN; NaN if there is none."""
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if seen.size else float("nan")


def list_stretches(flags: Flags) -> list[tuple[int, int]]:
    """Runs of true values as (first, stop)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.asarray(flags, np.int8), [0]))))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]


_SIDES = ("left", "right")

SEGMENTS: dict[str, tuple[str, str]] = {
    "trunk": ("pelvis", "neck"),
    "head": ("neck", "head"),
    **{f"{side}_upper_arm": (f"{side}_shoulder", f"{side}_elbow") for side in _SIDES},
    **{f"{side}_forearm": (f"{side}_elbow", f"{side}_wrist") for side in _SIDES},
    **{f"{side}_hand": (f"{side}_wrist", f"{side}_hand") for side in _SIDES},
    **{f"{side}_thigh": (f"{side}_hip", f"{side}_knee") for side in _SIDES},
    **{f"{side}_shank": (f"{side}_knee", f"{side}_ankle") for side in _SIDES},
    **{f"{side}_foot": (f"{side}_ankle", f"{side}_toe") for side in _SIDES},
}
"""Segments whose direction is compared, from joint to joint. Those across the girdles are not among them: skeletons
disagree on where a pelvis is."""

ANGLES: dict[str, tuple[str, str, str]] = {
    **{f"{side}_elbow": (f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist") for side in _SIDES},
    **{f"{side}_knee": (f"{side}_hip", f"{side}_knee", f"{side}_ankle") for side in _SIDES},
}
"""Joints whose flexion is compared: the joint above, the joint, the joint below."""

_SHORTEST = 1e-9  # m: a segment of no length has no direction
_LEAST_POINTS = 3  # that a rigid alignment takes


def compare_with_truth(
    names: Sequence[str],
    estimated: ArrayLike,
    truth_names: Sequence[str],
    truth: ArrayLike,
    *,
    frame_rate: float = 30.0,
    occluded: ArrayLike | None = None,
    loss_bound: float = LOSS_BOUND,
) -> Accuracy:
    """Compare estimated joints with the true ones.

    Parameters
    ----------
    names : (K,) of the estimated points; canonical names, or whatever the body calls its joints.
    estimated : (T, K, 3) m.
    truth_names : (M,) of the true points.
    truth : (T, M, 3) m, NaN where it is not known.
    frame_rate : Hz.
    occluded : (T, K) true where the estimate was placed by inertia alone; None if that is not known.
    loss_bound : m, mean error of a frame above which it counts as lost.

    Returns
    -------
    The accuracy. Errors are distances: raw; after moving the hips' midpoint onto the true one (the pelvis where
    there are no hips); after the best rotation and translation of the frame, without scaling.

    Raises
    ------
    OptionError : no name in common, names that occur twice, arrays of another shape or length.
    """
    places, true = _check_points(names, estimated, "estimate"), _check_points(truth_names, truth, "truth")
    joints, rows, true_rows = _match(names, truth_names)
    if len(places) != len(true):
        raise OptionError("trials.estimate_frames", found=len(places), expected=len(true))
    if not frame_rate > 0:
        raise OptionError("trials.rate", rate=frame_rate)
    hidden = None
    if occluded is not None:
        flags = np.asarray(occluded, bool)
        if flags.shape != places.shape[:2]:
            raise OptionError("trials.occlusion", expected=places.shape[:2], found=flags.shape)
        hidden = flags[:, rows]
    places, true = places[:, rows], true[:, true_rows]
    segments = {name: ends for name, ends in SEGMENTS.items() if set(ends) <= set(joints)}
    angles = {name: ends for name, ends in ANGLES.items() if set(ends) <= set(joints)}
    return Accuracy(
        joints=joints,
        errors=_distance(places, true),
        root_errors=_distance(places - _find_root(joints, places), true - _find_root(joints, true)),
        rigid_errors=_distance(_align(places, true), true),
        segments=tuple(segments),
        segment_errors=_compare_directions(joints, tuple(segments.values()), places, true),
        angles=tuple(angles),
        angle_errors=_compare_angles(joints, tuple(angles.values()), places, true),
        acceleration_errors=_distance(np.diff(places, 2, axis=0), np.diff(true, 2, axis=0)) * frame_rate**2,
        n_true=int(np.isfinite(true).all(axis=2).sum()),
        frame_rate=float(frame_rate),
        loss_bound=float(loss_bound),
        occluded=hidden,
    )


def compare_in_images(
    names: Sequence[str],
    estimated: ArrayLike,
    truth_names: Sequence[str],
    truth: ArrayLike,
    cameras: Sequence[Camera],
    stature: float,
) -> ImageAccuracy:
    """How far estimated joints lie from the true ones in the images.

    Parameters
    ----------
    names, estimated, truth_names, truth : as for `compare_with_truth`.
    cameras : (V,) the views; they need not be those that the estimate was made from.
    stature : m, of the person.

    Returns
    -------
    Errors in pixels, and in shares of what the stature measures in the image at the depth of the body (the mean of
    the true joints). NaN for a point behind the camera.

    Raises
    ------
    OptionError : as `compare_with_truth`; no camera, or a stature that is not above 0.
    """
    places, true = _check_points(names, estimated, "estimate"), _check_points(truth_names, truth, "truth")
    joints, rows, true_rows = _match(names, truth_names)
    if len(places) != len(true) or not len(cameras) or not stature > 0:
        raise OptionError(
            "trials.image_comparison",
            found=len(places),
            expected=len(true),
            cameras=len(cameras),
            stature=stature,
        )
    places, true = places[:, rows], true[:, true_rows]
    middle = np.stack([_mean_seen(true[:, :, axis]) for axis in range(3)], axis=1)
    pixels, shares = [], []
    for camera in cameras:
        off = _distance(camera.project(places), camera.project(true))
        focal = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
        depth = np.ones(len(true)) if camera.kind == "orthographic" else camera.compute_depths(middle)
        height = focal * stature / np.where(depth > 0, depth, np.nan)
        pixels.append(off)
        shares.append(off / height[:, None])
    return ImageAccuracy(joints, np.stack(pixels), np.stack(shares))


def compute_iou(masks: ArrayLike, others: ArrayLike) -> FloatArray:
    """Overlap of masks: pixels in both by pixels in either (intersection over union).

    Parameters
    ----------
    masks, others : (..., H, W) bool.

    Returns
    -------
    (...) 0 to 1; NaN where both are empty.

    Raises
    ------
    OptionError : shapes that differ or have no height and width.
    """
    one, other = np.asarray(masks, bool), np.asarray(others, bool)
    if one.shape != other.shape or one.ndim < 2:
        raise OptionError("trials.masks", one=one.shape, other=other.shape)
    both = np.count_nonzero(one & other, axis=(-2, -1))
    either = np.count_nonzero(one | other, axis=(-2, -1))
    return np.where(either > 0, both / np.maximum(either, 1), np.nan)


def _check_points(names: Sequence[str], points: ArrayLike, what: str) -> FloatArray:
    array = np.asarray(points, np.float64)
    if array.ndim != 3 or array.shape[1:] != (len(names), 3):
        raise OptionError("trials.points", what=what, points=len(names), shape=array.shape)
    if len(set(names)) != len(names):
        raise OptionError("trials.names", what=what, found=names)
    return array


def _match(
    names: Sequence[str], truth_names: Sequence[str]
) -> tuple[tuple[str, ...], NDArray[np.intp], NDArray[np.intp]]:
    """Common names, canonical joints first and in their order, and their places on both sides."""
    common = [name for name in truth_names if name in set(names)]
    if not common:
        raise OptionError("trials.no_common_joint", names=names, truth=truth_names)
    canonical = {name: index for index, name in enumerate(CANONICAL_JOINTS)}
    common.sort(key=lambda name: canonical.get(name, len(canonical)))
    where = [np.array([list(some).index(name) for name in common], np.intp) for some in (names, truth_names)]
    return tuple(common), where[0], where[1]


def _distance(points: FloatArray, others: FloatArray) -> FloatArray:
    distance: FloatArray = np.linalg.norm(points - others, axis=-1)
    return distance


def _mean_seen(values: FloatArray) -> FloatArray:
    """Mean over the last axis of what is no NaN; NaN if there is nothing."""
    seen = np.isfinite(values)
    count = seen.sum(axis=-1)
    total = np.where(seen, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _find_root(joints: tuple[str, ...], points: FloatArray) -> FloatArray:
    """(T, 1, 3), NaN where there is none."""
    if {"left_hip", "right_hip"} <= set(joints):
        hips = points[:, [joints.index("left_hip"), joints.index("right_hip")]]
        middle: FloatArray = hips.mean(axis=1, keepdims=True)
        return middle
    if "pelvis" in joints:
        return points[:, joints.index("pelvis"), None]
    return np.full((len(points), 1, 3), np.nan)


def _align(points: FloatArray, onto: FloatArray) -> FloatArray:
    """Rotate and move the points of each frame onto others (Kabsch); NaN with fewer than three."""
    seen: Mask = np.all(np.isfinite(points + onto), axis=2)
    count = np.maximum(seen.sum(axis=1), 1)[:, None, None]
    kept, target = (np.where(seen[..., None], array, 0.0) for array in (points, onto))
    centre, goal = kept.sum(axis=1, keepdims=True) / count, target.sum(axis=1, keepdims=True) / count
    kept, target = ((kept - centre) * seen[..., None], (target - goal) * seen[..., None])
    u, _, vt = np.linalg.svd(np.swapaxes(kept, 1, 2) @ target)
    flip = np.ones((len(points), 1, 3))
    flip[:, 0, 2] = np.sign(np.linalg.det(u @ vt))
    aligned = kept @ (u * flip) @ vt + goal
    return np.where((seen & (seen.sum(axis=1) >= _LEAST_POINTS)[:, None])[..., None], aligned, np.nan)


def _angle_between(one: FloatArray, other: FloatArray) -> FloatArray:
    """rad; by atan2, which is exact for small angles too; NaN for a vector of no length."""
    across = np.linalg.norm(np.cross(one, other), axis=-1)
    angle = np.arctan2(across, (one * other).sum(axis=-1))
    short = np.minimum(np.linalg.norm(one, axis=-1), np.linalg.norm(other, axis=-1)) < _SHORTEST
    return np.where(short, np.nan, angle)


def _compare_directions(
    joints: tuple[str, ...], ends: Sequence[tuple[str, str]], points: FloatArray, truth: FloatArray
) -> FloatArray:
    start, stop = ([joints.index(pair[k]) for pair in ends] for k in (0, 1))
    return _angle_between(points[:, stop] - points[:, start], truth[:, stop] - truth[:, start])


def _compare_angles(
    joints: tuple[str, ...], ends: Sequence[tuple[str, str, str]], points: FloatArray, truth: FloatArray
) -> FloatArray:
    above, at, below = ([joints.index(three[k]) for three in ends] for k in (0, 1, 2))
    flexion = [_angle_between(p[:, at] - p[:, above], p[:, below] - p[:, at]) for p in (points, truth)]
    return np.abs(flexion[0] - flexion[1])
