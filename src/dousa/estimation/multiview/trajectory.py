"""The poses of a whole film at once: what each picture says, and that bodies are not moved without force.

The most likely trajectory is found by Gauss-Newton steps over all frames (the iterated Kalman smoother: Bell, "The
iterated Kalman smoother as a Gauss-Newton method", 1994), whose equations are banded; the covariance of each pose
comes of the same equations. A joint that no view shows is carried by its neighbours in time, and its uncertainty grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.multiview.landmarks import Landmarks
from dousa.estimation.multiview.pose_residuals import Terms, normal_equations, step_poses
from dousa.motion import rotations as rot

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
    """The most likely poses of a film.

    Parameters
    ----------
    body : the model.
    start : (T, 7 + A) to begin with.
    landmarks : on the body, those of ``terms``.
    terms : what is known.
    tell : called with steps done and steps at most.

    Returns
    -------
    The trajectory within the joints' limits, but for hundredths of a radian.
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
    """(D,) what a squared second difference costs."""
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
    """(T - 2, D) how each pose goes off the straight way between its neighbours."""
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
    """Diagonals (T,), (T - 1,), (T - 2,) of the square of second differences."""
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
    """The banded equations as block tridiagonal ones; an odd last frame is filled up with ones."""
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
    """(T, D) the damped step: elimination forward, then backward."""
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
    """(T, D, D) blocks on the diagonal of the inverse of the banded equations.

    Eliminated forward, then inverted backward (Rauch, Tung and Striebel 1965).
    """
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
