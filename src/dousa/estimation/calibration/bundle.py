"""Bundle adjustment of a moving body: cameras, points, limb lengths, focal lengths and times in one least-squares fit.

The unknowns are a pose, a focal length and a time offset of each camera, the length of each limb, and the place of
each point at each moment. Residuals are distances in the images by their expected spread, and deviations of limbs from
their lengths, which tie the scale of different moments together. Both have robust weights (Cauchy's), so that
exchanged sides or wrong points pull little.

The normal equations are solved by eliminating the points moment by moment (Schur's complement; Triggs et al., Bundle
adjustment - a modern synthesis, 2000, section 6.1): the cost of a step grows linearly with the number of moments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.estimation.body.posing import minimise
from dousa.motion.rotations import from_axis_angle, to_matrix

CAMERA_UNKNOWNS = 8
"""Of each camera, by definition: turn (3) rad, place (3), the logarithm of the focal length, time offset (s)."""

LIKENESS = 5.0
"""Errors of networks last for some frames and are shared by neighbouring points: measured on real films, results are
off by five times what independent errors would give."""

_TURN, _MOVE, _FOCAL, _TIME = slice(0, 3), slice(3, 6), 6, 7
_NEAR = 0.05  # of the unit: nothing is seen closer to a camera


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The cameras.

    Parameters
    ----------
    rotations : (V, 3, 3) from the world to the camera's axes (x right, y down, z forward).
    translations : (V, 3) x_camera = R x_world + t, in the unit of the world.
    focals : (V,) px.
    offsets : (V,) s, added to a camera's own time to get the common time.
    """

    rotations: FloatArray
    translations: FloatArray
    focals: FloatArray
    offsets: FloatArray

    @property
    def positions(self) -> FloatArray:
        """(V, 3) the camera positions."""
        return np.asarray(-np.einsum("vij,vi->vj", self.rotations, self.translations))

    def face(self, centre: FloatArray, up: FloatArray) -> FloatArray:
        """Return axes (3, 3) of the world with Y up, whose Z points from a centre towards the first camera."""
        front = self.positions[0] - centre
        front -= up * (front @ up)
        if np.linalg.norm(front) < 1e-6:
            front = np.cross(up, (1.0, 0.0, 0.0))
        front /= np.linalg.norm(front)
        return np.stack((np.cross(up, front), up, front))

    def move(self, axes: FloatArray, shift: FloatArray) -> Rig:
        """Return the same rig in another world, whose points are those of this one by ``axes`` (3, 3), and shifted."""
        turned = self.rotations @ axes.T
        return replace(self, rotations=turned, translations=self.translations - turned @ shift)

    def to_camera(self, points: FloatArray) -> FloatArray:
        """Transform points (T, K, 3) of the world to the axes of each camera, (V, T, K, 3)."""
        return np.asarray(np.einsum("vij,tkj->vtki", self.rotations, points) + self.translations[:, None, None])

    def project(self, points: FloatArray) -> FloatArray:
        """Project points (T, K, 3) to (V, T, K, 2) px from the principal points; nan behind a camera."""
        local = self.to_camera(points)
        depth = np.where(local[..., 2:] > _NEAR, local[..., 2:], np.nan)
        return np.asarray(self.focals[:, None, None, None] * local[..., :2] / depth)


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The points seen by the cameras at common moments.

    Parameters
    ----------
    points : (V, T, K, 2) px from the principal points, without distortion; arbitrary where the weight is 0.
    weights : (V, T, K) 0 to 1; 0 where a point was not seen.
    spreads : (V,) px, expected error of a point.
    velocities : (V, T, K, 2) px/s, change of the points with the time offset.
    offsets : (V,) s, the time offsets with which the points were read.
    """

    points: FloatArray
    weights: FloatArray
    spreads: FloatArray
    velocities: FloatArray
    offsets: FloatArray

    def pick(self, moments: IndexArray) -> Sightings:
        """Return the sightings at some of the moments."""
        seen = (self.points[:, moments], self.weights[:, moments], self.spreads, self.velocities[:, moments])
        return Sightings(*seen, self.offsets)

    @property
    def seen_twice(self) -> BoolArray:
        """(T, K) True where at least two cameras saw a point, so that it has a place."""
        return np.asarray((self.weights > 0).sum(axis=0) >= 2)


@dataclass(frozen=True, slots=True)
class Limb:
    """Two points at a nearly constant distance.

    Parameters
    ----------
    first, second : places among the points.
    kind : limbs of one kind are equally long (left and right).
    spread : relative change of the seen distance.
    """

    first: int
    second: int
    kind: int
    spread: float


@dataclass(frozen=True, slots=True)
class Freedom:
    """The free unknowns, besides points and limb lengths.

    Parameters
    ----------
    poses : the poses of all cameras but the first.
    focals : the focal lengths.
    offsets : the time offsets of all cameras but the first.
    focal_spread : relative; expected deviation of the focal lengths from their first values.
    """

    poses: bool = True
    focals: bool = False
    offsets: bool = False
    focal_spread: float = 0.3

    def mask(self, n_views: int) -> BoolArray:
        """Return (V * 8,) True where a camera's unknown may change."""
        free = np.zeros((n_views, CAMERA_UNKNOWNS), bool)
        free[1:, :6] = self.poses
        free[:, _FOCAL] = self.focals
        free[1:, _TIME] = self.offsets
        return free.ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted scene.

    Parameters
    ----------
    rig : the cameras.
    points : (T, K, 3) in the unit of the world; nan where fewer than two cameras saw a point.
    lengths : (L,) of each kind of limb.
    cost : half the sum of the robust squares.
    covariance : (V * 8, V * 8) of the cameras' unknowns for independent residuals of the expected spread.
    """

    rig: Rig
    points: FloatArray
    lengths: FloatArray
    cost: float
    covariance: FloatArray = field(repr=False)

    @property
    def variances(self) -> FloatArray:
        """(V, 8) of the cameras' unknowns."""
        return np.maximum(np.diag(self.covariance).reshape(-1, CAMERA_UNKNOWNS), 0.0)


