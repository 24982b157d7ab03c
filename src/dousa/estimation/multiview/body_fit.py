"""One body and its poses fitted to the keypoints of a whole film.

Stature, lengths and the shifts of groups of points (a network's hips lie beside the joints) are found together with
poses from all over the film; each frame's pose is eliminated (Schur complement). Undetermined lengths stay at the
tables of body measures.

The most likely trajectory follows by Gauss-Newton steps over all frames (the iterated Kalman smoother: Bell, "The
iterated Kalman smoother as a Gauss-Newton method", 1994), whose equations are banded and yield the covariance of each
pose. A hidden joint follows its neighbours in time, and its uncertainty grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.multiview.landmarks import SHIFTS, Landmarks
from dousa.estimation.multiview.pose_residuals import (
    CORRELATED_S,
    Terms,
    image_weights,
    normal_equations,
    place_points,
    point_slopes,
    step_poses,
)
from dousa.estimation.multiview.triangulation import project_slope
from dousa.motion import rotations as rot

_STEP = 1e-4
_ROUNDS = 8

BuildBody = Callable[[FloatArray], BodyModel]
"""The body of parameters (N,)."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyParameters:
    """The parameters of a body and their spread.

    Parameters
    ----------
    build : makes the body of parameters (N,), zeros being the expected body.
    sigmas : (N,) standard deviations.
    groups : of shifted landmarks, three parameters each after those of the body.
    """

    build: BuildBody
    sigmas: FloatArray
    groups: tuple[str, ...]

    @property
    def all_sigmas(self) -> FloatArray:
        """Standard deviations (N + 3 G,) of all parameters."""
        return np.concatenate((self.sigmas, np.repeat([SHIFTS[group] for group in self.groups], 3)))

    def split(self, values: FloatArray) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Split values into parameters of the body and shifts of the groups."""
        count = len(self.sigmas)
        shifts = values[count:].reshape(-1, 3)
        return values[:count], dict(zip(self.groups, shifts, strict=True))


def fit_body_parameters(
    parameters: BodyParameters, place: Callable[[BodyModel], Landmarks], poses: FloatArray, terms: Terms
) -> tuple[BodyModel, Landmarks, FloatArray]:
    """Fit body, landmarks and poses (T, 7 + A) to a choice of frames.

    Parameters
    ----------
    parameters : what may change.
    place : puts the landmarks on a body.
    poses : (T, 7 + A) to begin with.
    terms : of these frames, not necessarily consecutive; each counts as one independent image.
    """
    values = np.zeros(len(parameters.all_sigmas))
    body, landmarks = _make(parameters, place, values)
    cost = _cost(body, landmarks, poses, terms, values, parameters)
    damping = 1e-2
    for _ in range(_ROUNDS):
        square, gradient, _ = normal_equations(body, poses, landmarks, terms)
        cross, own, pull = _parameter_equations(parameters, place, values, body, landmarks, poses, terms)
        accepted = False
        while damping < 1e5:
            steps, change = _eliminate(square, gradient, cross, own, pull, damping)
            tried_values, tried_poses = values + change, step_poses(poses, steps)
            tried_body, tried_landmarks = _make(parameters, place, tried_values)
            tried = _cost(tried_body, tried_landmarks, tried_poses, terms, tried_values, parameters)
            if tried < cost:
                accepted = True
                break
            damping *= 5.0
        if not accepted:
            break
        gained = cost - tried
        values, poses, body, landmarks, cost = tried_values, tried_poses, tried_body, tried_landmarks, tried
        damping = max(damping / 8.0, 1e-6)
        if gained < 1e-3 * cost:
            break
    return body, landmarks, poses


def _make(
    parameters: BodyParameters, place: Callable[[BodyModel], Landmarks], values: FloatArray
) -> tuple[BodyModel, Landmarks]:
    own, shifts = parameters.split(values)
    body = parameters.build(own)
    return body, place(body).shifted(shifts)


def _cost(
    body: BodyModel,
    landmarks: Landmarks,
    poses: FloatArray,
    terms: Terms,
    values: FloatArray,
    parameters: BodyParameters,
) -> float:
    costs = normal_equations(body, poses, landmarks, terms)[2]
    return float(costs.sum() + 0.5 * ((values / parameters.all_sigmas) ** 2).sum())


def _parameter_equations(
    parameters: BodyParameters,
    place: Callable[[BodyModel], Landmarks],
    values: FloatArray,
    body: BodyModel,
    landmarks: Landmarks,
    poses: FloatArray,
    terms: Terms,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute curvature between poses and parameters (T, D, N), of the parameters (N, N), and their gradient (N,)."""
    share = min(1.0, 1.0 / (terms.frame_rate * CORRELATED_S))
    places, slopes = point_slopes(body, poses, landmarks)
    grown = []
    for number in range(len(values)):
        tried = values.copy()
        tried[number] += _STEP
        if number < len(parameters.sigmas):
            other_body, other = _make(parameters, place, tried)
        else:  # points are shifted on the same body
            other_body, other = body, place(body).shifted(parameters.split(tried)[1])
        grown.append((place_points(other_body, poses, other) - places) / _STEP)
    growth = np.stack(grown, axis=-1)  # (T, L, 3, N)
    errors, weights, _ = image_weights(terms, landmarks, places, share)
    sigmas = parameters.all_sigmas
    cross = np.zeros((len(poses), slopes.shape[-1], len(values)))
    own, pull = np.diag(1.0 / sigmas**2), values / sigmas**2
    for view, camera in enumerate(terms.cameras):
        slope = np.nan_to_num(project_slope(camera, places))
        flow, change = slope @ slopes, slope @ growth
        weighted = weights[view][..., None, None] * change
        cross += np.einsum("tlid,tlin->tdn", flow, weighted)
        own = own + np.einsum("tlin,tlim->nm", change, weighted)
        pull = pull - np.einsum("tlin,tli->n", weighted, errors[view])
    return cross, own, pull


