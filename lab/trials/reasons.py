"""Do the reasons of `dousa.retrieval.explain` carry the vote? People left out one at a time; ablation, in two ways.

    python -m lab.trials.reasons FOLDER --performer-from 'name:_s(\\d+)_' [--features extended]

FOLDER has one folder per category. For every clip of the person left out: the vote for the category guessed, and what
is left of it without the relation of the first reason, without the relation that the trees ask about most often, and
without one drawn at random. "Ablated" is the library's way: the clip goes both ways at the tests of the relation.
"Swapped" is another way that shares no code with it: the features of the relation are those of 20 training clips
drawn at random, and the forest itself counts the mean vote.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.formats import ReadOptions
from dousa.retrieval import Explainer, MotionForest
from dousa.retrieval.explain.explanation import read_questions
from dousa.retrieval.features.feature_sets import FEATURE_SETS, FeatureSet

SWAPS = 20


def columns_of(features: FeatureSet, relation: str) -> list[int]:
    """The columns of a relation, with those of their squares and moments."""
    names = {channel.name for channel in features.channels if channel.relation == relation} | {relation}
    return [
        column
        for column, name in enumerate(features.column_names)
        if name.removesuffix(", squared").removesuffix(", times time") in names
    ]


class Trial:
    """One forest, the clips of one person, and the numbers collected."""

    def __init__(self, features: FeatureSet, forest: MotionForest, training: np.ndarray, seed: int) -> None:
        self.features, self.forest, self.training = features, forest, training
        self.explainer, self.questions = Explainer(forest), read_questions(forest)
        self.random = np.random.default_rng(seed)

    def swap(self, clip: np.ndarray, relation: str, number: int) -> float:
        """The mean vote for a category, with the relation of other clips."""
        columns = columns_of(self.features, relation)
        copies = np.repeat(clip[None], SWAPS, axis=0)
        drawn = self.random.integers(0, len(self.training), SWAPS)
        copies[:, :, columns] = self.training[drawn][:, :, columns]
        return float(self.forest.predict_proba(copies)[:, number].mean())

    def ask(self, clip: np.ndarray, duration: float) -> dict[str, float]:
        """Everything about one clip."""
        start = time.perf_counter()
        told = self.explainer.explain(clip, duration)
        seconds = time.perf_counter() - start
        without = self.explainer.votes_without(clip)
        number = self.forest.classes_.tolist().index(told.category)
        above = self.questions.evaluate(clip) > self.questions.threshold
        nodes, _ = self.questions.follow(above, np.ones(len(self.forest.trees_.roots), bool))
        asked = Counter(self.questions.relations[number] for number in self.questions.relation[nodes])
        often, any_one = asked.most_common(1)[0][0], str(self.random.choice(list(without)))
        first = told.reasons[0].relation if told.reasons else ""
        return {
            "ms": 1e3 * seconds,
            "reasons": len(told.reasons),
            "vote": told.vote,
            "first, ablated": without.get(first, told.vote),
            "often, ablated": without[often],
            "random, ablated": without[any_one],
            "all, ablated": told.vote_without_all,
            "first, swapped": self.swap(clip, first, number) if first else told.vote,
            "often, swapped": self.swap(clip, often, number),
            "random, swapped": self.swap(clip, any_one, number),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--performer-from", required=True)
    parser.add_argument("--features", choices=sorted(FEATURE_SETS), default="extended")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    clips, _ = read_labelled_clips(
        [options.folder],
        category_from="folder",
        performer_from=options.performer_from,
        options=ReadOptions(),
        n_jobs=2,
    )
    features = FEATURE_SETS[options.features]
    pose = np.stack([features.compute(clip) for clip in clips])
    categories = np.array([clip.category for clip in clips])
    performers = np.array([clip.performer for clip in clips])
    durations = [len(clip.positions) / clip.frame_rate for clip in clips]
    rows, right = [], 0
    for performer in np.unique(performers):
        train = performers != performer
        forest = MotionForest(
            thresholds=features.thresholds,
            random_state=options.seed,
            n_jobs=2,
        ).fit(pose[train], categories[train], feature_set=features)
        trial = Trial(features, forest, pose[train], options.seed)
        tested = np.flatnonzero(~train)
        right += int((forest.predict(pose[tested]) == categories[tested]).sum())
        trial.ask(pose[tested[0]], durations[tested[0]])  # compiles
        rows += [trial.ask(pose[k], durations[k]) for k in tested]
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    print(f"{len(clips)} clips, features {options.features}, accuracy {right / len(clips):.3f}")
    print(f"  {np.median(table['ms']):.1f} ms an explanation (median)")
    print(f"  clips with at least one reason: {(table['reasons'] > 0).mean():.3f}")
    for name, values in table.items():
        if name not in ("ms", "reasons"):
            lower = (values < table["vote"]).mean()
            print(f"  {name:18s} {values.mean():.3f}, lower than the vote: {lower:.3f}")


if __name__ == "__main__":
    main()
