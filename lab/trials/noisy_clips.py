"""How well noisy, slow clips that lack joints are recognised, learned from clean ones of other people and the reverse.

UTD-MHAD and HDM05, one of the people left out at a time, and half of the clips of each category of Bandai. Disturbed is
a clip as by a slow depth camera: single poses at 15 Hz, errors of 3 cm (standard deviation along each axis, anew in
every frame), 5 % of the joints' places missing; it is read like a file, which bridges what is missing. Columns: what
was learned -> what was asked, per cent of right guesses; "known" is the share of those that is not called unknown.

The forest is that of ``dousa train``. Beside it, in the same run: the clip whose poses at 32 instants are nearest
(body-fixed, body heights), dynamic time warping of the same, and MiniRocket and MultiRocket of aeon, if it can be
imported (joint positions from the pelvis over the body height at 64 instants).
Run: python -m lab.trials.noisy_clips
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.runner import describe_copies, fit_forest, leave_performer_out, make_forest, split_half
from dousa.formats import ReadOptions
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories, canonicalise
from dousa.retrieval import FEATURE_SETS, Assessor, LabelledClip, learn_calibration
from dousa.retrieval.ranking.ranking import warp_distances
from lab.places import SHARED_DATA
from lab.ranking.systems import compute_body_poses

DATA = SHARED_DATA
SETS = {
    "UTD-MHAD": ("utd_mhad/skeleton", r"name:_s(\d+)_"),
    "HDM05": ("hdm05", "name:HDM_(..)_"),
    "Bandai": ("bandai", None),
}
SET = FEATURE_SETS["extended"]
INSTANTS, PEER_INSTANTS = 32, 64
DIRECTIONS = (("clean", "clean"), ("clean", "noisy"), ("noisy", "clean"), ("noisy", "noisy"))


def disturb(clip: LabelledClip, generator: np.random.Generator, asked: argparse.Namespace) -> LabelledClip:
    """The clip as a slow, noisy sensor may have seen it, read like a file."""
    count = max(int(len(clip.positions) * asked.rate / clip.frame_rate), 2)
    places = np.minimum(np.arange(count) * clip.frame_rate / asked.rate, len(clip.positions) - 1.0)
    below = np.minimum(places.astype(int), len(clip.positions) - 2)
    share = (places - below)[:, None, None]
    points = clip.positions[below] * (1.0 - share) + clip.positions[below + 1] * share
    points = points + generator.normal(0.0, asked.noise, points.shape)
    points[generator.random(points.shape[:2]) < asked.missing] = np.nan
    rate = asked.rate * float(np.exp(generator.uniform(-asked.tempo, asked.tempo))) if asked.tempo else asked.rate
    read = canonicalise(Trajectories(CANONICAL_JOINTS, points, rate, np.array(CANONICAL_PARENTS)))
    return LabelledClip(clip.name, clip.category, clip.performer, read.positions, rate, read.height)


class Forest:
    """What ``dousa train`` learns: trees over the clips and their disturbed copies, and when to say "unknown"."""

    def __init__(self, seed: int, is_calibrated: bool) -> None:
        self.seed, self.is_calibrated = seed, is_calibrated
        self.forest = make_forest(SET, 100, seed, -1)

    def describe(self, clips: list[LabelledClip]) -> np.ndarray:
        return np.stack([SET.compute(clip) for clip in clips])

    def fit(self, clips: list[LabelledClip], features: np.ndarray, labels: np.ndarray) -> None:
        copies = describe_copies(clips, SET, self.seed)
        fit_forest(self.forest, features, np.arange(len(clips)), labels, copies, SET)
        if not self.is_calibrated:
            return
        people = [clip.performer for clip in clips]
        calibration = learn_calibration(
            self.forest, features, labels, people if all(people) else None, feature_set=SET,
            copies=copies,
        )  # fmt: skip
        self.assessor = Assessor(self.forest, calibration)

    def predict(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Guesses, and whether they are not called unknown."""
        if not self.is_calibrated:
            return self.forest.predict(features), None
        verdicts = self.assessor.assess(self.forest.apply(features), features)
        return self.forest.classes_[verdicts.guess], ~verdicts.unknown


class Nearest:
    """The clip with the nearest poses at equally spaced instants; or, warped, with the least cost of warping."""

    def __init__(self, warped: bool) -> None:
        self.warped = warped

    def describe(self, clips: list[LabelledClip]) -> np.ndarray:
        return np.stack([resample(compute_body_poses(clip), INSTANTS) for clip in clips]).astype(np.float32)

    def fit(self, clips: list[LabelledClip], features: np.ndarray, labels: np.ndarray) -> None:
        self.features, self.labels = features, labels

    def predict(self, features: np.ndarray) -> tuple[np.ndarray, None]:
        return self.labels[[int(np.argmin(self.measure(one))) for one in features]], None

    def measure(self, one: np.ndarray) -> np.ndarray:
        if not self.warped:
            return np.linalg.norm((self.features - one).reshape(len(self.features), -1), axis=1)
        starts, distances = np.arange(len(self.features)) * INSTANTS, np.empty(len(self.features))
        flat = self.features.reshape(-1, one.shape[1])
        warp_distances(one, flat, starts, starts + INSTANTS, 0.2 * INSTANTS, distances)
        return distances


