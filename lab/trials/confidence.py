"""Can confidences be trusted? Expected calibration error and AUROC of `classify` and `find`, beside plain baselines.

    python -m lab.trials.confidence ../shared/data [--only hdm05] [--folds 1] [--find 0] [--figure FILE.svg]

*People*: each person is left out (Bandai names none: half of the clips of each category), and the clips of that person
are asked as recorded, and disturbed by two generators that training does not use: `slow` (15 Hz, white noise of 3 cm, 5
% of the joints missing and bridged) and `drifting` (noise of 1 to 4 cm that drifts, joints held for up to half a
second), both seen from any side and at other tempos. *Sets*: three sets are learned, and all clips of the fourth asked;
right is a guess that means the same (MEANINGS), so most have no right answer. *One set*: the same of people of one set
(without the first, or half) and all clips of the others. *Unknown* is the AUROC of people left out
against clips of the other sets that mean something else; *mixed* is the error on both, one in eleven being of these, as
a confidence assumes.

The error is that of ten bins of equal width (Guo et al., ICML 2017). The baselines: the share of the votes as it is;
and the distance to the nearest clip in standardised features, by an isotonic fit on the people of the library, left out
in turn.

`find`: clips of the library in joined takes of the people left out (ten places each); right is a place that overlaps an
action of the query's category by half.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from sklearn.isotonic import IsotonicRegression

from dousa.library import Library
from dousa.library.search.text_store import find_meanings
from dousa.library.store.features import load_motions
from dousa.retrieval import FEATURE_SETS, MotionForest
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.calibration import STRANGERS, Assessor, Copies, guess_performers, learn_calibration
from dousa.retrieval.forest.likeness import LikenessLearner, merge_votes
from dousa.retrieval.forest.pose_space import compute_auroc
from dousa.retrieval.takes.find import describe_query, find_in_takes, judge_place, overlap
from dousa.retrieval.takes.made_takes import disturb_motion, join_clips, shuffle_into_takes
from dousa.retrieval.takes.windows import choose_grid, describe_take

KIND = FEATURE_SETS["extended"]
SETS = {"hdm05": r"name:HDM_(..)_", "utd_mhad/skeleton": r"name:_s(\d+)_", "bandai": None, "utkinect": r"name:(s..)_"}
MEANINGS = {
    "squat": r"squat.*", "walk": r"walk.*", "run": r"run/.*|jog.*", "throw": r"throw|pickup_throw",
    "basketball": r"throwBasketball|basketball_shoot", "wave": r"wave.*", "clap": r"clap.*",
    "sit": r"stand_to_sit|sitDown.*", "stand": r"sit_to_stand|standUp.*", "push": r"push", "pick up": r"pickUp",
    "raise": r"raise-up.*",
}  # fmt: skip
MOST_COPIES = 1000  # as in the library
Rows = dict[str, list[tuple[np.ndarray, ...]]]  # what was said, and whether that was right; or called unknown


def find_meaning(category: str) -> str:
    return next((name for name, pattern in MEANINGS.items() if re.fullmatch(pattern, category)), category)


def read_clips(data: Path, name: str) -> list[LabelledClip]:
    """Clips, or the annotated segments of takes."""
    with tempfile.TemporaryDirectory() as folder, Library.open(Path(folder) / "a.dousa", create=True) as library:
        takes = {"kind": "take", "labels_from": "beside"} if name == "utkinect" else {}
        library.add(data / name, performer_from=SETS[name], **takes)
        infos = [clip for clip in library.clips() if clip.kind == "clip" and clip.category]
        with library.database.reading() as connection:
            motions = list(load_motions(connection, [clip.id for clip in infos]))
    return [
        LabelledClip(info.path, str(info.category), info.performer, one.positions, one.frame_rate, one.height)
        for info, one in zip(infos, motions, strict=True)
    ]


def turn(points: np.ndarray, chance: np.random.Generator) -> np.ndarray:
    angle = chance.uniform(-np.pi, np.pi)
    across, along = np.cos(angle), np.sin(angle)
    return points @ np.array([[across, 0, along], [0, 1, 0], [-along, 0, across]])


def slow(clip: LabelledClip, chance: np.random.Generator) -> LabelledClip:
    points = turn(sample_positions(clip.positions, clip.frame_rate), chance)[::2]
    points = points + chance.normal(0, 0.03 / np.sqrt(3), points.shape)
    gone, frames = chance.random(points.shape[:2]) < 0.05, np.arange(len(points))
    for joint in range(points.shape[1]):
        seen = np.flatnonzero(~gone[:, joint])
        for axis in range(3) if len(seen) else ():
            points[:, joint, axis] = np.interp(frames, seen, points[seen, joint, axis])
    return replace(clip, positions=points, frame_rate=15.0 * float(np.exp(chance.uniform(-0.3, 0.3))))


def drifting(clip: LabelledClip, chance: np.random.Generator) -> LabelledClip:
    points = turn(sample_positions(clip.positions, clip.frame_rate), chance)
    stay, noise = chance.uniform(0.3, 0.9), chance.normal(size=points.shape)
    for frame in range(1, len(points)):
        noise[frame] = stay * noise[frame - 1] + np.sqrt(1 - stay**2) * noise[frame]
    size = chance.uniform(0.01, 0.04) * np.exp(chance.normal(0, 0.4, (1, points.shape[1], 1))) / np.sqrt(3)
    points = points + noise * size
    for joint in chance.choice(points.shape[1], 3, replace=False):
        start = int(chance.integers(len(points)))
        points[start : start + int(chance.integers(3, 16)), joint] = points[max(start - 1, 0), joint]
    return replace(clip, positions=points, frame_rate=30.0 * float(np.exp(chance.uniform(-0.3, 0.3))))


VERSIONS = {"recorded": lambda clip, chance: clip, "slow": slow, "drifting": drifting}


class Trained:
    """What `dousa train` learns from clips for `classify` and `find`, and the baselines."""

    def __init__(self, clips: list[LabelledClip], features: np.ndarray, copies: np.ndarray, seed: int) -> None:
        self.clips, self.labels = clips, np.array([clip.category for clip in clips])
        heights = guess_performers([clip.height for clip in clips])
        people = [clip.performer or guess for clip, guess in zip(clips, heights, strict=True)]
        means = find_meanings(set(self.labels.tolist()))
        meanings = np.array([means[name] for name in self.labels])
        self.forest = MotionForest(thresholds=KIND.thresholds, random_state=seed)
        rows = np.arange(0, len(clips), -(-len(clips) // MOST_COPIES))
        twice = np.concatenate([features, copies[rows]])
        self.forest.fit(twice, self.labels, feature_set=KIND, copied=rows)
        learner = LikenessLearner(features, self.labels, meanings, np.array(people), KIND)
        calibration = learn_calibration(
            self.forest, features, self.labels, people,
            feature_set=KIND, copies=Copies(rows, copies[rows]), watch=learner.watch,
        )  # fmt: skip
        self.assessor, self.likeness = Assessor(self.forest, calibration), learner.finish()
        self.meanings = np.unique([means[name] for name in self.forest.classes_.tolist()], return_inverse=True)[1]
        self._fit_nearest(features, np.array(people))

    def _fit_nearest(self, features: np.ndarray, people: np.ndarray) -> None:
        flat = features.reshape(len(features), -1)
        self._middle, self._spread = flat.mean(axis=0), flat.std(axis=0) + 1e-6
        self._points = (flat - self._middle) / self._spread
        away = self._distances(self._points)
        away[people[:, None] == people[None]] = np.inf
        np.fill_diagonal(away, np.inf)
        nearest = away.argmin(axis=1)
        rows = np.flatnonzero(np.isfinite(away.min(axis=1)))
        right = self.labels[nearest[rows]] == self.labels[rows]
        curve = IsotonicRegression(increasing=False, out_of_bounds="clip", y_min=0, y_max=1)
        self._curve = curve.fit(away.min(axis=1)[rows], right) if len(rows) else None

    def _distances(self, points: np.ndarray) -> np.ndarray:
        squares = (points**2).sum(axis=1)[:, None] + (self._points**2).sum(axis=1) - 2 * points @ self._points.T
        return np.sqrt(np.maximum(squares, 0) / points.shape[1])

    def classify(self, features: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Guesses and confidences of dousa and the baselines, and what they call unknown."""
        leaves = self.forest.apply(features)
        seen = self.assessor.assess(leaves, features)
        guess = self.forest.classes_[seen.guess]
        away = self._distances((features.reshape(len(features), -1) - self._middle) / self._spread)
        nearest = np.full(len(features), 0.5) if self._curve is None else self._curve.predict(away.min(axis=1))
        share = self.assessor.scale.measure(leaves)[1][:, 0]
        return {
            "dousa": (guess, seen.confidence, seen.unknown),
            "share of the votes": (guess, share, share < 0.5),
            "nearest, isotonic": (self.labels[away.argmin(axis=1)], nearest, nearest < 0.5),
        }

    def describe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shares = self.forest.histograms_of(self.forest.apply(features).astype(np.int64))
        return shares, merge_votes(shares, self.meanings), self.likeness.place(features)

    def find(self, takes: list, queries: list[LabelledClip]) -> dict[str, list[tuple[float, bool]]]:
        """Probabilities of places, and whether they are right."""
        grid = choose_grid([len(clip.positions) / clip.frame_rate for clip in self.clips], 0.5, 2.0)
        windows = [(str(number), describe_take(self.forest, KIND, take, grid)) for number, take in enumerate(takes)]
        said = defaultdict(list)
        for query in queries:
            found = find_in_takes(describe_query(self.forest, KIND, query), windows, limit=10)
            parts = []
            for place in found:
                take = takes[int(place.take)]
                first = round(place.start * take.frame_rate)
                last = max(round(place.stop * take.frame_rate), first + 1)
                parts.append(KIND.compute(replace(take, positions=take.positions[first:last])))
            if not parts:
                continue
            shares, told, direction = self.describe(KIND.compute(query)[None])
            there = self.describe(np.stack(parts))
            likeness = self.likeness.judge(told[0], direction[0], *there[1:])
            for row, place in enumerate(found):
                right = any(
                    piece.category == query.category
                    and overlap((30 * place.start, 30 * place.stop), (piece.start, piece.stop)) >= 0.5
                    for piece in takes[int(place.take)].pieces
                )
                votes = float(there[0][row, shares[0].argmax()])
                said["dousa"].append((judge_place(float(likeness[row]), place.score, votes), right))
                said["likeness as clips"].append((float(likeness[row]), right))
                said["score"].append((place.score, right))
        return said


