"""The motion forest: 100 trees that ask for mean pose features over intervals, and vote.

Source: Hamada, Kuriyama, Mukai, "Human motion retrieval using random forest", sections 3.2-3.4.

Where the text slips or is silent: step 3 says that the threshold maximises the entropy, which must mean the
information gain of eq. 7; nothing is said of a bootstrap, so there is none unless asked for; the number of
tests tried at a node is not given: Breiman's int(log2 M) + 1 ("Random forests", Machine Learning 45, 2001) is
taken, 12 of 3,080, which recognised as much as the square root (55) or more, and is faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, NotTrainedError, OptionError, TrainingError
from dousa.retrieval import _descent_kernels as kernels
from dousa.retrieval._decision import Decision
from dousa.retrieval._forest_checks import (
    check_features,
    check_names,
    check_whole,
    count_trials,
    is_whole,
    number_categories,
)
from dousa.retrieval._track_kernels import find_window_leaves
from dousa.retrieval._trees import KIND_NAMES, Trees, TreesSpec, evaluate_test, grow_trees, read_test
from dousa.retrieval.integral import integrate, list_tests

if TYPE_CHECKING:
    from dousa.retrieval.feature_sets import FeatureSet
    from dousa.retrieval.tracks import FeatureTrack

__all__ = ["Decision", "MotionForest"]

FloatArray = NDArray[np.float64]
Histogram = Literal["votes", "leaves"]

_PARAMETERS = ("n_trees", "n_trials", "max_entropy", "bootstrap", "thresholds", "random_state", "n_jobs")
_TRIALS = ("sqrt", "all")
_THRESHOLDS = ("best", "random")
_LARGEST_VALUE = 1e100  # sums and differences of larger ones could overflow


class MotionForest:
    """A random forest over mean pose features of intervals (steps 1-8 of the paper).

    Parameters
    ----------
    n_trees : trees, at least 1.
    n_trials : tests drawn at each node without replacement; None for int(log2(number of tests)) + 1, ``"sqrt"``
        for the square root, ``"all"`` for every test: then nothing is random and one tree says it all.
    max_entropy : bits; a node of at most this entropy becomes a leaf.
    bootstrap : draw each tree's clips with replacement (the paper does not).
    thresholds : ``"best"``, the threshold of largest gain of each drawn test (step 3 of the paper); ``"random"``, one
        threshold drawn between the lowest and the highest value, of which only the best test is kept: extremely
        randomised trees (Geurts, Ernst, Wehenkel, Machine Learning 63, 2006).
    random_state : seed; None for a new one each time. One seed gives one forest, however many workers.
    n_jobs : workers as in joblib; None is one, unless a joblib backend is set; -1 is all.

    Raises
    ------
    OptionError : a value outside its range.
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
        """The parameters of the constructor, as scikit-learn wants them (``deep`` changes nothing)."""
        return {name: getattr(self, name) for name in _PARAMETERS}

    def set_params(self, **params: Any) -> MotionForest:
        """Change parameters for the next ``fit``; OptionError for an unknown name or a value out of range."""
        for name, value in params.items():
            if name not in _PARAMETERS:
                raise OptionError(f"no parameter '{name}'; there are: {', '.join(_PARAMETERS)}")
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
    ) -> MotionForest:
        """Grow the trees.

        Parameters
        ----------
        features : (N, T, F) pose features of the training clips, thinned to T frames.
        categories : (N,) words or whole numbers; a single category is allowed and is then always the answer.
        feature_names : (F,) for ``decisions``; those of ``FEATURES`` where F is 56.
        feature_set : what the columns are and what may be asked of them; without one, their means.

        Raises
        ------
        TrainingError : no clips, or categories that are not one word or whole number a clip.
        InvalidMotionError : features of another shape, or not finite.
        OptionError : a parameter or ``feature_names`` out of range.
        """
        self._check_options()
        shape = None if feature_set is None else (feature_set.n_frames, feature_set.n_columns)
        pose = check_features(features, shape, finite=True)
        if not len(pose):
            raise TrainingError("expected clips to train with, got none")
        if np.abs(pose).max() > _LARGEST_VALUE:
            raise InvalidMotionError(f"expected pose features below {_LARGEST_VALUE:g}")
        classes, numbers = number_categories(categories, len(pose))
        if feature_set is None:
            names, tests = (
                check_names(feature_names, pose.shape[2]),
                list_tests(pose.shape[2], pose.shape[1]),
            )
        else:
            names, tests = feature_set.column_names, feature_set.tests
        seeds = (
            np.random.SeedSequence(self.random_state)
            .generate_state(self.n_trees, np.uint64)
            .astype(np.uint64)
        )
        trees = grow_trees(pose, numbers, len(classes), tests, self.make_spec(len(tests)), seeds)
        self._take(trees, classes, names)
        return self

    def make_spec(self, n_tests: int) -> TreesSpec:
        """How trees are grown with the forest's parameters, of so many tests."""
        return TreesSpec(
            n_trials=count_trials(self.n_trials, n_tests),
            max_entropy=float(self.max_entropy),
            bootstrap=bool(self.bootstrap),
            random_thresholds=self.thresholds == "random",
            n_jobs=self.n_jobs,
        )

    def predict(self, features: ArrayLike, histogram: Histogram = "votes") -> NDArray[Any]:
        """The category of largest share in ``predict_proba``, the first of equals: (N,)."""
        named: NDArray[Any] = self.classes_[self.predict_proba(features, histogram).argmax(axis=1)]
        return named

    def predict_proba(self, features: ArrayLike, histogram: Histogram = "votes") -> FloatArray:
        """How the trees see clips: the histograms H of section 3.4.

        Parameters
        ----------
        features : (N, T, F) as in ``fit``.
        histogram : ``"votes"``, each tree names its leaf's most frequent category (the first of equals); or
            ``"leaves"``, the mean of the leaves' histograms.

        Returns
        -------
        (N, C) shares in the order of ``classes_``; rows sum to 1.

        Raises
        ------
        NotTrainedError, InvalidMotionError, OptionError
        """
        self._entries(histogram)  # a wrong word is told before the work
        return self.histograms_of(self.apply(features), histogram)

    def histograms_of(self, leaves: NDArray[np.int64], histogram: Histogram = "votes") -> FloatArray:
        """The histograms of clips whose leaves are known: ``predict_proba`` without going down the trees again.

        Parameters
        ----------
        leaves : (N, n_trees) as ``apply`` gives them.
        histogram : as in ``predict_proba``.

        Returns
        -------
        (N, C) shares in the order of ``classes_``; rows sum to 1.

        Raises
        ------
        NotTrainedError, OptionError
        """
        entries = self._entries(histogram)
        shares = np.zeros((len(leaves), self._fitted.n_classes))
        kernels.count_leaves(leaves, *entries, shares)
        shares /= leaves.shape[1]
        return shares

    def count_votes(self, clip: FloatArray) -> FloatArray:
        """The votes for one clip, by the shortest way: for search while somebody types or moves.

        Parameters
        ----------
        clip : (T, F) float64 pose features.

        Returns
        -------
        (C,) number of trees that name each category.
        """
        trees = self._fitted
        if clip.shape != (trees.n_frames, trees.n_features) or clip.dtype != np.float64:
            raise InvalidMotionError(
                f"expected float64 pose features of shape ({trees.n_frames}, {trees.n_features}), "
                f"got {clip.dtype} {clip.shape}"
            )
        leaves = np.empty((1, len(trees.roots)), np.int64)
        votes = np.zeros((1, trees.n_classes))
        _run_down(np.ascontiguousarray(clip)[None], trees, self._cuts, leaves)
        kernels.count_leaves(leaves, *self._votes, votes)
        counts: FloatArray = votes[0]
        return counts

    def apply(self, features: ArrayLike) -> NDArray[np.int64]:
        """The leaf that each clip reaches in each tree: (N, n_trees), numbered through all trees from 0."""
        trees = self._fitted
        pose = check_features(features, (trees.n_frames, trees.n_features))
        leaves = np.empty((len(pose), len(trees.roots)), np.int64)
        _run_down(pose, trees, self._cuts, leaves)
        return leaves

    def apply_windows(self, track: FeatureTrack, starts: ArrayLike, stops: ArrayLike) -> NDArray[np.int64]:
        """The leaf that each window of a recording reaches in each tree.

        Parameters
        ----------
        track : of the feature set that the forest was fitted with.
        starts, stops : (N,) frames of the track.

        Returns
        -------
        (N, n_trees), as ``apply``; the features of all windows never stand in memory at once.

        Raises
        ------
        InvalidMotionError : a window outside the recording, or a track of other features.
        """
        trees = self._fitted
        if (track.feature_set.n_frames, track.feature_set.n_columns) != (trees.n_frames, trees.n_features):
            raise InvalidMotionError(
                f"expected a track of {trees.n_features} columns in {trees.n_frames} cells, "
                f"got one of the feature set '{track.feature_set.name}'"
            )
        first, last = np.atleast_1d(starts), np.atleast_1d(stops)
        leaves = np.empty((len(first), len(trees.roots)), np.int64)
        find_window_leaves(
            track.integrals,
            track.times,
            track.find_edges(first, last),
            track.frame_rate,
            len(track.feature_set.channels),
            trees.nodes,
            self._cuts,
            trees.roots,
            trees.only_means,
            leaves,
        )
        return leaves

    def decisions(self, clip: ArrayLike) -> list[Decision]:
        """Every question asked about one clip (T, F) on its way down all trees, in order."""
        trees = self._fitted
        pose = check_features(np.asarray(clip)[None], (trees.n_frames, trees.n_features))
        integrals = integrate(pose)[0]
        asked = []
        for tree, root in enumerate(trees.roots):
            node = int(root)
            while trees.nodes[node, 2] >= 0:
                test = read_test(trees, node)
                value = evaluate_test(integrals, test)
                asked.append(
                    Decision(
                        tree,
                        node,
                        self.feature_names_[test.column],
                        KIND_NAMES[test.kind],
                        test.start,
                        test.stop,
                        test.threshold,
                        value,
                    )
                )
                node = int(trees.nodes[node, 2]) + bool(value > test.threshold)
        return asked

    @property
    def classes_(self) -> NDArray[Any]:
        """(C,) the categories of the training, sorted."""
        self._fitted  # noqa: B018  (raises before the training)
        return self._classes

    @property
    def feature_names_(self) -> tuple[str, ...]:
        """(F,) names of the pose features."""
        self._fitted  # noqa: B018
        return self._feature_names

    @property
    def trees_(self) -> Trees:
        """The grown trees in flat arrays."""
        return self._fitted

    def to_bytes(self) -> bytes:
        """The trained forest as the bytes of an .npz file (no pickle); NotTrainedError before ``fit``."""
        from dousa.retrieval._forest_file import ForestFile, pack_forest

        return pack_forest(ForestFile(self.get_params(), self.trees_, self.classes_, self.feature_names_))

    @classmethod
    def from_bytes(cls, data: bytes) -> MotionForest:
        """The forest that ``to_bytes`` wrote.

        Raises
        ------
        DousaError : bytes that are damaged, are something else, or come from a newer dousa.
        """
        from dousa.retrieval._forest_file import unpack_forest

        file = unpack_forest(data)
        forest = cls().set_params(**file.parameters)
        forest._take(file.trees, file.classes, file.feature_names)
        return forest

    def with_trees(self, trees: Trees, classes: NDArray[Any]) -> MotionForest:
        """A forest of the same parameters and features with other trees; ``classes`` (C,) are its sorted categories."""
        forest = MotionForest().set_params(**self.get_params())
        forest._take(trees, classes, self.feature_names_)
        return forest

    @property
    def _fitted(self) -> Trees:
        if self._trees is None:
            raise NotTrainedError("the forest knows nothing yet; call fit first")
        return self._trees

    def _take(self, trees: Trees, classes: NDArray[Any], feature_names: tuple[str, ...]) -> None:
        self._trees, self._classes, self._feature_names = trees, classes, feature_names
        self._cuts = trees.cuts
        ones = np.arange(trees.n_leaves + 1)
        self._votes = (ones, trees.leaf_categories(), np.ones(trees.n_leaves))
        self._shares = (trees.leaf_starts, trees.leaf_classes, trees.leaf_shares())

    def _entries(self, histogram: str) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        self._fitted  # noqa: B018
        if histogram not in ("votes", "leaves"):
            raise OptionError(f"expected histogram 'votes' or 'leaves', got {histogram!r}")
        return self._votes if histogram == "votes" else self._shares

    def _check_options(self) -> None:
        check_whole("n_trees", self.n_trees, 1)
        if self.n_trials is not None and not (isinstance(self.n_trials, str) and self.n_trials in _TRIALS):
            check_whole("n_trials", self.n_trials, 1, "None, 'sqrt', 'all' or ")
        if self.random_state is not None:
            check_whole("random_state", self.random_state, 0, "None or ")
        if self.n_jobs is not None and (not is_whole(self.n_jobs) or self.n_jobs == 0):
            raise OptionError(f"n_jobs: expected None or a whole number other than 0, got {self.n_jobs!r}")
        if self.thresholds not in _THRESHOLDS:
            raise OptionError(f"thresholds: expected 'best' or 'random', got {self.thresholds!r}")
        if not isinstance(self.bootstrap, bool | np.bool_):
            raise OptionError(f"bootstrap: expected True or False, got {self.bootstrap!r}")
        entropy = self.max_entropy
        if not isinstance(entropy, int | float | np.number) or not 0 <= entropy < np.inf:
            raise OptionError(f"max_entropy: expected bits, 0 or more, got {entropy!r}")


def _run_down(pose: FloatArray, trees: Trees, cuts: FloatArray, leaves: NDArray[np.int64]) -> None:
    bad = kernels.find_leaves(pose, trees.nodes, cuts, trees.roots, trees.only_means, leaves)
    if bad >= 0:
        raise InvalidMotionError(f"expected finite pose features, clip {bad} has NaN or infinity")
