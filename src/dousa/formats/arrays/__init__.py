"""Arrays of numpy: npz of dousa, of SMPL poses or of joints, npy of joints or features; pickles of any."""

from __future__ import annotations

from dousa.formats.arrays.content import read_arrays
from dousa.formats.arrays.npz import read_any_npz, write_npz

__all__ = ["read_any_npz", "read_arrays", "write_npz"]