def calibration_error(chance: np.ndarray, right: np.ndarray, weights: np.ndarray | None = None) -> float:
    weights = np.ones(len(chance)) if weights is None else weights
    apart = np.bincount(np.minimum((chance * 10).astype(int), 9), weights * (chance - right), 10)
    return float(np.abs(apart).sum() / max(weights.sum(), 1e-9))


def mix(rows: dict[str, Rows], names: list[str], versions: list[str], system: str) -> tuple[np.ndarray, ...]:
    """People left out of sets, and strangers to them, one in eleven: what is said, what is right, and weights."""
    parts = []
    for name in names:
        for version in versions:
            known = rows[f"people, {name}, {version}"][system]
            chance, right = (np.concatenate([np.asarray(part[side], float) for part in known]) for side in (0, 1))
            strange = np.concatenate([part[0][part[1] == 0] for part in rows[f"unknown, {name}, {version}"][system]])
            share = STRANGERS * len(chance) / max(len(strange), 1)
            weights = np.repeat([1.0, share], [len(chance), len(strange)])
            parts.append((np.append(chance, strange), np.append(right, np.zeros(len(strange))), weights))
    return tuple(np.concatenate([part[side] for part in parts]) for side in range(3))


def print_rows(title: str, rows: Rows) -> None:
    for system, parts in rows.items():
        chance, right = (np.concatenate([np.asarray(part[side], float) for part in parts]) for side in (0, 1))
        error, area = calibration_error(chance, right), compute_auroc(chance, right.astype(bool))
        if title.startswith("unknown"):
            belongs = right > 0
            told = np.concatenate([part[2] for part in parts])
            called = f"known called unknown {told[belongs].mean():.3f}"
            if not belongs.all():
                called += f"  strange called known {np.mean(~told[~belongs]):.3f}"
            print(f"{title:42s} {system:20s} n {len(right):5d}  AUROC {area:.3f}  {called}", flush=True)
            continue
        print(
            f"{title:42s} {system:20s} n {len(right):5d}  says {chance.mean():.2f}  right {right.mean():.2f}  "
            f"error {error:.3f}  AUROC {area:.3f}  unknown {np.mean(chance < 0.5):.3f}",
            flush=True,
        )


