"""Labelling long takes: frames a second, from joint positions to the timeline, on two cores.

    python benchmarks/label.py [FOLDER] [--performer-from RULE] [--minutes M]

Clips of the folder (or synthetic ones) train a forest and a labeller and are joined into takes. Ours computes channels
once for the whole take, runs all windows down the trees and finds the best sequence. Peers on the same windows:
scikit-learn's extremely randomised trees on the cells of each window, which are read from our integrals and given to it
for nothing; and our forest with the features of every window computed anew from its positions. Goal: 100,000 frames/s.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from _take_material import FEATURE_SET, make_takes, read_or_make_clips, train_forest
from _timing import timed

from dousa.retrieval.features.feature_sets import compute_track
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.takes.label import label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.leaf_weights import JoinedTake
from dousa.retrieval.takes.windows import Sampled, TakeWindows, describe_take

_SAMPLE = 4000  # windows that a peer is timed on


def time_sklearn(clips: list[LabelledClip], take: JoinedTake, windows: TakeWindows) -> float | None:
    """Seconds a window."""
    try:
        from sklearn.ensemble import ExtraTreesClassifier
    except ImportError:
        print("peer: scikit-learn is not installed; run: pip install 'dousa[bench]'")
        return None
    features = np.stack([FEATURE_SET.compute(clip) for clip in clips]).reshape(len(clips), -1)
    peer = ExtraTreesClassifier(100, random_state=0, n_jobs=2).fit(features, [clip.category for clip in clips])
    some = np.random.default_rng(0).permutation(len(windows.starts))[:_SAMPLE]
    cells = compute_track(take, FEATURE_SET).describe(windows.starts[some], windows.stops[some])
    rows = cells.reshape(len(some), -1)
    peer.predict_proba(rows[:100])
    return timed(lambda: peer.predict_proba(rows), 2)[0] / len(some)


def time_anew(forest: MotionForest, take: JoinedTake, windows: TakeWindows) -> float:
    """Seconds a window, its features computed from its positions."""
    some = np.random.default_rng(0).permutation(len(windows.starts))[: _SAMPLE // 4]

    def run() -> None:
        for k in some:
            piece = Sampled(take.positions[windows.starts[k] : windows.stops[k]], take.height)
            forest.apply(FEATURE_SET.compute(piece)[None])

    return timed(run)[0] / len(some)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--minutes", type=float, default=20.0)
    options = parser.parse_args()
    clips = read_or_make_clips(options.folder, options.performer_from)
    forest = train_forest(clips)
    seconds, labeller = timed(lambda: train_labeller(forest, FEATURE_SET, clips, n_jobs=2))
    print(f"{len(clips)} clips, {len(forest.classes_)} categories; labeller learned in {seconds:.1f} s")
    take = make_takes(clips, options.minutes, options.minutes)[0]
    describe_take(forest, FEATURE_SET, JoinedTake(take.positions[:2000], take.height, ()), labeller.grid)

    def label(n_jobs: int) -> TakeWindows:
        windows = describe_take(forest, FEATURE_SET, take, labeller.grid, n_jobs=n_jobs)
        label_take(labeller, windows)
        return windows

    label(1)
    one, _ = timed(lambda: label(1), 3)
    two, windows = timed(lambda: label(2), 3)
    frames, count = windows.n_frames, len(windows.starts)
    print(f"{frames / 1800:.0f} minutes, {count} windows of {labeller.grid.lengths} frames")
    print(f"ours, one core: {frames / one:.0f} frames/s, {1e6 * one / count:.1f} us a window")
    print(f"ours, two cores: {frames / two:.0f} frames/s")
    peer = time_sklearn(clips, take, windows)
    if peer is not None:
        print(f"peer, scikit-learn on ready cells, two cores: {frames / (peer * count):.0f} frames/s")
        print(f"ratio, ours / peer: {peer * count / two:.1f}")
    anew = time_anew(forest, take, windows)
    print(f"peer, features of every window anew, one core: {frames / (anew * count):.0f} frames/s")
    print(f"ratio, ours on one core / peer: {anew * count / one:.1f}")


if __name__ == "__main__":
    main()
