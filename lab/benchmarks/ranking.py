"""Ranking clips for a query of an unseen performer: ours against dynamic time warping.

    python -m lab.benchmarks.ranking FOLDER --performer-from RULE [--queries N]

FOLDER holds one folder per category. The clips of each performer are the queries, those of the others the gallery, as
`python -m lab.ranking --split leave-performer-out` has it. Prints the median time of a query and the mean average
precision of the following, the descriptions of all clips being known (features and pose sequences for ours, body-fixed
joint positions at 30 Hz for DTW):

- ours: the default ranking, fused;
- our own DTW kernel, which divides by the lengths of the two clips;
- the peer: dtaidistance (dtw_ndim in C) on the same poses, as it comes;

and the ratios. All run one query after the other. With --queries, only so many of each performer, evenly chosen.
Goal: MAP 10 points above DTW at 1/100 of its time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.runner import leave_performer_out
from dousa.formats import ReadOptions
from dousa.retrieval.features.feature_sets import FEATURE_SETS
from lab.ranking.metrics import score_ranking
from lab.ranking.systems import RankingMaterial, RankingSettings, describe_clips, make_rankers

Ranker = Callable[[int], np.ndarray]


def make_peer(material: RankingMaterial, gallery: np.ndarray) -> Ranker | None:
    """DTW by dtaidistance, None where it is not installed or has no compiled library."""
    try:
        from dtaidistance import dtw_ndim
    except ImportError:
        return None
    stored = [material.poses[k].astype(np.float64) for k in gallery]

    def rank(query: int) -> np.ndarray:
        asked = material.poses[query].astype(np.float64)
        distances = [dtw_ndim.distance_fast(asked, other) for other in stored]
        return np.argsort(distances, kind="stable")

    return rank


def measure(
    rank: Ranker, queries: Sequence[int], gallery: np.ndarray, categories: np.ndarray
) -> tuple[list[float], list[float]]:
    """Seconds and average precision of each query."""
    rank(int(queries[0]))
    seconds, precisions = [], []
    for query in queries:
        start = time.perf_counter()
        order = rank(int(query))
        seconds.append(time.perf_counter() - start)
        precisions.append(score_ranking(categories[gallery[order]] == categories[query]).average_precision)
    return seconds, precisions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--performer-from", required=True)
    parser.add_argument("--queries", type=int, default=0, help="of each performer; 0 for all")
    options = parser.parse_args()
    clips, _ = read_labelled_clips(
        [options.folder],
        category_from="folder",
        performer_from=options.performer_from,
        options=ReadOptions(),
    )
    spec = FEATURE_SETS["extended"]
    material = describe_clips(clips, ("fused", "dtw"), spec, None)
    seconds: dict[str, list[float]] = {}
    precisions: dict[str, list[float]] = {}
    for fold in leave_performer_out([clip.performer for clip in clips]):
        gallery = np.random.default_rng(0).permutation(fold.train)
        rankers, _ = make_rankers(("fused", "dtw"), material, gallery, RankingSettings(spec, 100, -1), 0)
        peer = make_peer(material, gallery)
        named = {"ours, fused": rankers["fused"], "our DTW": rankers["dtw"]}
        if peer is not None:
            named["dtaidistance"] = peer
        queries = fold.test[np.isin(material.categories[fold.test], material.categories[gallery])]
        if options.queries:
            queries = queries[np.linspace(0, len(queries) - 1, options.queries).astype(int)]
        for name, rank in named.items():
            times, scores = measure(rank, queries, gallery, material.categories)
            seconds.setdefault(name, []).extend(times)
            precisions.setdefault(name, []).extend(scores)
    report(clips_count=len(clips), seconds=seconds, precisions=precisions)


def report(clips_count: int, seconds: dict[str, list[float]], precisions: dict[str, list[float]]) -> None:
    ours = float(np.median(seconds["ours, fused"]))
    print(f"{clips_count} clips, {len(seconds['ours, fused'])} queries")
    for name, times in seconds.items():
        middle = float(np.median(times))
        ratio = "" if name == "ours, fused" else f", ratio {middle / ours:.0f}"
        print(f"{name}: {1e3 * middle:.3f} ms a query, MAP {np.mean(precisions[name]):.3f}{ratio}")
    if "dtaidistance" not in seconds:
        print("peer: dtaidistance is not installed; run: pip install 'dousa[bench]'")


if __name__ == "__main__":
    main()
