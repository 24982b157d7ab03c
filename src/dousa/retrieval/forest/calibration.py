"""How far the guess of a forest can be trusted, learned from held-back people and categories.

Each round holds back some categories and the clips of some performers, trains a small forest on the rest, and collects
the evidence (``evidence``) on both, on disturbed copies of both, on motions half way between clips of different
categories, and on made-up gestures (``Strangers``). Clips of held-back people are known, all others unknown.

Logistic curves over the evidence give the probabilities that the motion is known and that the guess is right, for about
one unknown motion in ten, near curves learned over several data sets. A motion is called unknown if the guess is more
likely wrong than right, or if it is less likely known than 80 % of the disturbed motions of held-back people. It is
still possibly the guess if it is likelier known than 98 % of the made-up gestures.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import TrainingError
from dousa.messages import Message
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.forest.evidence import (
    EVIDENCE,
    PlacedClips,
    Strangers,
    VoteScale,
    describe_strangers,
    gather_evidence,
    learn_usual,
    relate_to_usual,
)
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.forest_file import check, damaged, pack_arrays, unpack_arrays
from dousa.retrieval.forest.pose_space import (
    ARRAYS,
    Curve,
    PoseBasis,
    PoseSpace,
    compute_auroc,
    fit_curve,
    fit_pose_basis,
    read_curve,
)
from dousa.workers.threads import limit_blas, map_pieces

STRANGERS = 0.1
"""Unknown motions for each known one (docs/confidence.md)."""
ALIEN = 0.98
"""Share of the made-up gestures that a possibly known motion must exceed in probability (docs/confidence.md)."""

_WHAT = Message("stored.calibration")
_NUMBERS = "threshold", "auroc", "false_alarms", "misses", "least_known", "least_possible"
Watch = Callable[[int, MotionForest, IndexArray, IndexArray, IndexArray], None]
"""Called with each round: its number, its forest, and its training, known and unknown clips."""

# Curves that a motion is known, and that its guess is right: with made-up gestures; without these. Fitted by
# lab/training/calibration_priors.py.
_PRIORS = (
    (Curve(1.3, (0.59, 0.26, 0.52, 1.36, 0.17, 0.67, 4.29)), Curve(2.75, (0.93, 0.24, 0.52, 5.16, 0.32, 0.01, 0.0))),
    (Curve(0.69, (0.59, 0.57, 0.59, 2.54, 3.58, 0.2, 2.76)), Curve(1.65, (0.87, 0.47, 0.63, 4.71, 3.51, 0.0, 0.0))),
)


@dataclass(frozen=True, slots=True, eq=False)
class Copies:
    """Disturbed copies of some clips: their rows (K,), each at most once, and the features (K, T, F)."""

    rows: IndexArray
    features: FloatArray

    def find(self, rows: IndexArray) -> IndexArray:
        """Return the places of the copies of clips, ascending."""
        return np.flatnonzero(np.isin(self.rows, rows))

    def of(self, rows: IndexArray) -> Copies:
        """Return the copies of some clips, with rows renumbered 0 ... M - 1 in the order of ``rows``."""
        places, order = self.find(rows), np.argsort(rows, kind="stable")
        return Copies(order[np.searchsorted(rows, self.rows[places], sorter=order)], self.features[places])

    def join(
        self, features: FloatArray, chosen: IndexArray, rows: IndexArray, at_once: int = 256
    ) -> tuple[FloatArray, IndexArray]:
        """Join some clips and their copies for ``MotionForest.fit``.

        Parameters
        ----------
        features : (N, T, F), of which the places ``chosen`` (M,) are taken.
        rows : (M,) their rows among the copies.
        at_once : clips copied in one step.

        Returns
        -------
        features : (M + K, T, F) of the clips, then of the copies.
        copied : (K,) clips among the M that have a copy.
        """
        _, frames, columns = features.shape
        # Ordered as by ``order_for_trees``, so that no forest makes its own copy.
        joined = np.empty((len(chosen) + len(self.find(rows)), columns, frames), features.dtype).transpose(0, 2, 1)
        for first in range(0, len(chosen), at_once):
            some = chosen[first : first + at_once]
            joined[first : first + len(some)] = features[some]
        return self.append(joined, rows)

    def append(self, room: FloatArray, rows: IndexArray) -> tuple[FloatArray, IndexArray]:
        """Join all clips at the front of ``room`` (N + M, T, F) with their copies, as ``join``, in place.

        ``room`` has space for the copies behind the clips; ``rows`` (N,) are the clips' rows among the copies.
        """
        places, end = self.find(rows), len(rows)
        room[end : end + len(places)] = self.features[places]
        return room[: end + len(places)], self.of(rows).rows


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The curves and limits that turn the evidence on a guess into a verdict.

    Parameters
    ----------
    known : whether the motion belongs to any category of the forest.
    sure : whether the guess is right.
    poses : space in which poses are compared.
    usual : (C, 2) usual cosine and logarithm of the closeness of a clip of each category by a performer outside the
        training, in the order of ``poses``.
    threshold : a clip whose guess is right with a smaller probability is called unknown.
    auroc : over the rounds, how well ``known`` separates held-back categories from the others; 0.5 to 1.
    false_alarms, misses : over the rounds, share of known clips called unknown, and of unknown ones called known.
    least_known : a clip known with a smaller probability is called unknown.
    lowest : (21,), ascending: probabilities to be known that 0, 1 ... 20 % of the disturbed motions of held-back people
        stay below.
    least_possible : a clip known with a greater probability, before ``limit``, is possibly the guess; 1 for never.
    """

    known: Curve
    sure: Curve
    poses: PoseSpace
    usual: FloatArray
    threshold: float
    auroc: float
    false_alarms: float
    misses: float
    least_known: float
    lowest: tuple[float, ...]
    least_possible: float

    def limit(self, known: FloatArray, least_share: float = 0.04) -> FloatArray:
        """Compute upper limits (N,) of the probabilities to be known.

        Below ``least_known`` hardly any clip trains the curves, so the odds are at most the share of known motions at
        or below that probability, but at least ``least_share`` for another body or sensor, against ``STRANGERS``.
        """
        shares = np.maximum(np.interp(known, self.lowest, np.arange(len(self.lowest)) / 100), least_share)
        return np.where(known < self.least_known, shares / (shares + STRANGERS), 1.0)

    def is_unknown(self, known: FloatArray, confidence: FloatArray) -> BoolArray:
        """Return which clips (N,) are called unknown, from the probabilities to be known and of a right guess."""
        unknown: BoolArray = (confidence < self.threshold) | (known < self.least_known)
        return unknown

    def is_possible(self, belongs: FloatArray) -> BoolArray:
        """Return which clips (N,) may be the guess, from the probabilities to be known before ``limit``."""
        possible: BoolArray = belongs > self.least_possible
        return possible

    def with_clips(self, features: FloatArray, categories: ArrayLike) -> Calibration:
        """Return the calibration of a forest that has taken up clips (M, T, F) of categories (M,), old or new."""
        poses = self.poses.with_clips(features, np.asarray(categories))
        usual = np.tile(np.median(self.usual, axis=0), (len(poses.categories), 1))
        usual[np.searchsorted(poses.categories, self.poses.categories)] = self.usual
        return replace(self, poses=poses, usual=usual)

    def to_json(self) -> dict[str, Any]:
        """Return the curves and numbers for ``json.dumps``, without the poses."""
        numbers = {name: getattr(self, name) for name in (*_NUMBERS, "lowest")}
        return {"known": asdict(self.known), "sure": asdict(self.sure), **numbers}

    def to_bytes(self) -> bytes:
        """Pack into an .npz file (no pickle); the same calibration gives the same bytes."""
        arrays = {"numbers": np.array(json.dumps(self.to_json())), "usual": self.usual, **self.poses.to_arrays()}
        return pack_arrays(arrays)

    @classmethod
    def from_bytes(cls, data: bytes) -> Calibration:
        """Read what ``to_bytes`` wrote; DousaError for anything else."""
        arrays = unpack_arrays(data, {"numbers", "usual", *ARRAYS}, _WHAT)
        poses = PoseSpace.from_arrays(arrays, _WHAT)
        usual = arrays["usual"]
        check(usual.shape == (len(poses.categories), 2) and usual.dtype == np.float64, _WHAT, "bad cosines")
        check(bool(np.isfinite(usual).all()), _WHAT, "bad cosines")
        try:
            written = json.loads(str(arrays["numbers"]))
            known, sure = (read_curve(written[name], len(EVIDENCE)) for name in ("known", "sure"))
            numbers = {name: float(written[name]) for name in _NUMBERS}
            lowest = tuple(float(number) for number in written["lowest"])
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise damaged(_WHAT, error) from error
        check(all(0.0 <= number <= 1.0 for number in (*numbers.values(), *lowest)), _WHAT, "shares beyond 0 ... 1")
        right = len(lowest) == 21 and lowest == tuple(sorted(lowest))
        check(right, _WHAT, "bad shares of what is known")
        return cls(known, sure, poses, usual, lowest=lowest, **numbers)


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """The verdicts on N clips.

    Parameters
    ----------
    guess : (N,) number of the judged category: the likeliest one, unless another was given.
    known : (N,) probability that the clip belongs to any category of the forest.
    confidence : (N,) probability that the guess is right; at most ``known``.
    unknown : (N,) whether the clip is called unknown.
    possible : (N,) whether the clip may be the guess, even if it is called unknown.
    evidence : (N, 7) columns of ``evidence``.
    odds : (N,) of ``weigh``, to compare a motion with its mirror image.
    """

    guess: IndexArray
    known: FloatArray
    confidence: FloatArray
    unknown: BoolArray
    possible: BoolArray
    evidence: FloatArray
    odds: FloatArray


