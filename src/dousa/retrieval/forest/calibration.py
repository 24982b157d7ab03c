"""Known or unknown: how far the guess of a forest can be trusted, learned from categories that are held back.

A forest names one of its categories for any motion, also for one that belongs to none. Three things tell the two
cases apart, of which the leaves know the first two:

- the share of the trees that vote for the guessed category;
- how many clips of that category stand in the clip's leaves, in proportion to how many usually stand around one of its
  own clips (Breiman's proximity, section 10 of "Random forests", Machine Learning 45, 2001);
- how well its poses go with those of the category (``_pose_space``).

What values are usual for clips that the forest does not know is learned by rounds: each holds back a part of the
categories and the clips of some performers, trains a small forest on the rest, and looks at both. The clips of the
categories held back play the unknown, those of the performers held back the known. A logistic curve over the
scores then gives the probability, known and unknown being taken for equally likely (Platt, "Probabilistic outputs for
support vector machines", 1999, with his smoothed targets, so that no curve is certain).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import InvalidMotionError, TrainingError
from dousa.messages import Message
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.forest import tree_kernels as kernels
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.forest_file import check, damaged, pack_arrays, unpack_arrays
from dousa.retrieval.forest.pose_space import (
    ARRAYS,
    Curve,
    PoseSpace,
    compute_auroc,
    fit_curve,
    fit_pose_space,
    read_curve,
)

_ROUNDS = 8
_CATEGORY_PARTS = 4  # a round holds back a quarter, so that its forest has almost as many categories as the real one
_PERFORMER_PARTS = 3
_TREES = 50
_LEAST_USUAL = 1e-3
_SAME_HEIGHT = 0.04  # m
_THRESHOLD = 0.5  # where a held back category and another are equally likely
_WHAT = Message("stored.calibration")
Watch = Callable[[int, MotionForest, IndexArray, IndexArray, IndexArray], None]
"""Looks at a round: its number, its forest, and the clips that train it, that are known, and that are unknown."""

_CURVES = {"known": 2, "known_by_poses": 3, "right": 1}
_NUMBERS = ("threshold", "auroc", "false_alarms", "misses")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What the scores of a clip mean: whether it is known, and whether the guess is right.

    Parameters
    ----------
    known : curve over the first two scores of ``Assessor.measure``: does the clip belong to any category of the forest?
    known_by_poses : the same with the likeness of the poses as third score.
    right : curve over the lead of the guess over the second category in votes: is the guess right, if it does?
    poses : in which the likeness is measured.
    threshold : a clip of a smaller probability to be known is called unknown.
    auroc : over the rounds, how well the probability told held back categories from the others; 0.5 to 1.
    false_alarms, misses : over the rounds, the share of known clips called unknown, and of unknown ones called known.
    """

    known: Curve
    known_by_poses: Curve
    right: Curve
    poses: PoseSpace
    threshold: float
    auroc: float
    false_alarms: float
    misses: float

    def with_clips(self, features: FloatArray, categories: ArrayLike) -> Calibration:
        """The calibration of a forest that has taken up clips (M, T, F) of categories (M,), old or new."""
        return replace(self, poses=self.poses.with_clips(features, np.asarray(categories)))

    def to_json(self) -> dict[str, Any]:
        """The curves and numbers, ready for ``json.dumps``; without the poses."""
        curves = {name: asdict(getattr(self, name)) for name in _CURVES}
        return {**curves, **{name: getattr(self, name) for name in _NUMBERS}}

    def to_bytes(self) -> bytes:
        """An .npz file (no pickle); the same calibration gives the same bytes."""
        return pack_arrays({"numbers": np.array(json.dumps(self.to_json())), **self.poses.to_arrays()})

    @classmethod
    def from_bytes(cls, data: bytes) -> Calibration:
        """The calibration that ``to_bytes`` wrote; DousaError where it is anything else."""
        arrays = unpack_arrays(data, {"numbers", *ARRAYS}, _WHAT)
        try:
            written = json.loads(str(arrays["numbers"]))
            known, known_by_poses, right = (read_curve(written[name], count) for name, count in _CURVES.items())
            numbers = [float(written[name]) for name in _NUMBERS]
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise damaged(_WHAT, error) from error
        check(all(0.0 <= number <= 1.0 for number in numbers), _WHAT, "shares beyond 0 ... 1")
        return cls(known, known_by_poses, right, PoseSpace.from_arrays(arrays, _WHAT), *numbers)


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """What is thought of N clips.

    Parameters
    ----------
    guess : (N,) number of the most voted category.
    known : (N,) probability that the clip belongs to any category of the forest.
    confidence : (N,) probability that the guess is right: that the clip is known, and the guess right then.
    unknown : (N,) whether the clip is called unknown.
    """

    guess: IndexArray
    known: FloatArray
    confidence: FloatArray
    unknown: BoolArray


