"""What a forest takes: checked, and put into the arrays that its kernels want."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, OptionError, TrainingError
from dousa.retrieval.features import FEATURE_NAMES

__all__ = ["check_features", "check_names", "check_whole", "count_trials", "is_whole", "number_categories"]

FloatArray = NDArray[np.float64]


def is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_whole(name: str, value: object, least: int, otherwise: str = "") -> None:
    if not is_whole(value) or value < least:  # type: ignore[operator]
        raise OptionError(f"{name}: expected {otherwise}a whole number of at least {least}, got {value!r}")


def count_trials(n_trials: int | str | None, n_tests: int) -> int:
    if isinstance(n_trials, str):
        return n_tests if n_trials == "all" else int(np.sqrt(n_tests))
    return min(int(np.log2(n_tests)) + 1 if n_trials is None else int(n_trials), n_tests)


def check_features(
    features: ArrayLike, shape: tuple[int, int] | None = None, *, finite: bool = False
) -> FloatArray:
    """C-ordered (N, T, F) float64; finite if that is asked for: the query looks for itself."""
    try:
        pose = np.ascontiguousarray(features, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidMotionError(f"expected pose features as numbers: {error}") from error
    if pose.ndim != 3 or 0 in pose.shape[1:] or (shape is not None and pose.shape[1:] != shape):
        wanted = "(clips, frames, features)" if shape is None else f"(clips, {shape[0]}, {shape[1]})"
        raise InvalidMotionError(f"expected pose features of shape {wanted}, got {pose.shape}")
    if finite and not np.isfinite(pose).all():
        bad = int(np.argwhere(~np.isfinite(pose))[0][0])
        raise InvalidMotionError(f"expected finite pose features, clip {bad} has NaN or infinity")
    return pose


def number_categories(categories: ArrayLike, n_clips: int) -> tuple[NDArray[Any], NDArray[np.int32]]:
    """The different categories, sorted, and each clip's number among them."""
    labels = np.asarray(categories)
    if labels.dtype == object and all(isinstance(label, str) for label in labels.flat):
        labels = labels.astype(np.str_)
    if labels.dtype.kind not in "Uiub":
        raise TrainingError(
            f"expected categories as words or whole numbers, got {labels.dtype} {labels.shape}"
        )
    if labels.shape != (n_clips,):
        raise TrainingError(f"expected one category for each of {n_clips} clips, got shape {labels.shape}")
    classes, numbers = np.unique(labels, return_inverse=True)
    return classes, numbers.astype(np.int32)


def check_names(names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if names is None:
        is_ours = count == len(FEATURE_NAMES)
        return FEATURE_NAMES if is_ours else tuple(f"feature {number}" for number in range(count))
    if isinstance(names, str) or len(names) != count:
        raise OptionError(f"expected {count} feature names, got {len(names)}")
    return tuple(str(name) for name in names)