def adjust(
    sightings: Sightings,
    rig: Rig,
    points: FloatArray,
    limbs: Sequence[Limb] = (),
    freedom: Freedom = Freedom(),
    steps: int = 50,
    *,
    cauchy: float = 2.0,
    settled: float = 1e-6,
) -> Fit:
    """Improve cameras and points together, by Levenberg's and Marquardt's method on reweighted squares.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    rig : first guess; its first camera stays.
    points : (T, K, 3) first guess; nan where there is none.
    limbs : of constant length.
    freedom : what may change.
    steps : at most.
    cauchy : spreads, where the robust function begins to give in.
    settled : relative gain of the last step.
    """
    known = sightings.seen_twice & np.isfinite(points).all(axis=-1)
    problem = _Problem(sightings, known, tuple(limbs), freedom, np.log(rig.focals), cauchy)
    state = _State(rig, np.where(known[..., None], points, 0.0), _measure_limbs(points, known, limbs))

    def linearise(state: _State, _: float) -> Callable[[float], _State]:
        system = problem.linearise(state)
        return lambda damping: problem.move(state, *system.solve(damping))

    state, cost = minimise(state, lambda state: (problem.cost(state),) * 2, linearise,
                           steps=steps, settled=settled, damping=1e-3, most_damping=1e9)  # fmt: skip
    placed, covariance = np.where(known[..., None], state.points, np.nan), problem.linearise(state).covariance()
    return Fit(state.rig, placed, np.exp(state.lengths), cost, covariance)


