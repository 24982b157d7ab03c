"""The motion forest: 100 trees that test mean pose features over intervals and vote.

Source: Hamada, Kuriyama, Mukai, "Human motion retrieval using random forest", sections 3.2-3.4. Step 3 of the paper
maximises "the entropy", read here as the information gain of eq. 7; it describes no bootstrap, so that is off by
default; it gives no number of tests tried at a node: the square root of M is used, 55 of 3,080, as for the features of
classifiers by Breiman ("Random forests", Machine Learning 45, 2001) and scikit-learn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError, NotTrainedError, OptionError, TrainingError
from dousa.retrieval.features.feature_sets import FeatureSet, FeatureTrack, list_tests
from dousa.retrieval.features.pose_features import FEATURE_NAMES
from dousa.retrieval.forest import tree_kernels as kernels
from dousa.retrieval.forest.forest_file import ForestFile, pack_forest, unpack_forest
from dousa.retrieval.forest.trees import Trees, TreesSpec, grow_trees, measure_columns, order_for_trees


def is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_whole(name: str, value: object, least: int, otherwise: str = "") -> None:
    if not is_whole(value) or value < least:  # type: ignore[operator]
        raise OptionError("forest.whole_number", name=name, otherwise=otherwise, least=least, value=repr(value))


def count_trials(n_trials: int | str | None, n_tests: int) -> int:
    if n_trials is None or isinstance(n_trials, str):
        return n_tests if n_trials == "all" else int(np.sqrt(n_tests))
    return min(int(n_trials), n_tests)


def check_features(features: ArrayLike, shape: tuple[int, int] | None = None, *, for_trees: bool = False) -> FloatArray:
    """Return (N, T, F) features, float32 if given as such, else float64; C-ordered or as ``order_for_trees``.

    Values may be infinite or NaN. Raises InvalidMotionError for non-numbers or another shape.
    """
    try:
        given = np.asarray(features)
        kind: Any = np.float32 if given.dtype == np.float32 else np.float64
        pose: FloatArray = given.astype(kind, copy=False) if for_trees else np.ascontiguousarray(given, dtype=kind)
    except (TypeError, ValueError) as error:
        raise InvalidMotionError("forest.numbers", reason=error) from error
    if pose.ndim != 3 or 0 in pose.shape[1:] or (shape is not None and pose.shape[1:] != shape):
        wanted = "(clips, frames, features)" if shape is None else f"(clips, {shape[0]}, {shape[1]})"
        raise InvalidMotionError("forest.shape", wanted=wanted, shape=pose.shape)
    return order_for_trees(pose) if for_trees else pose


def _measure_finite(pose: FloatArray, most: float = 1e100) -> FloatArray:
    """Return (F,) of ``measure_columns``; InvalidMotionError for features (N, T, F) not finite or above ``most``, whose
    sums and differences could overflow.
    """
    largest = measure_columns(pose)
    if not np.isfinite(largest).all():
        bad = next(number for number, clip in enumerate(pose) if not np.isfinite(clip).all())
        raise InvalidMotionError("forest.not_finite", clip=bad)
    if largest.max() > most:
        raise InvalidMotionError("forest.too_large", largest=most)
    return largest


def number_categories(categories: ArrayLike, n_clips: int) -> tuple[NDArray[Any], NDArray[np.int32]]:
    """Return the sorted distinct categories and each clip's index among them."""
    labels = np.asarray(categories)
    if labels.dtype == object and all(isinstance(label, str) for label in labels.flat):
        labels = labels.astype(np.str_)
    if labels.dtype.kind not in "Uiub":
        raise TrainingError("forest.labels_kind", kind=labels.dtype, shape=labels.shape)
    if labels.shape != (n_clips,):
        raise TrainingError("forest.labels_count", clips=n_clips, shape=labels.shape)
    classes, numbers = np.unique(labels, return_inverse=True)
    return classes, numbers.astype(np.int32)


def _check_copied(copied: ArrayLike | None, n_clips: int) -> IntArray:
    """Return (K,) the clips that the last K clips are copies of."""
    if copied is None:
        return np.zeros(0, np.int64)
    rows = np.asarray(copied, dtype=np.int64)
    last = n_clips - len(rows) - 1
    if rows.ndim != 1 or len(np.unique(rows)) < len(rows) or (len(rows) and not 0 <= rows.min() <= rows.max() <= last):
        raise TrainingError("forest.copied", last=last)
    return rows


