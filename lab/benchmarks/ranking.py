"""Ranking clips for a query of an unseen performer: ours against dynamic time warping.

    python -m lab.benchmarks.ranking [FOLDER] [--performer-from RULE] [--queries N]

FOLDER holds one folder per category. The clips of each performer are the queries, those of the others the gallery, as
`python -m lab.ranking --split leave-performer-out` has it; with --queries, only so many of each performer, evenly
chosen. A row is the median of the queries, and tells the mean average precision, the descriptions of all clips being
known (features and pose sequences for ours, body-fixed joint positions at 30 Hz for DTW):

- ours: the default ranking, fused; and our own DTW kernel, which divides by the lengths of the two clips;
- the peer: dtaidistance (dtw_ndim in C) on the same poses, as it comes.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.runner import leave_performer_out
from dousa.formats import ReadOptions
from dousa.retrieval.features.feature_sets import FEATURE_SETS
from lab.benchmarks.timing import Row, Spent, run, take_turns
from lab.places import SHARED_DATA
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


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    files = {"category_from": "folder", "performer_from": options.performer_from, "options": ReadOptions()}
    clips, _ = read_labelled_clips([options.folder], **files)
    spec = FEATURE_SETS["extended"]
    material = describe_clips(clips, ("fused", "dtw"), spec, None)
    spent: dict[str, list[Spent]] = defaultdict(list)
    precisions: dict[str, list[float]] = defaultdict(list)
    for fold in leave_performer_out([clip.performer for clip in clips]):
        gallery = np.random.default_rng(0).permutation(fold.train)
        rankers, _ = make_rankers(("fused", "dtw"), material, gallery, RankingSettings(spec, 100, -1), 0)
        peer = make_peer(material, gallery)
        named = {
            "ours": rankers["fused"],
            "our own DTW": rankers["dtw"],
            **({"dtaidistance (DTW)": peer} if peer else {}),
        }
        queries = fold.test[np.isin(material.categories[fold.test], material.categories[gallery])]
        if options.queries:
            queries = queries[np.linspace(0, len(queries) - 1, options.queries).astype(int)]
        for query in map(int, queries):
            calls = {name: lambda rank=rank, query=query: rank(query) for name, rank in named.items()}
            for name, one in take_turns(calls, options.repeats).items():
                spent[name].append(one)
                right = material.categories[gallery[named[name](query)]] == material.categories[query]
                precisions[name].append(score_ranking(right).average_precision)
    middle = {name: Spent(*np.median(values, axis=0)) for name, values in spent.items()}
    for name in list(middle)[1:]:
        note = f"MAP {np.mean(precisions['ours']):.3f}, {np.mean(precisions[name]):.3f}"
        yield Row(f"rank {len(clips)} clips, features given", middle["ours"], name, middle[name], note=note)
    if len(middle) == 2:
        print("dtaidistance is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, nargs="?", default=SHARED_DATA / "utd_mhad" / "skeleton")
    parser.add_argument("--performer-from", default=r"name:_s(\d+)_")
    parser.add_argument("--queries", type=int, default=0, help="of each performer; 0 for all")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
