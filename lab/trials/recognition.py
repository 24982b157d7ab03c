"""How many motions of a person never seen are recognised: a dousa forest against time series classifiers of aeon.

UTD-MHAD, 27 actions, one of four people left out at a time: the same splits, in one run. aeon's classifiers see the
joint positions from the pelvis over the body height at 64 equally spaced instants (turning them to the body changes
nothing). aeon needs an older NumPy than ours, so it has an environment of its own: ``make peers``, which runs this.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.runner import leave_performer_out
from dousa.formats import ReadOptions
from dousa.retrieval import FEATURE_SETS, LabelledClip, MotionForest
from lab.places import SHARED_DATA

DATA = SHARED_DATA / "utd_mhad" / "skeleton"
INSTANTS = 64
SEEDS = (0, 1, 2)


class Ours:
    """The default forest of ``dousa train``, from positions to answers."""

    def __init__(self, feature_set: str, seed: int) -> None:
        self.features = FEATURE_SETS[feature_set]
        options = {"thresholds": self.features.thresholds, "n_trials": self.features.n_trials}
        self.forest = MotionForest(random_state=seed, n_jobs=-1, **options)

    def fit(self, clips: list[LabelledClip], labels: np.ndarray) -> None:
        self.forest.fit(self.describe(clips), labels, feature_set=self.features)

    def predict(self, clips: list[LabelledClip]) -> np.ndarray:
        return self.forest.predict(self.describe(clips))

    def describe(self, clips: list[LabelledClip]) -> np.ndarray:
        return np.stack([self.features.compute(clip) for clip in clips])


class Peer:
    """A classifier of aeon on resampled positions."""

    def __init__(self, classifier: Any) -> None:
        self.classifier = classifier

    def fit(self, clips: list[LabelledClip], labels: np.ndarray) -> None:
        self.classifier.fit(self.describe(clips), labels)

    def predict(self, clips: list[LabelledClip]) -> np.ndarray:
        return self.classifier.predict(self.describe(clips))

    def describe(self, clips: list[LabelledClip]) -> np.ndarray:
        return np.stack([resample(clip) for clip in clips])


def resample(clip: LabelledClip) -> np.ndarray:
    """(57, INSTANTS) coordinates of all joints but the pelvis, from there, in body heights."""
    seen = (clip.positions - clip.positions[:, :1]) / clip.height
    columns = seen[:, 1:].reshape(len(seen), -1).T
    places = np.linspace(0.0, len(seen) - 1.0, INSTANTS)
    return np.stack([np.interp(places, np.arange(len(seen)), column) for column in columns])


def measure(make: Any, clips: list[LabelledClip], seed: int) -> tuple[float, float, float]:
    """Mean accuracy over the people, seconds to train, milliseconds a query."""
    labels = np.array([clip.category for clip in clips])
    right, fit_seconds, query_seconds = [], 0.0, 0.0
    for fold in leave_performer_out([clip.performer for clip in clips]):
        system = make(seed)
        started = time.perf_counter()
        system.fit([clips[k] for k in fold.train], labels[fold.train])
        fitted = time.perf_counter()
        right.append(np.mean(system.predict([clips[k] for k in fold.test]) == labels[fold.test]))
        fit_seconds += fitted - started
        query_seconds += time.perf_counter() - fitted
    return float(np.mean(right)), fit_seconds, 1000.0 * query_seconds / len(clips)


def main() -> None:
    """Measure and print."""
    if not DATA.exists():
        print(f"skipped: no recordings at {DATA}")
        return
    try:
        from aeon.classification.convolution_based import MiniRocketClassifier
        from aeon.classification.interval_based import TimeSeriesForestClassifier
    except ImportError:
        print("skipped: needs aeon, which has an environment of its own; run: make peers")
        return
    warnings.simplefilter("ignore")
    clips, _ = read_labelled_clips(
        [DATA], category_from="folder", performer_from=r"name:_s(\d+)_", options=ReadOptions()
    )
    systems = {
        "dousa, extended": lambda seed: Ours("extended", seed),
        "dousa, paper": lambda seed: Ours("paper", seed),
        "aeon MiniRocket": lambda seed: Peer(MiniRocketClassifier(random_state=seed, n_jobs=-1)),
        "aeon TimeSeriesForest": lambda seed: Peer(TimeSeriesForestClassifier(random_state=seed, n_jobs=-1)),
    }
    for make in systems.values():  # compiling is not timed
        measure(make, [clip for clip in clips if clip.category in ("clap", "wave")], 0)
    print(f"UTD-MHAD, one of 4 people left out, {len(clips)} clips, means of {len(SEEDS)} seeds")
    print(f"{'system':24s} {'accuracy':>16s} {'train s':>8s} {'query ms':>9s}")
    found = {name: np.array([measure(make, clips, seed) for seed in SEEDS]) for name, make in systems.items()}
    for name, rows in found.items():
        accuracy, fit_seconds, query = rows.mean(axis=0)
        print(f"{name:24s} {accuracy:8.4f} ± {rows[:, 0].std():.4f} {fit_seconds:8.1f} {query:9.2f}")
    ours, peer = found["dousa, extended"].mean(axis=0), found["aeon MiniRocket"].mean(axis=0)
    errors, faster = (1 - ours[0]) / (1 - peer[0]), peer[2] / ours[2]
    print(f"against MiniRocket: errors x {errors:.2f}, queries {faster:.1f} times as fast")


if __name__ == "__main__":
    main()
