"""What motion is: skeletons, joint rotations, trajectories, canonical joints.

Loaded name by name when first used: the types cost nothing, the kernels load numba.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
