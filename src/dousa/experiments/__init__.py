"""Every trial of dousa against known truth: recognition, ranking, takes, novelty, pose, errors."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
