"""The probability that two motions have the same meaning, and the threshold above which they count as the same.

The scores are the agreement of the trees' votes for meanings and the angle in a space where clips of one meaning lie
close (``pose_space``). Several categories may share a meaning ("walk/active" and "walk/tired").

In the rounds of the calibration, clips of held-back people and categories query a forest that was not trained on them.
A logistic curve over both scores gives the probability. The threshold is the strictest one with the best mean F over
the queries that have clips of their meaning. Queries of held-back categories train the curve but not the threshold:
with them it became so strict that half of the motions of held-back people were lost.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.messages import Message
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.forest_file import check, damaged, pack_arrays, unpack_arrays
from dousa.retrieval.forest.pose_space import ARRAYS, Curve, PoseSpace, fit_curve, fit_pose_basis, read_curve

_WHAT = Message("stored.calibration")
_NUMBERS = ("threshold", "precision", "recall")


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """The probability that two clips have the same meaning.

    Parameters
    ----------
    space : in which their angle is measured.
    curve : over the agreement of the votes and the cosine of the angle.
    threshold : probability from which they count as the same.
    precision, recall : over the rounds, means of the queries that have clips of their meaning.
    """

    space: PoseSpace
    curve: Curve
    threshold: float
    precision: float
    recall: float

    def place(self, features: FloatArray) -> NDArray[np.float32]:
        """Return unit directions (N, K) of clips (N, T, F) in the space: a product of two is their cosine."""
        return _shorten(self.space.place(features)).astype(np.float32)

    def judge(
        self,
        votes: FloatArray,
        direction: NDArray[np.float32],
        all_votes: FloatArray,
        directions: NDArray[np.float32],
    ) -> FloatArray:
        """Compute probabilities (N,) that clips have the same meaning as a query.

        Parameters
        ----------
        votes, direction : (M,) share of the trees for each meaning, and (K,) of ``place``, of the query.
        all_votes, directions : (N, M) and (N, K) of the clips.
        """
        return self.curve.evaluate(_score(votes, direction, all_votes, directions, np.linalg.norm(all_votes, axis=1)))

    def to_bytes(self) -> bytes:
        """Pack into an .npz file (no pickle)."""
        numbers = {name: getattr(self, name) for name in _NUMBERS}
        curve = {"intercept": self.curve.intercept, "slopes": self.curve.slopes}
        return pack_arrays({"numbers": np.array(json.dumps({**numbers, "curve": curve})), **self.space.to_arrays()})

    @classmethod
    def from_bytes(cls, data: bytes) -> Likeness:
        """Read what ``to_bytes`` wrote; DousaError for anything else."""
        arrays = unpack_arrays(data, {"numbers", *ARRAYS}, _WHAT)
        try:
            written = json.loads(str(arrays["numbers"]))
            curve = read_curve(written["curve"], 2)
            numbers = [float(written[name]) for name in _NUMBERS]
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise damaged(_WHAT, error) from error
        check(all(0.0 <= number <= 1.0 for number in numbers), _WHAT, "shares beyond 0 ... 1")
        return cls(PoseSpace.from_arrays(arrays, _WHAT), curve, *numbers)


_AXES, _SHRINKING = 60, 0.1  # each clip's direction is kept in memory (docs/ranking.md)


def _shorten(placed: FloatArray) -> FloatArray:
    directions: FloatArray = placed / np.maximum(np.linalg.norm(placed, axis=1, keepdims=True), 1e-9)
    return directions


def _score(
    votes: FloatArray, direction: NDArray[Any], all_votes: FloatArray, directions: NDArray[Any], lengths: FloatArray
) -> FloatArray:
    """Return (N, 2) the cosines of the votes, and of the directions.

    Not eq. 8, which separates clips by the spread of their votes: large on a stranger, small on a training clip.
    """
    both = lengths * np.linalg.norm(votes)
    # Not in float32: its sums depend on how many directions there are.
    cosines = directions @ direction.astype(np.float64)
    return np.column_stack([all_votes @ votes / np.maximum(both, 1e-9), cosines])


def merge_votes(votes: FloatArray, meanings: IndexArray) -> FloatArray:
    """Sum votes (N, C) for categories into votes (N, M) for meanings; ``meanings`` (C,) numbers each category's."""
    merged = np.zeros((int(meanings.max(initial=-1)) + 1, len(votes)))
    np.add.at(merged, meanings, votes.T)
    return merged.T