class Assessor:
    """A forest with its calibration, ready to judge the leaves of many clips or windows.

    Parameters
    ----------
    forest : trained, or grown since.
    calibration : of this forest, or of the one it has grown from.
    """

    def __init__(self, forest: MotionForest, calibration: Calibration) -> None:
        self.forest, self.calibration = forest, calibration
        self.scale = VoteScale(forest)

    def assess(
        self,
        leaves: NDArray[np.integer[Any]],
        features: FloatArray,
        guess: IndexArray | None = None,
    ) -> Verdicts:
        """Judge clips.

        Parameters
        ----------
        leaves : (N, n_trees) of ``apply``.
        features : (N, T, F) of the same clips.
        guess : (N,) category numbers to judge; None for the likeliest.
        """
        calibration, names = self.calibration, self.forest.classes_
        clips = PlacedClips.of(calibration.poses, features)
        guess, scores, odds = self.scale.measure(leaves, guess, clips.order(names))
        seen, places = gather_evidence(scores, clips, names[guess])
        evidence = relate_to_usual(seen, calibration.usual[places])
        belongs = calibration.known.evaluate(evidence)
        known = np.minimum(belongs, calibration.limit(belongs))
        confidence = np.minimum(calibration.sure.evaluate(evidence), known)
        unknown = calibration.is_unknown(known, confidence)
        possible = ~unknown | calibration.is_possible(belongs)
        return Verdicts(guess, known, confidence, unknown, possible, evidence, odds)


