"""How many motions are recognised of people never seen, on every set and sensor: one table for every candidate change.

Each row learns some clips and asks others: one person left out at a time, or half of each category where there is one
person. *15 Hz, noisy* are the same clips as by a slow depth camera: single poses at 15 Hz, errors of 3 cm along each
axis, 5 % of the joints missing; read like a file, which bridges what is missing. UI-PRMD is asked across its sensors
too, and UTKinect's annotated segments are clips here. *CMU* are the actions of one take with a name of HDM05; *other
sets* are three that are learned, and the clips of the fourth that mean something that these know.

*dousa* is what ``dousa classify`` guesses. Beside it its trees alone and the plainest systems: the clip whose poses at
32 instants are nearest (body-fixed, body heights), dynamic time warping of the same, and MiniRocket and MultiRocket of
aeon (joint positions from the pelvis over the body height at 64 instants), which need an older NumPy than ours, so an
environment of their own: ``make peers``. With ``--shots 1`` one clip of each category is learned, drawn among those
that may be. What was read and described stays in the folder build, until its code changes.
Run: python -m lab.trials.recognition
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.annotated_takes import cut_segments
from dousa.experiments.runner import describe_copies, fit_forest, leave_performer_out, make_forest, split_half
from dousa.formats import ReadOptions, read_motion
from dousa.library.results import MIRROR_ODDS
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories, canonicalise
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.retrieval import FEATURE_SETS, LabelledClip, MotionForest
from dousa.retrieval.forest.calibration import Copies
from dousa.retrieval.forest.evidence import PlacedClips, describe_strangers, weigh
from dousa.retrieval.forest.pose_space import fit_pose_basis
from dousa.retrieval.ranking.ranking import warp_distances
from lab.places import ROOT, SHARED_DATA
from lab.ranking.systems import compute_body_poses
from lab.trials.confidence import find_meaning

KEPT = ROOT / "build" / "recognition"
SET = FEATURE_SETS["extended"]
INSTANTS, PEER_INSTANTS = 32, 64
FOLDERS = {
    "HDM05": ("hdm05", r"name:HDM_(..)_"),
    "Bandai": ("bandai", None),
    "UTD-MHAD": ("utd_mhad/skeleton", r"name:_s(\d+)_"),
    "UI-PRMD Kinect": ("uiprmd/kinect", r"name:_(s\d+)_"),
    "UI-PRMD Vicon": ("uiprmd/vicon", r"name:_(s\d+)_"),
    "UTKinect": ("utkinect", r"name:(s..)_"),
    "CMU": ("cmu86", None),
}
NOISY, OTHERS = ", 15 Hz, noisy", "other sets"
ROWS = (  # learned, asked
    ("HDM05", "HDM05"),
    ("HDM05", "HDM05" + NOISY),
    ("Bandai", "Bandai"),
    ("Bandai", "Bandai" + NOISY),
    ("UTD-MHAD", "UTD-MHAD"),
    ("UTD-MHAD", "UTD-MHAD" + NOISY),
    ("UTD-MHAD" + NOISY, "UTD-MHAD"),
    ("UTD-MHAD" + NOISY, "UTD-MHAD" + NOISY),
    ("UI-PRMD Kinect", "UI-PRMD Kinect"),
    ("UI-PRMD Vicon", "UI-PRMD Kinect"),
    ("UI-PRMD Kinect", "UI-PRMD Vicon"),
    ("UTKinect", "UTKinect"),
    ("HDM05", "CMU"),
    *((OTHERS, name) for name in ("HDM05", "UTD-MHAD", "UTKinect")),
)
# The actions of CMU's take 86_01 that HDM05 has too, by its names.
_ALIKE = {"walk": "sneak2StepsLStart", "jump": "hopBothLegs1hops", "leg_kick": "kickLFront1Reps"}


def keep(title: str, make: Callable[[], Any], *sources: Path) -> Any:
    """What ``make`` returns, kept in a file until one of the sources (files or folders of code) changes."""
    files = [file for source in sources for file in ([source] if source.is_file() else sorted(source.rglob("*.py")))]
    seen = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]
    place = KEPT / f"{title.replace(' ', '_').replace(',', '').replace('/', '_')}-{seen}.pickle"
    if place.exists():
        return pickle.loads(place.read_bytes())
    made = make()
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(pickle.dumps(made))
    return made


def read_set(name: str) -> list[LabelledClip]:
    """The clips of a set, as recorded or disturbed."""
    clean = name.removesuffix(NOISY)
    folder, performer = FOLDERS[clean]
    source = ROOT / "src" / "dousa"
    clips = keep(clean, lambda: _read(clean, folder, performer), source / "formats", source / "motion" / "canonical")
    if clean == name:
        return clips
    generator = np.random.default_rng(0)
    return [disturb(clip, generator) for clip in clips]


def _read(name: str, folder: str, performer: str | None) -> list[LabelledClip]:
    options = ReadOptions()
    if name == "UTKinect":
        from dousa.app.pipelines.experiment_clips import read_annotated_takes

        where = [SHARED_DATA / folder], "beside"
        takes = read_annotated_takes(*where, performer_from=performer, options=options)[0]
        return cut_segments(takes)
    if name == "CMU":
        return _read_cmu()
    category = "folder" if "PRMD" not in name else r"name:(m\d+)_"
    clips = read_labelled_clips(
        [SHARED_DATA / folder], category_from=category, performer_from=performer, options=options
    )[0]
    return [clip for clip in clips if "incorrect" not in clip.name]


def _read_cmu() -> list[LabelledClip]:
    whole = canonicalise(read_motion(SHARED_DATA / "cmu86" / "86_01.amc"))
    lines = (SHARED_DATA / "cmu86" / "mocap.txt").read_text().split("\n\n")[0].splitlines()[1:]
    clips, start = [], 0
    for line in lines:
        action, _, stop, _ = line.split()
        if action in _ALIKE:
            points = whole.positions[start : int(stop)]
            clips.append(LabelledClip(line, _ALIKE[action], "86", points, whole.frame_rate, whole.height))
        start = int(stop)
    return clips


def disturb(
    clip: LabelledClip, generator: np.random.Generator, rate: float = 15.0, noise: float = 0.03, missing: float = 0.05
) -> LabelledClip:
    """The clip as a slow, noisy sensor may have seen it, read like a file."""
    count = max(int(len(clip.positions) * rate / clip.frame_rate), 2)
    places = np.minimum(np.arange(count) * clip.frame_rate / rate, len(clip.positions) - 1.0)
    points = resample(clip.positions.reshape(len(clip.positions), -1), places).reshape(count, -1, 3)
    points = points + generator.normal(0.0, noise, points.shape)
    points[generator.random(points.shape[:2]) < missing] = np.nan
    read = canonicalise(Trajectories(CANONICAL_JOINTS, points, rate, np.array(CANONICAL_PARENTS)))
    return LabelledClip(clip.name, clip.category, clip.performer, read.positions, rate, read.height)


def resample(rows: np.ndarray, places: np.ndarray | int) -> np.ndarray:
    """Rows (n, K) at fractional places, or at that many instants."""
    if isinstance(places, int):
        places = np.linspace(0.0, len(rows) - 1.0, places)
    below = np.minimum(places.astype(int), max(len(rows) - 2, 0))
    share = (places - below)[:, None]
    return rows[below] * (1.0 - share) + rows[np.minimum(below + 1, len(rows) - 1)] * share


@dataclass(frozen=True)
class Described:
    """A set: its clips, their features and those of their disturbed copies and mirror images."""

    clips: list[LabelledClip]
    labels: np.ndarray
    features: np.ndarray
    copies: Copies
    mirrored: np.ndarray

    @property
    def people(self) -> list[str | None]:
        return [clip.performer for clip in self.clips]


def describe_row(learned: str, asked: str) -> tuple[Described, Described]:
    """The two sets of a row; of other sets and this one, what has a name in both, by meanings."""
    if learned != OTHERS:
        return describe(learned), describe(asked)
    others = [describe(name) for name in ("HDM05", "Bandai", "UTD-MHAD", "UTKinect") if name != asked]
    labels = np.array([find_meaning(label) for one in others for label in one.labels])
    features, copies, mirrored = (
        np.concatenate(some)
        for some in zip(*((one.features, one.copies.features, one.mirrored) for one in others), strict=True)
    )
    clips = [clip for one in others for clip in one.clips]
    own = describe(asked)
    meanings = np.array([find_meaning(label) for label in own.labels])
    kept = np.flatnonzero(np.isin(meanings, labels))
    return (
        Described(clips, labels, features, Copies(np.arange(len(clips)), copies), mirrored),
        Described(
            [own.clips[k] for k in kept], meanings[kept], own.features[kept], own.copies.of(kept), own.mirrored[kept]
        ),
    )


@cache
def describe(name: str) -> Described:
    """A set as forests see it."""
    clips = read_set(name)

    def make() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        images = [replace(clip, positions=mirror_positions(clip.positions)) for clip in clips]
        seen, mirrored = (np.stack([SET.compute(clip) for clip in some]) for some in (clips, images))
        return seen, describe_copies(clips, SET, 0).features, mirrored

    retrieval = ROOT / "src" / "dousa" / "retrieval"
    made = keep(f"features {name}", make, retrieval / "features", retrieval / "takes" / "made_takes.py")
    labels = np.array([clip.category for clip in clips])
    return Described(clips, labels, made[0], Copies(np.arange(len(clips)), made[1]), made[2])


def list_folds(learned: Described, asked: Described, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The clips that are learned and those that are asked: of another person, or of the other half."""
    people = [np.array(one.people, dtype=object) for one in (learned, asked)]
    if learned is not asked and not set(people[0]) & set(people[1]):
        yield np.arange(len(people[0])), np.arange(len(people[1]))
    elif None in people[1]:
        half = split_half(learned.labels.tolist(), np.random.default_rng(seed))
        yield half.train, half.test
    else:
        for one in leave_performer_out(people[1].tolist()):
            person = people[1][one.test[0]]
            yield np.flatnonzero(people[0] != person), one.test