class Assessor:
    """A forest with its calibration, ready to judge the leaves of many clips or windows.

    Parameters
    ----------
    forest : trained, or grown since.
    calibration : of this forest, or of the one it has grown from.
    """

    def __init__(self, forest: MotionForest, calibration: Calibration) -> None:
        self.forest, self.calibration = forest, calibration
        self._scale = _Scale(forest)

    def measure(self, leaves: NDArray[np.integer[Any]]) -> tuple[IndexArray, FloatArray]:
        """The guesses and the scores of clips.

        Parameters
        ----------
        leaves : (N, n_trees) as ``apply`` gives them.

        Returns
        -------
        guess : (N,) number of the most voted category, the first of equals.
        scores : (N, 3) share of the votes for it; clips of it in the leaves in proportion to the usual, at most 2; lead
            over the second category in votes.
        """
        return self._scale.measure(leaves)

    def assess(self, leaves: NDArray[np.integer[Any]], features: FloatArray | None = None) -> Verdicts:
        """What is thought of clips.

        Parameters
        ----------
        leaves : (N, n_trees) as ``apply`` gives them.
        features : (N, T, F) of the same clips; with them, unknown ones are told better.
        """
        guess, scores = self.measure(leaves)
        calibration = self.calibration
        known = calibration.known.evaluate(scores[:, :2])
        if features is not None and len(guess):
            likeness = calibration.poses.compare(features, self.forest.classes_[guess])
            by_poses = calibration.known_by_poses.evaluate(np.column_stack([scores[:, :2], likeness]))
            known = np.where(np.isnan(likeness), known, by_poses)  # a category that came later without its poses
        right = calibration.right.evaluate(scores[:, 2:])
        return Verdicts(guess, known, known * right, known < calibration.threshold)


class _Scale:
    """How many clips of each category stand in a leaf, and how many usually do around a clip of that category."""

    def __init__(self, forest: MotionForest) -> None:
        trees = forest.trees_
        self._forest, n_trees = forest, len(trees.roots)
        counts = trees.leaf_counts.astype(np.float64)
        # Every clip stands in one leaf of each tree, so the leaves know how large the categories are, and how many
        # neighbours of its category each clip has: the sum of squares counts the pairs.
        sizes = np.bincount(trees.leaf_classes, counts, trees.n_classes) / n_trees
        pairs = np.bincount(trees.leaf_classes, counts**2, trees.n_classes) / n_trees
        usual = (pairs - sizes) / np.maximum(sizes * (sizes - 1.0), 1e-9)
        alone = sizes < 1.5
        usual[alone] = np.median(usual[~alone]) if (~alone).any() else 1.0
        weight = 1.0 / (np.maximum(sizes, 1.0) * np.maximum(usual, _LEAST_USUAL))
        self._entries = (trees.leaf_starts, trees.leaf_classes, counts * weight[trees.leaf_classes])

    def measure(self, leaves: NDArray[np.integer[Any]]) -> tuple[IndexArray, FloatArray]:
        """As ``Assessor.measure``."""
        trees = self._forest.trees_
        if leaves.ndim != 2 or leaves.shape[1] != len(trees.roots):
            raise InvalidMotionError("forest.leaves_shape", trees=len(trees.roots), shape=leaves.shape)
        wide = np.ascontiguousarray(leaves, dtype=np.int64)
        if wide.size and not (wide.min() >= 0 and wide.max() < trees.n_leaves):
            raise InvalidMotionError("forest.leaves_range", last=trees.n_leaves - 1)
        votes = self._forest.histograms_of(wide)
        near = np.zeros_like(votes)
        kernels.count_leaves(wide, *self._entries, near)
        guess, rows = votes.argmax(axis=1), np.arange(len(votes))
        first = votes[rows, guess]
        votes[rows, guess] = -1.0
        second = np.maximum(votes.max(axis=1), 0.0)
        around = np.minimum(near[rows, guess] / wide.shape[1], 2.0)
        return guess, np.stack([first, around, first - second], axis=1)


