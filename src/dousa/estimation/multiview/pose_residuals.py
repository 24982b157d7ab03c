"""Costs of a pose: reprojection of landmarks, limits of the joints, rest, and the network's own places in space.

Every term is a normal distribution in metres or radians, so that a pose's uncertainty follows from the curvature.
Errors of keypoints last for several frames, so that an image counts as a share of an independent one, and results do
not depend on the frame rate.

A network's errors in space add up from bone to bone and its scale is unknown, so vectors from joint to joint are
compared, in statures. Their biases and spreads across the view and in depth were measured on synthetic films
(``lab/trials/made_people.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import place_parts, step_poses
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.multiview.contours import Cones, contour_errors, list_cones
from dousa.estimation.multiview.landmarks import Landmarks, SeenLandmarks, join
from dousa.estimation.multiview.triangulation import pixels_per_metre, project_slope

# Measured by python -m lab.trials.made_people.
_ACROSS = (("hip", 0.018, 0.038), ("shoulder", 0.040, 0.060), ("ear", 0.050, 0.060))
"""Point -> the way from its right to its left: statures by which it is off across the view and in depth."""

# Measured by python -m lab.trials.made_people.
_BONES: tuple[tuple[str, str, float, float, tuple[float, float, float]], ...] = (
    ("neck", "hips", 0.020, 0.050, (0.0, 0.0, 0.0)),
    ("nose", "neck", 0.022, 0.035, (0.0, 0.027, -0.048)),
    ("elbow", "shoulder", 0.033, 0.053, (0.0, 0.008, -0.027)),
    ("wrist", "elbow", 0.033, 0.059, (0.0, 0.0, 0.0)),
    ("hand", "wrist", 0.016, 0.022, (0.0, -0.014, -0.010)),
    ("knee", "hip", 0.033, 0.057, (0.0, 0.0, -0.030)),
    ("ankle", "knee", 0.032, 0.056, (0.0, 0.0, 0.034)),
    ("heel", "ankle", 0.016, 0.024, (0.0, 0.0, 0.0)),
    ("toe", "ankle", 0.024, 0.047, (0.0, -0.031, -0.020)),
)
"""Point, the one it hangs on, statures by which the way there is off across and in depth, and always (x right, y down,
z away from the camera)."""

_MIDDLES = {"neck": "shoulder", "hips": "hip"}
_SIDES = ("left_", "right_")


def list_bones(names: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the bones of landmarks: weights (B, L) of these, spread and constant error (B, 3) in statures.

    The errors are those of the network's own places along the camera's axes.
    """
    ways, sigmas, biases = [], [], []

    def add(one: FloatArray | None, other: FloatArray | None, row: tuple[float, float], bias: Sequence[float]) -> None:
        if one is not None and other is not None:
            ways.append(one - other)
            sigmas.append((row[0], row[0], row[1]))
            biases.append(bias)

    for point, across, depth in _ACROSS:
        add(_pick(names, f"left_{point}"), _pick(names, f"right_{point}"), (across, depth), (0.0, 0.0, 0.0))
    for point, parent, across, depth, bias in _BONES:
        for side in _SIDES if point not in ("neck", "nose") else ("",):
            add(_pick(names, side + point), _pick(names, side + parent), (across, depth), bias)
    return np.reshape(ways, (-1, len(names))), np.reshape(sigmas, (-1, 3)), np.reshape(biases, (-1, 3))


def _pick(names: Sequence[str], name: str) -> FloatArray | None:
    """Return the weights (L,) of a point; None where the landmarks lack it."""
    some = [side + _MIDDLES[name] for side in _SIDES] if name in _MIDDLES else [name]
    if not set(some) <= set(names):
        return None
    return np.array([float(own in some) / len(some) for own in names])


