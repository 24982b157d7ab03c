"""Whose body it is: lengths of the bones and places of the network's points, from the whole film.

Stature, lengths and the shifts of groups of points (a network's hips lie beside the joints) are found together with the
poses of frames from all over the film; each frame's pose is eliminated (Schur complement), as in bundle adjustment.
What the film does not tell stays at the tables of body measures.
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

_STEP = 1e-4
_ROUNDS = 8

BuildBody = Callable[[FloatArray], BodyModel]
"""The body of parameters (N,)."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyParameters:
    """How a body may differ from what is expected.

    Parameters
    ----------
    build : makes the body of parameters (N,), zeros being what is expected.
    sigmas : (N,) how far each may be from zero.
    groups : of landmarks whose places may be shifted, three parameters each after those of the body.
    """

    build: BuildBody
    sigmas: FloatArray
    groups: tuple[str, ...]

    @property
    def all_sigmas(self) -> FloatArray:
        """(N + 3 G,) of everything."""
        return np.concatenate((self.sigmas, np.repeat([SHIFTS[group] for group in self.groups], 3)))

    def split(self, values: FloatArray) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Parameters of the body, and shifts of the groups."""
        count = len(self.sigmas)
        shifts = values[count:].reshape(-1, 3)
        return values[:count], dict(zip(self.groups, shifts, strict=True))


def fit_body_parameters(
    parameters: BodyParameters, place: Callable[[BodyModel], Landmarks], poses: FloatArray, terms: Terms
) -> tuple[BodyModel, Landmarks, FloatArray]:
    """Body, landmarks and poses (T, 7 + A) that explain a choice of frames best.

    Parameters
    ----------
    parameters : what may change.
    place : puts the landmarks on a body.
    poses : (T, 7 + A) to begin with.
    terms : of these frames, which need not follow each other; each counts as one independent picture.
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
    """Curvature between poses and parameters (T, D, N), of the parameters (N, N), and their gradient (N,)."""
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
    """Steps of the poses (T, D) and change of the parameters (N,)."""
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
