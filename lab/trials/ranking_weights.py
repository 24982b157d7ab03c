"""What the rankings and the weights of their fusion are worth in four situations.

    python -m lab.trials.ranking_weights FOLDER [--performer-from RULE] [--repeats N] [--dtw]

FOLDER holds one folder per category (and perhaps folders below for variants of it, such as walk/old). Prints the mean
average precision where

- known: the forest learned from the gallery, the queries are of performers left out (or a half, without performers);
- new clips: the forest learned from other performers than those of the gallery and of the query (of three or more);
- new categories: the forest knows half of the categories, the queries are of the other half;
- variants: the forest learned what stands before the '/' of a category, relevant are clips of the same whole category.

Every row has four weights: of the histogram's distance / sqrt(2), of the leaves' distance, of the poses' distance (1 /
body heights), and of 1 - cos of the angle between both clips in the space of poses; poses are compared for all clips
here. The rankings use (1, 0.5, 8, 0), a library (1, 0.5, 8, 0.5). With --dtw also a row of DTW on poses at 30 Hz, which
learns nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.runner import Split, fit_forest, leave_performer_out, make_forest, split_half
from dousa.formats import ReadOptions
from dousa.retrieval.features.feature_sets import FEATURE_SETS
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.evidence import describe_strangers
from dousa.retrieval.forest.pose_space import fit_pose_basis
from dousa.retrieval.ranking.ranking import warp_distances
from lab.ranking.dense import Gallery, rank_clips
from lab.ranking.metrics import score_ranking
from lab.ranking.systems import describe_clips

WEIGHTS = (
    (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 0.5, 0, 0), (1, 0.5, 4, 0), (1, 0.5, 8, 0), (1, 0.5, 12, 0),
    (1, 1, 8, 0), (1, 0.5, 8, 0.1), (1, 0.5, 8, 0.25), (1, 0.5, 8, 0.5), (1, 0.5, 8, 1),
)  # fmt: skip


class Trials:
    """The clips of a folder, and the average precisions that were measured on them."""

    def __init__(self, clips: Sequence[LabelledClip], with_dtw: bool) -> None:
        self.spec = FEATURE_SETS["extended"]
        self.material = describe_clips(clips, ("fused", "dtw"), self.spec, None)
        self.warped = warp_all(self.material.poses) if with_dtw else None
        self.categories = np.array([clip.category for clip in clips])
        self.precisions: dict[str, list[np.ndarray]] = {}

    def try_weights(
        self,
        name: str,
        train: np.ndarray,
        queries: np.ndarray,
        gallery: np.ndarray,
        labels: np.ndarray,
        seed: int,
    ) -> None:
        """Rank the gallery for each query; ``labels`` are what the forest is taught."""
        if len(set(labels[train])) < 2:
            return
        spec, features = self.spec, self.material.features
        forest = make_forest(spec, 100, seed, -1)
        fit_forest(forest, features, train, labels[train], self.material.copies, spec)
        directions = self.point(train, labels[train])
        leaves = forest.apply(features).astype(np.int32)
        votes, poses = forest.histograms_of(leaves), self.material.sequences
        gallery = np.random.default_rng(seed).permutation(gallery)
        clips = Gallery(votes[gallery], leaves[gallery], poses[gallery])
        for query in queries:
            relevant = self.categories[gallery] == self.categories[query]
            answer = rank_clips("fused", (votes[query], leaves[query], poses[query]), clips, len(gallery))
            angles = 1.0 - directions[gallery] @ directions[query]
            distances = np.stack([answer.histogram / np.sqrt(2), answer.leaves, answer.pose, angles])
            orders = np.argsort(np.array(WEIGHTS) @ distances, axis=1, kind="stable")
            if self.warped is not None:
                orders = np.vstack([orders, np.argsort(self.warped[query, gallery], kind="stable")])
            row = [score_ranking(relevant[order]).average_precision for order in orders]
            self.precisions.setdefault(name, []).append(np.array(row))

    def point(self, train: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """(N, K) unit directions of all clips in the space of poses of some, as a library learns it."""
        features, copies, strangers = (
            self.material.features,
            self.material.copies.of(train),
            describe_strangers(self.spec),
        )
        assert strangers is not None
        parts = [features[train], copies.features, strangers.beside]
        basis = fit_pose_basis(parts, self.spec)
        placed = np.concatenate([basis.place(part) for part in parts])
        points = basis.fit(placed, np.append(labels, labels[copies.rows])).place(features)
        return points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)

    def report(self) -> None:
        print("weights          ", *(f"{name:>16}" for name in self.precisions))
        means = {name: np.nanmean(rows, axis=0) for name, rows in self.precisions.items()}
        rows = (*WEIGHTS, "DTW") if self.warped is not None else WEIGHTS
        for place, weights in enumerate(rows):
            print(f"{weights!s:18}", *(f"{mean[place]:16.3f}" for mean in means.values()))


def warp_all(poses: Sequence[np.ndarray]) -> np.ndarray:
    """(N, N) distances of every clip from every other."""
    stops = np.cumsum([len(one) for one in poses])
    starts, frames = stops - [len(one) for one in poses], np.concatenate(poses)
    distances = np.empty((len(poses), len(poses)))
    for row, one in zip(distances, poses, strict=True):
        warp_distances(one, frames, starts, stops, np.inf, row)
    return distances


def make_folds(clips: Sequence[LabelledClip], seed: int) -> tuple[Split, ...]:
    if all(clip.performer for clip in clips):
        return leave_performer_out([clip.performer for clip in clips])
    return (split_half([clip.category for clip in clips], seed),)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--performer-from")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--dtw", action="store_true")
    options = parser.parse_args()
    clips, _ = read_labelled_clips(
        [options.folder],
        category_from="folder",
        performer_from=options.performer_from,
        options=ReadOptions(),
    )
    trials = Trials(clips, options.dtw)
    performers = np.array([clip.performer or "" for clip in clips])
    coarse = np.array([name.split("/")[0] for name in trials.categories])
    for seed in range(options.repeats):
        names = np.random.default_rng(seed).permutation(sorted(set(trials.categories)))
        known = np.isin(trials.categories, names[: len(names) // 2])
        for fold in make_folds(clips, seed):
            train, test = fold.train, fold.test
            trials.try_weights("known", train, test, train, trials.categories, seed)
            others = sorted(set(performers[train]))
            if len(others) > 1:
                apart = performers[train] == others[seed % len(others)]
                trials.try_weights("new clips", train[~apart], test, train[apart], trials.categories, seed)
            trials.try_weights(
                "new categories", train[known[train]], test[~known[test]], train, trials.categories, seed
            )
            if (coarse != trials.categories).any():
                trials.try_weights("variants", train, test, train, coarse, seed)
    trials.report()


if __name__ == "__main__":
    main()