def world_terms(
    camera: Camera,
    world: FloatArray,
    names: Sequence[str],
    places: FloatArray,
    slopes: FloatArray,
    stature: float,
    network_stature: float = 1.73,
) -> tuple[FloatArray, FloatArray]:
    """Compute errors in sigmas (T, B, 3), nan where unknown, and their derivative by the pose (T, B, 3, D).

    Parameters
    ----------
    camera : of the view.
    world : (T, L, 3) m, the network's places along the camera's axes; nan where it has none.
    names : (L,) of the landmarks.
    places : (T, L, 3) m, those of the body.
    slopes : (T, L, 3, D) their slopes.
    stature : m, of the body.
    network_stature : m, of every person in the network's places.
    """  # fmt: skip
    bones, sigmas, biases = list_bones(names)
    expected = np.einsum("bl,tli->tbi", bones, np.nan_to_num(world))
    known = ~np.einsum("bl,tl->tb", bones != 0, np.isnan(world).any(axis=-1))
    expected = expected * stature / network_stature - stature * biases
    turned = places @ camera.rotation.T
    sigmas = stature * sigmas
    off = (np.einsum("bl,tli->tbi", bones, turned) - expected) / sigmas
    change = np.einsum("bl,ij,tljd->tbid", bones, camera.rotation, slopes, optimize=True) / sigmas[..., None]
    return np.where(known[..., None], off, np.nan), np.asarray(change)


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """The observations of T poses.

    Parameters
    ----------
    cameras : (V,).
    seen : (V, T, L).
    frame_rate : Hz.
    world_weight : weight of the network's own places in space, 0 to 1.
    ease : factor of the pull of joints to their neutral angles.
    lasting : s, over which the errors of a network's points stay much the same.
    world_lasting : s, likewise of its places in space.
    tail : degrees of freedom of Student's t: the fewer, the less points count that are far off.
    contours : (V, T, C, 2) px, points of the contours of masks, nan where there are none; None without masks.
    contour_sigma : statures, one sigma of a contour off the body's outline.
    contour_weight : of a point of a contour, as its neighbours are off in the same way.
    """

    cameras: Sequence[Camera]
    seen: SeenLandmarks
    frame_rate: float
    world_weight: float = 0.0
    ease: float = 1.0
    lasting: float = 0.1
    world_lasting: float = 0.3
    tail: float = 4.0
    contours: NDArray[np.floating] | None = None
    contour_sigma: float = 0.012
    contour_weight: float = 0.3

    def cut(self, frames: slice | IndexArray) -> Terms:
        """Return the observations of some of the frames."""
        seen, contours = self.seen, self.contours
        own = SeenLandmarks(seen.names, seen.points[:, frames], seen.visibility[:, frames], seen.world[:, frames])
        return replace(self, seen=own, contours=None if contours is None else contours[:, frames])

    @property
    def share(self) -> float:
        """Share of an independent image that each counts as."""
        return min(1.0, 1.0 / (self.frame_rate * self.lasting))


def place_points(body: BodyModel, poses: FloatArray, landmarks: Landmarks) -> FloatArray:
    """Return places (..., L, 3) m of landmarks in poses (..., 7 + A)."""
    rotations, positions = place_parts(body, poses)
    turned = np.einsum("...lij,lj->...li", rotations[..., landmarks.parts, :, :], landmarks.places)
    return np.asarray(positions[..., landmarks.parts, :] + turned)


def point_slopes(
    body: BodyModel, poses: FloatArray, landmarks: Landmarks, step: float = 1e-5
) -> tuple[FloatArray, FloatArray]:
    """Return places (T, L, 3) and their slopes (T, L, 3, 6 + A), differences over ``step`` m and rad."""
    n_steps = 6 + body.n_angles
    steps = np.broadcast_to(step * np.eye(n_steps), (len(poses), n_steps, n_steps))
    tried = step_poses(poses[:, None], steps)
    here = place_points(body, poses, landmarks)
    there = place_points(body, tried, landmarks)
    return here, np.asarray(np.moveaxis(there - here[:, None], 1, -1) / step)


