"""Estimation: from silhouettes or keypoints to joint angles, with a body model and inertia.

The method for silhouettes is that of Kameda, Minoh and Ikeda. Names are loaded when first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
