"""Retrieval: find the motions that mean the same.

Pose features -> integral features -> random forest -> histograms -> ranking (Hamada, Kuriyama, Mukai), the
motion template baseline, and the experiment that compares them. Loaded name by name when first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