@limit_blas()
def learn_calibration(
    forest: MotionForest,
    features: FloatArray,
    categories: ArrayLike,
    performers: Sequence[str | None] | None = None,
    *,
    feature_set: FeatureSet | None = None,
    copies: Copies | None = None,
    random_state: int = 0,
    watch: Watch | None = None,
    alien: float = ALIEN,
) -> Calibration:
    """Learn from held-back people and categories how far guesses can be trusted.

    Parameters
    ----------
    forest : gives the parameters of the rounds' small forests; it need not be trained.
    features : (N, T, F) of the training clips.
    categories : (N,) words or whole numbers.
    performers : (N,); a clip of unknown performer counts as one of its own. Without performers, clips of people that
        the forest knows are the known ones, and strangers are called unknown too often; ``guess_performers`` helps.
    feature_set : that of ``MotionForest.fit``.
    copies : disturbed copies of some clips, of any rows. Without them, noise is taken for strangeness.
    random_state : seed; the same seed gives the same calibration for any number of workers.
    watch : called in each round, see ``Watch``.
    alien : share of the made-up gestures that a possibly known motion must exceed in probability.

    Raises TrainingError: fewer than 3 categories, or neither clips to hold back nor copies.
    """
    labels = np.asarray(categories)
    labels = labels.astype(np.str_) if labels.dtype == object else labels
    names = np.unique(labels)
    if len(names) < 3:
        raise TrainingError("calibration.categories", count=len(names))
    people = [None] * len(labels) if performers is None else performers
    rounds = list(_draw_rounds(labels, people, random_state))
    # Curves are of more clips held back than there are categories: a few tell nothing.
    fitted = len(np.unique(np.concatenate([known for _, known, _ in rounds]))) >= len(names) if rounds else False
    if not fitted and copies is not None:
        # As of one clip of each category: the copies stand for another person, but are too like the clips for curves.
        people = ["as recorded"] * len(labels) + ["disturbed"] * len(copies.rows)
        features, labels = np.concatenate([features, copies.features]), np.append(labels, labels[copies.rows])
        copies = watch = None
        rounds = list(_draw_rounds(labels, people, random_state))
    if not rounds:
        raise TrainingError("calibration.clips")
    judge = _Judge.of(forest.get_params(), features, labels, feature_set, copies, watch)
    # One worker a round, as small forests are not worth dividing.
    seen = map_pieces(lambda number: judge.hold(number, *rounds[number]), range(len(rounds)), forest.n_jobs, 1)
    return _summarise(seen, judge.fit_space(slice(None)), alien, fitted)


