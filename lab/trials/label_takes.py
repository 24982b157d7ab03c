"""Real annotated takes of people left out in turn: dousa, a peer and the plainest baseline, in one run.

    python -m lab.trials.label_takes FOLDER --labels beside --performer-from REGEX-RULE [--repeats N]

dousa learns from the takes, and from their segments as if they were clips. The peer is a sliding MiniRocket with the
same decoding (`sliding_rocket.py`), if aeon can be imported: it has an environment of its own, see `recognition.py`.

The baseline calls every frame by extremely randomised trees (scikit-learn) on the mean and the spread of the joints
over the second and a half around it, one more category being nothing; the most frequent name of the second around a
frame is its name.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier

from dousa.app.pipelines.experiment_clips import read_annotated_takes
from dousa.arrays import FloatArray, IndexArray
from dousa.experiments.annotated_takes import (
    LabelTake,
    LearnToLabel,
    cut_segments,
    learn_clip_judge,
    run_annotated_takes_experiment,
)
from dousa.formats import ReadOptions
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.takes.label import Segment, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.trials import sliding_rocket

HALF, SMOOTH = 22, 15  # frames to either side
HIPS = [JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]]


# The baseline, from here ...
def describe(take: AnnotatedTake) -> FloatArray:
    """(T, 120) mean and spread of the joints about a frame, seen from the pelvis and turned to face ahead."""
    joints = sample_positions(take.positions, take.frame_rate) / take.height
    joints = joints - joints[:, :1]
    across = joints[:, HIPS[0]] - joints[:, HIPS[1]]
    turn = np.arctan2(across[:, 2], across[:, 0])[:, None]
    x = joints[..., 0] * np.cos(turn) + joints[..., 2] * np.sin(turn)
    z = joints[..., 2] * np.cos(turn) - joints[..., 0] * np.sin(turn)
    flat = np.concatenate([x, joints[..., 1], z], axis=1)
    sums = np.cumsum(np.pad(np.stack([flat, flat**2]), ((0, 0), (1, 0), (0, 0))), axis=1)
    first = np.maximum(np.arange(len(flat)) - HALF, 0)
    stop = np.minimum(np.arange(len(flat)) + HALF + 1, len(flat))
    mean, square = (sums[:, stop] - sums[:, first]) / (stop - first)[:, None]
    return np.concatenate([mean, np.sqrt(np.maximum(square - mean**2, 0.0))], axis=1)


def name_frames(take: AnnotatedTake, count: int) -> list[str | None]:
    """What each frame shows, None where nobody can say."""
    at = (np.arange(count) + 0.5) / TAKE_RATE
    parts = [next((one for one in take.stretches if one.start <= t < one.stop), take.stretches[-1]) for t in at]
    return [(one.category or "") if one.counted else None for one in parts]


def learn(takes: Sequence[AnnotatedTake]) -> LabelTake:
    """Trees on every third frame."""
    seen = [describe(take)[::3] for take in takes]
    names = [name_frames(take, 3 * len(one))[::3] for take, one in zip(takes, seen, strict=True)]
    rows, named = np.concatenate(seen), [name for some in names for name in some]
    counts = [k for k, name in enumerate(named) if name is not None]
    trees = ExtraTreesClassifier(200, min_samples_leaf=3, class_weight="balanced", n_jobs=2, random_state=0)
    trees.fit(rows[counts], [named[k] for k in counts])

    def label(take: AnnotatedTake) -> dict[str, list[Segment]]:
        sums = np.cumsum(np.pad(trees.predict_proba(describe(take)), ((SMOOTH + 1, SMOOTH), (0, 0)), "edge"), axis=0)
        shares = sums[2 * SMOOTH + 1 :] - sums[: -2 * SMOOTH - 1]
        named = shares * (trees.classes_ != "")
        return {"baseline": cut(shares.argmax(axis=1)), "baseline, never nothing": cut(named.argmax(axis=1))}

    def cut(best: IndexArray) -> list[Segment]:
        edges = [0, *(np.flatnonzero(np.diff(best)) + 1).tolist(), len(best)]
        return [
            Segment(a / TAKE_RATE, b / TAKE_RATE, str(trees.classes_[best[a]]) or None, 1.0) for a, b in pairwise(edges)
        ]

    return label


# ... to here.


def learn_from_clips(takes: Sequence[AnnotatedTake]) -> LabelTake:
    """What `dousa train` learns where the segments have been cut out and the takes are gone."""
    clips = cut_segments(takes)
    labeller, judge = train_labeller(clips, n_jobs=2), learn_clip_judge(clips, 0, 2)

    def label(take: AnnotatedTake) -> dict[str, list[Segment]]:
        return {
            name: list(label_take(labeller, take, judge=judge, threshold=threshold, n_jobs=2).segments)
            for name, threshold in (("dousa, from clips", None), ("dousa, from clips, threshold 0", 0.0))
        }

    return label


def choose_methods() -> dict[str, LearnToLabel]:
    """What dousa is compared with."""
    methods: dict[str, LearnToLabel] = {"from clips": learn_from_clips, "baseline": learn}
    try:
        import aeon  # noqa: F401
    except ImportError:
        print("without the sliding MiniRocket: aeon cannot be imported")
    else:
        methods["MiniRocket"] = sliding_rocket.learn
    return methods


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--labels", default="beside")
    parser.add_argument("--performer-from", required=True)
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    takes, _ = read_annotated_takes(
        options.folders, options.labels, performer_from=options.performer_from, options=ReadOptions()
    )
    found: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(options.repeats):
        methods = choose_methods() if not seed else {}
        result = run_annotated_takes_experiment(takes, methods=methods, random_state=seed, n_jobs=2)
        for name, one in result.scores.items():
            found.setdefault(name, []).append((one.annotated_right, one.rest_called, one.timeline.f_measure))
    print(f"{len(takes)} takes; annotated frames right, rest called something, F of segments (mean, spread)")
    for name, rows in found.items():
        mean, spread = np.mean(rows, axis=0), np.std(rows, axis=0)
        print(f"{name:33}", "  ".join(f"{m:.3f} ± {s:.3f}" for m, s in zip(mean, spread, strict=True)))


if __name__ == "__main__":
    main()
