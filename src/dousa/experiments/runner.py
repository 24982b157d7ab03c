"""How every trial is run: options and clips checked, clips divided, steps counted."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import OptionError, TrainingError
from dousa.messages import Message, Progress

if TYPE_CHECKING:
    from dousa.retrieval.features.feature_sets import FeatureSet
    from dousa.retrieval.features.posed_motion import LabelledClip
    from dousa.retrieval.forest.calibration import Copies
    from dousa.retrieval.forest.forest import MotionForest
    from dousa.retrieval.forest.stretches import StretchJudge


class Steps:
    """Counts the steps of a trial for the progress callback."""

    def __init__(self, progress: Progress | None, total: int = 0) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def say(self, doing: Message) -> None:
        """Tell what comes next."""
        if self.progress is not None:
            self.progress(self.done, self.total, doing)

    def finish(self) -> None:
        """Tell that all is done."""
        self.done = self.total
        self.say(Message("trial_progress.done"))


def check_at_least(**numbers: tuple[float, float]) -> None:
    """OptionError where a number is below its least: name=(number, least)."""
    for name, (found, least) in numbers.items():
        if not found >= least:
            raise OptionError("trials.at_least", name=name, least=least, found=found)


def check_choice(name: str, found: str, known: Collection[str]) -> None:
    """OptionError where a word is none of those known."""
    if found not in known:
        raise OptionError("trials.choice", name=name, known=tuple(known), found=found)


def check_some(name: str, found: Sequence[str], known: Collection[str]) -> None:
    """OptionError where there is no word, or one that is not known."""
    unknown = [word for word in found if word not in known]
    if unknown or not found:
        code = "trials.some" if unknown else "trials.some_none"
        raise OptionError(code, name=name, known=tuple(known), found=unknown)


def choose_split(split: str | None, test_given: bool) -> str:
    """How clips are divided, by default in halves: of `SPLITS`, or ``"given"``.

    Raises
    ------
    OptionError : a way that is not known, or there is nothing to divide.
    """
    if split is not None:
        check_choice("split", split, SPLITS)
        if test_given:
            raise OptionError("trials.split_and_test")
    return "given" if test_given else split or SPLITS[0]


def check_categories(clips: Sequence[LabelledClip]) -> None:
    """TrainingError for a clip without category."""
    for clip in clips:
        if not clip.category:
            raise TrainingError("trials.no_category", name=clip.name)


# Who trains and who is tested

SPLITS: tuple[str, ...] = ("half", "leave-performer-out")


@dataclass(frozen=True, slots=True)
class Split:
    """Indices of the training and of the test clips.

    Parameters
    ----------
    train, test : sorted, without common members.
    name : the performer left out, ``"half"`` or ``"given"``.
    """

    train: NDArray[np.intp]
    test: NDArray[np.intp]
    name: str = "given"


def split_half(
    categories: Sequence[str],
    random_state: int | np.random.Generator | None = None,
    train_share: float = 0.5,
) -> Split:
    """Draw half of the clips of every category, or another share, for training.

    Parameters
    ----------
    categories : (N,) label of every clip.
    random_state : seed, or a generator to draw from.
    train_share : of the clips of each category, above 0 and below 1.

    Returns
    -------
    Split. What is no whole number of clips is rounded up; so a category with one clip trains only.

    Raises
    ------
    TrainingError : no clips, or so few in every category that nothing is left to test.
    OptionError : a share out of range.

    Source: Hamada, Kuriyama, Mukai, section 4.1.
    """
    if not 0.0 < train_share < 1.0:
        raise OptionError("trials.train_share", found=train_share)
    labels = np.asarray(categories, dtype=object)
    if not len(labels):
        raise TrainingError("trials.no_clips")
    generator = np.random.default_rng(random_state)
    train: list[int] = []
    for category in sorted(set(labels)):
        members = np.flatnonzero(labels == category)
        count = math.ceil(len(members) * train_share - 1e-9)
        train.extend(generator.permutation(members)[:count])
    chosen = np.zeros(len(labels), bool)
    chosen[train] = True
    if chosen.all():
        raise TrainingError("trials.none_left")
    return Split(np.flatnonzero(chosen), np.flatnonzero(~chosen), "half")


def leave_performer_out(performers: Sequence[str | None]) -> tuple[Split, ...]:
    """One split per performer, whose clips test what the others' clips train.

    Parameters
    ----------
    performers : (N,) performer of every clip.

    Returns
    -------
    Splits named after the performers, in alphabetical order.

    Raises
    ------
    TrainingError : no clips, a clip without a performer, or one performer only.
    """
    if not len(performers):
        raise TrainingError("trials.no_clips")
    unknown = [index for index, performer in enumerate(performers) if not performer]
    if unknown:
        raise TrainingError("trials.no_performer", unknown=len(unknown), clips=len(performers), first=unknown[0])
    names = np.asarray(performers, dtype=object)
    everyone = sorted(set(names))
    if len(everyone) < 2:
        raise TrainingError("trials.one_performer", clips=len(names), performer=everyone[0])
    return tuple(Split(np.flatnonzero(names != one), np.flatnonzero(names == one), one) for one in everyone)


def make_folds(
    clips: Sequence[LabelledClip], n_given: int, split: str, seeds: Sequence[int], train_share: float = 0.5
) -> tuple[Split, ...]:
    """The folds of one repeat.

    Parameters
    ----------
    clips : all of them; with ``"given"`` the first ``n_given`` train and the others are tested.
    split : of `SPLITS`, or ``"given"``.
    seeds : of what is drawn.
    train_share : with ``"half"``.

    Raises
    ------
    TrainingError : a fold with one category to train on, or with nothing to test; and as `split_half` and
        `leave_performer_out`.
    """
    if split == "given":
        folds: tuple[Split, ...] = (Split(np.arange(n_given), np.arange(n_given, len(clips))),)
    elif split == "leave-performer-out":
        folds = leave_performer_out([clip.performer for clip in clips])
    else:
        folds = (split_half([clip.category for clip in clips], np.random.default_rng(seeds), train_share),)
    for fold in folds:
        found = tuple(sorted({clips[k].category for k in fold.train}))
        if len(found) < 2:
            raise TrainingError("trials.one_category", fold=fold.name, found=found)
        if not len(fold.test):
            raise TrainingError("trials.no_test")
    return folds


def make_forest(features: FeatureSet, n_trees: int, random_state: int, n_jobs: int | None) -> MotionForest:
    """A forest to be trained on these features."""
    from dousa.retrieval.forest.forest import MotionForest

    return MotionForest(n_trees, thresholds=features.thresholds, random_state=random_state, n_jobs=n_jobs)


def describe_copies(clips: Sequence[LabelledClip], features: FeatureSet, random_state: int = 0) -> Copies:
    """A disturbed copy of each clip, for forests to learn from as those of ``dousa train`` do.

    None of no clips, and none for features without banks: the paper knows no copies.
    """
    from dousa.retrieval.forest.calibration import Copies
    from dousa.retrieval.takes.made_takes import disturb_motion

    some = clips if features.has_banks else ()
    described = [
        features.compute(disturb_motion(clip, np.random.default_rng([random_state, number])))
        for number, clip in enumerate(some)
    ]
    blank = np.empty((0, features.n_frames, features.n_columns))
    return Copies(np.arange(len(some)), np.stack(described) if described else blank)


def fit_forest(
    forest: MotionForest,
    features: FloatArray,
    rows: NDArray[np.intp],
    labels: NDArray[np.str_],
    copies: Copies,
    feature_set: FeatureSet,
) -> MotionForest:
    """Train a forest on some of the clips, and on their copies.

    Parameters
    ----------
    features : (N, T, F) of all clips.
    rows, labels : (M,) those that train it, and their categories.
    copies : of ``describe_copies``, of all clips.
    """
    joined, copied = copies.join(features, rows, rows)
    return forest.fit(joined, labels, feature_set=feature_set, copied=copied)


def learn_judge(
    forest: MotionForest,
    features: FloatArray,
    rows: NDArray[np.intp],
    clips: Sequence[LabelledClip],
    copies: Copies,
    feature_set: FeatureSet,
) -> StretchJudge | None:
    """Who judges stretches of takes as clips, as in ``dousa label``; None where there is too little to learn it from.

    Parameters
    ----------
    forest : trained on some clips, by ``fit_forest``.
    features : (N, T, F) of all clips.
    rows, clips : (M,) those that trained it.
    copies : of ``describe_copies``, of all clips.
    """
    from dousa.retrieval.forest.calibration import Assessor, guess_performers, learn_calibration
    from dousa.retrieval.forest.stretches import StretchJudge

    guesses = guess_performers([clip.height for clip in clips])
    people = [clip.performer or guess for clip, guess in zip(clips, guesses, strict=True)]
    labels = np.array([clip.category for clip in clips], dtype=np.str_)
    try:
        calibration = learn_calibration(
            forest, features[rows], labels, people, feature_set=feature_set, copies=copies.of(rows)
        )
    except TrainingError:
        return None
    return StretchJudge(Assessor(forest, calibration), feature_set)