def guess_performers(heights: ArrayLike, within: float = 0.04) -> tuple[str, ...]:
    """Guess performers (N,) from ``heights`` (N,), m, for ``learn_calibration``: those ``within`` m count as one."""
    return tuple(f"{within * round(float(height) / within):.2f} m" for height in np.asarray(heights))


_UNKNOWN, _KNOWN, _BETWEEN, _MADE = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """The motions of a round: evidence (M, 7); guess, kind, whether it is a copy and guessed right (M,)."""

    evidence: FloatArray
    guess: NDArray[Any]
    kinds: IndexArray
    copied: BoolArray
    right: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Judge:
    """Holds the rounds: forest parameters, the clips' features and categories, and the feature set.

    ``placed`` are the clips, their copies, and the motions of no category, along the axes of ``basis``.
    """

    parameters: dict[str, Any]
    features: FloatArray
    labels: NDArray[Any]
    feature_set: FeatureSet | None
    copies: Copies | None
    watch: Watch | None
    strangers: Strangers | None
    basis: PoseBasis
    placed: tuple[FloatArray, FloatArray, FloatArray]

    @classmethod
    def of(
        cls,
        parameters: dict[str, Any],
        features: FloatArray,
        labels: NDArray[Any],
        feature_set: FeatureSet | None,
        copies: Copies | None,
        watch: Watch | None,
    ) -> _Judge:
        strangers = describe_strangers(feature_set)
        parts = [
            features,
            features[:0] if copies is None else copies.features,
            features[:0] if strangers is None else strangers.beside,
        ]
        basis = fit_pose_basis(parts, feature_set)
        first, second, third = map(basis.place, parts)
        return cls(parameters, features, labels, feature_set, copies, watch, strangers, basis, (first, second, third))

    def hold(self, number: int, train: IndexArray, known: IndexArray, unknown: IndexArray) -> _Round:
        """Train on some clips, guess the categories of others, and compare their poses."""
        small, space = self.train(number, train, known, unknown), self.fit_space(train)
        parts, labels, kinds, copied = self._choose(number, known, unknown)
        scale, found, named = VoteScale(small), [], []
        for features in parts:
            clips = PlacedClips.of(space, features)
            guess, scores, _ = scale.measure(small.apply(features), None, clips.order(small.classes_))
            named.append(small.classes_[guess])
            found.append(gather_evidence(scores, clips, named[-1])[0])
        names = np.concatenate(named)
        return _Round(np.concatenate(found), names, kinds, copied, (names == labels) & (kinds == _KNOWN))

    def train(
        self, number: int, train: IndexArray, known: IndexArray, unknown: IndexArray, most_trees: int = 50
    ) -> MotionForest:
        trees = min(most_trees, self.parameters["n_trees"])
        small = MotionForest(**{**self.parameters, "n_trees": trees, "random_state": number, "n_jobs": 1})
        copies = Copies(np.zeros(0, np.intp), self.features[:0]) if self.copies is None else self.copies
        features, copied = copies.join(self.features, train, train)
        small.fit(features, self.labels[train], feature_set=self.feature_set, copied=copied)
        del features  # some rounds are held at a time
        if self.watch is not None:
            self.watch(number, small, train, known, unknown)
        return small

    def _choose(
        self, number: int, known: IndexArray, unknown: IndexArray, most: int = 500, most_between: int = 250
    ) -> tuple[list[FloatArray], NDArray[Any], IndexArray, BoolArray]:
        """Choose held-back clips, their copies, and motions between two; return features in parts, labels, kinds,
        copied or not.

        At most ``most`` clips are known, and as many unknown; at most ``most_between`` motions lie between two.
        """
        chance = np.random.default_rng(number)
        known, unknown = (chance.permutation(rows)[:most] for rows in (known, unknown))
        other = chance.permutation(known)
        apart = np.flatnonzero(self.labels[known] != self.labels[other])[:most_between]
        between = 0.5 * (self.features[known[apart]] + self.features[other[apart]])
        parts = [(self.features[known], known), (self.features[unknown], unknown), (between, known[apart])]
        kinds, copied = [_KNOWN, _UNKNOWN, _BETWEEN], [False] * 3
        if self.copies is not None:
            for kind, rows in ((_KNOWN, known), (_UNKNOWN, unknown)):
                places = self.copies.find(rows)
                parts.append((self.copies.features[places], self.copies.rows[places]))
                kinds.append(kind)
                copied.append(True)
        if self.strangers is not None:
            parts.append((self.strangers.asked, np.zeros(len(self.strangers.asked), np.intp)))
            kinds.append(_MADE)
            copied.append(False)
        sizes = [len(rows) for _, rows in parts]
        labels = self.labels[np.concatenate([rows for _, rows in parts])]
        return [features for features, _ in parts], labels, np.repeat(kinds, sizes), np.repeat(copied, sizes)

    def fit_space(self, rows: IndexArray | slice) -> PoseSpace:
        """Fit the space of some clips and their copies, so that noise counts as scatter within a category."""
        clips, copies, others = self.placed
        labels = self.labels[rows]
        if self.copies is not None:
            places = rows if isinstance(rows, slice) else self.copies.find(rows)  # a slice moves nothing
            copies = copies[places]
            labels = np.concatenate([labels, self.labels[self.copies.rows[places]]])
        return self.basis.fit(np.concatenate([clips[rows], copies, others]), labels)


