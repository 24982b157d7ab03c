"""The windows of a take as bytes: an .npz of plain arrays, checked so that no bytes can crash a search."""

from __future__ import annotations

import numpy as np

from dousa.errors import DousaError, OptionError
from dousa.retrieval._npz_bytes import check, pack_arrays, unpack_arrays
from dousa.retrieval.takes import N_SMALL, TakeWindows, WindowGrid, place_windows

__all__ = ["pack_take", "unpack_take"]

_VERSION = 1
_WHAT = "the windows of a take"
_NAMES = ("version", "lengths", "leaves", "poses", "duration")


def pack_take(take: TakeWindows) -> bytes:
    """The bytes of a take; the same take gives the same bytes."""
    return pack_arrays(
        {
            "version": np.array(_VERSION, np.int64),
            "lengths": np.array(take.grid.lengths, np.int64),
            "leaves": np.ascontiguousarray(take.leaves),
            "poses": np.ascontiguousarray(take.poses),
            "duration": np.array(take.duration, np.float64),
        }
    )


def unpack_take(data: bytes) -> TakeWindows:
    """The take in the bytes; DousaError if they are damaged, something else, or of a newer version."""
    arrays = unpack_arrays(data, _NAMES, _WHAT)
    version, duration = arrays["version"], arrays["duration"]
    check(version.shape == () and version.dtype.kind in "iu", _WHAT, "no version")
    if int(version) != _VERSION:
        raise DousaError(
            f"the windows of a take are of version {int(version)}, this dousa reads {_VERSION}; update dousa, or train"
        )
    lengths, leaves, poses = arrays["lengths"], arrays["leaves"], arrays["poses"]
    check(lengths.ndim == 1 and lengths.dtype == np.int64, _WHAT, "bad lengths")
    try:
        grid = WindowGrid(tuple(lengths.tolist()))
    except OptionError as error:
        raise DousaError(f"expected {_WHAT}, got damaged or other data: {error}; train again") from error
    right = poses.ndim == 2 and poses.shape[1] == N_SMALL and poses.dtype == np.float16
    check(right and bool(np.isfinite(poses).all()), _WHAT, "bad poses")
    right = leaves.ndim == 2 and leaves.shape[1] > 0 and leaves.dtype in (np.uint16, np.int32)
    check(right and leaves.flags.c_contiguous, _WHAT, "bad leaves")
    check(len(leaves) == len(place_windows(grid, len(poses))[0]), _WHAT, "another number of windows")
    check(not len(leaves) or int(leaves.min()) >= 0, _WHAT, "bad leaves")
    right = duration.shape == () and duration.dtype == np.float64
    check(right and bool(np.isfinite(duration)) and float(duration) >= 0, _WHAT, "bad duration")
    return TakeWindows(grid, leaves, poses, float(duration))
