"""Work on a cluster, ``with use_cluster("tcp://scheduler:8786"):`` around ``Library.add`` or ``Library.train``."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
