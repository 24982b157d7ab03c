"""Categories learned from few clips: Bandai-Namco 2, 70 categories, 3 of 10 clips of each train, the others are tested.

    python -m lab.trials.few_clips [FOLDER] [--share 0.3]

FOLDER holds one folder per category. Ours is the forest of `dousa train`, and that on the paper's features; the peer is
scikit-learn's extremely randomised trees on the cells of the extended features. All see the same draws. Goal: F 0.97.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.metrics import compute_scores
from dousa.formats import ReadOptions
from dousa.retrieval import FEATURE_SETS, MotionForest
from lab.benchmarks.timing import timed
from lab.places import SHARED_DATA

DATA = SHARED_DATA / "bandai"
SEEDS = range(6)


def draw_training(categories: np.ndarray, share: float, seed: int) -> np.ndarray:
    """Which clips train: the share of every category, at least one."""
    generator, trains = np.random.default_rng(seed), np.zeros(len(categories), bool)
    for category in np.unique(categories):
        members = generator.permutation(np.flatnonzero(categories == category))
        trains[members[: max(1, round(share * len(members)))]] = True
    return trains


def fit_ours(feature_set: str, features: np.ndarray, categories: np.ndarray, seed: int) -> Any:
    spec = FEATURE_SETS[feature_set]
    forest = MotionForest(thresholds=spec.thresholds, random_state=seed, n_jobs=2)
    return forest.fit(features, categories, feature_set=spec)


def fit_peer(features: np.ndarray, categories: np.ndarray, seed: int) -> Any:
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import FunctionTransformer

    forest = ExtraTreesClassifier(100, random_state=seed, n_jobs=2)
    flat = FunctionTransformer(lambda cells: cells.reshape(len(cells), -1))
    return make_pipeline(flat, forest).fit(features, categories)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=DATA)
    parser.add_argument("--share", type=float, default=0.3)
    asked = parser.parse_args()
    if not asked.folder.exists():
        print(f"skipped: no recordings at {asked.folder}")
        return
    clips, _ = read_labelled_clips([asked.folder], category_from="folder", performer_from=None, options=ReadOptions())
    categories = np.array([clip.category for clip in clips])
    cells = {name: np.stack([spec.compute(clip) for clip in clips]) for name, spec in FEATURE_SETS.items()}
    systems = {
        "dousa, extended": ("extended", lambda *given: fit_ours("extended", *given)),
        "dousa, paper": ("paper", lambda *given: fit_ours("paper", *given)),
        "scikit-learn extra trees": ("extended", fit_peer),
    }
    print(f"{len(set(categories))} categories, {asked.share:.0%} of {len(clips)} clips train, {len(SEEDS)} draws")
    print(f"{'system':26s} {'F':>15s} {'accuracy':>9s} {'train s':>8s}")
    for name, (features, fit) in systems.items():
        rows = []
        for seed in SEEDS:
            trains = draw_training(categories, asked.share, seed)
            seconds, fitted = timed(lambda: fit(cells[features][trains], categories[trains], seed))  # noqa: B023
            scores = compute_scores(categories[~trains], fitted.predict(cells[features][~trains]))
            rows.append((scores.f_measure, scores.accuracy, seconds))
        means = np.mean(rows, axis=0)
        spread = np.std([row[0] for row in rows])
        print(f"{name:26s} {means[0]:7.4f} ± {spread:.4f} {means[1]:9.4f} {means[2]:8.2f}")


if __name__ == "__main__":
    main()
