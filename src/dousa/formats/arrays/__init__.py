"""Arrays of numpy: npz of dousa, of SMPL poses or of joints, npy of joints or features; pickles of any."""

from __future__ import annotations

from dousa.formats.arrays.npz import read_any_npz, write_npz
from dousa.formats.arrays.pickles import read_arrays

__all__ = ["read_any_npz", "read_arrays", "write_npz"]