Guess = Callable[[Described, np.ndarray, Described, np.ndarray, int], np.ndarray]
"""Guesses (M,) by a system that learns some clips of one set, and is asked some of another."""


def ask_trees(learned: Described, train: np.ndarray, asked: Described, test: np.ndarray, seed: int) -> np.ndarray:
    """The forest of ``dousa train`` alone."""
    return _grow(learned, train, seed).predict(asked.features[test])


def _grow(learned: Described, train: np.ndarray, seed: int) -> MotionForest:
    forest = make_forest(SET, 100, seed, -1)
    return fit_forest(forest, learned.features, train, learned.labels[train], learned.copies, SET)


def ask_dousa(learned: Described, train: np.ndarray, asked: Described, test: np.ndarray, seed: int) -> np.ndarray:
    """What ``dousa classify`` guesses: by the forest and the space of poses, of the clip or of its mirror image."""
    forest, copies, strangers = _grow(learned, train, seed), learned.copies.of(train), describe_strangers(SET)
    assert strangers is not None
    parts = [learned.features[train], copies.features, strangers.beside]
    basis = fit_pose_basis(parts, SET)
    labels = learned.labels[train]
    size = float(np.median(np.unique(labels, return_counts=True)[1]))
    space = basis.fit(np.concatenate([basis.place(part) for part in parts]), np.append(labels, labels[copies.rows]))

    def weigh_clips(features: np.ndarray) -> np.ndarray:
        return weigh(forest.predict_proba(features), PlacedClips.of(space, features).order(forest.classes_), size)

    own, mirrored = weigh_clips(asked.features[test]), weigh_clips(asked.mirrored[test])
    as_seen = (own.max(axis=1) + MIRROR_ODDS >= mirrored.max(axis=1))[:, None]
    return forest.classes_[np.where(as_seen, own, mirrored).argmax(axis=1)]


