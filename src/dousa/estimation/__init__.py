"""Estimation: from silhouettes to joint angles, with a body model and inertia.

Masks or video -> silhouettes; a body of rigid parts and calibrated cameras; each frame the joint angles whose
projection fits the silhouettes are searched part by part within what inertia allows (Kameda, Minoh and Ikeda).
Loaded name by name when first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
