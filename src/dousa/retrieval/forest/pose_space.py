"""A space in which clips of one category lie close, and the logistic curves over scores.

The axes are the principal ones of the training clips, stretched so that the scatter within the categories is the same
along all (within-class covariance normalisation, from speaker verification: Hatch, Kajarekar, Stolcke, Interspeech
2006). Clips are compared by the angle to a category's centre, seen from the mean of all clips.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.errors import InvalidMotionError
from dousa.messages import Message
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.forest.forest_file import check

_TINY = 1e-9  # by definition: keeps lengths and variances of 0 above 0


@dataclass(frozen=True, slots=True, eq=False)
class PoseSpace:
    """The space, and the categories in it.

    Parameters
    ----------
    layout : (2,) number of columns that are means, and 1 where their squares follow behind the duration, else 0.
    middle, scale : (D,) subtracted from a clip's description, and then multiplied.
    axes : (D, K) from there into the space.
    sums, counts : (C, K) and (C,) of the training clips of each category in the space.
    categories : (C,) names or whole numbers, sorted.
    others : (M, K) unit directions of motions of no category; M is 0 where there are none.
    """

    layout: IntArray
    middle: FloatArray
    scale: FloatArray
    axes: FloatArray
    sums: FloatArray
    counts: IntArray
    categories: NDArray[Any]
    others: FloatArray

    def place(self, features: FloatArray) -> FloatArray:
        """Place clips (N, T, F) in the space: (N, K)."""
        columns, has_squares = (int(number) for number in self.layout)
        if features.ndim != 3 or features.shape[2] < columns * (1 + has_squares) + has_squares:
            raise InvalidMotionError("forest.pose_space", shape=features.shape)
        return _place(features, self.layout, self.middle, self.scale, self.axes)

    def compare_all(self, placed: FloatArray) -> FloatArray:
        """Return the cosines (N, C) of the angles between placed clips (N, K) and all category centres."""
        lengths = np.outer(np.linalg.norm(placed, axis=1), np.linalg.norm(self.sums, axis=1))
        return np.clip(placed @ self.sums.T / np.maximum(lengths, _TINY), -1.0, 1.0)

    def compare_others(self, placed: FloatArray) -> FloatArray:
        """Return the highest cosines (N,) between placed clips (N, K) and motions of no category; 0 without any."""
        if not len(self.others):
            return np.zeros(len(placed))
        lengths = np.maximum(np.linalg.norm(placed, axis=1), _TINY)
        cosines: FloatArray = np.clip((placed @ self.others.T).max(axis=1) / lengths, -1.0, 1.0)
        return cosines

    def measure_distances(self, placed: FloatArray, rows: IntArray) -> FloatArray:
        """Return log distances (N,) of placed clips (N, K) from the centres of categories ``rows`` (N,)."""
        centres = self.sums / np.maximum(self.counts, 1)[:, None]
        distances: FloatArray = np.log(np.linalg.norm(placed - centres[rows], axis=1) + _TINY)
        return distances

    def with_clips(self, features: FloatArray, categories: NDArray[Any]) -> PoseSpace:
        """Return the space with more clips (N, T, F), of categories old or new."""
        return self.with_placed(self.place(features), categories)

    def with_placed(self, placed: FloatArray, categories: NDArray[Any]) -> PoseSpace:
        """Return the space with more clips (N, K), placed by ``place``."""
        names = np.unique(np.concatenate([self.categories, categories]))
        sums, counts = np.zeros((len(names), self.axes.shape[1])), np.zeros(len(names), np.int64)
        old, own = np.searchsorted(names, self.categories), np.searchsorted(names, categories)
        sums[old], counts[old] = self.sums, self.counts
        # On a grid, so that the sums do not depend on the order of clips.
        np.add.at(sums, own, np.rint(placed * 2.0**20) / 2.0**20)
        np.add.at(counts, own, 1)
        return PoseSpace(self.layout, self.middle, self.scale, self.axes, sums, counts, names, self.others)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for ``from_arrays``."""
        return {name: getattr(self, name) for name in ARRAYS}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], what: Message) -> PoseSpace:
        """Read the space; DousaError if the arrays are invalid."""
        check(arrays["axes"].ndim == 2, what, "bad axes")
        space = cls(*(arrays[name] for name in ARRAYS))
        check(space.layout.shape == (2,) and space.layout.dtype == np.int64, what, "bad layout")
        check(0 < space.layout[0] < 2**31 and 0 <= space.layout[1] <= 1, what, "bad layout")
        numbers = (space.middle, space.scale, space.axes, space.sums, space.others)
        right = all(one.dtype == np.float64 and np.isfinite(one).all() for one in numbers)
        size, width = space.middle.shape, space.axes.shape[1:]
        check(right and len(size) == 1 and len(width) == 1, what, "bad numbers")
        check(space.scale.shape == size and space.axes.shape == (*size, *width), what, "bad axes")
        count = space.categories.shape
        check(len(count) == 1 and count[0] > 0 and space.categories.dtype.kind in "Uiub", what, "bad categories")
        check(len(np.unique(space.categories)) == count[0], what, "a category occurs twice")
        check(bool((np.sort(space.categories) == space.categories).all()), what, "bad order")
        check(space.sums.shape == (*count, *width), what, "bad centres")
        check(space.others.ndim == 2 and space.others.shape[1:] == width, what, "bad motions of no category")
        check(space.counts.shape == count and space.counts.dtype == np.int64, what, "bad counts")
        return space


