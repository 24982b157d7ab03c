"""Labelling long takes: frames a second, from joint positions to the timeline, on two cores.

    python -m lab.benchmarks.label [FOLDER] [--performer-from RULE] [--minutes M]

Clips of the folder (or synthetic ones) train a labeller and are joined into takes. Ours computes channels once for the
whole take, judges every fifth of a second by its discriminants, finds the best sequence and counts repetitions. The
peer is given ours of every moment as numbers: scikit-learn's extremely randomised trees judge them, and no sequence is
found.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from dousa.experiments.annotated_takes import learn_clip_judge
from dousa.retrieval.takes.label import label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import JoinedTake
from dousa.retrieval.takes.moment_model import HOP, describe_moments
from lab.benchmarks.take_material import make_takes, read_or_make_clips
from lab.benchmarks.timing import Row, run, spend, take_turns

_MOMENTS, _TREES = 20_000, 60  # that the peer is grown on, and that it has


def make_peer(take: JoinedTake) -> tuple[Callable[[], object], int] | None:
    """What judges some moments, and how many."""
    try:
        from sklearn.ensemble import ExtraTreesClassifier
    except ImportError:
        print("scikit-learn is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)
        return None
    values = np.concatenate([some for _, some in describe_moments(take.positions, take.height)])[:_MOMENTS]
    middles = (np.arange(len(values)) + 0.5) * HOP
    starts = np.array([piece.start for piece in take.pieces])
    shown = [take.pieces[k].category for k in np.searchsorted(starts, middles, side="right") - 1]
    peer = ExtraTreesClassifier(_TREES, min_samples_leaf=2, random_state=0, n_jobs=2)
    peer.fit(values, shown)
    return lambda: peer.predict_proba(values), len(values)


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    clips = read_or_make_clips(options.folder, options.performer_from)
    train_labeller(clips[:: max(len(clips) // 40, 1)], n_jobs=2)  # compiles
    spent, labeller = spend(lambda: train_labeller(clips, n_jobs=2))
    yield Row(f"learn a labeller, {len(clips)} clips, {len(labeller.classes)} categories", spent)
    judge = learn_clip_judge(clips, 0, 2)
    take = make_takes(clips, options.minutes, options.minutes)[0]
    frames = len(take.positions)
    calls = {
        "one core": lambda: label_take(labeller, take, judge=judge),
        "one core, without asking the clips": lambda: label_take(labeller, take),
        "two cores": lambda: label_take(labeller, take, judge=judge, n_jobs=2),
    }
    peer = make_peer(take)
    found = take_turns({**calls, **({"peer": peer[0]} if peer else {})}, options.repeats)
    for name in calls:
        theirs, said = None, ""
        if peer is not None and name == "two cores":
            theirs, said = found["peer"].per(peer[1] * HOP / frames), "scikit-learn's trees, numbers ready, no sequence"
        yield Row(f"label {frames / 1800:.0f} minutes, {name}", found[name], said, theirs, frames, "frames/s")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--minutes", type=float, default=20.0)


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