def learn_calibration(
    forest: MotionForest,
    features: FloatArray,
    categories: ArrayLike,
    performers: Sequence[str | None] | None = None,
    *,
    feature_set: FeatureSet | None = None,
    random_state: int = 0,
    watch: Watch | None = None,
) -> Calibration:
    """Learn from categories that are held back what the scores of unknown clips are.

    Parameters
    ----------
    forest : whose parameters the small forests of the rounds take; it need not be trained.
    features : (N, T, F) of the training clips.
    categories : (N,) words or whole numbers.
    performers : (N,); a clip whose performer is not known counts as a performer of its own. Without performers, clips
        of people that the forest knows stand for the known, and strangers are called unknown too often;
        ``guess_performers`` helps.
    feature_set : that of ``MotionForest.fit``.
    random_state : seed; the same seed gives the same calibration, however many workers.
    watch : called in each round with its number, its forest, and the rows that train it, that are known and unknown.

    Returns
    -------
    Calibration

    Raises
    ------
    TrainingError : fewer than 3 categories, or too few clips to hold some back.
    """
    from joblib import Parallel, delayed

    labels = np.asarray(categories)
    labels = labels.astype(np.str_) if labels.dtype == object else labels
    names = np.unique(labels)
    if len(names) < 3:
        raise TrainingError("calibration.categories", count=len(names))
    people = [None] * len(labels) if performers is None else performers
    judge = _Judge(forest.get_params(), features, labels, feature_set, watch)
    rounds = list(_draw_rounds(labels, people, random_state))
    # The forests side by side, each by one worker, as small ones are not worth dividing; the poses one after the other,
    # as the linear algebra has workers of its own.
    asked = Parallel(n_jobs=forest.n_jobs, prefer="threads")(
        delayed(judge.ask_forest)(number, *parts) for number, parts in enumerate(rounds)
    )
    seen = [judge.compare_poses(*parts, *said) for parts, said in zip(rounds, asked, strict=True)]
    if not seen:
        raise TrainingError("calibration.clips")
    return _summarise(seen, fit_pose_space(features, labels, feature_set))


