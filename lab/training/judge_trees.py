"""The judge learns: frames of trials with their labels, and boosted trees over them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.errors.descriptors import LIMB_OF, N_LIMBS, Descriptors, join_descriptors
from dousa.evaluation.errors.evidence import gather_evidence
from dousa.evaluation.errors.judge import BODY_CLASSES, LIMB_CLASSES, BoostedTrees
from dousa.evaluation.grade.assessment import compute_all_postures
from dousa.evaluation.grade.references import choose_tolerance, compare, describe, prepare_references
from dousa.evaluation.posture.posture import SEGMENTS, spread_weights, thin_postures
from lab.injection.injection import Error
from lab.training.judge_material import Trial

_BODY_SEGMENTS = 8  # an error of so many segments, or of all limbs but one, is the body's
_UNSURE_S = 0.1  # beside an error's edges


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Classes of moments; -1 where nothing is learned.

    Parameters
    ----------
    limbs : (N, 5), numbers of `LIMB_CLASSES`.
    body : (N,), numbers of `BODY_CLASSES`.
    """

    limbs: NDArray[np.int8]
    body: NDArray[np.int8]


def is_of_body(error: Error) -> bool:
    """Whether an error is the whole body's."""
    limbs = {int(LIMB_OF[SEGMENTS.index(name)]) for name in error.segments}
    return error.kind == "global" or len(error.segments) >= _BODY_SEGMENTS or len(limbs) >= N_LIMBS - 1


def label_moments(times: FloatArray, errors: Sequence[Error]) -> Labels:
    """Labels of the moments (N,) s of a performance.

    Limbs are held against the body: of a late body no limb is late. What a limb does while the body does another figure
    or a smaller one is not learned.
    """
    limbs = np.zeros((len(times), N_LIMBS), np.int8)
    body = np.zeros(len(times), np.int8)
    unsure = np.zeros(len(times), bool)
    for error in errors:
        inside = (times >= error.start_s) & (times <= error.end_s)
        unsure |= (np.abs(times - error.start_s) < _UNSURE_S) | (np.abs(times - error.end_s) < _UNSURE_S)
        if is_of_body(error):
            kind = "global" if error.kind == "partial" else error.kind
            body[inside] = BODY_CLASSES.index(kind)
    for error in errors:
        if is_of_body(error):
            continue
        inside = (times >= error.start_s) & (times <= error.end_s)
        for limb in {int(LIMB_OF[SEGMENTS.index(name)]) for name in error.segments}:
            # Of two errors of one limb the later class in the list is the graver one.
            limbs[inside, limb] = np.maximum(limbs[inside, limb], LIMB_CLASSES.index(error.kind))
    limbs[(body > 1)[:, None] & np.ones(N_LIMBS, bool)] = -1
    limbs[unsure] = -1
    body[unsure] = -1
    return Labels(limbs, body)


def describe_trial(trial: Trial, wanted: slice = slice(None)) -> tuple[Descriptors, Labels]:
    """Features and labels of the moments of a trial's performance, or of those that are wanted."""
    weights = spread_weights(None)
    postures, played = compute_all_postures(list(trial.references), trial.performance, side="same", tempo="same")
    references = prepare_references(postures, "same", weights)
    working = thin_postures(played)
    comparison = compare(references.working, working, "same", weights, references.between)
    tolerance = choose_tolerance(comparison.deviations)
    evidence = gather_evidence(comparison.deviations, tolerance.angle, tolerance.lag_s, weights)
    descriptors = join_descriptors(describe(references, comparison.alignment.frames, evidence, wanted))
    times = np.asarray((descriptors.frames + 0.5) / working.frame_rate, np.float64)
    return descriptors, label_moments(times, trial.errors)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Features and classes of many moments."""

    features: NDArray[np.float32]
    classes: NDArray[np.int8]


def stack_limbs(described: Iterable[tuple[Descriptors, Labels]]) -> Table:
    """All limbs of all moments that have a label."""
    features, classes = [], []
    for descriptors, labels in described:
        known = labels.limbs >= 0
        features.append(descriptors.limbs[known])
        classes.append(labels.limbs[known])
    return Table(np.concatenate(features), np.concatenate(classes))


def stack_body(described: Iterable[tuple[Descriptors, Labels]]) -> Table:
    """The body at all moments that have a label."""
    features, classes = [], []
    for descriptors, labels in described:
        known = labels.body >= 0
        features.append(descriptors.body[known])
        classes.append(labels.body[known])
    return Table(np.concatenate(features), np.concatenate(classes))


def train_trees(
    table: Table,
    *,
    n_rounds: int = 120,
    n_leaves: int = 16,
    learning_rate: float = 0.08,
    right_share: float = 0.3,
    seed: int = 0,
) -> BoostedTrees:
    """Boosted trees over a table, by scikit-learn's histogram gradient boosting.

    Of what is right only a share is looked at, with a larger weight each.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier

    rng = np.random.default_rng(seed)
    right = table.classes == 0
    keep = ~right | (rng.random(len(right)) < right_share)
    weights = np.where(right, 1.0 / right_share, 1.0)[keep]
    model = HistGradientBoostingClassifier(
        max_iter=n_rounds,
        max_leaf_nodes=n_leaves,
        learning_rate=learning_rate,
        min_samples_leaf=150,
        l2_regularization=30.0,
        max_features=0.3,
        early_stopping=False,
        random_state=seed,
    )
    model.fit(table.features[keep], table.classes[keep], sample_weight=weights)
    return export_trees(model)


def export_trees(model: object) -> BoostedTrees:
    """The trees of a fitted `HistGradientBoostingClassifier` as plain arrays."""
    rounds = model._predictors  # type: ignore[attr-defined]  # scikit-learn has no public form of them
    feature, threshold, left, right = [], [], [], []
    roots = np.empty((len(rounds), len(rounds[0])), np.int32)
    count = 0
    for turn, trees in enumerate(rounds):
        for place, tree in enumerate(trees):
            nodes = tree.nodes
            leaf = nodes["is_leaf"].astype(bool)
            roots[turn, place] = count
            feature.append(np.where(leaf, 0, nodes["feature_idx"]).astype(np.uint16))
            threshold.append(np.where(leaf, nodes["value"], nodes["num_threshold"]).astype(np.float32))
            left.append(np.where(leaf, -1, nodes["left"].astype(np.int64) + count).astype(np.int32))
            right.append(np.where(leaf, -1, nodes["right"].astype(np.int64) + count).astype(np.int32))
            count += len(nodes)
    start = np.asarray(model._baseline_prediction, np.float64).ravel()  # type: ignore[attr-defined]
    return BoostedTrees(
        np.concatenate(feature), np.concatenate(threshold), np.concatenate(left), np.concatenate(right), roots, start
    )