def split(clips: list[LabelledClip]) -> list[np.ndarray]:
    """Which clips are asked, in each fold: those of a person, or a half of every category."""
    people = [clip.performer for clip in clips]
    if all(people):
        return [np.array([person == name for person in people]) for name in sorted(set(people))]
    chance, half = np.random.default_rng(0), np.zeros(len(clips), bool)
    for name in {clip.category: None for clip in clips}:
        inside = chance.permutation([row for row, clip in enumerate(clips) if clip.category == name])
        half[inside[: len(inside) // 2]] = True
    return [half]


class Trial:
    """All sets with their features, as recorded and disturbed; and what was measured."""

    def __init__(self, data: Path, names: list[str]) -> None:
        self.clips = {name: read_clips(data, name) for name in names}
        self.features: dict[str, dict[str, np.ndarray]] = {}
        for name, clips in self.clips.items():
            self.features[name] = {
                version: np.stack(
                    [KIND.compute(make(clip, np.random.default_rng([row, 7]))) for row, clip in enumerate(clips)]
                )
                for version, make in (*VERSIONS.items(), ("copies", disturb_motion))
            }
        self.rows: dict[str, Rows] = defaultdict(lambda: defaultdict(list))

    def train(self, parts: dict[str, np.ndarray], seed: int) -> Trained:
        clips = [self.clips[name][row] for name, rows in parts.items() for row in np.flatnonzero(rows)]
        features, copies = (
            np.concatenate([self.features[name][version][rows] for name, rows in parts.items()])
            for version in ("recorded", "copies")
        )
        return Trained(clips, features, copies, seed)

    def ask(self, trained: Trained, name: str, rows: np.ndarray, title: str, strangers: bool) -> None:
        labels = np.array([clip.category for clip in self.clips[name]])[rows]
        for version in VERSIONS:
            answers = trained.classify(self.features[name][version][rows])
            for system, (guess, chance, _) in answers.items():
                same = [find_meaning(one) == find_meaning(other) for one, other in zip(guess, labels, strict=True)]
                right = np.array(same) if strangers else guess == labels
                for key in (f"{title}, {version}", f"{title}, all"):
                    self.rows[key][system].append((chance, right))

    def ask_unknown(self, trained: Trained, name: str, rows: np.ndarray) -> None:
        """Known clips of people left out, and clips of other sets that mean something else."""
        known = {find_meaning(label) for label in trained.labels}
        for version in VERSIONS:
            said = trained.classify(self.features[name][version][rows])
            for system, (_, chance, told) in said.items():
                self.rows[f"unknown, {name}, {version}"][system].append((chance, np.ones(len(chance), bool), told))
        for other in self.clips:
            strange = np.array([find_meaning(clip.category) not in known for clip in self.clips[other]])
            if other != name and strange.any():
                for version in VERSIONS:
                    said = trained.classify(self.features[other]["recorded"][strange])
                    for system, (_, chance, told) in said.items():
                        part = chance, np.zeros(len(chance), bool), told
                        self.rows[f"unknown, {name}, {version}"][system].append(part)

    def search(self, trained: Trained, name: str, rows: np.ndarray, n_queries: int, seed: int) -> None:
        chance = np.random.default_rng(seed)
        held = [replace(clip, performer="held") for clip, out in zip(self.clips[name], rows, strict=True) if out]
        groups = shuffle_into_takes(held, chance)[:4]
        chosen = [trained.clips[row] for row in chance.permutation(len(trained.clips))[:n_queries]]
        joined = [join_clips([held[row] for row in group], chance) for group in groups]
        noisy = []
        for take in joined:
            seen = slow(LabelledClip("", "", None, take.positions, 30.0, take.height), chance)
            noisy.append(replace(take, positions=seen.positions, frame_rate=15.0))
        for version, takes in (("recorded", joined), ("slow", noisy)):
            for system, pairs in trained.find(takes, chosen).items():
                part = np.array([one for one, _ in pairs]), np.array([one for _, one in pairs])
                for key in (f"find, {name}, {version}", f"find, {name}, all"):
                    self.rows[key][system].append(part)


def draw_figure(rows: dict[str, Rows], path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(7, 3.4), sharey=True, layout="constrained")
    names = sorted({key.split(", ")[1] for key in rows if key.startswith("unknown")})
    for axis, start in zip(axes, ("people", "find"), strict=True):
        for system in ("dousa", "share of the votes" if start == "people" else "likeness as clips"):
            if start == "people":
                chance, right, weights = mix(rows, names, list(VERSIONS), system)
            else:
                parts = [part for name in names for part in rows[f"find, {name}, all"][system]]
                chance, right = (np.concatenate([part[side] for part in parts]) for side in (0, 1))
                weights = np.ones(len(chance))
            bins = np.minimum((chance * 10).astype(int), 9)
            there = [number for number in range(10) if weights[bins == number].sum() >= 20]
            spots = [
                [np.average(side[bins == number], weights=weights[bins == number]) for side in (chance, right)]
                for number in there
            ]
            axis.plot(*np.array(spots).T, "o-", label=system)
        axis.plot([0, 1], [0, 1], color="0.7", zorder=0)
        axis.set(xlabel="what it says", title={"people": "classify", "find": "find"}[start])
        axis.legend()
    axes[0].set_ylabel("how often it is right")
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default=",".join(SETS), help="sets, separated by commas")
    parser.add_argument("--folds", type=int, default=99, help="people of each set that are left out")
    parser.add_argument("--find", type=int, default=30, help="queries of each person left out; 0 for none")
    parser.add_argument("--figure", type=Path)
    asked = parser.parse_args()
    if not asked.data.exists():
        print(f"skipped: no recordings at {asked.data}")
        return
    trial = Trial(asked.data, asked.only.split(","))
    for name, clips in trial.clips.items():
        for seed, rows in enumerate(split(clips)[: asked.folds]):
            trained = trial.train({name: ~rows}, seed)
            trial.ask(trained, name, rows, f"people, {name}", False)
            trial.ask(trained, name, rows, "people", False)
            trial.ask_unknown(trained, name, rows)
            for other, some in trial.clips.items() if seed == 0 else ():
                if other != name:
                    trial.ask(trained, other, np.ones(len(some), bool), f"one set, {name}", True)
                    trial.ask(trained, other, np.ones(len(some), bool), "one set", True)
            if asked.find:
                trial.search(trained, name, rows, asked.find, seed)
    for name in trial.clips if len(trial.clips) > 1 else ():
        others = {other: np.ones(len(clips), bool) for other, clips in trial.clips.items() if other != name}
        trained = trial.train(others, 0)
        everything = np.ones(len(trial.clips[name]), bool)
        trial.ask(trained, name, everything, f"sets, {name}", True)
        trial.ask(trained, name, everything, "sets", True)
    for title, rows in trial.rows.items():
        print_rows(title, rows)
    for system in ("dousa", "share of the votes", "nearest, isotonic") if len(trial.clips) > 1 else ():
        for version in (*VERSIONS, "all"):
            chance, right, weights = mix(
                trial.rows, list(trial.clips), list(VERSIONS) if version == "all" else [version], system
            )
            error = calibration_error(chance, right, weights)
            print(f"mixed, {version:35s} {system:20s} error {error:.3f}", flush=True)
    if asked.figure is not None:
        draw_figure(trial.rows, asked.figure)


if __name__ == "__main__":
    main()
