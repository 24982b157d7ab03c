"""dousa (動作, "motion"): capture, find and judge human motion.

``dousa.read_motion("walk.bvh")`` reads any motion file, ``dousa.Library.open("mine.dousa")`` opens a motion
library. Names are loaded when first used, so that ``import dousa`` costs next to nothing.
"""

from __future__ import annotations

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
