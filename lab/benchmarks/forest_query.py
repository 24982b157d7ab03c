"""One clip through 100 trees: ours against scikit-learn's predict_proba, in one run.

    python -m lab.benchmarks.forest_query [FOLDER] [--clips 5000] [--classes 50]

Prints microseconds a query, mean over many different clips that were not trained with, each a Python call of
its own; ours include the integral of the clip, the peer's materialised row is made beforehand. Goal: 20 us.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

from sklearn.ensemble import RandomForestClassifier

from dousa.retrieval import MotionForest, integrate
from lab.benchmarks.forest_material import make_clips, materialise, read_clips, split_half


def microseconds(ask: Callable[[int], object], n_clips: int, queries: int) -> float:
    """Mean time of one call, over different clips."""
    for number in range(min(queries, 100)):
        ask(number % n_clips)
    start = time.perf_counter()
    for number in range(queries):
        ask(number % n_clips)
    return (time.perf_counter() - start) / queries * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--clips", type=int, default=5000, help="training clips made at random, without FOLDER")
    parser.add_argument("--classes", type=int, default=50)
    options = parser.parse_args()
    made = options.folder is None
    features, categories = make_clips(2 * options.clips, options.classes) if made else read_clips(options.folder)
    train = split_half(categories)
    forest = MotionForest(random_state=0, n_jobs=2).fit(features[train], categories[train])
    columns = materialise(features)
    peer = RandomForestClassifier(100, criterion="entropy", bootstrap=False, random_state=0, n_jobs=1)
    peer.fit(columns[train], categories[train])
    clips, rows = features[~train], columns[~train]
    n = len(clips)
    print(f"{train.sum()} training clips, {len(forest.classes_)} categories, {len(forest.trees_.nodes)} nodes")
    low = microseconds(lambda k: forest.count_votes(clips[k]), n, 20_000)
    high = microseconds(lambda k: forest.predict_proba(clips[k : k + 1]), n, 20_000)
    integral = microseconds(lambda k: integrate(clips[k : k + 1]), n, 20_000)
    theirs = microseconds(lambda k: peer.predict_proba(rows[k : k + 1]), n, 200)
    print(f"  ours, count_votes (integral included) {low:10.1f} us")
    print(f"  ours, predict_proba                   {high:10.1f} us")
    print(f"  (integrate alone, by NumPy            {integral:10.1f} us, not part of either)")
    print(f"  scikit-learn, predict_proba           {theirs:10.1f} us  ratio {theirs / low:.0f}")
    start = time.perf_counter()
    forest.predict_proba(clips)
    ours = time.perf_counter() - start
    start = time.perf_counter()
    peer.predict_proba(rows)
    batch = time.perf_counter() - start
    print(f"  {n} clips at once: ours {ours * 1e3:.1f} ms, scikit-learn {batch * 1e3:.1f} ms, ratio {batch / ours:.1f}")


if __name__ == "__main__":
    main()
