"""A trained forest as bytes: an .npz of plain arrays, checked so that no bytes can crash or hang a query."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import DousaError
from dousa.retrieval._npz_bytes import check, pack_arrays, unpack_arrays
from dousa.retrieval._trees import Trees

__all__ = ["ForestFile", "pack_forest", "unpack_forest"]

_WHAT = "a dousa forest"
_VERSION = 2
_WITHOUT_KINDS = (
    1  # of a version whose every test was a mean, which is what its nodes say in version 2 as well
)
_ARRAYS = {
    "nodes": (np.int32, 2),
    "roots": (np.int64, 1),
    "leaf_starts": (np.int64, 1),
    "leaf_classes": (np.int32, 1),
    "leaf_counts": (np.int32, 1),
    "sizes": (np.int64, 1),
}


@dataclass(frozen=True, slots=True, eq=False)
class ForestFile:
    """What is stored of a forest: constructor parameters, trees, categories (C,), feature names (F,)."""

    parameters: dict[str, Any]
    trees: Trees
    classes: NDArray[Any]
    feature_names: tuple[str, ...]


def pack_forest(file: ForestFile) -> bytes:
    """The bytes of a forest; the same forest gives the same bytes."""
    trees = file.trees
    parameters = {
        key: value.item() if isinstance(value, np.generic) else value
        for key, value in file.parameters.items()
    }
    arrays = {
        "version": np.array(_VERSION, np.int64),
        "parameters": np.array(json.dumps(parameters)),
        "classes": file.classes,
        "feature_names": np.array(file.feature_names, dtype=np.str_),
        "nodes": trees.nodes,
        "roots": trees.roots,
        "leaf_starts": trees.leaf_starts,
        "leaf_classes": trees.leaf_classes,
        "leaf_counts": trees.leaf_counts,
        "sizes": np.array([trees.n_features, trees.n_frames, trees.n_classes], np.int64),
    }
    return pack_arrays(arrays)


def unpack_forest(data: bytes) -> ForestFile:
    """The forest in the bytes; DousaError if they are damaged, something else, or of a newer version."""
    arrays = unpack_arrays(data, {"version", "parameters", "classes", "feature_names", *_ARRAYS}, _WHAT)
    _check(arrays["version"].shape == () and arrays["version"].dtype.kind in "iu", "no version")
    version = int(arrays["version"])
    if version not in (_WITHOUT_KINDS, _VERSION):
        raise DousaError(
            f"the forest is of version {version}, this dousa reads {_VERSION}; update dousa, or train"
        )
    for name, (dtype, axes) in _ARRAYS.items():
        array = arrays[name]
        _check(array.dtype == dtype and array.ndim == axes and array.flags.c_contiguous, f"bad {name}")
    _check(arrays["sizes"].shape == (3,) and (arrays["sizes"] >= 1).all(), "bad sizes")
    _check((arrays["sizes"] < 2**31).all(), "bad sizes")
    trees = Trees(
        arrays["nodes"],
        arrays["roots"],
        arrays["leaf_starts"],
        arrays["leaf_classes"],
        arrays["leaf_counts"],
        *(int(size) for size in arrays["sizes"]),
    )
    _check_trees(trees)
    classes, names = arrays["classes"], arrays["feature_names"]
    _check(classes.shape == (trees.n_classes,) and classes.dtype.kind in "Uiub", "bad categories")
    _check(len(np.unique(classes)) == len(classes), "a category occurs twice")
    _check(names.shape == (trees.n_features,) and names.dtype.kind == "U", "bad feature names")
    return ForestFile(_read_parameters(arrays["parameters"]), trees, classes, tuple(map(str, names)))


def _check(condition: bool | np.bool_, problem: str) -> None:
    check(condition, _WHAT, problem)


def _read_parameters(text: NDArray[Any]) -> dict[str, Any]:
    try:
        parameters: dict[str, Any] = json.loads(str(text))
    except (ValueError, RecursionError) as error:
        raise DousaError(f"expected a dousa forest, got damaged data: {error}; train again") from error
    _check(isinstance(parameters, dict), "bad parameters")
    return parameters


def _check_trees(trees: Trees) -> None:
    """Every index in range and every child behind its parent, so that each way down ends in a leaf."""
    count = len(trees.nodes)
    _check(trees.nodes.shape == (count, 6) and count > 0, "bad nodes")
    roots = trees.roots
    _check(len(roots) > 0 and roots[0] == 0 and (np.diff(roots) > 0).all() and roots[-1] < count, "bad roots")
    children = trees.nodes[:, 2].astype(np.int64)
    inner = np.flatnonzero(children >= 0)
    ends = np.append(roots[1:], count)[np.searchsorted(roots, inner, side="right") - 1]
    _check(
        bool(((children[inner] > inner) & (children[inner] + 1 < ends)).all()), "a child before its parent"
    )
    _check(not trees.nodes[children < 0][:, [0, 1, 3]].any(), "a leaf that tests")
    leaves = -1 - children[children < 0]
    _check(bool((leaves < trees.n_leaves).all()), "a leaf that does not exist")
    later, sooner = trees.nodes[inner, 0].astype(np.int64), trees.nodes[inner, 1].astype(np.int64)
    width = trees.n_frames + 1
    in_range = (sooner >= 0) & (later < trees.n_features * width) & (sooner < later)
    _check(bool((in_range & (later // width == sooner // width)).all()), "a test outside the clip")
    partner = np.abs(trees.nodes[inner, 3].astype(np.int64))
    in_range = (partner % width == 0) & (later + partner < trees.n_features * width)
    _check(bool(in_range.all()), "a test of a column that does not exist")
    _check(bool(np.isfinite(trees.cuts[inner, 2]).all()), "a threshold that is not finite")
    starts, entries = trees.leaf_starts, len(trees.leaf_classes)
    _check(len(starts) > 1 and starts[0] == 0 and starts[-1] == entries, "bad leaves")
    _check(bool((np.diff(starts) > 0).all()) and len(trees.leaf_counts) == entries, "bad leaves")
    in_range = (trees.leaf_classes >= 0) & (trees.leaf_classes < trees.n_classes) & (trees.leaf_counts > 0)
    _check(bool(in_range.all()), "a leaf of a category that does not exist")