def check_names(names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if names is None:
        is_ours = count == len(FEATURE_NAMES)
        return FEATURE_NAMES if is_ours else tuple(f"feature {number}" for number in range(count))
    if isinstance(names, str) or len(names) != count:
        raise OptionError("forest.names_count", count=count, found=len(names))
    return tuple(str(name) for name in names)


Histogram = Literal["votes", "leaves"]

_PARAMETERS = ("n_trees", "n_trials", "max_entropy", "bootstrap", "thresholds", "random_state", "n_jobs")


class MotionForest:
    """A random forest over mean pose features of intervals (steps 1-8 of the paper).

    Parameters
    ----------
    n_trees : trees, at least 1.
    n_trials : tests drawn at each node without replacement; None or ``"sqrt"`` for the square root of their number,
        ``"all"`` for every test.
    max_entropy : bits; a node of at most this entropy becomes a leaf.
    bootstrap : draw each tree's clips with replacement (the paper does not).
    thresholds : ``"best"``, the threshold of largest gain of each test (step 3 of the paper); ``"random"``, one drawn
        between the lowest and highest value (Geurts, Ernst, Wehenkel, "Extremely randomized trees", Machine Learning
        63, 2006). The best test is kept.
    random_state : seed; None for a new one each time. One seed gives one forest for any number of workers.
    n_jobs : workers as in joblib; None is one, unless a joblib backend is set; -1 is all.

    Raises OptionError: a value outside its range.

    >>> walk, squat = np.zeros((2, 4, 10, 56)) + [[[[0.0]]], [[[1.0]]]]
    >>> forest = dousa.MotionForest(n_trees=5, random_state=0)
    >>> forest = forest.fit([*walk, *squat], ["walk"] * 4 + ["squat"] * 4)
    >>> forest.predict(squat[:1])
    array(['squat'], dtype='<U5')
    """

    def __init__(
        self,
        n_trees: int = 100,
        *,
        n_trials: int | Literal["all", "sqrt"] | None = None,
        max_entropy: float = 0.0,
        bootstrap: bool = False,
        thresholds: Literal["best", "random"] = "best",
        random_state: int | None = None,
        n_jobs: int | None = None,
    ) -> None:
        self.n_trees = n_trees
        self.n_trials = n_trials
        self.max_entropy = max_entropy
        self.bootstrap = bootstrap
        self.thresholds = thresholds
        self.random_state = random_state
        self.n_jobs = n_jobs
        self._trees: Trees | None = None
        self._check_options()

    def __repr__(self) -> str:
        return f"MotionForest({', '.join(f'{key}={value!r}' for key, value in self.get_params().items())})"

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's parameters, as scikit-learn requires (``deep`` changes nothing)."""
        return {name: getattr(self, name) for name in _PARAMETERS}

    def __sklearn_tags__(self) -> Any:
        """What scikit-learn, which alone calls this, should know: a classifier of clips (N, T, F)."""
        from sklearn.utils import ClassifierTags, InputTags, Tags, TargetTags

        return Tags(
            estimator_type="classifier",
            target_tags=TargetTags(required=True),
            classifier_tags=ClassifierTags(),
            input_tags=InputTags(two_d_array=False, three_d_array=True),
        )

    def __sklearn_is_fitted__(self) -> bool:
        return self._trees is not None

    def set_params(self, **params: Any) -> MotionForest:
        """Set parameters for the next ``fit``; OptionError for an unknown name or a value out of range."""
        for name, value in params.items():
            if name not in _PARAMETERS:
                raise OptionError("forest.parameter", name=name, known=tuple(_PARAMETERS))
            setattr(self, name, value)
        self._check_options()
        return self

    def fit(
        self,
        features: ArrayLike,
        categories: ArrayLike,
        feature_names: Sequence[str] | None = None,
        *,
        feature_set: FeatureSet | None = None,
        copied: ArrayLike | None = None,
    ) -> MotionForest:
        """Grow the trees.

        Parameters
        ----------
        features : (N, T, F) pose features of the training clips, thinned to T frames; (N + K, T, F) with copies.
        categories : (N,) words or whole numbers; with a single category, that is always predicted.
        feature_names : (F,) for explanations; those of ``FEATURES`` where F is 56.
        feature_set : defines the columns and the tests; without one, their means are tested.
        copied : (K,) distinct clips of which the last K are noisy copies. Each tree learns a clip or its copy, half of
            the clips by copies, or fewer where there are not as many, so that the forest does not rely on what noise
            changes.

        Raises
        ------
        TrainingError : no clips, or categories that are not one word or whole number a clip.
        InvalidMotionError : features of another shape, or not finite.
        OptionError : a parameter or ``feature_names`` out of range.
        """
        self._check_options()
        shape = None if feature_set is None else (feature_set.n_frames, feature_set.n_columns)
        pose = check_features(features, shape, for_trees=True)
        largest = _measure_finite(pose)
        twins = _check_copied(copied, len(pose))
        if len(pose) == len(twins):
            raise TrainingError("forest.no_clips")
        classes, numbers = number_categories(categories, len(pose) - len(twins))
        numbers = np.append(numbers, numbers[twins])
        if feature_set is None:
            names = check_names(feature_names, pose.shape[2])
            tests = list_tests(pose.shape[2], pose.shape[1])
        else:
            names, tests = feature_set.column_names, feature_set.tests
        drawn = np.random.SeedSequence(self.random_state).generate_state(self.n_trees, np.uint64)
        seeds = drawn.astype(np.uint64)
        trees = grow_trees(pose, numbers, len(classes), tests, self.make_spec(len(tests)), seeds, twins, largest)
        self._take(trees, classes, names)
        return self

    def make_spec(self, n_tests: int) -> TreesSpec:
        """Return how trees are grown with the forest's parameters and ``n_tests`` tests."""
        return TreesSpec(
            n_trials=count_trials(self.n_trials, n_tests),
            max_entropy=float(self.max_entropy),
            bootstrap=bool(self.bootstrap),
            random_thresholds=self.thresholds == "random",
            n_jobs=self.n_jobs,
        )

    def predict(self, features: ArrayLike, histogram: Histogram = "votes") -> NDArray[Any]:
        """Return (N,) the category of largest share in ``predict_proba``, the first of equals."""
        named: NDArray[Any] = self.classes_[self.predict_proba(features, histogram).argmax(axis=1)]
        return named

    def score(self, features: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> float:
        """Return the share of clips (N, T, F) whose predicted category is ``y`` (N,); weighted by (N,) if given."""
        weights = None if sample_weight is None else np.asarray(sample_weight, np.float64)
        return float(np.average(self.predict(features) == np.asarray(y), weights=weights))

    def predict_proba(self, features: ArrayLike, histogram: Histogram = "votes") -> FloatArray:
        """Compute the histograms H of section 3.4.

        Parameters
        ----------
        features : (N, T, F) as in ``fit``.
        histogram : ``"votes"``, each tree votes for its leaf's most frequent category (the first of equals), or by
            shares if ``Trees.pooled``; ``"leaves"``, the mean of the leaves' histograms.

        Returns (N, C) shares in the order of ``classes_``; rows sum to 1, or less where a leaf of a grown forest is
        empty. Raises NotTrainedError, InvalidMotionError or OptionError.
        """
        self._entries(histogram)  # fails on a wrong word before the work
        return self.histograms_of(self.apply(features), histogram)

    def histograms_of(self, leaves: IntArray, histogram: Histogram = "votes") -> FloatArray:
        """Compute ``predict_proba`` from leaves (N, n_trees) of ``apply``, without going down the trees again.

        Raises NotTrainedError or OptionError.
        """
        entries = self._entries(histogram)
        shares = np.zeros((len(leaves), self._fitted.n_classes))
        kernels.count_leaves(leaves, *entries, shares)
        shares /= leaves.shape[1]
        return shares

    def count_votes(self, clip: FloatArray) -> FloatArray:
        """Count the trees that vote for each category (C,), for one clip (T, F) float64, by the shortest way."""
        trees = self._fitted
        if clip.shape != (trees.n_frames, trees.n_features) or clip.dtype != np.float64:
            wanted = trees.n_frames, trees.n_features
            raise InvalidMotionError("forest.clip_shape", wanted=wanted, kind=clip.dtype, shape=clip.shape)
        votes = np.zeros((1, trees.n_classes))
        kernels.count_leaves(trees.find_leaves(clip[None]), *self._votes, votes)
        counts: FloatArray = votes[0]
        return counts

    def apply(self, features: ArrayLike) -> IntArray:
        """Return (N, n_trees) the leaf that each clip reaches in each tree, numbered through all trees from 0."""
        trees = self._fitted
        return trees.find_leaves(check_features(features, (trees.n_frames, trees.n_features)))

    def apply_windows(self, track: FeatureTrack, starts: ArrayLike, stops: ArrayLike) -> IntArray:
        """Return (N, n_trees) the leaf that each window of a recording reaches in each tree, as ``apply``.

        Parameters
        ----------
        track : of the feature set that the forest was fitted with.
        starts, stops : (N,) frames of the track.

        Raises InvalidMotionError: a window outside the recording, or a track of other features.
        """
        trees = self._fitted
        if (track.feature_set.n_frames, track.feature_set.n_columns) != (trees.n_frames, trees.n_features):
            raise InvalidMotionError(
                "forest.track", columns=trees.n_features, cells=trees.n_frames, name=track.feature_set.name
            )
        first, last = np.atleast_1d(starts), np.atleast_1d(stops)
        leaves = np.empty((len(first), len(trees.roots)), np.int64)
        edges, count = track.find_edges(first, last), len(track.feature_set.channels)
        rows, work = np.empty((2, track.integrals.shape[1])), np.empty((2, len(trees.roots)), np.int64)
        kernels.find_window_leaves(
            track.integrals, track.times, edges, track.frame_rate, count, trees.nodes, trees.cuts, trees.roots,
            trees.only_means, rows, np.zeros(trees.n_features * (trees.n_frames + 1)), work, leaves,
        )  # fmt: skip
        return leaves

    @property
    def classes_(self) -> NDArray[Any]:
        """Return (C,) the sorted categories of the training."""
        self._fitted  # noqa: B018  (raises before the training)
        return self._classes

    @property
    def feature_names_(self) -> tuple[str, ...]:
        """Return (F,) names of the pose features."""
        self._fitted  # noqa: B018
        return self._feature_names

    @property
    def trees_(self) -> Trees:
        """Return the grown trees in flat arrays."""
        return self._fitted

    @property
    def vote_entries(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return the votes of the leaves: (L + 1,) starts of their entries, (E,) categories and weights."""
        return self._entries("votes")

    def to_bytes(self) -> bytes:
        """Pack the trained forest as an .npz file (no pickle); NotTrainedError before ``fit``."""
        return pack_forest(ForestFile(self.get_params(), self.trees_, self.classes_, self.feature_names_))

    @classmethod
    def from_bytes(cls, data: bytes) -> MotionForest:
        """Read a forest that ``to_bytes`` wrote; DousaError if damaged, something else, or from a newer dousa."""
        file = unpack_forest(data)
        forest = cls().set_params(**file.parameters)
        forest._take(file.trees, file.classes, file.feature_names)
        return forest

    def with_trees(self, trees: Trees, classes: NDArray[Any]) -> MotionForest:
        """Return a forest of the same parameters and features with other trees; ``classes`` (C,) are sorted."""
        forest = MotionForest().set_params(**self.get_params())
        forest._take(trees, classes, self.feature_names_)
        return forest

    @property
    def _fitted(self) -> Trees:
        if self._trees is None:
            raise NotTrainedError("forest.not_fitted")
        return self._trees

    def _take(self, trees: Trees, classes: NDArray[Any], feature_names: tuple[str, ...]) -> None:
        self._trees, self._classes, self._feature_names = trees, classes, feature_names
        ones = np.arange(trees.n_leaves + 1)
        self._votes = (ones, trees.leaf_categories(), trees.leaf_votes())
        self._shares = (trees.leaf_starts, trees.leaf_classes, trees.leaf_shares())
        if trees.pooled:
            self._votes = self._shares

    def _entries(self, histogram: str) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        self._fitted  # noqa: B018
        if histogram not in ("votes", "leaves"):
            raise OptionError("forest.histogram", found=repr(histogram))
        return self._votes if histogram == "votes" else self._shares

    def _check_options(self) -> None:
        check_whole("n_trees", self.n_trees, 1)
        if self.n_trials is not None and not (isinstance(self.n_trials, str) and self.n_trials in ("sqrt", "all")):
            check_whole("n_trials", self.n_trials, 1, "None, 'sqrt', 'all' or ")
        if self.random_state is not None:
            check_whole("random_state", self.random_state, 0, "None or ")
        if self.n_jobs is not None and (not is_whole(self.n_jobs) or self.n_jobs == 0):
            raise OptionError("forest.n_jobs", found=repr(self.n_jobs))
        if self.thresholds not in ("best", "random"):
            raise OptionError("forest.thresholds", found=repr(self.thresholds))
        if not isinstance(self.bootstrap, bool | np.bool_):
            raise OptionError("forest.bootstrap", found=repr(self.bootstrap))
        entropy = self.max_entropy
        if not isinstance(entropy, int | float | np.number) or not 0 <= entropy < np.inf:
            raise OptionError("forest.max_entropy", found=repr(entropy))