def guess_performers(heights: ArrayLike) -> tuple[str, ...]:
    """Who may have performed clips of which only the body height is known: people of one height count as one.

    Parameters
    ----------
    heights : (N,) m.

    Returns
    -------
    (N,) a word for each; of use only to part strangers in ``learn_calibration``.
    """
    return tuple(f"{_SAME_HEIGHT * round(float(height) / _SAME_HEIGHT):.2f} m" for height in np.asarray(heights))


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """Clips held back: scores (M, 4), poses last; which are of known categories; which guesses are right."""

    scores: FloatArray
    known: BoolArray
    right: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Judge:
    """Holds rounds: parameters of the forests, the clips' features and categories, and what the columns are."""

    parameters: dict[str, Any]
    features: FloatArray
    labels: NDArray[Any]
    feature_set: FeatureSet | None
    watch: Watch | None = None

    def ask_forest(
        self, number: int, train: IndexArray, known: IndexArray, unknown: IndexArray
    ) -> tuple[NDArray[Any], FloatArray]:
        """Train on some clips, and guess the categories of others, with the scores."""
        trees = min(_TREES, self.parameters["n_trees"])
        small = MotionForest(**{**self.parameters, "n_trees": trees, "random_state": number, "n_jobs": 1})
        small.fit(self.features[train], self.labels[train], feature_set=self.feature_set)
        leaves = small.apply(self.features[np.concatenate([known, unknown])])
        if self.watch is not None:
            self.watch(number, small, train, known, unknown)
        guess, scores = _Scale(small).measure(leaves)
        return small.classes_[guess], scores

    def compare_poses(
        self,
        train: IndexArray,
        known: IndexArray,
        unknown: IndexArray,
        guess: NDArray[Any],
        scores: FloatArray,
    ) -> _Round:
        """Add the likeness to the scores."""
        looked = np.concatenate([known, unknown])
        space = fit_pose_space(self.features[train], self.labels[train], self.feature_set)
        scores = np.column_stack([scores, space.compare(self.features[looked], guess)])
        return _Round(scores, np.arange(len(looked)) < len(known), guess == self.labels[looked])


def _summarise(rounds: list[_Round], poses: PoseSpace) -> Calibration:
    scores, known, right = (
        np.concatenate([getattr(one, name) for one in rounds]) for name in ("scores", "known", "right")
    )
    curve = fit_curve(scores[:, [0, 1, 3]], known)
    probability = curve.evaluate(scores[:, [0, 1, 3]])
    called = probability >= _THRESHOLD
    return Calibration(
        known=fit_curve(scores[:, :2], known),
        known_by_poses=curve,
        right=fit_curve(scores[known, 2:3], right[known], balanced=False),
        poses=poses,
        threshold=_THRESHOLD,
        auroc=compute_auroc(probability, known),
        false_alarms=float(1.0 - called[known].mean()),
        misses=float(called[~known].mean()),
    )


def _draw_rounds(
    labels: NDArray[Any], performers: Sequence[str | None], random_state: int
) -> Iterator[tuple[IndexArray, IndexArray, IndexArray]]:
    """Clips that train, that are known, and that are unknown, for each round that can be held."""
    generator = np.random.default_rng(random_state)
    names, own = np.unique(labels, return_inverse=True)
    parts = _part_performers(own, performers, generator)
    n_groups = min(_CATEGORY_PARTS, len(names))
    for number in range(_ROUNDS):
        if number % n_groups == 0:
            group = generator.permutation(np.arange(len(names)) % n_groups)
        held = group[own] == number % n_groups
        stranger = parts == number % (parts.max() + 1)
        train = np.flatnonzero(~held & ~stranger)
        known = np.flatnonzero(~held & stranger & np.isin(own, own[train]))
        if len(known) and len(np.unique(own[train])) > 1:
            yield train, known, np.flatnonzero(held)


def _part_performers(own: IndexArray, performers: Sequence[str | None], generator: np.random.Generator) -> IndexArray:
    """(N,) the part of each clip: performers, and clips without one, dealt out evenly."""
    people = sorted({name for name in performers if name})
    count = len(people) if 1 < len(people) < _PERFORMER_PARTS else _PERFORMER_PARTS
    dealt = dict(zip(generator.permutation(people), np.arange(len(people)) % count, strict=True))
    drawn = generator.random(len(own))
    parts = np.zeros(len(own), np.intp)
    # One performer alone cannot be left out, so his or her clips are dealt out one by one.
    single = np.array([len(people) < 2 or not name for name in performers], bool)
    order = np.lexsort((drawn, own))
    alone = order[single[order]]
    parts[alone] = np.arange(len(alone)) % count
    parts[~single] = [dealt[name] for name in performers if len(people) > 1 and name]
    return parts