ARRAYS: Sequence[str] = ("layout", "middle", "scale", "axes", "sums", "counts", "categories", "others")
"""Names of the arrays of a space."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseBasis:
    """The principal axes of clips, in which spaces of some of them are fitted without describing them again.

    Parameters
    ----------
    layout, middle, scale : as in ``PoseSpace``.
    axes : (D, K) orthonormal, the one of largest variance first.
    """

    layout: IntArray
    middle: FloatArray
    scale: FloatArray
    axes: FloatArray

    def place(self, features: FloatArray) -> FloatArray:
        """Place clips (N, T, F) along the axes: (N, K)."""
        return _place(features, self.layout, self.middle, self.scale, self.axes)

    def fit(self, placed: FloatArray, categories: NDArray[Any], most: int = 150, shrinking: float = 0.3) -> PoseSpace:
        """Fit the space in which clips of one category lie close.

        Its axes are principal ones of these clips alone: along others, what they never do would look familiar.

        Parameters
        ----------
        placed : (N + M, K) by ``place``: clips, then motions of no category.
        categories : (N,) of the clips, words or whole numbers.
        most : axes at most (docs/retrieval.md).
        shrinking : share of the mean scatter that is added along every axis (docs/retrieval.md).
        """
        mean, count = placed.mean(axis=0), len(categories)
        own_axes = _find_axes(placed - mean, most)
        axes, placed = self.axes @ own_axes, (placed - mean) @ own_axes
        names, own = np.unique(categories, return_inverse=True)
        centres = np.stack([placed[:count][own == number].mean(axis=0) for number in range(len(names))])
        apart = placed[:count] - centres[own]
        scatter = apart.T @ apart / max(count - len(names), 1)
        floor = shrinking * np.trace(scatter) / max(len(scatter), 1) + 1e-6 * placed.var() + _TINY
        turned = np.linalg.cholesky(np.linalg.inv(scatter + floor * np.eye(len(scatter))))
        placed = placed @ turned
        beside = placed[count:] / np.maximum(np.linalg.norm(placed[count:], axis=1, keepdims=True), _TINY)
        middle = self.middle + (self.axes @ mean) / self.scale
        empty = np.zeros((0, len(turned))), np.zeros(0, np.int64), names[:0]
        space = PoseSpace(self.layout, middle, self.scale, axes @ turned, *empty, beside)
        return space.with_placed(placed[:count], np.asarray(categories))


def fit_pose_basis(parts: Sequence[FloatArray], feature_set: FeatureSet | None = None, most: int = 300) -> PoseBasis:
    """Find the axes along which clips vary most.

    Parameters
    ----------
    parts : (N, T, F) features of clips, each of any precision.
    feature_set : defines the columns; without one, all are means.
    most : axes at most (docs/retrieval.md).
    """
    layout = np.array([parts[0].shape[2], 0], np.int64)
    if feature_set is not None:
        layout[:] = len(feature_set.channels), feature_set.has_banks
    centred = _describe(parts, layout)
    middle, spread = centred.mean(axis=0), centred.var(axis=0)
    # Half of a column's scale is that of all cells of its channel, so that one that hardly varies does not dominate.
    scale = 1.0 / np.sqrt(spread + _mean_of_channels(spread, layout) + _TINY)
    centred -= middle  # in place, to save memory
    centred *= scale
    return PoseBasis(layout, middle, scale, _find_axes(centred, most))


def _place(
    features: FloatArray, layout: IntArray, middle: FloatArray, scale: FloatArray, axes: FloatArray
) -> FloatArray:
    described = _describe([features], layout)
    if described.shape[1] != len(middle):
        raise InvalidMotionError("forest.pose_space", shape=features.shape)
    described -= middle  # in place, to save memory
    described *= scale
    placed: FloatArray = described @ axes
    return placed


def _describe(parts: Sequence[FloatArray], layout: IntArray, n_cells: int = 5) -> FloatArray:
    """Return (N, D) of clips (M, T, F) in some parts: means, and spreads where there are squares.

    They are over at most ``n_cells`` joined cells of a clip.
    """
    count, has_squares = (int(number) for number in layout)
    described = np.empty((sum(map(len, parts)), 1 + has_squares, min(n_cells, parts[0].shape[1]), count))
    first = 0
    for features in parts:
        own = described[first : first + len(features)]
        first += len(features)
        _join_cells(features[:, :, :count], own[:, 0])
        if has_squares:
            means, spreads = own[:, 0], own[:, 1]
            _join_cells(features[:, :, count + 1 : 2 * count + 1], spreads)
            spreads -= means**2
            np.sqrt(np.maximum(spreads, 0.0, out=spreads), out=spreads)
    return described.reshape(len(described), math.prod(described.shape[1:]))


def _mean_of_channels(values: FloatArray, layout: IntArray) -> FloatArray:
    """Return (D,) the mean over the cells for each column of a description."""
    by_cell = values.reshape(1 + int(layout[1]), -1, int(layout[0]))
    return np.broadcast_to(by_cell.mean(axis=1, keepdims=True), by_cell.shape).reshape(-1)


def _find_axes(centred: FloatArray, most: int) -> FloatArray:
    """Return at most ``most`` principal axes (D, K) of (N, D), from the products along the shorter side."""
    width = max(1, min(most, centred.shape[1], len(centred) - 1))
    wide = len(centred) <= centred.shape[1]
    sizes, axes = np.linalg.eigh(centred @ centred.T if wide else centred.T @ centred)
    axes, sizes = axes[:, : -width - 1 : -1], sizes[: -width - 1 : -1]
    if wide:
        axes = centred.T @ (axes / np.sqrt(np.maximum(sizes, 1e-12 * sizes[0] + _TINY)))
    return np.ascontiguousarray(axes)


def _join_cells(cells: FloatArray, joined: FloatArray) -> None:
    """Average (N, T, C) over neighbouring cells, into fewer cells (N, S, C)."""
    for row, group in enumerate(np.array_split(np.arange(cells.shape[1]), joined.shape[1])):
        mean = joined[:, row]
        mean[:] = cells[:, group[0]]
        for cell in group[1:]:
            mean += cells[:, cell]
        mean /= len(group)


@dataclass(frozen=True, slots=True)
class Curve:
    """A logistic curve that rises with every score; its log odds are ``intercept`` plus scores times ``slopes`` (0 or
    more).
    """

    intercept: float
    slopes: tuple[float, ...]

    def evaluate(self, scores: FloatArray) -> FloatArray:
        """Return probabilities (N,) of scores (N, K)."""
        return _logistic(self.intercept + scores @ np.asarray(self.slopes))


def compute_auroc(scores: FloatArray, positive: BoolArray) -> float:
    """Return how often a positive scores higher than a negative, ties counting half; 0.5 without either."""
    n_positive = int(positive.sum())
    n_negative = len(positive) - n_positive
    if not n_positive or not n_negative:
        return 0.5
    ordered = np.sort(scores)
    ranks = 0.5 * (np.searchsorted(ordered, scores, "left") + np.searchsorted(ordered, scores, "right") + 1)
    return float((ranks[positive].sum() - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative))


def fit_curve(
    scores: FloatArray,
    positive: BoolArray,
    weights: FloatArray | None = None,
    prior: Curve | None = None,
    prior_rows: float = 5.0,
    ridge: float = 0.01,
) -> Curve:
    """Fit the most likely logistic curve without falling slopes.

    Parameters
    ----------
    scores, positive : (N, K) and (N,).
    weights : (N,) of the rows; None for both sides weighing the same.
    prior, prior_rows : a curve near which it lies, and the rows that this counts as (docs/confidence.md).
    ridge : on slopes in spreads of the scores; keeps the curve finite where these separate both sides perfectly.
    """
    n_positive, n_negative = int(positive.sum()), int((~positive).sum())
    if weights is None:
        weights = np.where(positive, 1.0 / max(n_positive, 1), 1.0 / max(n_negative, 1))
    share = weights / weights.sum()
    middle = share @ scores
    spread = np.sqrt(share @ (scores - middle) ** 2)
    near = prior or Curve(0.0, (0.0,) * scores.shape[1])
    centre = np.array([near.intercept + np.dot(near.slopes, middle), *near.slopes])
    weight = prior_rows / len(scores) if prior else _TINY
    pull = np.array([weight, *((ridge + weight) * spread**2 + _TINY)])
    # Platt's targets, so that no curve is certain.
    target = np.where(positive, (n_positive + 1) / (n_positive + 2), 1 / (n_negative + 2))
    used, slopes = np.arange(scores.shape[1]), np.zeros(scores.shape[1])
    while True:  # scores whose slopes would fall are left out, the worst one first
        kept = np.append(0, used + 1)
        solution = climb_likelihood((scores - middle)[:, used], target, share, centre[kept], pull[kept])
        if not len(used) or solution[1:].min() >= 0.0:
            break
        used = np.delete(used, solution[1:].argmin())
    slopes[used] = solution[1:]
    return Curve(float(solution[0] - slopes @ middle), tuple(slopes.tolist()))


def climb_likelihood(
    scores: FloatArray, target: FloatArray, weight: FloatArray, centre: FloatArray, pull: FloatArray
) -> FloatArray:
    """Maximise the likelihood of a logistic curve by Newton's method; return intercept and slopes (1 + K,).

    Parameters
    ----------
    scores, target, weight : (N, K); (N,) probabilities; (N,) of the rows.
    centre, pull : (1 + K,) where intercept and slopes are pulled, and how strongly.
    """
    design = np.column_stack([np.ones(len(scores)), scores])
    ridge = np.diag(pull)
    solution = np.zeros(design.shape[1])
    for _ in range(50):
        probability = _logistic(design @ solution)
        slope = design.T @ (weight * (target - probability)) - ridge @ (solution - centre)
        bend = (design.T * (weight * np.maximum(probability * (1.0 - probability), 1e-6))) @ design + ridge
        step = np.linalg.solve(bend, slope)
        solution += step * min(1.0, 4.0 / max(np.abs(step).max(), 1e-12))
        if np.abs(step).max() < 1e-9:
            break
    return solution


def _logistic(odds: FloatArray) -> FloatArray:
    # Never certain, however far from the data.
    probability: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(odds, -30.0, 30.0)))
    return probability


def read_curve(data: Mapping[str, Any], count: int) -> Curve:
    """Read a curve over ``count`` scores; KeyError, TypeError or ValueError for anything else."""
    curve = Curve(float(data["intercept"]), tuple(float(slope) for slope in data["slopes"]))
    if len(curve.slopes) != count or not np.isfinite([curve.intercept, *curve.slopes]).all() or min(curve.slopes) < 0:
        raise ValueError(f"expected a rising curve over {count} scores")
    return curve
