"""The motion library: clips with their categories, features, histograms and the forest, in one file.

``Library.open("moves.dousa", create=True)`` opens or makes one. Loaded name by name when first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
