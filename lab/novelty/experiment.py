"""How well unknown motions are detected, and how well new categories are added without retraining.

**Unknown.** Half of the categories, drawn at random, train a forest and its calibration; the clips of all categories
are then judged. With performers, one at a time is left out, and only the clips of that performer are judged: neither
a known nor an unknown clip is by anybody the forest has seen.

**New.** A forest is trained without some categories; then ``n_clips`` clips of each of them are added. Three forests
answer the same test clips: the one before, the one that grew, and one trained anew with the same clips.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import TrainingError
from dousa.experiments.runner import (
    Split,
    Steps,
    check_at_least,
    describe_copies,
    fit_forest,
    leave_performer_out,
    make_forest,
    split_half,
)
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.messages import Message, Progress
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, FeatureSet, get_feature_set
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.calibration import Assessor, learn_calibration
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.growth import StandingClips, grow_forest
from dousa.retrieval.forest.pose_space import compute_auroc

FORESTS: tuple[str, ...] = ("before", "grown", "trained anew")
"""The forests that are compared on new categories."""

_FOREST_WORDS = {
    "before": Message("trial_novelty.before"),
    "grown": Message("trial_novelty.grown"),
    "trained anew": Message("trial_novelty.trained_anew"),
}

_SHOWN_LIMITS = (0.2, 0.3, 0.7, 0.8)


@dataclass(frozen=True, slots=True)
class UnknownMotions:
    """How well clips of categories that were held back were distinguished from the others.

    Parameters
    ----------
    auroc, auroc_std : mean over the trials, and standard deviation.
    false_alarms : share of known clips that were called unknown.
    misses : share of unknown clips that were taken for known.
    expected_false_alarms, expected_misses : what the calibrations predicted.
    accuracy : share of known clips whose category was guessed, before any is called unknown.
    curve : rows (threshold, false alarms, misses) for other thresholds.
    train_seconds, calibrate_seconds : mean time for a forest, and for its calibration.
    n_trials : how many were averaged.
    """

    auroc: float
    auroc_std: float
    false_alarms: float
    misses: float
    expected_false_alarms: float
    expected_misses: float
    accuracy: float
    curve: tuple[tuple[float, float, float], ...]
    train_seconds: float
    calibrate_seconds: float
    n_trials: int


@dataclass(frozen=True, slots=True)
class NewCategories:
    """What a forest does with categories that came after its training.

    Parameters
    ----------
    forest : of ``FORESTS``.
    n_new, n_clips : categories that came, and clips of each.
    accuracy : share of all test clips whose category was guessed.
    recall_new, recall_old : the same of those of the new, and of the old categories.
    called_unknown : share of the test clips of the new categories that are called unknown.
    seconds : mean time to grow, or to train.
    """

    forest: str
    n_new: int
    n_clips: int
    accuracy: float
    recall_new: float
    recall_old: float
    called_unknown: float
    seconds: float


@dataclass(frozen=True, slots=True)
class NoveltyResult(Result):
    """Both measurements.

    Parameters
    ----------
    unknown : detecting unknown motions.
    new : adding new categories; a row for each forest and number of categories.
    n_clips, n_categories : of the data.
    split : ``"leave-performer-out"`` or ``"half"``.
    feature_set, n_trees, repeats, random_state : as asked for.
    """

    unknown: UnknownMotions
    new: tuple[NewCategories, ...]
    n_clips: int
    n_categories: int
    split: str
    feature_set: str
    n_trees: int
    repeats: int
    random_state: int

    def to_tables(self) -> tuple[ResultTable, ...]:
        """Unknown motions, and new categories where there were any."""
        what = Message(
            "trial_novelty.data",
            clips=self.n_clips,
            categories=self.n_categories,
            split=self.split,
            features=self.feature_set,
            trees=self.n_trees,
            repeats=self.repeats,
            seed=self.random_state,
        )
        return (_tabulate_unknown(self.unknown, what), *([_tabulate_new(self.new)] if self.new else []))


def _tabulate_unknown(unknown: UnknownMotions, what: Message) -> ResultTable:
    shown = [row for row in unknown.curve if row[0] in _SHOWN_LIMITS]
    rows: tuple[tuple[Cell, ...], ...] = (
        ("AUROC", f"{show(unknown.auroc)} ± {show(unknown.auroc_std)}", ""),
        (
            Message("trial_novelty.false_alarms"),
            show(unknown.false_alarms),
            show(unknown.expected_false_alarms),
        ),
        (Message("trial_novelty.misses"), show(unknown.misses), show(unknown.expected_misses)),
        *(
            (Message("trial_novelty.at_threshold", limit=limit), f"{show(alarms)}, {show(misses)}", "")
            for limit, alarms, misses in shown
        ),
        (Message("trial_novelty.accuracy"), show(unknown.accuracy), ""),
        (
            Message("trial_novelty.seconds"),
            f"{show(unknown.train_seconds, 2)} s, {show(unknown.calibrate_seconds, 2)} s",
            "",
        ),
    )
    return ResultTable(
        ("", Message("trial_novelty.measured"), Message("trial_novelty.predicted")),
        rows,
        title=Message("trial_novelty.unknown", trials=unknown.n_trials),
        preface=(what,),
    )


def _tabulate_new(rows: Sequence[NewCategories]) -> ResultTable:
    return ResultTable(
        (
            Message("trial_novelty.new"),
            Message("trial_novelty.forest"),
            Message("trial_novelty.all_clips"),
            Message("trial_novelty.of_new"),
            Message("trial_novelty.of_old"),
            Message("trial_novelty.called_unknown"),
            Message("trial_novelty.time"),
        ),
        tuple(
            (
                str(row.n_new),
                _FOREST_WORDS[row.forest],
                *map(show, (row.accuracy, row.recall_new, row.recall_old, row.called_unknown)),
                show(row.seconds, 2),
            )
            for row in rows
        ),
        title=Message("trial_novelty.new_categories", clips=rows[0].n_clips),
        n_words=2,
    )


_NEW = (1, 5)
_LIMITS = tuple(round(0.1 * step, 1) for step in range(1, 10))


def run_novelty_experiment(
    clips: Sequence[LabelledClip],
    *,
    repeats: int = 5,
    n_clips: int = 5,
    n_trees: int = 100,
    feature_set: str = DEFAULT_FEATURE_SET,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> NoveltyResult:
    """Hold categories back, and see what forests make of them.

    Parameters
    ----------
    clips : with categories; with performers for all of them one is left out at a time, without any half of each
        category is tested.
    repeats : how often categories are drawn, for each performer.
    n_clips : clips of a category that is added.
    n_trees, feature_set : of the forests.
    random_state : seed; the same seed gives the same numbers, but for the times.
    n_jobs : threads; None for one.
    progress : called with the number of trials done, their total, and what comes next.

    Returns
    -------
    NoveltyResult

    Raises
    ------
    TrainingError : no clips, a clip without category, or fewer than 6 categories.
    OptionError : a number out of range.
    """
    check_at_least(repeats=(repeats, 1), n_clips=(n_clips, 1), seed=(random_state, 0))
    trials = _Trials(clips, get_feature_set(feature_set), n_trees, random_state, n_jobs, progress)
    for split, generator in trials.draw(repeats):
        trials.hold_back_half(split, generator)
        for count in _NEW:
            if 2 * count < len(trials.names):
                trials.add_categories(split, generator, count, n_clips)
    return NoveltyResult(
        unknown=_summarise_unknown(trials.held_back),
        new=_summarise_new(trials.added),
        n_clips=len(clips),
        n_categories=len(trials.names),
        split=trials.split,
        feature_set=feature_set,
        n_trees=n_trees,
        repeats=repeats,
        random_state=random_state,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _HeldBack:
    """One trial with half of the categories: confidences, which are known and called unknown, and what else is said."""

    probability: NDArray[np.float64]
    known: NDArray[np.bool_]
    called: NDArray[np.bool_]
    expected: tuple[float, float]
    accuracy: float
    seconds: tuple[float, float]


class _Trials:
    """Makes the forests and collects what they answer."""

    def __init__(
        self,
        clips: Sequence[LabelledClip],
        feature_set: FeatureSet,
        n_trees: int,
        random_state: int,
        n_jobs: int | None,
        progress: Progress | None,
    ) -> None:
        self.labels = np.array([clip.category for clip in clips], dtype=np.str_)
        self.names = np.unique(self.labels)
        if len(self.names) < 6 or not all(self.names):
            raise TrainingError("trials.categories", found=len(self.names))
        self.performers = np.array([clip.performer for clip in clips], dtype=object)
        self.split = "leave-performer-out" if len(set(self.performers)) > 1 and all(self.performers) else "half"
        self.feature_set, self.n_trees, self.n_jobs = feature_set, n_trees, n_jobs
        self.random_state, self.steps = random_state, Steps(progress)
        self.held_back: list[_HeldBack] = []
        self.added: list[NewCategories] = []
        self.steps.say(Message("trial_progress.features"))
        self.features = np.stack([feature_set.compute(clip) for clip in clips])
        self.copies = describe_copies(clips, feature_set, random_state)

    def draw(self, repeats: int) -> Iterator[tuple[Split, np.random.Generator]]:
        """Who trains and who is tested, and the random numbers of the trial."""
        if self.split == "half":
            drawn = [np.random.default_rng([self.random_state, repeat]) for repeat in range(repeats)]
            trials = [(split_half(list(self.labels), generator), generator) for generator in drawn]
        else:
            folds = leave_performer_out(list(self.performers))
            seeds = [(repeat, number) for repeat in range(repeats) for number in range(len(folds))]
            trials = [(folds[seed[1]], np.random.default_rng([self.random_state, *seed])) for seed in seeds]
        self.steps.total = len(trials)
        for trial in trials:
            half = self.split == "half"
            code = "trial_progress.half" if half else "trial_progress.without"
            self.steps.say(Message(code, fold=trial[0].name))
            yield trial
            self.steps.done += 1
        self.steps.finish()

    def hold_back_half(self, split: Split, generator: np.random.Generator) -> None:
        """Train on half of the categories, and judge clips of all."""
        kept = np.isin(self.labels, generator.permutation(self.names)[: (len(self.names) + 1) // 2])
        train, test = split.train[kept[split.train]], split.test
        known = kept[test] & np.isin(self.labels[test], self.labels[train])
        judged = known | ~kept[test]  # a kept category that only the one left out performs is neither
        started = time.perf_counter()
        forest = self._fit(train, generator)
        trained = time.perf_counter()
        assessor = self._calibrate(forest, train)
        ended = time.perf_counter()
        verdicts = assessor.assess(forest.apply(self.features[test]), self.features[test])
        right = forest.classes_[verdicts.guess] == self.labels[test]
        calibration = assessor.calibration
        if known.any() and not kept[test].all():
            self.held_back.append(
                _HeldBack(
                    verdicts.confidence[judged],
                    known[judged],
                    verdicts.unknown[judged],
                    (calibration.false_alarms, calibration.misses),
                    float(right[known].mean()),
                    (trained - started, ended - trained),
                )
            )

    def add_categories(self, split: Split, generator: np.random.Generator, count: int, n_clips: int) -> None:
        """Train without some categories, add them, and compare with a forest that is trained anew."""
        new = generator.permutation(self.names)[:count]
        old = split.train[~np.isin(self.labels[split.train], new)]
        added = np.concatenate(
            [generator.permutation(split.train[self.labels[split.train] == name])[:n_clips] for name in new]
        )
        if not np.isin(self.labels[split.test], new).any() or not len(added):
            return
        before = self._fit(old, generator)
        assessor = self._calibrate(before, old)
        features, labels = self.features[added], self.labels[added]
        leaves = before.apply(self.features[old])
        started = time.perf_counter()
        growth = grow_forest(
            before,
            StandingClips(self.labels[old], leaves, lambda rows: self.features[old[rows]]),
            features,
            labels,
            feature_set=self.feature_set,
        )
        calibration = assessor.calibration.with_clips(features, labels)
        grown = time.perf_counter()
        anew = self._fit(np.concatenate([old, added]), generator)
        trained = time.perf_counter()
        forests = (assessor, Assessor(growth.forest, calibration), Assessor(anew, calibration))
        seconds = (0.0, grown - started, trained - grown)
        for name, one, spent in zip(FORESTS, forests, seconds, strict=True):
            self.added.append(self._judge_new(one, name, split.test, (new, n_clips), spent))

    def _judge_new(
        self,
        assessor: Assessor,
        name: str,
        test: NDArray[np.intp],
        added: tuple[NDArray[np.str_], int],
        seconds: float,
    ) -> NewCategories:
        verdicts = assessor.assess(assessor.forest.apply(self.features[test]), self.features[test])
        right = assessor.forest.classes_[verdicts.guess] == self.labels[test]
        of_new = np.isin(self.labels[test], added[0])
        return NewCategories(
            name,
            len(added[0]),
            added[1],
            float(right.mean()),
            float(right[of_new].mean()),
            float(right[~of_new].mean()),
            float(verdicts.unknown[of_new].mean()),
            seconds,
        )

    def _fit(self, rows: NDArray[np.intp], generator: np.random.Generator) -> MotionForest:
        seed = int(generator.integers(2**31 - 1))
        forest = make_forest(self.feature_set, self.n_trees, seed, self.n_jobs)
        return fit_forest(forest, self.features, rows, self.labels[rows], self.copies, self.feature_set)

    def _calibrate(self, forest: MotionForest, rows: NDArray[np.intp]) -> Assessor:
        people = list(self.performers[rows]) if self.split != "half" else None
        calibration = learn_calibration(
            forest,
            self.features[rows],
            self.labels[rows],
            people,
            feature_set=self.feature_set,
            copies=self.copies.of(rows),
        )
        return Assessor(forest, calibration)


def _summarise_unknown(trials: list[_HeldBack]) -> UnknownMotions:
    if not trials:
        raise TrainingError("trials.nothing_to_judge")

    def mean(values: Sequence[float]) -> float:
        return float(np.mean(values))

    def errors(called: Sequence[NDArray[np.bool_]]) -> tuple[float, float]:
        """False alarms and misses of what is called unknown, averaged over the trials."""
        pairs = list(zip(trials, called, strict=True))
        alarms = [float(unknown[one.known].mean()) for one, unknown in pairs]
        return mean(alarms), mean([float(1.0 - unknown[~one.known].mean()) for one, unknown in pairs])

    areas = [compute_auroc(one.probability, one.known) for one in trials]
    alarms, misses = errors([one.called for one in trials])
    return UnknownMotions(
        auroc=mean(areas),
        auroc_std=float(np.std(areas)),
        false_alarms=alarms,
        misses=misses,
        expected_false_alarms=mean([one.expected[0] for one in trials]),
        expected_misses=mean([one.expected[1] for one in trials]),
        accuracy=mean([one.accuracy for one in trials]),
        curve=tuple((limit, *errors([one.probability < limit for one in trials])) for limit in _LIMITS),
        train_seconds=mean([one.seconds[0] for one in trials]),
        calibrate_seconds=mean([one.seconds[1] for one in trials]),
        n_trials=len(trials),
    )


def _summarise_new(rows: list[NewCategories]) -> tuple[NewCategories, ...]:
    """The mean over all trials, for each forest and number of categories."""
    means = []
    for key in dict.fromkeys((row.forest, row.n_new, row.n_clips) for row in rows):
        alike = [row for row in rows if (row.forest, row.n_new, row.n_clips) == key]
        numbers = [
            float(np.mean([getattr(row, name) for row in alike]))
            for name in ("accuracy", "recall_new", "recall_old", "called_unknown", "seconds")
        ]
        means.append(NewCategories(*key, *numbers))
    return tuple(means)