def _summarise(
    rounds: list[_Round],
    poses: PoseSpace,
    alien: float,
    fitted: bool,
    threshold: float = 0.5,
    lost: int = 20,
    least_known: tuple[float, float] = (0.5, 0.97),
) -> Calibration:
    """Fit the curves and limits to the rounds.

    Parameters
    ----------
    alien : as for ``learn_calibration``.
    fitted : whether curves are fitted, or those of the other data sets used as they are.
    threshold : of the calibration.
    lost : % of the disturbed motions of held-back people called unknown; the full library knows more.
    least_known : the lowest and the highest ``Calibration.least_known``.
    """
    seen, guess, kinds, copied, right = (
        np.concatenate([getattr(one, name) for one in rounds])
        for name in ("evidence", "guess", "kinds", "copied", "right")
    )
    usual, own = learn_usual(seen, guess, right & ~copied, poses.categories)
    evidence, weights = relate_to_usual(seen, own), _weigh(kinds, copied)
    known, sure = (curves[0 if len(poses.others) else 1] for curves in _PRIORS)
    if fitted:
        known = fit_curve(evidence, kinds == _KNOWN, weights, known)
        sure = fit_curve(evidence, right, weights, sure)
    belongs = known.evaluate(evidence)
    confidence = np.minimum(sure.evaluate(evidence), belongs)
    own = kinds == _KNOWN
    harder = own & copied if (own & copied).any() else own
    lowest = np.quantile(belongs[harder], np.arange(lost + 1) / 100)
    least = float(np.clip(lowest[-1], *least_known))
    made = belongs[kinds == _MADE]
    plain = ~copied & (kinds <= _KNOWN)
    called = ((confidence >= threshold) & (belongs >= least))[plain]
    own = own[plain]
    return Calibration(
        known=known,
        sure=sure,
        poses=poses,
        usual=usual,
        threshold=threshold,
        auroc=compute_auroc(belongs[plain], own),
        false_alarms=float(1.0 - called[own].mean()),
        misses=float(called[~own].mean()) if not own.all() else 0.0,
        least_known=least,
        lowest=tuple(lowest.tolist()),
        least_possible=float(np.quantile(made, alien)) if len(made) else 1.0,
    )


