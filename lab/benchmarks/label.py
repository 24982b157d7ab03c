"""Labelling long takes: frames a second, from joint positions to the timeline, on two cores.

    python -m lab.benchmarks.label [FOLDER] [--performer-from RULE] [--minutes M]

Clips of the folder (or synthetic ones) train a labeller and are joined into takes. Ours computes channels once for the
whole take, judges every fifth of a second by its discriminants, finds the best sequence and counts repetitions. The
peer is given ours of every moment as numbers: scikit-learn's extremely randomised trees judge them, and no sequence is
found. Goal: 200,000 frames/s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dousa.experiments.annotated.trial import learn_clip_judge
from dousa.retrieval.takes.label import label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import JoinedTake
from dousa.retrieval.takes.moment_model import HOP, describe_moments
from lab.benchmarks.take_material import make_takes, read_or_make_clips
from lab.benchmarks.timing import timed

_MOMENTS, _TREES = 20_000, 60  # that the peer is grown on, and that it has


def time_sklearn(take: JoinedTake) -> float | None:
    """Seconds a moment."""
    try:
        from sklearn.ensemble import ExtraTreesClassifier
    except ImportError:
        print("peer: scikit-learn is not installed; run: pip install 'dousa[bench]'")
        return None
    values = np.concatenate([some for _, some in describe_moments(take.positions, take.height)])[:_MOMENTS]
    middles = (np.arange(len(values)) + 0.5) * HOP
    starts = np.array([piece.start for piece in take.pieces])
    shown = [take.pieces[k].category for k in np.searchsorted(starts, middles, side="right") - 1]
    peer = ExtraTreesClassifier(_TREES, min_samples_leaf=2, random_state=0, n_jobs=2)
    peer.fit(values, shown)
    return timed(lambda: peer.predict_proba(values), 2)[0] / len(values)


def time_both(call: Callable[[], object], repeats: int = 5) -> tuple[float, float]:
    """Shortest times of a call, s: on the clock, and of all processors, which counts where others are busy, too."""
    clock, spent = [], []
    for _ in range(repeats):
        began = time.process_time()
        clock.append(timed(call)[0])
        spent.append(time.process_time() - began)
    return min(clock), min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--minutes", type=float, default=20.0)
    options = parser.parse_args()
    clips = read_or_make_clips(options.folder, options.performer_from)
    train_labeller(clips[:: max(len(clips) // 40, 1)], n_jobs=2)  # compiles
    seconds, labeller = timed(lambda: train_labeller(clips, n_jobs=2))
    print(f"{len(clips)} clips, {len(labeller.classes)} categories; labeller learned in {seconds:.1f} s")
    judge = learn_clip_judge(clips, 0, 2)
    take = make_takes(clips, options.minutes, options.minutes)[0]
    frames = len(take.positions)
    label_take(labeller, JoinedTake(take.positions[:2000], take.height, ()), judge=judge)
    alone, spent_alone = time_both(lambda: label_take(labeller, take))
    one, spent = time_both(lambda: label_take(labeller, take, judge=judge))
    two, spent_on_two = time_both(lambda: label_take(labeller, take, judge=judge, n_jobs=2))
    print(f"{frames / 1800:.0f} minutes; frames a second, and in brackets frames a second of a processor")
    print(f"ours, one core, without asking the clips: {frames / alone:.0f} ({frames / spent_alone:.0f})")
    print(f"ours, one core: {frames / one:.0f} ({frames / spent:.0f})")
    print(f"ours, two cores: {frames / two:.0f} ({frames / spent_on_two:.0f})")
    peer = time_sklearn(take)
    if peer is not None:
        print(f"peer, scikit-learn's trees on ready numbers, two cores: {HOP / peer:.0f} frames/s")
        print(f"ratio, ours / peer: {peer * frames / HOP / two:.1f}")


if __name__ == "__main__":
    main()