def ask_nearest(warped: bool) -> Guess:
    """The clip of the nearest poses, or that of the cheapest warping."""

    def guess(learned: Described, train: np.ndarray, asked: Described, test: np.ndarray, seed: int) -> np.ndarray:
        seen, wanted = _describe_poses(learned, train), _describe_poses(asked, test)
        if not warped:
            flat, own = seen.reshape(len(seen), -1), wanted.reshape(len(wanted), -1)
            apart = (flat**2).sum(1) - 2.0 * own @ flat.T
        else:
            rows, starts = seen.reshape(-1, seen.shape[2]), np.arange(len(seen)) * INSTANTS
            apart = np.empty((len(wanted), len(seen)))
            for one, distances in zip(wanted, apart, strict=True):
                warp_distances(one, rows, starts, starts + INSTANTS, 0.2 * INSTANTS, distances)
        return learned.labels[train][apart.argmin(axis=1)]

    return guess


def _describe_poses(some: Described, rows: np.ndarray) -> np.ndarray:
    return np.stack([resample(compute_body_poses(some.clips[k]), INSTANTS) for k in rows]).astype(np.float32)


def ask_peer(make: Callable[[int], Any]) -> Guess:
    """A classifier of aeon."""

    def see(some: Described, rows: np.ndarray) -> np.ndarray:
        clips = [some.clips[k] for k in rows]
        seen = [(clip.positions - clip.positions[:, :1])[:, 1:] / clip.height for clip in clips]
        return np.stack([resample(one.reshape(len(one), -1), PEER_INSTANTS).T for one in seen])

    def guess(learned: Described, train: np.ndarray, asked: Described, test: np.ndarray, seed: int) -> np.ndarray:
        return make(seed).fit(see(learned, train), learned.labels[train]).predict(see(asked, test))

    return guess


