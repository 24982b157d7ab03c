"""A trained forest as bytes: an .npz of plain arrays, checked so that no bytes can crash or hang a query."""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import DousaError
from dousa.files.npz_arrays import open_npz
from dousa.messages import Message
from dousa.retrieval.forest.trees import LeafEntries, Trees


def damaged(what: Message, reason: object) -> DousaError:
    """Return the error that stored bytes are not ``what``; ``reason`` is another error, or the wrong part."""
    return DousaError("stored.damaged", what=what, reason=reason)


def check(condition: bool | np.bool_, what: Message, part: str) -> None:
    """Raise DousaError with the wrong ``part`` of ``what`` unless ``condition`` holds."""
    if not condition:
        raise damaged(what, part)


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack arrays into bytes; the same arrays give the same bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def unpack_arrays(
    data: bytes, names: Collection[str], what: Message, optional: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """Read the arrays ``names`` and any ``optional`` ones; DousaError for any other content."""
    with open_npz(data, lambda message: damaged(what, message)) as archive:
        check(sorted({*archive.names} - {*optional}) == sorted(names), what, "other arrays")
        # Arrays are stored uncompressed, so no file may unpack to more than its size.
        check(not archive.compressed, what, "it is compressed")
        # Copied, as numba compiles for arrays that may be written to.
        return {name: archive.read(name, "biufU", most=len(data)).copy("K") for name in archive.names}


def check_version(arrays: Mapping[str, NDArray[Any]], what: Message, known: int) -> None:
    """Raise DousaError unless the array ``version`` is ``known``."""
    version = arrays["version"]
    check(version.shape == () and version.dtype.kind in "iu", what, "no version")
    if int(version) != known:
        raise DousaError("stored.other_version", what=what, version=int(version), known=known)


_WHAT = Message("stored.forest")
_VERSION = 4  # of the stored form, also of the calibration beside it, by definition

# Arrays of the trees by the names of their fields, and of the training; all have one axis, the nodes two.
_TREE_ARRAYS: dict[str, type[np.generic]] = {
    "nodes": np.int32,
    "roots": np.int64,
    "leaf_starts": np.int64,
    "leaf_classes": np.int32,
    "leaf_counts": np.int32,
}
_TRAINED_ARRAYS: dict[str, type[np.generic]] = {
    "trained_starts": np.int64,
    "trained_classes": np.int32,
    "trained_counts": np.int32,
}


@dataclass(frozen=True, slots=True, eq=False)
class ForestFile:
    """The stored parts of a forest: constructor parameters, trees, categories (C,), feature names (F,)."""

    parameters: dict[str, Any]
    trees: Trees
    classes: NDArray[Any]
    feature_names: tuple[str, ...]


def pack_forest(file: ForestFile) -> bytes:
    """Pack a forest; the same forest gives the same bytes."""
    trees = file.trees
    parameters = {
        key: value.item() if isinstance(value, np.generic) else value for key, value in file.parameters.items()
    }
    return pack_arrays(
        {
            "version": np.array(_VERSION, np.int64),
            "parameters": np.array(json.dumps(parameters)),
            "classes": file.classes,
            "feature_names": np.array(file.feature_names, dtype=np.str_),
            **{name: getattr(trees, name) for name in _TREE_ARRAYS},
            "sizes": np.array([trees.n_features, trees.n_frames, trees.n_classes], np.int64),
            **({} if trees.homes is None else {"homes": trees.homes}),
            **({"pooled": np.array(1, np.int64)} if trees.pooled else {}),
            **({} if trees.trained is None else dict(zip(_TRAINED_ARRAYS, trees.trained, strict=True))),
        }
    )


def unpack_forest(data: bytes) -> ForestFile:
    """Read a forest; DousaError if the bytes are damaged, something else, or of another version."""
    names = {"version", "parameters", "classes", "feature_names", *_TREE_ARRAYS, "sizes"}
    arrays = unpack_arrays(data, names, _WHAT, ("homes", "pooled", *_TRAINED_ARRAYS))
    check_version(arrays, _WHAT, _VERSION)
    grown = _TRAINED_ARRAYS.keys() <= arrays.keys()  # a grown forest keeps the entries of the training
    _check(all((name in arrays) == grown for name in _TRAINED_ARRAYS), "other arrays")
    for name, dtype in {**_TREE_ARRAYS, **(_TRAINED_ARRAYS if grown else {})}.items():
        array, axes = arrays[name], 2 if name == "nodes" else 1
        _check(array.dtype == dtype and array.ndim == axes and array.flags.c_contiguous, f"bad {name}")
    sizes = arrays["sizes"]
    _check(sizes.dtype == np.int64 and sizes.shape == (3,), "bad sizes")
    _check(((sizes >= 1) & (sizes < 2**31)).all(), "bad sizes")
    fields: list[Any] = [
        *(arrays[name] for name in _TREE_ARRAYS),
        *map(int, sizes),
        arrays.get("homes"),
        "pooled" in arrays,
        LeafEntries(*(arrays[name] for name in _TRAINED_ARRAYS)) if grown else None,
    ]
    trees = Trees(*fields)
    _check_trees(trees)
    classes, features = arrays["classes"], arrays["feature_names"]
    _check(classes.shape == (trees.n_classes,) and classes.dtype.kind in "Uiub", "bad categories")
    _check(len(np.unique(classes)) == len(classes), "a category occurs twice")
    _check(features.shape == (trees.n_features,) and features.dtype.kind == "U", "bad feature names")
    return ForestFile(_read_parameters(arrays["parameters"]), trees, classes, tuple(map(str, features)))


def _check(condition: bool | np.bool_, problem: str) -> None:
    check(condition, _WHAT, problem)


def _read_parameters(text: NDArray[Any]) -> dict[str, Any]:
    try:
        parameters: dict[str, Any] = json.loads(str(text))
    except (ValueError, RecursionError) as error:
        raise damaged(_WHAT, error) from error
    _check(isinstance(parameters, dict), "bad parameters")
    return parameters


def _check_trees(trees: Trees) -> None:
    """Check that every index is in range and every child behind its parent, so that each path ends in a leaf."""
    count = len(trees.nodes)
    _check(trees.nodes.shape == (count, 6) and count > 0, "bad nodes")
    roots = trees.roots
    _check(len(roots) > 0 and roots[0] == 0 and (np.diff(roots) > 0).all() and roots[-1] < count, "bad roots")
    children = trees.nodes[:, 2].astype(np.int64)
    inner = np.flatnonzero(children >= 0)
    ends = np.append(roots[1:], count)[np.searchsorted(roots, inner, side="right") - 1]
    _check(bool(((children[inner] > inner) & (children[inner] + 1 < ends)).all()), "a child before its parent")
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
    least = 1 if trees.homes is None else 0
    in_range = (trees.leaf_classes >= 0) & (trees.leaf_classes < trees.n_classes) & (trees.leaf_counts >= least)
    _check(bool(in_range.all()), "a leaf of a category that does not exist")
    if trees.homes is not None:
        homes = trees.homes
        _check(homes.dtype == np.int32 and homes.shape == (trees.n_leaves,), "bad homes")
        _check(bool(((homes >= 0) & (homes < trees.n_leaves)).all()), "a home that does not exist")
        _check(bool((homes[homes] == homes).all()), "a home that has grown itself")
    if trees.trained is not None:
        starts, classes, counts = trees.trained
        _check(trees.homes is not None and 1 < len(starts) <= trees.n_leaves + 1, "bad leaves of the training")
        right = starts[0] == 0 and starts[-1] == len(classes) == len(counts) and bool((np.diff(starts) > 0).all())
        _check(right and bool((trees.home_leaves < len(starts) - 1).all()), "bad leaves of the training")
        in_range = (classes >= 0) & (classes < trees.n_classes) & (counts > 0)
        _check(bool(in_range.all()), "a leaf of a category that does not exist")
