from .formats.registry import read_motion, write_motion
from .library import Library
from .motion import (
    CANONICAL_JOINTS,
    CanonicalMotion,
    Motion,
    Skeleton,
    Trajectories,
    canonicalise,
    compute_trajectories,
)
from .retrieval import MotionForest, compute_clip_features

__version__: str

__all__ = [
    "CANONICAL_JOINTS",
    "CanonicalMotion",
    "Library",
    "Motion",
    "MotionForest",
    "Skeleton",
    "Trajectories",
    "canonicalise",
    "compute_clip_features",
    "compute_trajectories",
    "read_motion",
    "write_motion",
]