def _weigh(kinds: IndexArray, copied: BoolArray, share_of_copies: float = 2 / 3) -> FloatArray:
    """Return weights: ``STRANGERS`` split evenly over the kinds of strangers; copies weigh twice as much as clips."""
    weights = np.zeros(len(kinds))
    strange = [kind for kind in np.unique(kinds).tolist() if kind != _KNOWN]
    for kind, weight in ((_KNOWN, 1.0), *((kind, STRANGERS / len(strange)) for kind in strange)):
        own, again = kinds == kind, (kinds == kind) & copied
        of_copies = share_of_copies if again.any() else 0.0
        weights[own & ~copied] = weight * (1.0 - of_copies) / max(int((own & ~copied).sum()), 1)
        weights[again] = weight * of_copies / max(int(again.sum()), 1)
    return weights


def _draw_rounds(
    labels: NDArray[Any],
    performers: Sequence[str | None],
    random_state: int,
    category_parts: int = 4,
    performer_parts: int = 3,
) -> Iterator[tuple[IndexArray, IndexArray, IndexArray]]:
    """Yield the training, known and unknown clips of each round that is possible.

    Each round holds back one of ``category_parts`` of the categories, so its forest has almost as many as the real one,
    and one of ``performer_parts`` of the performers. Twice as many gave nothing more (lab/notes/confidence.md).
    """
    generator = np.random.default_rng(random_state)
    names, own = np.unique(labels, return_inverse=True)
    parts = _part_performers(own, performers, generator, performer_parts)
    n_groups = min(category_parts, len(names))
    group = generator.permutation(np.arange(len(names)) % n_groups)
    for number in range(n_groups):
        held = group[own] == number
        stranger = parts == number % (parts.max() + 1)
        train = np.flatnonzero(~held & ~stranger)
        known = np.flatnonzero(~held & stranger & np.isin(own, own[train]))
        if len(known) and len(np.unique(own[train])) > 1:
            yield train, known, np.flatnonzero(held)


def _part_performers(
    own: IndexArray, performers: Sequence[str | None], generator: np.random.Generator, n_parts: int
) -> IndexArray:
    """Return (N,) the part of each clip, dealing out performers, and clips without one, evenly."""
    people = sorted({name for name in performers if name})
    count = len(people) if 1 < len(people) < n_parts else n_parts
    dealt = dict(zip(generator.permutation(people), np.arange(len(people)) % count, strict=True))
    drawn = generator.random(len(own))
    parts = np.zeros(len(own), np.intp)
    # A single performer cannot be left out, so those clips are dealt out one by one.
    single = np.array([len(people) < 2 or not name for name in performers], bool)
    order = np.lexsort((drawn, own))
    alone = order[single[order]]
    parts[alone] = np.arange(len(alone)) % count
    parts[~single] = [dealt[name] for name in performers if len(people) > 1 and name]
    return parts
