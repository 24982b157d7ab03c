"""The forest: training, and one query, ours on integral features against scikit-learn on 3,080 materialised columns.

    python -m lab.benchmarks.forest [FOLDER ...] [--clips 1000] [--classes 20]

FOLDER holds one folder per category (``../shared/data/bandai``); half of each category trains. Same clips, same
split, 100 trees, entropy, no bootstrap, 2 workers, square root of the tests at a node. The peer's time does not count
making the columns, ours the integrals. A query is a clip that was not trained with, each a Python call of its own.
Macro F-measures are means over the repeats, each with its own seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.ensemble import RandomForestClassifier
from sklearn.metrics import f1_score

from dousa.retrieval import MotionForest, compute_clip_features, integrate, list_tests
from lab.benchmarks.timing import Row, Spent, run, spend, take_turns

QUERIES = 2000  # of ours; the peer is asked a hundredth


def read_clips(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Features (N, 10, 56) and categories of all BVH, AMC and C3D files below a folder."""
    from dousa.formats.registry import read_motion
    from dousa.motion import canonicalise

    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in (".bvh", ".amc", ".c3d"))
    features = [compute_clip_features(canonicalise(read_motion(path))) for path in files]
    return np.array(features), np.array([path.parent.relative_to(folder).as_posix() for path in files])


def make_clips(n_clips: int, n_classes: int) -> tuple[np.ndarray, np.ndarray]:
    """Random features (N, 10, 56) about one random motion per category: a timed stand-in, not human motion."""
    random = np.random.default_rng(0)
    categories = np.arange(n_clips) % n_classes
    features = 0.5 * random.normal(size=(n_classes, 10, 56))[categories]
    features += 0.5 * random.normal(size=(n_clips, 10, 56)) + 0.5 * random.normal(size=(n_clips, 1, 56))
    return features, np.array([f"category {number:02d}" for number in categories])


def materialise(features: np.ndarray) -> np.ndarray:
    """All 3,080 means as columns, which the peer needs."""
    integrals = integrate(features)
    tests = list_tests(features.shape[2], features.shape[1])
    columns = np.empty((len(features), len(tests)), np.float32)
    for column, (_, i, _, t0, t1) in enumerate(tests):
        columns[:, column] = (integrals[:, i, t1] - integrals[:, i, t0]) / (t1 - t0)
    return columns


def split_half(categories: np.ndarray) -> np.ndarray:
    """True for the training half of each category."""
    random, train = np.random.default_rng(0), np.zeros(len(categories), bool)
    for name in np.unique(categories):
        inside = random.permutation(np.flatnonzero(categories == name))
        train[inside[: (len(inside) + 1) // 2]] = True
    return train


def make_ours(seed: int) -> MotionForest:
    return MotionForest(n_jobs=2, random_state=seed)


def make_peer(seed: int) -> RandomForestClassifier:
    options = {"criterion": "entropy", "bootstrap": False, "max_features": "sqrt"}
    return RandomForestClassifier(100, n_jobs=2, random_state=seed, **options)


def compare(name: str, features: np.ndarray, categories: np.ndarray, repeats: int) -> Iterator[Row]:
    """Training, then single queries."""
    train, columns = split_half(categories), materialise(features)
    labels, truth, n_classes = categories[train], categories[~train], len(np.unique(categories))
    made: list[Any] = [None, None]
    scores: tuple[list[float], list[float]] = [], []
    spent: tuple[list[Spent], list[Spent]] = [], []
    for seed in range(repeats):
        for k, (make, values) in enumerate(((make_ours, features), (make_peer, columns))):
            taken, made[k] = spend(lambda make=make, values=values, seed=seed: make(seed).fit(values[train], labels))
            spent[k].append(taken)
            scores[k].append(float(f1_score(truth, made[k].predict(values[~train]), average="macro")))
    ours, theirs = (Spent(*np.median(times, axis=0)) for times in spent)
    note = "macro F {:.3f}, peer's {:.3f}".format(*map(np.mean, scores))
    work = f"train, {len(labels)} clips of {name}, {n_classes} categories"
    yield Row(work, ours, "scikit-learn", theirs, note=note)
    forest, peer = made
    peer.n_jobs = 1  # which is quicker for one query
    clips, rows = features[~train], columns[~train]
    found = take_turns(
        {
            "ours": lambda: [forest.count_votes(clips[k % len(clips)]) for k in range(QUERIES)],
            "theirs": lambda: [peer.predict_proba(rows[k : k + 1]) for k in range(min(QUERIES // 100, len(rows)))],
        },
        repeats,
    )
    theirs = found["theirs"].per(min(QUERIES // 100, len(rows)))
    work = f"one query, {len(forest.trees_.nodes):,} nodes"
    yield Row(work, found["ours"].per(QUERIES), "scikit-learn", theirs)


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    MotionForest(n_trees=2).fit(*make_clips(10, 2)).count_votes(make_clips(10, 2)[0][0])  # compiles
    for folder in options.folders:
        yield from compare(folder.name, *read_clips(folder), options.repeats)
    if options.clips:
        yield from compare("random numbers", *make_clips(2 * options.clips, options.classes), options.repeats)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--clips", type=int, default=1000, help="training clips made at random; 0 for none")
    parser.add_argument("--classes", type=int, default=20)


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
