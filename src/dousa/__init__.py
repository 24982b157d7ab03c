"""dousa (動作, "motion"): capture, find and judge human motion.

``dousa.read_motion("walk.bvh")`` reads any motion file, ``dousa.Library.open("mine.dousa")`` opens a motion
library. Names are loaded when first used, so that ``import dousa`` costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dousa.formats import read_motion, write_motion
    from dousa.library import Library
    from dousa.motion import (
        CANONICAL_JOINTS,
        CanonicalMotion,
        Motion,
        Skeleton,
        Trajectories,
        canonicalise,
        compute_trajectories,
    )
    from dousa.retrieval import MotionForest, compute_clip_features

__version__ = "0.1.0"

_HOME = {
    "read_motion": "dousa.formats",
    "write_motion": "dousa.formats",
    "CANONICAL_JOINTS": "dousa.motion",
    "CanonicalMotion": "dousa.motion",
    "Motion": "dousa.motion",
    "Skeleton": "dousa.motion",
    "Trajectories": "dousa.motion",
    "canonicalise": "dousa.motion",
    "compute_trajectories": "dousa.motion",
    "MotionForest": "dousa.retrieval",
    "compute_clip_features": "dousa.retrieval",
    "Library": "dousa.library",
}

__all__ = [
    "CANONICAL_JOINTS",
    "CanonicalMotion",
    "Library",
    "Motion",
    "MotionForest",
    "Skeleton",
    "Trajectories",
    "__version__",
    "canonicalise",
    "compute_clip_features",
    "compute_trajectories",
    "read_motion",
    "write_motion",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'dousa' has no attribute '{name}'")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