def _eliminate(
    square: FloatArray,
    gradient: FloatArray,
    cross: FloatArray,
    own: FloatArray,
    pull: FloatArray,
    damping: float,
) -> tuple[FloatArray, FloatArray]:
    """Return steps of the poses (T, D) and change of the parameters (N,)."""
    size = np.arange(square.shape[1])
    damped = square.copy()
    damped[:, size, size] *= 1.0 + damping
    damped[:, size, size] += 1e-6
    solved = np.linalg.solve(damped, np.concatenate((cross, gradient[..., None]), axis=2))
    reduced = own + damping * np.diag(np.diag(own)) - np.einsum("tdn,tdm->nm", cross, solved[..., :-1])
    rest = pull - np.einsum("tdn,td->n", cross, solved[..., -1])
    change = -np.linalg.solve(reduced, rest)
    steps = -(solved[..., -1] + solved[..., :-1] @ change)
    return steps, change


_ROOT_FORCE = 6.0  # m/s^2, one sigma of the acceleration of the body's place over `_FORCE_S`
_TURN_FORCE = 25.0  # rad/s^2, likewise of its turning
_JOINT_FORCE = 60.0  # rad/s^2, likewise of a joint, times its agility
_FORCE_S = 0.1
_MOST_STEPS = 25
_SETTLED = 1e-4
_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e6

Tell = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses (T, 7 + A), the covariance (T, D, D) of their steps, and the cost."""

    poses: FloatArray
    covariance: FloatArray
    cost: float


def fit_trajectory(
    body: BodyModel, start: FloatArray, landmarks: Landmarks, terms: Terms, tell: Tell | None = None
) -> Trajectory:
    """Fit the most likely poses of a film, within the joints' limits but for hundredths of a radian.

    Parameters
    ----------
    body : the model.
    start : (T, 7 + A) to begin with.
    landmarks : on the body, those of ``terms``.
    terms : the observations.
    tell : called with steps done and steps at most.
    """
    poses, damping = start.copy(), 1e-3
    force = force_weights(body, terms.frame_rate)
    square, gradient, cost = _evaluate(body, poses, landmarks, terms, force)
    for number in range(_MOST_STEPS):
        if tell is not None:
            tell(number, _MOST_STEPS)
        while damping < _MOST_DAMPING:
            tried = step_poses(poses, _solve(square, gradient, force, damping))
            found = _evaluate(body, tried, landmarks, terms, force)
            if found[2] < cost:
                break
            damping *= 5.0
        else:
            break
        gained = cost - found[2]
        poses, (square, gradient, cost) = tried, found
        damping = max(damping / 8.0, _LEAST_DAMPING)
        if gained <= _SETTLED * abs(cost):
            break
    return Trajectory(poses, find_covariance(square, force), cost)


def force_weights(body: BodyModel, frame_rate: float) -> FloatArray:
    """Compute the cost (D,) of a squared second difference."""
    sigma = [np.full(3, _ROOT_FORCE), np.full(3, _TURN_FORCE)]
    sigma += [np.full(count, _JOINT_FORCE * body.agility[part]) for part, count in enumerate(body.n_axes)]
    second = np.concatenate(sigma) / frame_rate**2
    return np.asarray(1.0 / (second**2 * max(1.0, frame_rate * _FORCE_S)))


def _evaluate(
    body: BodyModel, poses: FloatArray, landmarks: Landmarks, terms: Terms, force: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    square, gradient, costs = normal_equations(body, poses, landmarks, terms)
    cost = float(costs.sum())
    if len(poses) > 2:
        bend = _second_differences(poses)
        pull = force * bend
        gradient[:-2] += pull
        gradient[1:-1] -= 2.0 * pull
        gradient[2:] += pull
        cost += 0.5 * float((pull * bend).sum())
    return square, gradient, cost


def _second_differences(poses: FloatArray) -> FloatArray:
    """Compute second differences (T - 2, D) of poses."""
    moves = np.concatenate(
        (
            np.diff(poses[:, :3], axis=0),
            rot.to_axis_angle(rot.multiply(rot.conjugate(poses[:-1, 3:7]), poses[1:, 3:7])),
            np.diff(poses[:, 7:], axis=0),
        ),
        axis=1,
    )
    return np.asarray(np.diff(moves, axis=0))


def _couplings(n_frames: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return diagonals (T,), (T - 1,), (T - 2,) of the square of second differences."""
    own, one, two = np.zeros(n_frames), np.zeros(max(n_frames - 1, 0)), np.zeros(max(n_frames - 2, 0))
    if n_frames > 2:
        own[:-2] += 1.0
        own[1:-1] += 4.0
        own[2:] += 1.0
        one[:-1] -= 2.0
        one[1:] -= 2.0
        two += 1.0
    return own, one, two