class LikenessLearner:
    """Learns from the rounds of a calibration (``watch``).

    Parameters
    ----------
    features : (N, T, F) of the clips of the rounds.
    labels, meanings : (N,) their categories, and the meanings of these.
    performers : (N,); clips of one person are not compared, if there are several people.
    feature_set : defines the columns.
    """

    def __init__(
        self,
        features: FloatArray,
        labels: NDArray[Any],
        meanings: NDArray[Any],
        performers: NDArray[Any],
        feature_set: FeatureSet,
    ) -> None:
        self._features, self._labels, self._meanings = features, labels, meanings
        self._performers = performers
        self._basis = fit_pose_basis([features], feature_set)
        self._placed = self._basis.place(features)
        self._has_people = len(np.unique(performers)) > 1
        self._rounds: dict[int, list[tuple[FloatArray, BoolArray, bool]]] = {}

    def watch(
        self,
        number: int,
        forest: MotionForest,
        train: IndexArray,
        known: IndexArray,
        unknown: IndexArray,
        n_queries: int = 60,
    ) -> None:
        """Compare ``n_queries`` clips, half of them known, with the training clips of a forest."""
        chance = np.random.default_rng(number)
        space = self._basis.fit(self._placed[train], self._meanings[train], _AXES, _SHRINKING)
        of_label = dict(zip(self._labels[train].tolist(), self._meanings[train].tolist(), strict=True))
        _, numbers = np.unique([of_label[name] for name in forest.classes_.tolist()], return_inverse=True)
        queries = np.concatenate(
            [chance.choice(rows, min(n_queries // 2, len(rows)), replace=False) for rows in (known, unknown)]
        ).astype(np.intp)
        asked, stored = (self._ask(forest, space, numbers, rows) for rows in (queries, train))
        lengths, pairs = np.linalg.norm(stored[0], axis=1), []
        for row, votes, direction in zip(queries, *asked, strict=True):
            others = self._performers[train] != self._performers[row] if self._has_people else np.ones(len(train), bool)
            same = (self._meanings[train] == self._meanings[row])[others]
            pairs.append((_score(votes, direction, *stored, lengths)[others], same, bool(same.any())))
        self._rounds[number] = pairs

    def _ask(
        self, forest: MotionForest, space: PoseSpace, numbers: IndexArray, rows: IndexArray
    ) -> tuple[FloatArray, FloatArray]:
        features = self._features[rows]
        leaves = forest.apply(features)
        return merge_votes(forest.histograms_of(leaves.astype(np.int64)), numbers), _shorten(space.place(features))

    def finish(self, as_good: float = 0.01) -> Likeness | None:
        """Fit curve and threshold; None if no round had two clips of one meaning.

        The strictest threshold is taken whose F is within ``as_good`` of the best.
        """
        pairs = [pair for number in sorted(self._rounds) for pair in self._rounds[number]]
        if not any(has for _, _, has in pairs):
            return None
        scores, same = (np.concatenate([pair[part] for pair in pairs]) for part in (0, 1))
        curve = fit_curve(scores, same)
        chances = [curve.evaluate(scored) for scored, _, _ in pairs]
        limits = 1.0 / (1.0 + np.exp(-np.linspace(np.log(2.0), 9.0, 43)))  # even log odds, from odds of 2
        measured = np.array(
            [
                [_measure(chance >= limit, pair[1]) for chance, pair in zip(chances, pairs, strict=True)]
                for limit in limits
            ]
        )
        has = np.array([pair[2] for pair in pairs])
        f = measured[:, has, 2].mean(axis=1)
        best = int(np.flatnonzero(f >= f.max() - as_good)[-1])
        precision, recall, _ = measured[best, has].mean(axis=0)
        space = self._basis.fit(self._placed, self._meanings, _AXES, _SHRINKING)
        return Likeness(space, curve, float(limits[best]), float(precision), float(recall))


def _measure(called: BoolArray, same: BoolArray) -> tuple[float, float, float]:
    """Return precision, recall and F of the clips called the same; 1 where none are and none are called so."""
    if not same.any():
        right = float(not called.any())
        return right, right, right
    hits = float((called & same).sum())
    return hits / max(float(called.sum()), 1.0), hits / float(same.sum()), 2.0 * hits / float(called.sum() + same.sum())
