"""Means and medians of what is known; nan where nothing is, and no warning."""

from __future__ import annotations

import warnings

import numpy as np

from dousa.arrays import FloatArray


def known_mean(values: FloatArray, axis: int) -> FloatArray:
    """The mean of the values that are not nan along an axis."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all nan, whose mean is nan
        return np.asarray(np.nanmean(values, axis=axis))


def known_median(values: FloatArray, axis: int) -> FloatArray:
    """The median of the values that are not nan along an axis."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmedian(values, axis=axis))


def known_span(values: FloatArray, axis: int) -> FloatArray:
    """Greatest less least of the values that are not nan along an axis."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmax(values, axis=axis) - np.nanmin(values, axis=axis))
