"""Motion: skeletons, joint rotations, trajectories, canonical joints.

Names are loaded when first used, as the kernels load numba.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
