"""The sets of features a forest can be trained on, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval.extra_features import compute_extra_features
from dousa.retrieval.features import compute_clip_features

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion

__all__ = ["FEATURE_SETS"]


def _compute_extended(
    canonical: CanonicalMotion, n_frames: int = 10, samples_per_frame: int = 8
) -> NDArray[np.float64]:
    """The 56 and the extra features of a clip, (n_frames, 82)."""
    poses = compute_clip_features(canonical, n_frames, samples_per_frame)
    parts = (poses, compute_extra_features(canonical, n_frames))
    return np.concatenate(parts, axis=1)


FEATURE_SETS: dict[str, Callable[[CanonicalMotion, int, int], NDArray[np.float64]]] = {
    "paper": compute_clip_features,
    "extended": _compute_extended,
}
"""``"paper"``: the 56 pose features; ``"extended"``: those and turn, travel, velocities and duration."""
