"""Clips for the forest benchmarks: real ones from a folder with one folder per category, or made ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval import compute_clip_features, integrate, list_tests


def read_clips(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Features (N, 10, 56) and categories of all BVH, AMC and C3D files below a folder."""
    from dousa.formats.registry import read_motion
    from dousa.motion import canonicalise

    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in (".bvh", ".amc", ".c3d"))
    features = [compute_clip_features(canonicalise(read_motion(path))) for path in files]
    return np.array(features), np.array([path.parent.relative_to(folder).as_posix() for path in files])


def make_clips(n_clips: int, n_classes: int) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Random features (N, 10, 56) about one random motion per category: a timed stand-in, not human motion."""
    random = np.random.default_rng(0)
    categories = np.arange(n_clips) % n_classes
    features = 0.5 * random.normal(size=(n_classes, 10, 56))[categories]
    features += 0.5 * random.normal(size=(n_clips, 10, 56)) + 0.5 * random.normal(size=(n_clips, 1, 56))
    return features, np.array([f"category {number:02d}" for number in categories])


def materialise(features: NDArray[np.float64]) -> NDArray[np.float32]:
    """All 3,080 means as columns, which the peer needs."""
    integrals = integrate(features)
    tests = list_tests(features.shape[2], features.shape[1])
    columns = np.empty((len(features), len(tests)), np.float32)
    for column, (_, i, _, t0, t1) in enumerate(tests):
        columns[:, column] = (integrals[:, i, t1] - integrals[:, i, t0]) / (t1 - t0)
    return columns


def split_half(categories: NDArray[np.str_], seed: int = 0) -> NDArray[np.bool_]:
    """True for the training half of each category."""
    random, train = np.random.default_rng(seed), np.zeros(len(categories), bool)
    for name in np.unique(categories):
        inside = random.permutation(np.flatnonzero(categories == name))
        train[inside[: (len(inside) + 1) // 2]] = True
    return train
