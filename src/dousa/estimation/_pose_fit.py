"""Levenberg-Marquardt over a pose: places and directions of its joints, limits, and what pulls it to its start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dousa.estimation.body import BodyModel
from dousa.estimation.kinematics import compute_points, point_names
from dousa.motion import rotations as rot

__all__ = ["find_bones", "solve_pose", "turn_onto"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

_PLACE = 0.5  # what a metre off a joint's place costs
_DIRECTION = (
    0.3  # what a radian off a limb's direction costs, per metre of stature: bones may differ in length
)
_NEUTRAL = 0.003  # what a radian off the start costs, likewise: for what the given joints do not tell
_LIMIT = 0.5  # what a radian beyond a limit costs, likewise
_SHORT = 0.02  # statures: a shorter bone has no direction worth the name
_MOST_STEPS = 60
_DIFFERENCE = 1e-6
_SETTLED = 1e-7  # a step that gains less than this share ends the search
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e6


def find_bones(body: BodyModel, rows: IntArray) -> IntArray:
    """Pairs (B, 2) of places in ``rows`` whose direction says how a part lies.

    A part with one point hanging on it is told by the way there from its joint; one with several by the ways from
    right to left, because bodies differ in where a pelvis or a chest has its joint and how shoulders lie to the neck.
    """
    owners = np.concatenate((body.parents, body.tip_parts))
    points = point_names(body)
    place = {int(row): index for index, row in enumerate(rows)}
    pairs: list[tuple[int, int]] = []
    for part in range(body.n_parts):
        hanging = [place[int(row)] for row in np.flatnonzero(owners == part) if int(row) in place]
        if (owners == part).sum() > 1:
            names = {points[int(rows[index])]: index for index in hanging}
            pairs += [
                (names["right_" + name[5:]], index)
                for name, index in names.items()
                if name.startswith("left_") and "right_" + name[5:] in names
            ]
        elif hanging and part in place:
            pairs.append((place[part], hanging[0]))
    return np.array(pairs, np.intp).reshape(-1, 2)


def turn_onto(source: FloatArray, target: FloatArray) -> FloatArray:
    """The rotation matrix (3, 3) that turns directions (N, 3) best onto others (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(target.T @ source)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def solve_pose(
    body: BodyModel, places: FloatArray, rows: IntArray, start: FloatArray
) -> tuple[FloatArray, float]:
    """The pose (7 + A,) near ``start`` whose points ``rows`` come nearest to ``places`` (N, 3), and its cost."""
    costs = _Costs(body, places, rows, start)
    pose, damping = start.copy(), 1e-3
    residuals = costs.evaluate(pose[None])[0]
    cost = residuals @ residuals
    for _ in range(_MOST_STEPS):
        steps = np.eye(6 + body.n_angles) * _DIFFERENCE
        slope = (costs.evaluate(_step(pose, steps)) - residuals).T / _DIFFERENCE
        square, gradient = slope.T @ slope, slope.T @ residuals
        while damping < _MOST_DAMPING:
            damped = square + np.diag(damping * (np.diag(square) + 1e-6))
            tried = _step(pose, -np.linalg.solve(damped, gradient)[None])
            result = costs.evaluate(tried)[0]
            if result @ result < cost:
                break
            damping *= 4.0
        else:
            break
        gained = cost - result @ result
        pose, residuals, cost = tried[0], result, float(result @ result)
        damping = max(damping / 6.0, _LEAST_DAMPING)
        if gained <= _SETTLED * cost:
            break
    return pose, float(cost)


def _step(pose: FloatArray, steps: FloatArray) -> FloatArray:
    """Poses (N, 7 + A) moved by steps (N, 6 + A): place, turn in the root's axes, angles."""
    moved = np.repeat(pose[None], len(steps), axis=0)
    moved[:, :3] += steps[:, :3]
    moved[:, 3:7] = rot.normalise(rot.multiply(pose[3:7], rot.from_axis_angle(steps[:, 3:6])))
    moved[:, 7:] += steps[:, 6:]
    return moved


class _Costs:
    """Residuals of poses; their squares add up to what is made small."""

    def __init__(self, body: BodyModel, places: FloatArray, rows: IntArray, start: FloatArray) -> None:
        self._body, self._places, self._rows, self._start = body, places, rows, start
        bones = find_bones(body, rows)
        ways = places[bones[:, 1]] - places[bones[:, 0]]
        lengths = np.linalg.norm(ways, axis=1)
        long = lengths > _SHORT * body.stature
        self._bones, self._ways = bones[long], ways[long] / lengths[long, None]

    def evaluate(self, poses: FloatArray) -> FloatArray:
        """(N, R) of poses (N, 7 + A)."""
        body, stature = self._body, self._body.stature
        points = compute_points(body, poses)[:, self._rows]
        ways = points[:, self._bones[:, 1]] - points[:, self._bones[:, 0]]
        ways /= np.linalg.norm(ways, axis=2, keepdims=True) + 1e-12
        angles, limits = poses[:, 7:], body.angle_limits
        beyond = angles - np.clip(angles, limits[:, 0], limits[:, 1])
        parts = (
            _PLACE * (points - self._places),
            _DIRECTION * stature * (ways - self._ways),
            _LIMIT * stature * beyond,
            _NEUTRAL * stature * (angles - self._start[7:]),
        )
        return np.concatenate([part.reshape(len(poses), -1) for part in parts], axis=1)