def list_systems() -> dict[str, Guess]:
    """The systems of the table."""
    systems: dict[str, Guess] = {
        "dousa": ask_dousa,
        "its trees": ask_trees,
        "nearest poses": ask_nearest(warped=False),
        "warped poses": ask_nearest(warped=True),
    }
    try:
        from aeon.classification.convolution_based import MiniRocketClassifier, MultiRocketClassifier
    except ImportError:
        print("without aeon's classifiers: it cannot be imported; see make peers")
        return systems
    warnings.simplefilter("ignore")
    systems["aeon MiniRocket"] = ask_peer(lambda seed: MiniRocketClassifier(random_state=seed, n_jobs=-1))
    systems["aeon MultiRocket"] = ask_peer(lambda seed: MultiRocketClassifier(random_state=seed, n_jobs=-1))
    return systems


def draw_shots(labels: np.ndarray, train: np.ndarray, shots: int, seed: int) -> np.ndarray:
    """Of the clips that may be learned so many of each category; all for 0."""
    mixed = np.random.default_rng(seed).permutation(train)
    some = [mixed[labels[mixed] == name][: shots or len(mixed)] for name in np.unique(labels[train])]
    return np.sort(np.concatenate(some))


def measure(guess: Guess, learned: str, asked: str, seed: int, shots: int) -> float:
    """Share of the asked clips that are guessed right."""
    one, other = describe_row(learned, asked)
    right = [
        guess(one, draw_shots(one.labels, train, shots, seed), other, test, seed) == other.labels[test]
        for train, test in list_folds(one, other, seed)
    ]
    return float(np.concatenate(right).mean())


def print_table(systems: dict[str, Guess], rows: Sequence[tuple[str, str]], repeats: int, shots: int) -> None:
    """Print the rows as they are measured: the mean and the spread over seeds; then the seconds of each system."""
    print(f"| learned -> asked | {' | '.join(systems)} |\n| --- |{' --- |' * len(systems)}")
    seconds = dict.fromkeys(systems, 0.0)
    for learned, asked in rows:
        if any(not (SHARED_DATA / folder).is_dir() for folder, _ in FOLDERS.values()):
            print(f"skipped: {learned} -> {asked}: there are recordings missing in {SHARED_DATA}")
            continue
        cells = []
        for name, guess in systems.items():
            started = time.process_time()
            found = [
                measure(guess, learned, asked, seed, shots)
                for seed in range(repeats if shots or ("aeon" not in name and "poses" not in name) else 1)
            ]
            seconds[name] += (time.process_time() - started) / len(found)
            spread = f" ± {100 * np.std(found):.1f}" if len(found) > 1 else ""
            cells.append(f"{100 * np.mean(found):.1f}{spread}")
        print(f"| {learned if learned == asked else f'{learned} -> {asked}'} | {' | '.join(cells)} |", flush=True)
    print(f"| seconds of processor | {' | '.join(f'{one:.0f}' for one in seconds.values())} |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Recognition of people never seen, on every set and sensor.")
    parser.add_argument("--only", default="", help="only rows with this in a name")
    parser.add_argument("--systems", default="", help="only systems with one of these in the name, by commas")
    parser.add_argument("--repeats", type=int, default=3, help="seeds of the forest")
    parser.add_argument("--shots", type=int, default=0, help="clips of each category that are learned; 0 for all")
    asked = parser.parse_args()
    rows = [row for row in ROWS if any(asked.only in name for name in row)]
    systems = {
        name: guess for name, guess in list_systems().items() if any(one in name for one in asked.systems.split(","))
    }
    print_table(systems, rows, asked.repeats, asked.shots)


if __name__ == "__main__":
    main()
