"""Evidence for and against a guess of a forest: of the votes, of the leaves, and of the poses.

- *log_share*, *log_lead*: logarithms of the share of the trees that vote for the guess, and of its ratio to that of the
  second category;
- *around*: clips of the category in the clip's leaves, relative to the usual number around one of its own clips
  (Breiman's proximity, section 10 of "Random forests", Machine Learning 45, 2001);
- *typical*: cosine of the poses with those of the category (``pose_space``), less the usual value for a clip of the
  category by another performer; *pose_lead*: less that of the best other category; *apart*: less that to the nearest
  motion of no category (``Strangers``);
- *near*: how much less the logarithm of the distance of the poses from the centre of the category is than usual.

Their weights are learned in ``calibration``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import InvalidMotionError
from dousa.motion import canonicalise, mirror_canonical
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.posed_motion import PosedMotion, hide_joints
from dousa.retrieval.features.sensor_noise import reduce_noise_of_all
from dousa.retrieval.forest import tree_kernels as kernels
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.pose_space import PoseSpace

EVIDENCE: tuple[str, ...] = ("around", "log_share", "log_lead", "typical", "pose_lead", "near", "apart")
"""The columns, of which *apart* is the last."""

_USUAL = [EVIDENCE.index("typical"), EVIDENCE.index("near")]  # columns with a usual value in each category


class VoteScale:
    """Clips of each category in a leaf, relative to the usual number around a clip of that category."""

    def __init__(self, forest: MotionForest) -> None:
        trees = forest.trees_
        self._forest, n_trees = forest, len(trees.roots)
        counts = trees.leaf_counts.astype(np.float64)
        # Every clip is in one leaf of each tree, so the leaves give the category sizes, and the sum of squares counts
        # the pairs, so the neighbours of its category that each clip has.
        sizes = np.bincount(trees.leaf_classes, counts, trees.n_classes) / n_trees
        pairs = np.bincount(trees.leaf_classes, counts**2, trees.n_classes) / n_trees
        usual = (pairs - sizes) / np.maximum(sizes * (sizes - 1.0), 1e-9)
        alone = sizes < 1.5
        self._size = max(float(np.median(sizes)), 1.0)
        usual[alone] = np.median(usual[~alone]) if (~alone).any() else 1.0
        weight = 1.0 / (np.maximum(sizes, 1.0) * np.maximum(usual, 1e-3))
        self._entries = (trees.leaf_starts, trees.leaf_classes, counts * weight[trees.leaf_classes])

    def measure(
        self,
        leaves: NDArray[np.integer[Any]],
        guess: IndexArray | None = None,
        cosines: FloatArray | None = None,
    ) -> tuple[IndexArray, FloatArray, FloatArray]:
        """Return the guesses and the scores of clips.

        Parameters
        ----------
        leaves : (N, n_trees) of ``apply``.
        guess : (N,) category numbers to score; None for the likeliest, the first of equals.
        cosines : (N, C) of the poses with each category; None to go by the votes alone.

        Returns
        -------
        guess : (N,) as given, or the likeliest.
        scores : (N, 3) share of the votes; clips of it in the leaves relative to the usual, at most 2; lead in votes.
        odds : (N,) of ``weigh`` for the guess.
        """
        trees = self._forest.trees_
        if leaves.ndim != 2 or leaves.shape[1] != len(trees.roots):
            raise InvalidMotionError("forest.leaves_shape", trees=len(trees.roots), shape=leaves.shape)
        wide = np.ascontiguousarray(leaves, dtype=np.int64)
        if wide.size and not (wide.min() >= 0 and wide.max() < trees.n_leaves):
            raise InvalidMotionError("forest.leaves_range", last=trees.n_leaves - 1)
        votes = self._forest.histograms_of(wide)
        near = np.zeros_like(votes)
        kernels.count_leaves(wide, *self._entries, near)
        odds, rows = weigh(votes, cosines, self._size), np.arange(len(votes))
        guess = odds.argmax(axis=1) if guess is None else guess
        first = votes[rows, guess]
        votes[rows, guess] = -1.0
        second = np.maximum(votes.max(axis=1), 0.0)
        around = np.minimum(near[rows, guess] / wide.shape[1], 2.0)
        return guess, np.stack([first, around, first - second], axis=1), odds[rows, guess]


_LEAST_SHARE = 0.02  # added to shares of the votes before their logarithm (docs/confidence.md)
_POSES = 10.0  # logits for a cosine of 1 (docs/retrieval.md)


def weigh(votes: FloatArray, cosines: FloatArray | None, size: float) -> FloatArray:
    """Return the log odds (N, C), but for a constant, of the categories by votes and by cosines of the poses.

    ``size`` is the usual number of clips of a category: of single ones votes say little, so poses count twice as much.
    """
    odds: FloatArray = np.log(votes + _LEAST_SHARE)
    return odds if cosines is None else odds + _POSES * (1.0 + size**-2) * cosines


def learn_usual(
    evidence: FloatArray, guess: NDArray[Any], right: BoolArray, categories: NDArray[Any], n_added: float = 3.0
) -> tuple[FloatArray, FloatArray]:
    """Learn the usual cosine and distance of a clip of each category by a performer outside the training.

    Parameters
    ----------
    evidence, guess : (N, 7) of ``gather_evidence`` and (N,) categories, of clips held back.
    right : (N,) clips to learn from: of held-back people, with a right guess.
    categories : (C,) sorted.
    n_added : clips of median value added to those of each category.

    Returns
    -------
    usual : (C, 2) cosine, and logarithm of the closeness; seldom guessed categories stay near the median.
    own : (N, 2) for each clip, learned without it.
    """
    values = evidence[:, _USUAL]
    rows, weight = np.searchsorted(categories, guess), right.astype(np.float64)
    middle = np.median(values[right], axis=0) if right.any() else np.array([1.0, 0.0])
    sizes = np.bincount(rows, weight, len(categories))[:, None]
    sums = np.stack([np.bincount(rows, weight * column, len(categories)) for column in values.T], axis=1)
    usual: FloatArray = (sums + n_added * middle) / (sizes + n_added)
    without = sums[rows] - weight[:, None] * values + n_added * middle
    own: FloatArray = without / (sizes[rows] - weight[:, None] + n_added)
    return usual, own


def relate_to_usual(evidence: FloatArray, usual: FloatArray) -> FloatArray:
    """Return the evidence (N, 7) with two columns relative to the usual values (N, 2) of ``learn_usual``."""
    related = evidence.copy()
    related[:, _USUAL] -= usual
    return related


@dataclass(frozen=True, slots=True, eq=False)
class PlacedClips:
    """N clips in a space of poses: ``placed`` (N, K), and the cosines (N, C) with its categories."""

    space: PoseSpace
    placed: FloatArray
    cosines: FloatArray

    @classmethod
    def of(cls, space: PoseSpace, features: FloatArray) -> PlacedClips:
        """Place clips (N, T, F)."""
        placed = space.place(features)
        return cls(space, placed, space.compare_all(placed))

    def order(self, names: NDArray[Any]) -> FloatArray | None:
        """Return the cosines with the categories of a forest (C,), -1 for those that the space lacks.

        None for the features of the paper, in which the trees alone decide.
        """
        if not self.space.layout[1]:
            return None
        places = np.minimum(np.searchsorted(self.space.categories, names), len(self.space.categories) - 1)
        return np.where(self.space.categories[places] == names, self.cosines[:, places], -1.0)


def gather_evidence(scores: FloatArray, clips: PlacedClips, guess: NDArray[Any]) -> tuple[FloatArray, IndexArray]:
    """Gather evidence on guesses, not yet related to the usual values.

    Parameters
    ----------
    scores : (N, 3) of ``VoteScale.measure``.
    clips : the N clips in the space of poses.
    guess : (N,) categories of the space.

    Returns
    -------
    evidence : (N, 7), with the cosine in the place of *typical* and the closeness in that of *near*.
    places : (N,) of each category in the space.
    """
    share, around, lead = scores.T
    space, cosines, rows = clips.space, clips.cosines.copy(), np.arange(len(scores))
    places = np.searchsorted(space.categories, guess)
    own = cosines[rows, places]
    cosines[rows, places] = -1.0
    evidence = np.column_stack(
        [
            around,
            np.log(share + _LEAST_SHARE),
            np.log((share + _LEAST_SHARE) / (share - lead + _LEAST_SHARE)),
            own,
            own - cosines.max(axis=1),
            -space.measure_distances(clips.placed, places),
            own - space.compare_others(clips.placed) if len(space.others) else np.zeros(len(own)),
        ]
    )
    return evidence, places


_BESIDE, _ASKED = 80, 40  # gestures; each is there with its mirror image (docs/confidence.md)


@dataclass(frozen=True, slots=True, eq=False)
class Strangers:
    """Features of made-up gestures: ``beside`` (M, T, F) for the spaces of poses, ``asked`` (K, T, F) to be judged."""

    beside: FloatArray
    asked: FloatArray


def describe_strangers(feature_set: FeatureSet | None) -> Strangers | None:
    """Describe made-up gestures by a feature set; None for one without banks, as the paper has no strangers."""
    return None if feature_set is None or not feature_set.has_banks else _describe(feature_set)


@lru_cache(maxsize=4)
def _describe(kind: FeatureSet) -> Strangers:
    hidden = [kind.complete(hide_joints(one, kind.hidden)) for one in _make_gestures()]
    features = kind.compute_quiet_all(reduce_noise_of_all(hidden))
    features.flags.writeable = False
    return Strangers(features[: 2 * _BESIDE], features[2 * _BESIDE :])


@lru_cache(maxsize=1)
def _make_gestures() -> Sequence[PosedMotion]:
    from dousa.motion.synthetic.performers import make_gesture

    motions = [canonicalise(make_gesture(seed)) for seed in range(_BESIDE + _ASKED)]
    return [side for motion in motions for side in (motion, mirror_canonical(motion))]
