"""Wrong labels found by halves of the clips that judge each other, as `dousa review` does, and by other ways.

    python -m lab.trials.label_review [--draws 6]

A share of the labels is replaced at random. For each way: the wrong labels that are in doubt, those for which the right
one is suggested, those among the first as many of the list, and the right labels in doubt. The baselines are
cross-validation with five parts, whose answers depend on how the clips are dealt, and the five nearest clips.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from dousa.app.demo import write_library
from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.formats import ReadOptions
from dousa.library.care.review import split_halves, vote_without
from dousa.retrieval import FEATURE_SETS
from lab.places import SHARED_DATA

SHARES = 0.05, 0.15
REAL = "hdm05", "utd_mhad"


def find_sets(scratch: Path) -> Iterator[tuple[str, Path]]:
    """Folders of clips: synthetic ones, and the real ones that are at hand."""
    write_library(scratch, n_performers=12, categories=("kick_left", "squat", "wave_right", "walk", "bow", "jump"))
    yield "synthetic", scratch
    yield from ((name, SHARED_DATA / name) for name in REAL if (SHARED_DATA / name).is_dir())


def split_fifths(labels: np.ndarray, seed: int) -> np.ndarray:
    """(5, N) the clips learned in cross-validation of five parts, each part of all categories."""
    order = np.lexsort((np.random.default_rng(seed).permutation(len(labels)), labels))
    parts = np.empty(len(labels), int)
    parts[order] = np.arange(len(labels)) % 5
    return parts != np.arange(5)[:, np.newaxis]


def vote_halves(features: np.ndarray, labels: np.ndarray, seed: int) -> np.ndarray:
    """The votes of `dousa review`."""
    halves = split_halves(labels, 12)
    return vote_without(features, labels, FEATURE_SETS["extended"], np.concatenate([halves, ~halves]), n_trees=10)[1]


def vote_fifths(features: np.ndarray, labels: np.ndarray, seed: int) -> np.ndarray:
    """Those of 50 trees each of four fifths."""
    return vote_without(features, labels, FEATURE_SETS["extended"], split_fifths(labels, seed), n_trees=50)[1]


def vote_nearest(features: np.ndarray, labels: np.ndarray, seed: int) -> np.ndarray:
    """Those of the five nearest, each column in units of its standard deviation."""
    flat = features.reshape(len(features), -1).astype(float)
    flat = (flat - flat.mean(axis=0)) / np.maximum(flat.std(axis=0), 1e-9)
    squares = (flat**2).sum(axis=1)
    far = squares[:, np.newaxis] + squares - 2 * flat @ flat.T
    np.fill_diagonal(far, np.inf)
    nearest = np.argsort(far, axis=1)[:, :5]
    return np.stack([(labels[nearest] == name).mean(axis=1) for name in np.unique(labels)], axis=1)


WAYS = {"halves (dousa review)": vote_halves, "five parts": vote_fifths, "five nearest": vote_nearest}


def count_found(shares: np.ndarray, right: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Wrong labels, those in doubt, with the right suggestion, among the first, and right labels in doubt."""
    names, wrong = np.unique(given), right != given
    rows, own = np.arange(len(given)), np.searchsorted(names, given)
    others = shares.copy()
    others[rows, own] = -1.0
    margins, suggested = others.max(axis=1) - shares[rows, own], names[others.argmax(axis=1)]
    doubted, first = margins > 0, np.argsort(-margins, kind="stable")[: wrong.sum()]
    return np.array([
        wrong.sum(), (wrong & doubted).sum(), (wrong & doubted & (suggested == right)).sum(),
        (wrong & doubted)[first].sum(), (~wrong & doubted).sum(),
    ])  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=6)
    n_draws = parser.parse_args().draws
    columns = ("clips", "way", "wrong", "in doubt", "right one named", "among the first", "right ones in doubt")
    table = Table(
        *columns, title=f"{n_draws} draws each of {', '.join(f'{share:.0%}' for share in SHARES)} wrong labels"
    )
    with tempfile.TemporaryDirectory() as scratch:
        for name, folder in find_sets(Path(scratch)):
            clips, _ = read_labelled_clips([folder], category_from="folder", performer_from=None, options=ReadOptions())
            categories = np.array([clip.category for clip in clips])
            kept = [row for row, category in enumerate(categories) if (categories == category).sum() >= 5]
            features = np.stack([FEATURE_SETS["extended"].compute(clips[row]) for row in kept]).astype(np.float32)
            right = categories[kept]
            totals = {way: np.zeros(5, int) for way in WAYS}
            for share in SHARES:
                for seed in range(n_draws):
                    chance, given = np.random.default_rng([int(100 * share), seed]), right.copy()
                    for row in chance.choice(len(given), round(share * len(given)), replace=False):
                        given[row] = chance.choice(np.setdiff1d(right, right[row]))
                    for way, vote in WAYS.items():
                        totals[way] += count_found(vote(features, given, seed), right, given)
            for way, counts in totals.items():
                table.add_row(f"{name}, {len(right)}", way, *map(str, counts))
    Console().print(table)


if __name__ == "__main__":
    main()
