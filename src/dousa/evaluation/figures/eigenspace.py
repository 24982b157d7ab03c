"""Eigenspace of a furi: the few directions in which its postures vary, and how far other postures are from it.

A posture is 27 numbers: the nine segments of `SEGMENTS` one after the other, x, y, z of each. Postures are turned
about the vertical onto the mean posture first (`Eigenspace.align`); every function that takes ``aligned`` postures
means such ones. Distances are chords: a segment that is off by an angle a adds (2 sin(a / 2))^2 to the square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.posture.posture import SEGMENTS, check_segments
from dousa.evaluation.posture.yaw import compute_complex_correlation, estimate_robust_yaw, estimate_yaw, rotate_yaw

_WIDTH = 3 * len(SEGMENTS)  # of a posture, by definition


@dataclass(frozen=True, slots=True, eq=False)
class Eigenspace:
    """The space that the postures of one furi vary in.

    Parameters
    ----------
    mean : (9, 3) plain mean of the aligned postures. Its segments are shorter than 1 where they move.
    axes : (27, m) orthonormal, one column an axis, largest variance first; the largest number of each is positive.
    variances : (m,) along the axes.
    contribution : share of the whole variance that the axes hold, 0 to 1.
    n_frames : postures it was made from.
    yaw : ``"robust"`` or ``"plain"``, how postures are turned onto the mean.
    bias : rad, added to that angle. The robust one is nearer to a median, which leaves the mean of the turned
        postures a degree or so beside the mean that they were turned onto.

    Source: Yamane and Shakunaga, section 3.1.
    """

    mean: FloatArray
    axes: FloatArray
    variances: FloatArray
    contribution: float
    n_frames: int
    yaw: str = "robust"
    bias: float = 0.0

    @property
    def n_dims(self) -> int:
        """Number of axes; 0 for a person who stands still."""
        return int(self.axes.shape[1])

    def align(self, segments: ArrayLike) -> FloatArray:
        """Turn postures about the vertical onto the mean posture.

        Parameters
        ----------
        segments : (T, 9, 3) unit vectors, Y up.

        Returns
        -------
        (T, 9, 3).

        Raises
        ------
        InvalidMotionError : another shape, or missing values.

        Source: Yamane and Shakunaga, eq. 7. By default the angle is one that a wrong limb cannot bend.
        """
        return rotate_yaw(segments, self.find_turn(segments))

    def find_turn(self, segments: ArrayLike) -> FloatArray:
        """Find the angles (T,) rad about +Y by which `align` turns postures (T, 9, 3); raises as `align`."""
        return _estimate(check_segments(segments, "segments"), self.mean, self.yaw) + self.bias

    def project(self, aligned: ArrayLike) -> FloatArray:
        """Project aligned postures (T, 9, 3) onto the space: (T, m) X*. Source: Yamane and Shakunaga, eq. 8."""
        return self._centre(aligned) @ self.axes

    def residual(self, aligned: ArrayLike) -> FloatArray:
        """Compute the part of aligned postures (T, 9, 3) outside the space: (T, 27) X#. Source: eq. 9."""
        centred = self._centre(aligned)
        return centred - (centred @ self.axes) @ self.axes.T

    def _centre(self, aligned: ArrayLike) -> FloatArray:
        difference = np.asarray(check_segments(aligned, "aligned") - self.mean)
        return difference.reshape(*difference.shape[:-2], _WIDTH)


def fit_eigenspace(segments: ArrayLike, contribution: float = 0.99, yaw: str = "robust") -> Eigenspace:
    """Fit the eigenspace of the postures of a furi.

    The yaw reference is the mean posture: every posture is turned onto it and the mean taken again until it
    rests. It starts from the posture that faces like most of the others, so the order of takes does not matter.

    Parameters
    ----------
    segments : (T, 9, 3) unit vectors, Y up; frames of several takes may follow each other.
    contribution : above 0 and up to 1; as many axes as hold this share of the variance.
    yaw : ``"robust"``, or ``"plain"`` for the paper's.

    Returns
    -------
    The eigenspace: at least one axis, but none and a contribution of 1 where nothing moves (one frame, a person
    who stands still), since no direction means anything then.

    Raises
    ------
    InvalidMotionError : no frame, another shape, or missing values.
    OptionError : a contribution or yaw that cannot be.

    Source: Yamane and Shakunaga, section 3.1, covariance over the number of frames. They do not say what the
    postures of a furi are turned onto.
    """
    poses = check_segments(segments, "segments")
    if poses.ndim != 3 or len(poses) == 0:
        raise InvalidMotionError("postures.sequence_shape", what="segments", shape=poses.shape)
    if not 0.0 < contribution <= 1.0:
        raise OptionError("eigenspace.contribution", contribution=contribution)
    if yaw not in ("robust", "plain"):
        raise OptionError("eigenspace.yaw", yaw=yaw)
    aligned, mean, bias = _settle(poses, yaw)
    centred = (aligned - mean).reshape(len(poses), _WIDTH)
    spread, directions = np.linalg.eigh(centred.T @ centred / len(poses))
    spread, directions = np.maximum(spread[::-1], 0.0), directions[:, ::-1]
    n_dims, held = _count_axes(spread, contribution)
    axes = directions[:, :n_dims]
    axes = np.ascontiguousarray(axes * np.sign(axes[np.abs(axes).argmax(axis=0), np.arange(n_dims)]))
    variances = spread[:n_dims].copy()
    for array in (mean, axes, variances):
        array.flags.writeable = False
    return Eigenspace(mean, axes, variances, held, len(poses), yaw, bias)


