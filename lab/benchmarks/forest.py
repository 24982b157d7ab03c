"""Training the forest: ours on integral features against scikit-learn on the 3,080 materialised columns.

    python -m lab.benchmarks.forest [FOLDER ...] [--clips 5000] [--classes 50] [--repeats 3]

FOLDER holds one folder per category (``../shared/data/bandai``); half of each category trains. Same clips, same
split, 100 trees, entropy, no bootstrap, 2 workers, square root of the tests at a node. Prints the seconds of the
fastest of the repeats (the peer's do not count making the columns), the ratio and both macro F-measures, means over the
repeats. The last line of each is ours with its own default of tests at a node.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.ensemble import RandomForestClassifier
from sklearn.metrics import f1_score

from dousa.retrieval import MotionForest
from lab.benchmarks.forest_material import make_clips, materialise, read_clips, split_half


def measure(create: Callable[[int], Any], train: Any, test: Any, truth: Any, repeats: int) -> tuple[float, float]:
    """Fastest training in seconds and mean macro F-measure."""
    seconds, scores = [], []
    for seed in range(repeats):
        start = time.perf_counter()
        forest = create(seed).fit(*train)
        seconds.append(time.perf_counter() - start)
        scores.append(f1_score(truth, forest.predict(test), average="macro"))
    return min(seconds), float(np.mean(scores))


def compare(name: str, features: Any, categories: Any, repeats: int) -> None:
    """Prints one comparison."""
    train = split_half(categories)
    columns = materialise(features)

    def create_peer(seed: int) -> RandomForestClassifier:
        return RandomForestClassifier(
            100, criterion="entropy", bootstrap=False, max_features="sqrt", n_jobs=2, random_state=seed
        )

    truth, labels = categories[~train], categories[train]
    ours, theirs = features[train], columns[train]
    sqrt, sqrt_f = measure(
        lambda seed: MotionForest(n_trials="sqrt", n_jobs=2, random_state=seed),
        (ours, labels), features[~train], truth, repeats,
    )  # fmt: skip
    default, default_f = measure(
        lambda seed: MotionForest(n_jobs=2, random_state=seed),
        (ours, labels), features[~train], truth, repeats,
    )  # fmt: skip
    peer, peer_f = measure(create_peer, (theirs, labels), columns[~train], truth, repeats)
    print(f"{name}: {len(labels)} training clips, {len(np.unique(labels))} categories")
    print(f"  ours         {sqrt:8.3f} s  macro F {sqrt_f:.4f}")
    print(f"  scikit-learn {peer:8.3f} s  macro F {peer_f:.4f}  ratio {peer / sqrt:.1f}")
    print(f"  ours, default{default:8.3f} s  macro F {default_f:.4f}  ratio {peer / default:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--clips", type=int, default=5000, help="training clips made at random; 0 for none")
    parser.add_argument("--classes", type=int, default=50)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    start = time.perf_counter()
    MotionForest(n_trees=2).fit(*make_clips(10, 2)).predict(make_clips(10, 2)[0])
    print(f"first training and query, with compilation or its cache: {time.perf_counter() - start:.2f} s")
    for folder in options.folders:
        compare(folder.name, *read_clips(folder), options.repeats)
    if options.clips:
        compare("made at random", *make_clips(2 * options.clips, options.classes), options.repeats)


if __name__ == "__main__":
    main()
