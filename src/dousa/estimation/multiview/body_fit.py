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
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import pose_difference, step_poses
from dousa.estimation.body.posing import minimise
from dousa.estimation.multiview.landmarks import SHIFTS, Landmarks
from dousa.estimation.multiview.pose_residuals import Terms, image_weights, normal_equations, place_points, point_slopes
from dousa.estimation.multiview.triangulation import project_slope


@dataclass(frozen=True, slots=True, eq=False)
class BodyParameters:
    """The parameters of a body and their spread.

    Parameters
    ----------
    build : makes the body of parameters (N,), zeros being the expected body.
    place : puts the landmarks on a body.
    sigmas : (N,) standard deviations.
    groups : of shifted landmarks, three parameters each after those of the body.
    """

    build: Callable[[FloatArray], BodyModel]
    place: Callable[[BodyModel], Landmarks]
    sigmas: FloatArray
    groups: tuple[str, ...]

    @property
    def all_sigmas(self) -> FloatArray:
        """Standard deviations (N + 3 G,) of all parameters."""
        return np.concatenate((self.sigmas, np.repeat([SHIFTS[group] for group in self.groups], 3)))

    def make(self, values: FloatArray, body: BodyModel | None = None) -> tuple[BodyModel, Landmarks]:
        """Return the body of all parameters, or a given one, and its shifted landmarks."""
        count = len(self.sigmas)
        body = self.build(values[:count]) if body is None else body
        shifts = dict(zip(self.groups, values[count:].reshape(-1, 3), strict=True))
        return body, self.place(body).shifted(shifts)


@dataclass(frozen=True, slots=True, eq=False)
class FittedBody:
    """A fitted body.

    Parameters
    ----------
    body, landmarks : of the parameters.
    poses : (T, 7 + A) of the frames that were fitted.
    values, covariance : (N + 3 G,) and (N + 3 G, N + 3 G) of all parameters.
    """

    body: BodyModel
    landmarks: Landmarks
    poses: FloatArray
    values: FloatArray
    covariance: FloatArray


def fit_body_parameters(
    parameters: BodyParameters, poses: FloatArray, terms: Terms, *, steps: int = 8, settled: float = 1e-3
) -> FittedBody:
    """Fit body and landmarks to a choice of frames, together with the poses.

    Parameters
    ----------
    parameters : what may change.
    poses : (T, 7 + A) to begin with.
    terms : of these frames, not necessarily consecutive; each counts as one independent image.
    steps, settled : see `minimise`.
    """
    sigmas = parameters.all_sigmas

    def evaluate(state: tuple[FloatArray, FloatArray]) -> tuple[float, Any]:
        values, poses = state
        body, landmarks = parameters.make(values)
        square, gradient, costs = normal_equations(body, poses, landmarks, terms)
        return float(costs.sum() + 0.5 * ((values / sigmas) ** 2).sum()), (body, landmarks, square, gradient)

    def linearise(state: tuple[FloatArray, FloatArray], found: Any) -> Callable[[float], Any]:
        values, poses = state
        body, landmarks, square, gradient = found
        others = _parameter_equations(parameters, values, body, landmarks, poses, terms)

        def move(damping: float) -> tuple[FloatArray, FloatArray]:
            solved, reduced, rest = _reduce(square, gradient, *others, damping)
            change = np.asarray(-np.linalg.solve(reduced, rest))
            return values + change, step_poses(poses, -(solved[..., -1] + solved[..., :-1] @ change))

        return move

    state = (np.zeros(len(sigmas)), poses)
    state, found = minimise(state, evaluate, linearise, steps=steps, settled=settled, damping=1e-2, most_damping=1e5)
    body, landmarks, square, gradient = found
    others = _parameter_equations(parameters, state[0], body, landmarks, state[1], terms)
    _, reduced, _ = _reduce(square, gradient, *others, 0.0)
    return FittedBody(body, landmarks, state[1], state[0], np.asarray(np.linalg.inv(reduced)))


