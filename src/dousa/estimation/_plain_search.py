"""The search of Kameda, Minoh and Ikeda written down plainly, to hold ways of placing candidates side by side.

The tracker of `dousa.estimation.tracker` is the one to use. This one knows no beam, no revisits and no smoothing, and
differs in one thing only between its ways: whether an angle's candidates lie over the whole range of the joint, as
before inertia was introduced, within what inertia allows, or there and weighed. So it tells what inertia is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from dousa.motion import rotations as rot

if TYPE_CHECKING:
    from dousa.estimation._types import Reading
    from dousa.estimation.body import BodyModel
    from dousa.estimation.camera import Camera
    from dousa.estimation.silhouettes import Silhouettes

__all__ = ["REACHES", "Reach", "search_plainly"]

FloatArray = NDArray[np.float64]
Bits = NDArray[np.uint64]
Reach = Literal["range", "near", "inertia"]

REACHES: tuple[Reach, ...] = ("range", "near", "inertia")

_TIE = 1e-12  # W of one candidate and mismatch of another can make up for each other exactly
_SLACK = 1e-9  # rad: an angle at its limit is within it


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What does not change from candidate to candidate."""

    body: BodyModel
    cameras: tuple[Camera, ...]
    reading: Reading
    reach: Reach
    max_change: float
    root_change: float
    half: int

    def draw(self, poses: FloatArray, first: int, stop: int) -> list[Bits]:
        """Bits (C, H, words) for every view of the parts from first to before stop in poses (C, 7 + A)."""
        from dousa.estimation._raster_kernels import draw_layers
        from dousa.estimation.kinematics import place_parts
        from dousa.estimation.rasteriser import outline_scratch

        rotations, positions = (np.ascontiguousarray(a[:, first:stop]) for a in place_parts(self.body, poses))
        starts = self.body.sphere_starts[first : stop + 1]
        solids = (self.body.spheres[starts[0] : starts[-1]], starts - starts[0])
        layers = np.zeros(stop - first, np.intp)
        views = []
        for camera in self.cameras:
            bits = np.zeros((len(poses), 1, camera.height, -(-camera.width // 64)), np.uint64)
            work = outline_scratch(self.body, camera.height)
            draw_layers(rotations, positions, solids, camera.to_row(), camera.width, layers, work, bits)
            views.append(bits[:, 0])
        return views


def search_plainly(
    silhouettes: Silhouettes,
    cameras: Sequence[Camera],
    body: BodyModel,
    start: FloatArray,
    *,
    known: FloatArray | None = None,
    reading: Reading,
    reach: Reach,
    max_change: float,
    root_change: float,
    n_candidates: int = 13,
) -> FloatArray:
    """Follow silhouettes from the root to the leaves, one axis at a time.

    Parameters
    ----------
    silhouettes : (V, T); every view has an image in every frame.
    cameras : (V,).
    body : with A joint angles.
    start : (7 + A,) pose of the first frame.
    known : (T, 7 + A) poses that every frame is predicted from, so that no error lives on; by default those found.
    reading : of eq. 2.
    reach : ``"range"``: candidates over the whole range of each joint, W = 1; ``"near"``: within max_change of the
        prediction (eq. 1), W = 1; ``"inertia"``: the same, weighed by W (eq. 3) as eq. 2 has it. The root, which has no
        range, is searched within max_change and root_change in any case.
    max_change : rad, the dR of eq. 1, at the rate of the silhouettes.
    root_change : m, the same for the root's place.
    n_candidates : of each axis, odd.

    Returns
    -------
    (T, 7 + A) poses. Among candidates of one score the one nearest to the prediction wins; with the range, the one
    nearest to the angle of the frame before, which is more than the method had.
    """
    from dousa.estimation.rasteriser import pack_bits

    scene = _Scene(body, tuple(cameras), reading, reach, max_change, root_change, n_candidates // 2)
    poses = [np.array(start, np.float64)]
    for frame in range(1, silhouettes.n_frames):
        bits = []
        for mask in silhouettes.read(frame):
            assert mask is not None, "the plain search takes views without gaps"
            bits.append(pack_bits(mask))
        past = poses if known is None else known[:frame]
        predicted = _predict(past[max(frame - 2, 0)], past[frame - 1], body.angle_limits)
        if reach == "range":
            predicted[7:] = past[frame - 1][7:]
        poses.append(_search_frame(scene, bits, predicted))
    return np.stack(poses)


def _predict(before: FloatArray, last: FloatArray, limits: FloatArray) -> FloatArray:
    """Constant velocity."""
    pose = 2.0 * last - before
    turn = rot.multiply(rot.conjugate(before[3:7]), last[3:7])
    pose[3:7] = rot.multiply(last[3:7], turn)
    pose[3:7] /= np.linalg.norm(pose[3:7])
    pose[7:] = np.clip(pose[7:], limits[:, 0], limits[:, 1])
    return pose


def _search_frame(scene: _Scene, silhouettes: list[Bits], predicted: FloatArray) -> FloatArray:
    pose = predicted.copy()
    fixed = [np.zeros_like(bits) for bits in silhouettes]
    starts = scene.body.angle_starts
    for part in range(scene.body.n_parts):
        axes = range(6) if part == 0 else range(6 + starts[part], 6 + starts[part + 1])
        for axis in axes:
            trials, weights = _make_candidates(scene, pose, axis)
            # The whole body helps to place the root: the root's own solid is inside the trunk's silhouette.
            drawn = scene.draw(trials, part, scene.body.n_parts if part == 0 else part + 1)
            mismatch = sum(
                _count_mismatch(scene.reading, s, f, p)
                for s, f, p in zip(silhouettes, fixed, drawn, strict=True)
            )
            scores = weights / (1.0 + mismatch)  # eq. 2
            pose = trials[int(np.argmax(scores >= (1.0 - _TIE) * scores.max()))]
        placed = scene.draw(pose[None], part, part + 1)
        fixed = [f | p[0] for f, p in zip(fixed, placed, strict=True)]
    return pose


def _make_candidates(scene: _Scene, pose: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Poses (C, 7 + A), the one that wins a tie first, and their W of eq. 3."""
    steps = np.arange(-scene.half, scene.half + 1) / scene.half
    if axis >= 6 and scene.reach == "range":
        low, high = scene.body.angle_limits[axis - 6]
        angles = 0.5 * (low + high) + 0.5 * (high - low) * steps
        angles = angles[np.argsort(np.abs(angles - pose[axis + 1]), kind="stable")]
        trials = np.tile(pose, (len(angles), 1))
        trials[:, axis + 1] = angles
        return trials, np.ones(len(angles))
    steps = steps[np.argsort(np.abs(steps), kind="stable")]
    amounts = steps * (scene.root_change if axis < 3 else scene.max_change)
    weights = 1.0 - 0.25 * steps * steps  # the prediction of an axis is where the search of it begins
    if scene.reach != "inertia":
        weights = np.ones(len(steps))
    trials = np.tile(pose, (len(steps), 1))
    if axis < 3:
        trials[:, axis] += amounts
    elif axis < 6:
        turns = np.zeros((len(steps), 3))
        turns[:, axis - 3] = amounts
        trials[:, 3:7] = rot.multiply(pose[3:7], rot.from_axis_angle(turns))
    else:
        trials[:, axis + 1] += amounts
        low, high = scene.body.angle_limits[axis - 6]
        kept = (trials[:, axis + 1] >= low - _SLACK) & (trials[:, axis + 1] <= high + _SLACK)
        trials, weights = trials[kept], weights[kept]
    return trials, weights


def _count_mismatch(reading: Reading, silhouette: Bits, fixed: Bits, candidates: Bits) -> NDArray[np.intp]:
    """(C,) pixels that disagree, as eq. 2 is read; see `READINGS` of `dousa.estimation._types`."""
    if reading == "residual":
        wrong = (silhouette & ~fixed) ^ candidates
    elif reading == "masked":
        wrong = (silhouette ^ candidates) & ~fixed
    elif reading == "union":
        wrong = (silhouette | fixed) ^ candidates
    elif reading == "plain":
        wrong = silhouette ^ candidates
    else:
        wrong = (silhouette & fixed) ^ candidates
    return np.bitwise_count(wrong).sum(axis=(1, 2), dtype=np.intp)
