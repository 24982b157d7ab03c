"""Scores of a classifier: recall, precision, F-measure, accuracy, confusions.

Conventions, where a category leaves a score undefined:

- Averages are macro averages over the categories of the truth: each counts the same, however many clips it
  has. A category that was only ever predicted lowers the recall of those it was mistaken for, nothing else.
- A category that was never predicted has precision 0; its F-measure is 0.
- F-measure is computed per category, then averaged.
- Nothing to score gives 0 everywhere.

These are scikit-learn's ``precision_recall_fscore_support(truth, predicted, labels=unique(truth),
average="macro", zero_division=0)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import OptionError

__all__ = ["Confusion", "Scores", "compute_confusion_matrix", "compute_scores", "list_confusions"]


@dataclass(frozen=True, slots=True)
class Scores:
    """Macro averages over the categories of the truth, and the share of clips that were right; 0 to 1."""

    recall: float
    precision: float
    f_measure: float
    accuracy: float


@dataclass(frozen=True, slots=True)
class Confusion:
    """How often clips of one category were taken for another.

    Parameters
    ----------
    truth, predicted : the categories.
    count : clips.
    share : of the clips of the true category, 0 to 1.
    """

    truth: str
    predicted: str
    count: int
    share: float


def compute_confusion_matrix(truth: ArrayLike, predicted: ArrayLike) -> tuple[NDArray[np.intp], NDArray[Any]]:
    """Count which category was taken for which.

    Parameters
    ----------
    truth, predicted : (N,) categories.

    Returns
    -------
    matrix : (C, C), row the true category, column the predicted one.
    categories : (C,) all that occur in either, sorted.

    Raises
    ------
    OptionError : arrays that are not one-dimensional and of equal length.
    """
    true, named = _check(truth, predicted)
    if not len(true):
        return np.zeros((0, 0), np.intp), true
    categories, numbers = np.unique(np.concatenate([true, named]), return_inverse=True)
    count = len(categories)
    rows, columns = numbers[: len(true)], numbers[len(true) :]
    matrix = np.bincount(rows * count + columns, minlength=count * count).reshape(count, count)
    return matrix.astype(np.intp), categories


def compute_scores(truth: ArrayLike, predicted: ArrayLike) -> Scores:
    """Score predictions; see the module for the conventions.

    Parameters
    ----------
    truth, predicted : (N,) categories.

    Returns
    -------
    Scores, each 0 to 1; 0 if there is nothing to score.

    Raises
    ------
    OptionError : arrays that are not one-dimensional and of equal length.
    """
    matrix, _ = compute_confusion_matrix(truth, predicted)
    if not len(matrix):
        return Scores(0.0, 0.0, 0.0, 0.0)
    right = np.diag(matrix).astype(np.float64)
    clips, named = matrix.sum(axis=1), matrix.sum(axis=0)
    in_truth = clips > 0
    recall = right[in_truth] / clips[in_truth]
    precision = right[in_truth] / np.maximum(named[in_truth], 1)
    f_measure = 2.0 * right[in_truth] / (clips[in_truth] + named[in_truth])
    return Scores(
        recall=float(recall.mean()),
        precision=float(precision.mean()),
        f_measure=float(f_measure.mean()),
        accuracy=float(right.sum() / matrix.sum()),
    )


def list_confusions(truth: ArrayLike, predicted: ArrayLike, limit: int | None = 10) -> tuple[Confusion, ...]:
    """The mistakes, most frequent first; ties by share, then by name.

    Parameters
    ----------
    truth, predicted : (N,) categories.
    limit : how many to list; None for all.
    """
    matrix, categories = compute_confusion_matrix(truth, predicted)
    clips = matrix.sum(axis=1)
    found = [
        Confusion(str(categories[i]), str(categories[j]), int(matrix[i, j]), float(matrix[i, j] / clips[i]))
        for i, j in np.argwhere(matrix)
        if i != j
    ]
    found.sort(key=lambda one: (-one.count, -one.share, one.truth, one.predicted))
    return tuple(found[:limit])


def _check(truth: ArrayLike, predicted: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    true, named = np.asarray(truth), np.asarray(predicted)
    if true.ndim != 1 or true.shape != named.shape:
        raise OptionError(
            "expected one true and one predicted category per clip, "
            f"got shapes {true.shape} and {named.shape}"
        )
    return true, named