def _parameter_equations(
    parameters: BodyParameters,
    values: FloatArray,
    body: BodyModel,
    landmarks: Landmarks,
    poses: FloatArray,
    terms: Terms,
    step: float = 1e-4,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute curvature between poses and parameters (T, D, N), of the parameters (N, N), and their gradient (N,).

    The slopes are differences over ``step`` of a parameter.
    """
    places, slopes = point_slopes(body, poses, landmarks)
    grown = []
    for number in range(len(values)):
        tried = values.copy()
        tried[number] += step
        # shifts move points on the same body
        other_body, other = parameters.make(tried, None if number < len(parameters.sigmas) else body)
        grown.append((place_points(other_body, poses, other) - places) / step)
    growth = np.stack(grown, axis=-1)  # (T, L, 3, N)
    errors, weights, _ = image_weights(terms, landmarks, places)
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


def _reduce(
    square: FloatArray,
    gradient: FloatArray,
    cross: FloatArray,
    own: FloatArray,
    pull: FloatArray,
    damping: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the poses' answers (T, D, N + 1) to the parameters and the gradient, and the parameters' equations."""
    size = np.arange(square.shape[1])
    damped = square.copy()
    damped[:, size, size] *= 1.0 + damping
    damped[:, size, size] += 1e-6
    solved = np.asarray(np.linalg.solve(damped, np.concatenate((cross, gradient[..., None]), axis=2)))
    reduced = own + damping * np.diag(np.diag(own)) - np.einsum("tdn,tdm->nm", cross, solved[..., :-1])
    return solved, reduced, pull - np.einsum("tdn,td->n", cross, solved[..., -1])


def fit_trajectory(
    body: BodyModel, start: FloatArray, landmarks: Landmarks, terms: Terms, *, steps: int = 25, settled: float = 1e-4
) -> tuple[FloatArray, FloatArray]:
    """Fit the most likely poses of a film, within the joints' limits but for hundredths of a radian.

    Returns poses (T, 7 + A) and the covariance (T, D, D) of their steps.

    Parameters
    ----------
    body : the model.
    start : (T, 7 + A) to begin with.
    landmarks : on the body, those of ``terms``.
    terms : the observations.
    steps, settled : see `minimise`.
    """
    force = force_weights(body, terms.frame_rate)

    def evaluate(poses: FloatArray) -> tuple[float, tuple[FloatArray, FloatArray]]:
        square, gradient, costs = normal_equations(body, poses, landmarks, terms)
        cost = float(costs.sum())
        if len(poses) > 2:
            bend = np.diff(pose_difference(poses[:-1], poses[1:]), axis=0)
            pull = force * bend
            gradient[:-2] += pull
            gradient[1:-1] -= 2.0 * pull
            gradient[2:] += pull
            cost += 0.5 * float((pull * bend).sum())
        return cost, (square, gradient)

    def linearise(poses: FloatArray, found: tuple[FloatArray, FloatArray]) -> Callable[[float], FloatArray]:
        square, gradient = found
        return lambda damping: step_poses(poses, _solve(square, gradient, force, damping))

    poses, (square, _) = minimise(
        start.copy(), evaluate, linearise, steps=steps, settled=settled, damping=1e-3, most_damping=1e6
    )
    return poses, find_covariance(square, force)


def force_weights(
    body: BodyModel,
    frame_rate: float,
    *,
    place: float = 6.0,
    turn: float = 25.0,
    joint: float = 60.0,
    lasting: float = 0.1,
) -> FloatArray:
    """Compute the cost (D,) of a squared second difference.

    Parameters
    ----------
    body : the model.
    frame_rate : Hz.
    place : m/s^2, one sigma of the acceleration of the body's place: the larger, the less smooth.
    turn, joint : rad/s^2, likewise of its turning, and of a joint, times its agility.
    lasting : s, over which forces stay much the same.
    """
    sigma = [np.full(3, place), np.full(3, turn)]
    sigma += [np.full(count, joint * body.agility[part]) for part, count in enumerate(body.n_axes)]
    second = np.concatenate(sigma) / frame_rate**2
    return np.asarray(1.0 / (second**2 * max(1.0, frame_rate * lasting)))


def _assemble(square: FloatArray, force: FloatArray, damping: float) -> tuple[FloatArray, FloatArray]:
    """Return the banded equations as block tridiagonal ones; an odd last frame is padded with the identity.

    Two frames are one block: diagonal ones (N, 2 D, 2 D) and those to the right of them (N - 1, 2 D, 2 D).
    """
    n_frames, size = square.shape[:2]
    bend = np.diff(np.eye(n_frames), 2, axis=0)
    own, one, two = (np.diag(bend.T @ bend, apart) for apart in range(3))
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


def _eliminate(
    square: FloatArray, force: FloatArray, damping: float
) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
    """Return the blocks on the right of the diagonal, the inverses of those left on it, and what each hands on."""
    diagonals, uppers = _assemble(square, force, damping)
    inverses: list[FloatArray] = []
    gains: list[FloatArray] = []
    for k, diagonal in enumerate(diagonals):
        inverses.append(np.linalg.inv(diagonal - uppers[k - 1].T @ gains[-1] if k else diagonal))
        if k < len(uppers):
            gains.append(inverses[-1] @ uppers[k])
    return uppers, inverses, gains


def _solve(square: FloatArray, gradient: FloatArray, force: FloatArray, damping: float) -> FloatArray:
    """Return the damped step (T, D) by forward and backward elimination."""
    n_frames, size = gradient.shape
    uppers, inverses, gains = _eliminate(square, force, damping)
    steps = np.zeros((2 * len(inverses), size))
    steps[:n_frames] = -gradient
    steps = steps.reshape(len(inverses), 2 * size)
    for k, inverse in enumerate(inverses):
        steps[k] = inverse @ (steps[k] - uppers[k - 1].T @ steps[k - 1] if k else steps[k])
    for k in range(len(gains) - 1, -1, -1):
        steps[k] -= gains[k] @ steps[k + 1]
    return np.asarray(steps.reshape(-1, size)[:n_frames])


def find_covariance(square: FloatArray, force: FloatArray) -> FloatArray:
    """Compute the diagonal blocks (T, D, D) of the inverse of the banded equations (Rauch, Tung and Striebel 1965)."""
    n_frames, size = square.shape[:2]
    _, inverses, gains = _eliminate(square, force, 0.0)
    answer = np.empty((2 * len(inverses), size, size))
    later = np.zeros((2 * size, 2 * size))
    for k in range(len(inverses) - 1, -1, -1):
        later = inverses[k] + gains[k] @ later @ gains[k].T if k < len(gains) else inverses[k]
        answer[2 * k], answer[2 * k + 1] = later[:size, :size], later[size:, size:]
    return answer[:n_frames]