def _estimate(poses: FloatArray, mean: FloatArray, yaw: str) -> FloatArray:
    return estimate_yaw(mean, poses) if yaw == "plain" else estimate_robust_yaw(mean, poses)[0]


def _settle(
    poses: FloatArray, yaw: str, *, max_rounds: int = 20, settled: float = 1e-6, most_learnt: int = 512
) -> tuple[FloatArray, FloatArray, float]:
    """All postures turned onto their mean (T, 9, 3), the mean (9, 3), and the bias of the angle."""
    # max_rounds: of turning all postures onto the mean and taking the mean again; settled: the mean posture has moved
    # less than this; most_learnt: postures that settle the mean where there are more
    # An even choice of the frames finds the direction; all of them make the mean.
    step = -(-len(poses) // most_learnt)
    some = poses[::step]
    mean = _choose_start(some)
    for _ in range(max_rounds):
        before = mean
        mean = _turn_onto(some, before, yaw)[1]
        if np.abs(mean - before).max() < settled:
            break
    if step > 1:
        mean = _turn_onto(poses, mean, yaw)[1]
    return _turn_onto(poses, mean, yaw)


def _turn_onto(poses: FloatArray, target: FloatArray, yaw: str) -> tuple[FloatArray, FloatArray, float]:
    """Postures turned onto a target, their mean, and how much further they were turned for it to face like it."""
    turned = rotate_yaw(poses, _estimate(poses, target, yaw))
    bias = float(estimate_yaw(target, turned.mean(axis=0)))
    turned = rotate_yaw(turned, bias)
    return turned, turned.mean(axis=0), bias


def _choose_start(poses: FloatArray, *, most_candidates: int = 64) -> FloatArray:
    """The medoid: the pose that correlates best with the others, of an even choice of them."""
    # most_candidates: poses among which the first yaw reference is chosen
    some = poses[:: -(-len(poses) // most_candidates)]
    likeness = np.abs(compute_complex_correlation(some[:, None], some[None]))
    # Rounding must not decide between poses that are equally good.
    return np.asarray(some[int(np.round(likeness.sum(axis=1), 9).argmax())])


def _count_axes(spread: FloatArray, contribution: float, *, still: float = 1e-12) -> tuple[int, float]:
    """How many axes, and the share of the variance that they hold."""
    # still: variance in all, below which nothing moves: rounding of a person who stands still
    total = float(spread.sum())
    if total < still:
        return 0, 1.0
    held = np.cumsum(spread) / total
    # The sum of all is 1 but for rounding.
    n_dims = min(int(np.searchsorted(held, contribution - 1e-12)) + 1, _WIDTH)
    return n_dims, min(float(held[n_dims - 1]), 1.0)


def compute_distance_from_space(space: Eigenspace, aligned: ArrayLike) -> FloatArray:
    """Compute the distance (T,) d# of aligned postures (T, 9, 3) from the eigenspace.

    Source: Yamane and Shakunaga, eq. 10 and 11. Eq. 10 is printed with Y#; it must be Y*.
    """
    return np.asarray(np.linalg.norm(space.residual(aligned), axis=-1))


def compute_distance_within(space: Eigenspace, aligned: ArrayLike, others: ArrayLike) -> FloatArray:
    """Compute the distance (T,) d* of aligned postures (T, 9, 3) X and Y of the same moments inside the eigenspace.

    Source: Yamane and Shakunaga, eq. 12 to 14.
    """
    return np.asarray(np.linalg.norm(space.project(aligned) - space.project(others), axis=-1))


def compute_distance_to_path(
    space: Eigenspace, reference: ArrayLike, performance: ArrayLike, *, at_once: int = 500_000
) -> FloatArray:
    """Compute the distance of postures from the nearest posture of the reference at any time.

    Parameters
    ----------
    space : of the furi.
    reference : (T, 9, 3) aligned postures of the furi, at least one.
    performance : (U, 9, 3) aligned.
    at_once : pairs of postures compared at a time; their memory.

    Returns
    -------
    (U,) in all 27 dimensions, not only those of the space.

    Raises
    ------
    InvalidMotionError : no reference, another shape, or missing values.

    Not in the paper, whose d# takes every posture of the space for a right one.
    """
    targets, queries = space._centre(reference), space._centre(performance)
    if len(targets) == 0:
        raise InvalidMotionError("eigenspace.no_posture")
    squares = 0.5 * (targets * targets).sum(axis=1)
    nearest = np.empty(len(queries), np.intp)
    step = max(1, at_once // len(targets))
    for first in range(0, len(queries), step):
        # The smallest |q - t|^2 / 2, with its sign changed and without |q|^2 / 2, the same for all targets.
        scores = queries[first : first + step] @ targets.T
        scores -= squares
        nearest[first : first + step] = scores.argmax(axis=1)
    return np.asarray(np.linalg.norm(queries - targets[nearest], axis=1))
