"""dousa (動作, "motion"): capture, find and judge human motion.

``dousa.read_motion("walk.bvh")`` reads any motion file, ``dousa.Library.open("mine.dousa")`` opens a motion
library. Names are loaded when first used, so that ``import dousa`` costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dousa._lazy import load_when_used

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


__getattr__ = load_when_used(__name__, _HOME)


def __dir__() -> list[str]:
    return sorted(__all__)
