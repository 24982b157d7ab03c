"""Perhaps: what becomes of clips of another sensor, studio and style, between what is known and what is unknown.

    python -m lab.trials.perhaps ../shared/data [--shares 0.9,0.95,0.98,0.99,1] [--folds 1] [--moved 0]

People of one set train a library (without one person; Bandai: half of every category), and all clips of the other three
sets are asked, as recorded; what means the same is told by the table of `confidence.py`. *Lost*: clips whose guess is
right, and which are called unknown. *Named*: clips that mean nothing that the library knows, and get a name, for sure
or perhaps. Gain is what is not lost less what is named, averaged over pairs of library and set.

Where "perhaps" begins, dousa learns for each library from gestures that nobody named: a share of them is less likely
known. The baselines have one curve and one threshold for all libraries: the confidence that is told, and the same
before it is limited. Each threshold, and the share, is also chosen anew for each pair of library and set, as what gains
most on pairs that have neither of the two (*left out*). With `--moved 0` nobody of the disturbed copies moves
differently.

Every library, and one of the 22 synthetic categories, is also asked about the figures of the synthetic dance by people
whom it does not have: two are known there, its circles as arm circles and its kicks as kicks.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dousa.motion import Motion, canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import draw_performer, make_library
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.calibration import ALIEN, Copies, guess_performers, learn_calibration
from dousa.retrieval.takes import made_takes as disturbances
from dousa.retrieval.takes.made_takes import MOVED_SHARE, disturb_motion
from lab.trials.confidence import KIND, MOST_COPIES, SETS, Trained, Trial, find_meaning, split

DANCERS, DANCES = range(10, 22), (0, 1)
FIGURES = {"circles": r"arm_circles", "kick": r"kick.*"}  # of the dance, and what they are
CONFIDENCES = (0.05, 0.1, 0.15, 0.2, 0.25, 0.28, 0.3, 0.35, 0.4, 0.5)


def mean(values: np.ndarray | list[float]) -> float:
    """Nothing has no mean."""
    return float(np.mean(values)) if len(values) else float("nan")


@dataclass(frozen=True)
class Asked:
    """Clips of a set, asked of a library: whether each is right, strange, called known; and what each system names."""

    library: str
    name: str
    right: np.ndarray
    strange: np.ndarray
    known: np.ndarray
    named: dict[str, dict[float, np.ndarray]]

    def gain(self, system: str, choice: float) -> float:
        told = self.named[system][choice] | self.known
        return mean(told[self.right]) - mean(told[self.strange])


def learn_least(
    trial: Trial, name: str, rows: np.ndarray, trained: Trained, shares: tuple[float, ...]
) -> dict[float, float]:
    """From where a motion is perhaps known, for each share of the gestures."""
    features, copies = (trial.features[name][version][rows] for version in ("recorded", "copies"))
    heights = guess_performers([clip.height for clip in trained.clips])
    people = [clip.performer or guess for clip, guess in zip(trained.clips, heights, strict=True)]
    some = np.arange(0, len(features), -(-len(features) // MOST_COPIES))
    least = {}
    for share in shares:
        calibration = learn_calibration(
            trained.forest, features, trained.labels, people,
            feature_set=KIND, copies=Copies(some, copies[some]), alien=share,
        )  # fmt: skip
        least[share] = calibration.least_possible
    return least


def ask(trial: Trial, library: str, name: str, trained: Trained, least: dict[float, float]) -> Asked:
    features = trial.features[name]["recorded"]
    leaves = trained.forest.apply(features)
    assessor = trained.assessor
    seen = assessor.assess(leaves, features)
    plain = replace(assessor.calibration, least_known=0.0)
    raw = type(assessor)(trained.forest, plain).assess(leaves, features)
    meanings = np.array([find_meaning(clip.category) for clip in trial.clips[name]])
    guesses = np.array([find_meaning(guess) for guess in trained.forest.classes_[seen.guess]])
    strange = ~np.isin(meanings, [find_meaning(label) for label in trained.labels])
    named = {
        "dousa": {share: raw.known > start for share, start in least.items()},
        "confidence as told": {one: seen.confidence >= one for one in CONFIDENCES},
        "confidence, not limited": {one: raw.confidence >= one for one in CONFIDENCES},
    }
    return Asked(library, name, guesses == meanings, strange, ~seen.unknown, named)


def describe_people(category: str, performer: str, motion: Motion) -> LabelledClip:
    posed = canonicalise(motion)
    return LabelledClip("", category, performer, posed.positions, posed.frame_rate, posed.height)


def make_figures() -> list[LabelledClip]:
    """The figures of the synthetic dance, each by all dancers."""
    figures = []
    for dancer in DANCERS:
        for seed in DANCES:
            dance = make_dance(draw_performer(dancer), seed)
            for figure in dance.figures:
                frames = slice(figure.start, figure.end)
                part = replace(
                    dance.motion,
                    rotations=dance.motion.rotations[frames],
                    translations=dance.motion.translations[frames],
                )
                figures.append(describe_people(figure.name, str(dancer), part))
    return figures


def ask_dance(library: str, trained: Trained, figures: list[LabelledClip], features: np.ndarray) -> None:
    """How many of each figure have a name, for sure or perhaps, and which most."""
    seen = trained.assessor.assess(trained.forest.apply(features), features)
    guesses = trained.forest.classes_[seen.guess]
    for name in sorted({clip.category for clip in figures}):
        rows = np.array([clip.category == name for clip in figures])
        known = any(re.fullmatch(FIGURES.get(name, ""), label) for label in trained.labels)
        names, counts = np.unique(guesses[rows], return_counts=True)
        sure, perhaps = (~seen.unknown)[rows].mean(), (seen.possible & seen.unknown)[rows].mean()
        print(
            f"{library:20s} {name:8s} {'known' if known else 'strange':8s} {rows.sum():3d}  for sure {sure:.2f}  "
            f"perhaps {perhaps:.2f}  most often {names[counts.argmax()]} ({counts.max() / rows.sum():.2f})",
            flush=True,
        )


def choose(pairs: list[Asked], system: str, left_out: set[str]) -> float:
    """What gains most on pairs that have none of these sets."""
    rest = [one for one in pairs if not {one.library, one.name} & left_out and one.right.sum() >= 5]
    choices = list(pairs[0].named[system])
    gains = [mean([one.gain(system, choice) for one in rest]) for choice in choices]
    return choices[int(np.argmax(gains))] if rest else choices[len(choices) // 2]


def print_row(title: str, pairs: list[Asked], named: Callable[[Asked], np.ndarray]) -> None:
    right, strange, known = (
        np.concatenate([getattr(one, side) for one in pairs]) for side in ("right", "strange", "known")
    )
    perhaps = np.concatenate([named(one) for one in pairs]) & ~known
    print(
        f"{title:52s} right {right.sum():4d}  lost {mean(~(known | perhaps)[right]):.2f} (before "
        f"{mean(~known[right]):.2f})  strange {strange.sum():4d}  perhaps {mean(perhaps[strange]):.2f}  for sure "
        f"{mean(known[strange]):.2f}  of perhaps right {right[perhaps].sum() / max(perhaps.sum(), 1):.2f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default=",".join(SETS), help="sets, separated by commas")
    parser.add_argument("--shares", default="0.9,0.95,0.98,0.99,1", help="of the gestures that nobody named")
    parser.add_argument("--folds", type=int, default=1, help="people of each set that are left out")
    parser.add_argument(
        "--moved", type=float, default=MOVED_SHARE, help="share of the copies that are moved differently"
    )
    asked = parser.parse_args()
    if not asked.data.exists():
        print(f"skipped: no recordings at {asked.data}")
        return
    shares = tuple(sorted({ALIEN, *map(float, asked.shares.split(","))}))
    disturbances.MOVED_SHARE = asked.moved
    trial = Trial(asked.data, asked.only.split(","))
    figures, pairs = make_figures(), []
    danced = np.stack([KIND.compute(clip) for clip in figures])
    for library, clips in trial.clips.items():
        for seed, rows in enumerate(split(clips)[: asked.folds]):
            trained = trial.train({library: ~rows}, seed)
            if seed == 0:
                ask_dance(library, trained, figures, danced)
            least = learn_least(trial, library, ~rows, trained, shares)
            pairs += [ask(trial, library, name, trained, least) for name in trial.clips if name != library]
    people = [describe_people(category, who.name, motion) for category, who, _, motion in make_library(10, 1, 0)]
    copies = [KIND.compute(disturb_motion(clip, np.random.default_rng([row, 7]))) for row, clip in enumerate(people)]
    synthetic = Trained(people, np.stack([KIND.compute(clip) for clip in people]), np.stack(copies), 0)
    ask_dance("synthetic", synthetic, figures, danced)
    for system in pairs[0].named if pairs else ():
        for choice in pairs[0].named[system]:
            gain = mean([one.gain(system, choice) for one in pairs if one.right.sum() >= 5])
            print(f"{system:30s} {choice:5.2f}  gain {gain:.3f}", flush=True)
    for library in trial.clips if len(pairs) > 1 else ():
        own = [one for one in pairs if one.library == library]
        print_row(f"{library}: dousa, {ALIEN}", own, lambda one: one.named["dousa"][ALIEN])
        for system in own[0].named:
            chosen = {one.name: choose(pairs, system, {library, one.name}) for one in own}
            print_row(
                f"{library}: {system}, left out",
                own,
                lambda one, system=system, chosen=chosen: one.named[system][chosen[one.name]],  # type: ignore[misc]
            )


if __name__ == "__main__":
    main()
