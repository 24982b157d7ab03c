"""Names of the array types, spelled once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
Mask = NDArray[np.bool_]
"""(..., H, W), True where the person is."""
Image = NDArray[np.uint8]
"""(H, W) or (H, W, 3), bytes."""