class Peer:
    """A classifier of aeon."""

    def __init__(self, classifier: Any) -> None:
        self.classifier = classifier

    def describe(self, clips: list[LabelledClip]) -> np.ndarray:
        seen = [(clip.positions - clip.positions[:, :1])[:, 1:] / clip.height for clip in clips]
        return np.stack([resample(one.reshape(len(one), -1), PEER_INSTANTS).T for one in seen])

    def fit(self, clips: list[LabelledClip], features: np.ndarray, labels: np.ndarray) -> None:
        self.classifier.fit(features, labels)

    def predict(self, features: np.ndarray) -> tuple[np.ndarray, None]:
        return self.classifier.predict(features), None


def resample(rows: np.ndarray, count: int) -> np.ndarray:
    places = np.linspace(0.0, len(rows) - 1.0, count)
    below = np.minimum(places.astype(int), max(len(rows) - 2, 0))
    share = (places - below)[:, None]
    return rows[below] * (1.0 - share) + rows[np.minimum(below + 1, len(rows) - 1)] * share


def list_systems(n_calibrated: int) -> dict[str, Callable[[int], Any]]:
    systems: dict[str, Callable[[int], Any]] = {
        "dousa": lambda seed: Forest(seed, seed < n_calibrated),
        "nearest poses": lambda seed: Nearest(warped=False),
        "warped poses": lambda seed: Nearest(warped=True),
    }
    try:
        from aeon.classification.convolution_based import MiniRocketClassifier, MultiRocketClassifier
    except ImportError:
        print("without aeon's classifiers: it cannot be imported")
        return systems
    warnings.simplefilter("ignore")
    systems["aeon MiniRocket"] = lambda seed: Peer(MiniRocketClassifier(random_state=seed, n_jobs=-1))
    systems["aeon MultiRocket"] = lambda seed: Peer(MultiRocketClassifier(random_state=seed, n_jobs=-1))
    return systems


def list_folds(clips: list[LabelledClip], seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    people = [clip.performer for clip in clips]
    labels = [clip.category for clip in clips]
    folds = leave_performer_out(people) if all(people) else [split_half(labels, np.random.default_rng(seed))]
    return ((fold.train, fold.test) for fold in folds)


def measure(make: Callable[[int], Any], sides: dict[str, list[LabelledClip]], seed: int) -> np.ndarray:
    """(directions, 2) right guesses, and those of them that are not called unknown."""
    labels = np.array([clip.category for clip in sides["clean"]])
    features = {side: make(seed).describe(clips) for side, clips in sides.items()}
    right: dict[tuple[str, str], list[np.ndarray]] = {direction: [] for direction in DIRECTIONS}
    known: dict[tuple[str, str], list[np.ndarray]] = {direction: [] for direction in DIRECTIONS}
    for train, test in list_folds(sides["clean"], seed):
        for learned in sides:
            system = make(seed)
            system.fit([sides[learned][k] for k in train], features[learned][train], labels[train])
            for asked in sides:
                guesses, said = system.predict(features[asked][test])
                is_right = guesses == labels[test]
                right[learned, asked].append(is_right)
                known[learned, asked].append(np.full(len(test), np.nan) if said is None else said[is_right])
    return np.array([[np.concatenate(found[direction]).mean() for found in (right, known)] for direction in DIRECTIONS])


def main() -> None:
    parser = argparse.ArgumentParser(description="Noisy, slow clips that lack joints; people held out.")
    parser.add_argument("--set", choices=SETS, help="only this data set")
    parser.add_argument("--system", help="only this system")
    parser.add_argument("--repeats", type=int, default=10, help="of the disturbance and of the forests")
    parser.add_argument("--calibrated", type=int, default=2, help="repeats in which it is asked what is known")
    parser.add_argument("--rate", type=float, default=15.0, help="Hz")
    parser.add_argument("--noise", type=float, default=0.03, help="m")
    parser.add_argument("--missing", type=float, default=0.05, help="share of the places")
    parser.add_argument("--tempo", type=float, default=0.0, help="logarithm of how much faster or slower at most")
    asked = parser.parse_args()
    systems = list_systems(asked.calibrated)
    for title, (folder, performer) in SETS.items():
        if asked.set not in (None, title):
            continue
        if not (DATA / folder).is_dir():
            print(f"{title}: no recordings in {DATA / folder}")
            continue
        clips = read_labelled_clips(
            [DATA / folder], category_from="folder", performer_from=performer, options=ReadOptions()
        )[0]
        print(f"\n{title}: {len(clips)} clips, {len({clip.category for clip in clips})} categories")
        print(f"| system | {' | '.join(f'{learned} -> {of}' for learned, of in DIRECTIONS)} | seconds |")
        print(f"| --- |{' --- |' * (len(DIRECTIONS) + 1)}")
        for name, make in systems.items():
            if asked.system not in (None, name):
                continue
            started, found = time.perf_counter(), []
            for seed in range(asked.repeats):
                generator = np.random.default_rng(seed)
                sides = {"clean": clips, "noisy": [disturb(clip, generator, asked) for clip in clips]}
                found.append(measure(make, sides, seed))
            cells = [describe_cell(100.0 * np.array(found)[:, k]) for k in range(len(DIRECTIONS))]
            seconds = (time.perf_counter() - started) / asked.repeats
            print(f"| {name} | {' | '.join(cells)} | {seconds:.1f} |", flush=True)


def describe_cell(values: np.ndarray) -> str:
    """Mean and spread over the repeats (R, 2)."""
    right = f"{values[:, 0].mean():.1f} ± {values[:, 0].std():.1f}"
    return right if np.isnan(values[:, 1]).all() else f"{right}, known {np.nanmean(values[:, 1]):.0f}"


if __name__ == "__main__":
    main()
