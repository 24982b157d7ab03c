"""Evaluation: what differs between a dance and its model, where, and by how much.

Postures -> yaw -> time-series correlation matrix -> correspondence -> furi -> eigenspaces -> the four errors
(Yamane and Shakunaga); errors injected into real motion measure how well that works. Loaded name by name when
first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