def _measure_limbs(points: FloatArray, known: BoolArray, limbs: Sequence[Limb]) -> FloatArray:
    """Return (L,) logarithms of the median lengths of the kinds of limbs; unseen ones take the median of the others."""
    n_kinds = 1 + max((limb.kind for limb in limbs), default=-1)
    found: list[list[FloatArray]] = [[] for _ in range(n_kinds)]
    for limb in limbs:
        both = known[:, limb.first] & known[:, limb.second]
        found[limb.kind].append(np.linalg.norm(points[both, limb.first] - points[both, limb.second], axis=-1))
    middle = [float(np.median(every)) if len(every := np.concatenate(some)) else np.nan for some in found]
    lengths = np.array(middle)
    lengths[~(lengths > 0)] = np.nanmedian(lengths) if (lengths > 0).any() else 1.0
    return np.asarray(np.log(lengths))


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    rig: Rig
    points: FloatArray
    lengths: FloatArray  # logarithms


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    sightings: Sightings
    known: BoolArray
    limbs: tuple[Limb, ...]
    freedom: Freedom
    log_focals: FloatArray
    cauchy: float

    def cost(self, state: _State) -> float:
        off, counts = self._image_residuals(state)
        squares = (off**2).sum(axis=-1)
        total = float((counts * np.log1p(squares / self.cauchy**2)).sum())
        for limb in self.limbs:
            rest, both, _, _ = self._limb_residuals(state, limb)
            total += float(np.log1p(rest[both] ** 2 / self.cauchy**2).sum())
        total *= self.cauchy**2
        if self.freedom.focals:
            total += float((((np.log(state.rig.focals) - self.log_focals) / self.freedom.focal_spread) ** 2).sum())
        return 0.5 * total

    def _image_residuals(self, state: _State) -> tuple[FloatArray, FloatArray]:
        """Return residuals (V, T, K, 2) in spreads, and their weights (V, T, K)."""
        seen = self.sightings
        local = state.rig.to_camera(state.points)
        depth = local[..., 2:]
        behind = depth <= _NEAR
        places = state.rig.focals[:, None, None, None] * local[..., :2] / np.where(behind, _NEAR, depth)
        late = (state.rig.offsets - seen.offsets)[:, None, None, None]
        off = (places - seen.points + late * seen.velocities) / seen.spreads[:, None, None, None]
        counts = np.where(self.known, seen.weights, 0.0)
        return np.where(counts[..., None] > 0, off, 0.0), counts

    def _limb_residuals(self, state: _State, limb: Limb) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
        """Return residuals (T,) in spreads, where they are known, and the limb vectors (T, 3) and their lengths."""
        both = self.known[:, limb.first] & self.known[:, limb.second]
        along = state.points[:, limb.first] - state.points[:, limb.second]
        length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
        rest = np.where(both, (np.log(length) - state.lengths[limb.kind]) / limb.spread, 0.0)
        return rest, both, along, length

    def linearise(self, state: _State) -> _System:
        """Return the normal equations about a state."""
        n_views, n_frames, n_points = self.sightings.weights.shape
        n_cameras, n_kinds = n_views * CAMERA_UNKNOWNS, len(state.lengths)
        system = _System(
            np.zeros((n_cameras + n_kinds, n_cameras + n_kinds)),
            np.zeros(n_cameras + n_kinds),
            np.zeros((n_frames, n_points, 3, n_points, 3)),
            np.zeros((n_frames, n_points, 3)),
            np.zeros((n_frames, n_cameras + n_kinds, n_points, 3)),
            np.concatenate((self.freedom.mask(n_views), np.ones(n_kinds, bool))),
            n_cameras,
        )
        self._add_images(state, system)
        for limb in self.limbs:
            self._add_limb(state, limb, system, n_cameras + limb.kind)
        if self.freedom.focals:
            places = np.arange(n_views) * CAMERA_UNKNOWNS + _FOCAL
            system.hessian[places, places] += self.freedom.focal_spread**-2
            system.gradient[places] += (np.log(state.rig.focals) - self.log_focals) * self.freedom.focal_spread**-2
        return system

    def _add_images(self, state: _State, system: _System) -> None:
        off, counts = self._image_residuals(state)
        weights = counts / (1.0 + (off**2).sum(axis=-1) / self.cauchy**2)
        local = state.rig.to_camera(state.points)
        each = np.arange(self.known.shape[1])
        for view in range(len(state.rig.rotations)):
            by_camera, by_point = self._derivatives(state.rig, view, local[view])
            weighted = weights[view, ..., None, None] * by_camera
            here = slice(view * CAMERA_UNKNOWNS, (view + 1) * CAMERA_UNKNOWNS)
            system.hessian[here, here] += np.einsum("tkia,tkib->ab", weighted, by_camera)
            system.gradient[here] += np.einsum("tkia,tki->a", weighted, off[view])
            own = np.einsum("tk,tkia,tkib->tkab", weights[view], by_point, by_point)
            # Advanced indices in two places move to the front: (K, T, 3, 3).
            system.blocks[:, each, :, each, :] += own.swapaxes(0, 1)
            system.forces[...] += np.einsum("tk,tkia,tki->tka", weights[view], by_point, off[view])
            system.mixed[:, here] += np.einsum("tkia,tkib->takb", weighted, by_point)

    def _derivatives(self, rig: Rig, view: int, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Differentiate one view's residuals by the camera's unknowns (T, K, 2, 8) and by the points (T, K, 2, 3)."""
        spread, focal = self.sightings.spreads[view], rig.focals[view]
        depth = np.maximum(local[..., 2], _NEAR)
        by_local = np.zeros((*local.shape[:2], 2, 3))
        by_local[..., 0, 0] = by_local[..., 1, 1] = focal / depth / spread
        by_local[..., 2] = -focal * local[..., :2] / depth[..., None] ** 2 / spread
        by_camera = np.empty((*local.shape[:2], 2, CAMERA_UNKNOWNS))
        turned = local - rig.translations[view]
        by_camera[..., _TURN] = np.cross(turned[..., None, :], by_local)
        by_camera[..., _MOVE] = by_local
        by_camera[..., _FOCAL] = focal * local[..., :2] / depth[..., None] / spread
        # With a greater offset the same moment lies earlier in the camera's own time.
        by_camera[..., _TIME] = self.sightings.velocities[view] / spread
        return by_camera, by_local @ rig.rotations[view]

    def _add_limb(self, state: _State, limb: Limb, system: _System, place: int) -> None:
        rest, both, along, length = self._limb_residuals(state, limb)
        weights = both / (1.0 + rest**2 / self.cauchy**2)
        slope = along / length[:, None] ** 2 / limb.spread
        outer = np.einsum("t,ta,tb->tab", weights, slope, slope)
        i, j = limb.first, limb.second
        system.blocks[:, i, :, i] += outer
        system.blocks[:, j, :, j] += outer
        system.blocks[:, i, :, j] -= outer
        system.blocks[:, j, :, i] -= outer
        push = (weights * rest)[:, None] * slope
        system.forces[:, i] += push
        system.forces[:, j] -= push
        system.hessian[place, place] += weights.sum() / limb.spread**2
        system.gradient[place] -= (weights * rest).sum() / limb.spread
        cross = weights[:, None] * slope / limb.spread
        system.mixed[:, place, i] -= cross
        system.mixed[:, place, j] += cross

    def move(self, state: _State, step: FloatArray, shifts: FloatArray) -> _State:
        """Return the state after a step of the global unknowns and of the points."""
        rig = state.rig
        n_cameras = len(rig.rotations) * CAMERA_UNKNOWNS
        cameras = step[:n_cameras].reshape(-1, CAMERA_UNKNOWNS)
        moved = replace(
            rig,
            rotations=to_matrix(from_axis_angle(cameras[:, _TURN])) @ rig.rotations,
            translations=rig.translations + cameras[:, _MOVE],
            focals=rig.focals * np.exp(np.clip(cameras[:, _FOCAL], -0.5, 0.5)),
            offsets=rig.offsets + cameras[:, _TIME],
        )
        return _State(moved, state.points + shifts, state.lengths + np.clip(step[n_cameras:], -0.5, 0.5))


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Normal equations: global unknowns (G,), points (T, K, 3), and their coupling."""

    hessian: FloatArray  # (G, G)
    gradient: FloatArray  # (G,)
    blocks: FloatArray  # (T, K, 3, K, 3)
    forces: FloatArray  # (T, K, 3)
    mixed: FloatArray  # (T, G, K, 3)
    free: BoolArray  # (G,)
    n_cameras: int  # of the global unknowns, those of the cameras; the rest are limbs

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Return the step (G,) of the global unknowns and (T, K, 3) of the points."""
        n_frames, n_points = self.forces.shape[:2]
        reduced, force, solved_forces, solved_mixed = self._reduce(damping)
        step = np.zeros(len(self.gradient))
        step[self.free] = np.linalg.solve(reduced, -force)
        shifts = -(solved_forces + solved_mixed @ step[self.free])
        return step, shifts.reshape(n_frames, n_points, 3)

    def _reduce(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return Schur's complement (F, F) and (F,) of the free unknowns, and the solutions for the points."""
        n_frames, size = len(self.forces), 3 * self.forces.shape[1]
        blocks = self.blocks.reshape(n_frames, size, size).copy()
        diagonal = np.arange(size)
        # Points that no view sees have no equations and keep their places.
        blocks[:, diagonal, diagonal] += damping * blocks[:, diagonal, diagonal] + 1e-9
        mixed = self.mixed[:, self.free].reshape(n_frames, -1, size).swapaxes(1, 2)
        right = np.concatenate((mixed, self.forces.reshape(n_frames, size, 1)), axis=2)
        solved = np.asarray(np.linalg.solve(blocks, right), np.float64)
        hessian = self.hessian[np.ix_(self.free, self.free)].copy()
        count = np.arange(len(hessian))
        hessian[count, count] += damping * hessian[count, count] + 1e-12
        reduced = hessian - np.einsum("tsa,tsb->ab", mixed, solved[..., :-1], optimize=True)
        force = self.gradient[self.free] - np.einsum("tsa,ts->a", mixed, solved[..., -1], optimize=True)
        return reduced, force, solved[..., -1], solved[..., :-1]

    def covariance(self) -> FloatArray:
        """Return the covariance (V * 8, V * 8) of the cameras' unknowns."""
        reduced = self._reduce(0.0)[0]
        whole = np.zeros((len(self.free), len(self.free)))
        whole[np.ix_(self.free, self.free)] = np.linalg.pinv(reduced, hermitian=True)
        return whole[: self.n_cameras, : self.n_cameras]
