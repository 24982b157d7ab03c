"""What labels takes as bytes: an .npz of plain arrays, checked so that no bytes can crash an answer."""

from __future__ import annotations

import numpy as np

from dousa.errors import DousaError, OptionError
from dousa.retrieval._leaf_weights import LeafWeights
from dousa.retrieval._npz_bytes import check, pack_arrays, unpack_arrays
from dousa.retrieval.labelling import TakeLabeller
from dousa.retrieval.takes import WindowGrid

__all__ = ["pack_labeller", "unpack_labeller"]

_VERSION = 1
_WHAT = "a dousa take labeller"
_NAMES = ("version", "classes", "weights", "offset", "lengths", "calibration", "threshold", "n_trees")


def pack_labeller(labeller: TakeLabeller) -> bytes:
    """The bytes of a labeller; the same labeller gives the same bytes."""
    return pack_arrays(
        {
            "version": np.array(_VERSION, np.int64),
            "classes": np.array(labeller.classes, dtype=np.str_),
            "weights": np.ascontiguousarray(labeller.leaf_weights.weights),
            "offset": np.ascontiguousarray(labeller.leaf_weights.offset),
            "lengths": np.array(labeller.grid.lengths, np.int64),
            "calibration": np.array(labeller.calibration, np.float64),
            "threshold": np.array(labeller.threshold, np.float64),
            "n_trees": np.array(labeller.n_trees, np.int64),
        }
    )


def unpack_labeller(data: bytes) -> TakeLabeller:
    """The labeller in the bytes; DousaError if they are damaged, something else, or of a newer version."""
    arrays = unpack_arrays(data, _NAMES, _WHAT)
    version = arrays["version"]
    check(version.shape == () and version.dtype.kind in "iu", _WHAT, "no version")
    if int(version) != _VERSION:
        raise DousaError(
            f"the take labeller is of version {int(version)}, this dousa reads {_VERSION}; update dousa, or train"
        )
    classes, weights, offset = arrays["classes"], arrays["weights"], arrays["offset"]
    check(classes.ndim == 1 and len(classes) > 0 and classes.dtype.kind == "U", _WHAT, "bad categories")
    check(len(np.unique(classes)) == len(classes), _WHAT, "a category occurs twice")
    right = weights.dtype == np.float32 and weights.ndim == 2 and weights.shape[1] == len(classes)
    check(right and weights.flags.c_contiguous and bool(np.isfinite(weights).all()), _WHAT, "bad weights")
    right = offset.dtype == np.float32 and offset.shape == classes.shape
    check(right and bool(np.isfinite(offset).all()), _WHAT, "bad weights")
    lengths, calibration = arrays["lengths"], arrays["calibration"]
    check(lengths.ndim == 1 and lengths.dtype == np.int64, _WHAT, "bad lengths")
    try:
        grid = WindowGrid(tuple(lengths.tolist()))
    except OptionError as error:
        raise DousaError(f"expected {_WHAT}, got damaged or other data: {error}; train again") from error
    right = calibration.shape == (3,) and calibration.dtype == np.float64
    check(right and bool(np.isfinite(calibration).all()), _WHAT, "bad calibration")
    threshold, n_trees = arrays["threshold"], arrays["n_trees"]
    right = threshold.shape == () and threshold.dtype == np.float64
    check(right and 0 <= float(threshold) <= 1, _WHAT, "bad threshold")
    check(
        n_trees.shape == () and n_trees.dtype == np.int64 and int(n_trees) > 0, _WHAT, "bad number of trees"
    )
    offset_score, by_score, by_lead = (float(value) for value in calibration)
    return TakeLabeller(
        tuple(map(str, classes)),
        LeafWeights(weights, offset),
        grid,
        (offset_score, by_score, by_lead),
        float(threshold),
        int(n_trees),
    )