Blocks = tuple[FloatArray, FloatArray]
"""Diagonal blocks (N, 2 D, 2 D) and those to the right of them (N - 1, 2 D, 2 D): two frames are one block."""


def _assemble(square: FloatArray, force: FloatArray, damping: float) -> Blocks:
    """Return the banded equations as block tridiagonal ones; an odd last frame is padded with the identity."""
    n_frames, size = square.shape[:2]
    own, one, two = _couplings(n_frames)
    n_blocks = (n_frames + 1) // 2
    index = np.arange(size)
    frames = np.tile(np.eye(size), (2 * n_blocks, 1, 1))
    frames[:n_frames] = square
    frames[:n_frames, index, index] *= 1.0 + damping
    frames[:n_frames, index, index] += own[:, None] * force + 1e-9
    diagonals = np.zeros((n_blocks, 2 * size, 2 * size))
    uppers = np.zeros((max(n_blocks - 1, 0), 2 * size, 2 * size))
    diagonals[:, :size, :size], diagonals[:, size:, size:] = frames[0::2], frames[1::2]
    for apart, values in ((1, one), (2, two)):
        for t, value in enumerate(values):
            a, b = t, t + apart
            target = diagonals[a // 2] if a // 2 == b // 2 else uppers[a // 2]
            target[a % 2 * size + index, b % 2 * size + index] += value * force
            if a // 2 == b // 2:
                target[b % 2 * size + index, a % 2 * size + index] += value * force
    return diagonals, uppers


def _solve(square: FloatArray, gradient: FloatArray, force: FloatArray, damping: float) -> FloatArray:
    """Return the damped step (T, D) by forward and backward elimination."""
    n_frames, size = gradient.shape
    diagonals, uppers = _assemble(square, force, damping)
    right = np.zeros((2 * len(diagonals), size))
    right[:n_frames] = -gradient
    right = right.reshape(len(diagonals), 2 * size)
    gains: list[FloatArray] = []
    rests: list[FloatArray] = []
    current, rest = diagonals[0], right[0]
    for k in range(len(diagonals)):
        if k:
            current, rest = diagonals[k] - uppers[k - 1].T @ gains[-1], right[k] - uppers[k - 1].T @ rests[-1]
        wide = uppers[k] if k < len(uppers) else np.zeros((2 * size, 0))
        solved = np.linalg.solve(current, np.concatenate((wide, rest[:, None]), axis=1))
        gains.append(solved[:, :-1])
        rests.append(solved[:, -1])
    steps = np.stack(rests)
    for k in range(len(diagonals) - 2, -1, -1):
        steps[k] -= gains[k] @ steps[k + 1]
    return np.asarray(steps.reshape(-1, size)[:n_frames])


def find_covariance(square: FloatArray, force: FloatArray) -> FloatArray:
    """Compute the diagonal blocks (T, D, D) of the inverse of the banded equations (Rauch, Tung and Striebel 1965)."""
    n_frames, size = square.shape[:2]
    diagonals, uppers = _assemble(square, force, 0.0)
    inverses: list[FloatArray] = []
    gains: list[FloatArray] = []
    for k, diagonal in enumerate(diagonals):
        current = diagonal - uppers[k - 1].T @ gains[-1] if k else diagonal
        inverses.append(np.linalg.inv(current))
        if k < len(uppers):
            gains.append(inverses[-1] @ uppers[k])
    answer = np.empty((2 * len(diagonals), size, size))
    later = np.zeros((2 * size, 2 * size))
    for k in range(len(diagonals) - 1, -1, -1):
        later = inverses[k] + gains[k] @ later @ gains[k].T if k < len(gains) else inverses[k]
        answer[2 * k], answer[2 * k + 1] = later[:size, :size], later[size:, size:]
    return answer[:n_frames]