def image_weights(
    terms: Terms, landmarks: Landmarks, places: FloatArray, visible: float = 0.05
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return errors (V, T, L, 2) px, the cost of a squared pixel (V, T, L), and the robust total cost (T,).

    Points are left out whose visibility is not above ``visible``.
    """
    share, tail = terms.share, terms.tail
    errors, weights, costs = [], [], np.zeros(len(places))
    for view, camera in enumerate(terms.cameras):
        visibility = terms.seen.visibility[view]
        off = terms.seen.points[view] - camera.project(places)
        sigma = landmarks.spread * pixels_per_metre(camera, places)
        square = (off**2).sum(axis=-1) / sigma**2
        good = np.isfinite(square) & (visibility > visible)
        trust = np.where(good, visibility, 0.0)
        square = np.where(good, square, 0.0)
        cost, weight = _bend(square, 2, tail)
        costs += share * (trust * cost).sum(axis=1)
        weights.append(share * trust * weight / np.where(good, sigma, 1.0) ** 2)
        errors.append(np.where(good[..., None], off, 0.0))
    return np.stack(errors), np.stack(weights), costs


class _Equations:
    """Sums over residuals of each frame: curvature (T, D, D), gradient (T, D) and cost (T,)."""

    def __init__(self, n_frames: int, n_steps: int) -> None:
        self.square, self.gradient = np.zeros((n_frames, n_steps, n_steps)), np.zeros((n_frames, n_steps))
        self.costs = np.zeros(n_frames)

    def add(self, off: FloatArray, ways: FloatArray, weight: FloatArray, costs: FloatArray) -> None:
        """Add residuals (T, N), their slopes (T, N, D) and weights (T, N), and what they cost together (T,)."""
        rooted = np.sqrt(weight)[..., None] * ways
        self.square += np.swapaxes(rooted, 1, 2) @ rooted
        self.gradient += np.einsum("tnd,tn,tn->td", ways, weight, off)
        self.costs += costs


def _bend(square: FloatArray, count: int, tail: float) -> tuple[FloatArray, FloatArray]:
    """Return cost and weight of Student's t, for squared distances in sigmas of ``count`` coordinates."""
    return 0.5 * (tail + count) * np.log1p(square / tail), (tail + count) / (tail + square)


def normal_equations(
    body: BodyModel, poses: FloatArray, landmarks: Landmarks, terms: Terms
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return curvature (T, D, D), gradient (T, D) and cost (T,) of the frames' own terms; D = 6 + A."""
    cones = None if terms.contours is None else list_cones(body)
    places, slopes = point_slopes(body, poses, landmarks if cones is None else join(landmarks, cones.centres))
    n_frames, n_steps, n_points = len(poses), slopes.shape[-1], len(landmarks.parts)
    sums = _Equations(n_frames, n_steps)
    if cones is not None:
        _add_contours(sums, body, terms, cones, (places[:, n_points:], slopes[:, n_points:]))
    places, slopes = places[:, :n_points], slopes[:, :n_points]
    errors, weights, costs = image_weights(terms, landmarks, places)
    for view, camera in enumerate(terms.cameras):
        flow = np.nan_to_num(project_slope(camera, places)) @ slopes  # (T, L, 2, D)
        sums.add(-errors[view].reshape(n_frames, -1), flow.reshape(n_frames, -1, n_steps),
                 np.repeat(weights[view], 2, axis=1), costs / len(terms.cameras))  # fmt: skip
    if terms.world_weight > 0:
        _add_world(sums, body, terms, landmarks, places, slopes)
    _add_angles(sums, body, poses, terms)
    return sums.square, sums.gradient, sums.costs


def _add_contours(
    sums: _Equations, body: BodyModel, terms: Terms, cones: Cones, discs: tuple[FloatArray, FloatArray]
) -> None:
    """Add the distances of contours from the body's outline."""
    assert terms.contours is not None
    sigma, scale = terms.contour_sigma * body.stature, terms.share * terms.contour_weight
    for camera, points in zip(terms.cameras, terms.contours, strict=True):
        off, ways = contour_errors(camera, cones, points, *discs)
        known = np.isfinite(off)
        off, ways = np.where(known, off / sigma, 0.0), np.where(known[..., None], ways / sigma, 0.0)
        costs, weight = _bend(off * off, 1, terms.tail)
        sums.add(off, ways, np.where(known, scale * weight, 0.0), scale * costs.sum(axis=1))


def _add_world(
    sums: _Equations, body: BodyModel, terms: Terms, landmarks: Landmarks, places: FloatArray, slopes: FloatArray
) -> None:
    """Add the network's own vectors from joint to joint."""
    share, n_frames = terms.world_weight * min(1.0, 1.0 / (terms.frame_rate * terms.world_lasting)), len(places)
    for view, camera in enumerate(terms.cameras):
        off, ways = world_terms(camera, terms.seen.world[view], landmarks.names, places, slopes, body.stature)
        known = np.asarray(np.isfinite(off).all(axis=-1))
        off = np.where(known[..., None], off, 0.0)
        costs, weight = _bend((off**2).sum(axis=-1), 3, terms.tail)
        weight = np.where(known, share * weight, 0.0)
        sums.add(off.reshape(n_frames, -1), ways.reshape(n_frames, -1, ways.shape[-1]), np.repeat(weight, 3, axis=1),
                 share * np.where(known, costs, 0.0).sum(axis=1))  # fmt: skip


def angle_rest(body: BodyModel, rest: float = 0.8, trunk: float = 0.48) -> tuple[FloatArray, FloatArray]:
    """Return neutral angles (A,), and the cost of a squared radian off them.

    One sigma of a joint of stiffness 1 is the share ``rest`` of half its range, and of the trunk ``trunk`` rad: points
    at hips and shoulders hardly show how a bend is shared between hips and back (lab/notes/estimation.md).
    """
    ease, cost = [], []
    for name, stiffness, limits, neutral, count in zip(
        body.names, body.stiffness, body.limits, body.neutral, body.n_axes, strict=True
    ):
        half = 0.5 * np.ptp(limits[:count], axis=1)
        ease.append(neutral[:count])
        cost.append(stiffness / (trunk if name == "trunk" else rest * np.maximum(half, 0.05)) ** 2 * np.ones(count))
    return np.concatenate(ease), np.concatenate(cost)


def _add_angles(sums: _Equations, body: BodyModel, poses: FloatArray, terms: Terms, limit: float = 0.05) -> None:
    """Add limits and ease of the joints; ``limit`` rad beyond a limit are one sigma."""
    angles, limits = poses[:, 7:], body.angle_limits
    beyond = angles - np.clip(angles, limits[:, 0], limits[:, 1])
    ease, rest = angle_rest(body)
    off, rest = angles - ease, terms.ease * terms.share * rest
    hard = terms.share * (beyond != 0) / limit**2
    rows = np.arange(6, sums.square.shape[1])
    sums.square[:, rows, rows] += hard + rest
    sums.gradient[:, 6:] += hard * beyond + rest * off
    sums.costs += 0.5 * (hard * beyond**2 + rest * off**2).sum(axis=1)
