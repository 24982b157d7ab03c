"""Fit the curves that a calibration starts from: those of a library too small to learn its own.

Four sets are each a library without one person. Asked are the rounds of its own calibration, and all clips of the other
three sets, known where they mean something that the library knows; these have half of the weight of the strangers of
the rounds. Every library counts the same. The result is ``_PRIORS`` of ``dousa.retrieval.forest.calibration``; the
curves fitted without a set are then used as they are on it: the expected calibration error of the confidence, with what
is said and what is right, of the person left out and of the other sets.
Run: python -m lab.training.calibration_priors
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.experiments.runner import fit_forest, leave_performer_out, make_forest, split_half
from dousa.retrieval.forest import calibration
from dousa.retrieval.forest.calibration import _MADE, _Judge, learn_calibration
from dousa.retrieval.forest.evidence import EVIDENCE, learn_usual, relate_to_usual
from dousa.retrieval.forest.pose_space import Curve, fit_curve
from lab.trials.confidence import calibration_error, find_meaning
from lab.trials.recognition import SET, Described, describe

NAMES = ("HDM05", "UTD-MHAD", "Bandai", "UTKinect")


@dataclass(frozen=True)
class Asked:
    """Evidence on M guesses: which clips are known, which guesses right, their weights, which are made gestures."""

    evidence: np.ndarray
    known: np.ndarray
    right: np.ndarray
    weights: np.ndarray
    made: np.ndarray


def ask_rounds(judge: _Judge, people: Sequence[str | None]) -> Asked:
    """The rounds of a library's own calibration, weighed as there."""
    rounds = [judge.hold(number, *one) for number, one in enumerate(calibration._draw_rounds(judge.labels, people, 0))]
    seen, guess, kinds, copied, right = (
        np.concatenate([getattr(one, name) for one in rounds])
        for name in ("evidence", "guess", "kinds", "copied", "right")
    )
    _, own = learn_usual(seen, guess, right & ~copied, np.unique(judge.labels))
    weights = calibration._weigh(kinds, copied)
    return Asked(relate_to_usual(seen, own), kinds == calibration._KNOWN, right, weights, kinds == _MADE)


def ask_clips(assessor: calibration.Assessor, some: Described, rows: np.ndarray) -> Asked:
    """Clips of people whom the library does not know."""
    features = some.features[rows]
    verdicts = assessor.assess(assessor.forest.apply(features), features)
    meanings = np.array([find_meaning(label) for label in assessor.forest.classes_])
    true = np.array([find_meaning(label) for label in some.labels[rows]])
    known, right = np.isin(true, meanings), meanings[verdicts.guess] == true
    return Asked(verdicts.evidence, known, right, np.ones(len(rows)), np.zeros(len(rows), bool))


def learn(name: str) -> tuple[Asked, Asked, Asked]:
    """A set without a person (Bandai: without half): its rounds, the person, and the other sets."""
    own = describe(name)
    folds = (
        leave_performer_out(own.people)
        if all(own.people)
        else [split_half(own.labels.tolist(), np.random.default_rng(0))]
    )
    train, test = folds[0].train, folds[0].test
    people, labels, copies = [own.people[row] for row in train], own.labels[train], own.copies.of(train)
    forest = make_forest(SET, 100, 0, -1)
    fit_forest(forest, own.features, train, labels, own.copies, SET)
    judge = _Judge.of(forest.get_params(), own.features[train], labels, SET, copies, None)
    learned = learn_calibration(forest, own.features[train], labels, people, feature_set=SET, copies=copies)
    assessor = calibration.Assessor(forest, learned)
    others = [ask_clips(assessor, describe(one), np.arange(len(describe(one).clips))) for one in NAMES if one != name]
    return ask_rounds(judge, people), ask_clips(assessor, own, test), join(others)


def join(some: Sequence[Asked]) -> Asked:
    return Asked(
        *(
            np.concatenate([getattr(one, name) for one in some])
            for name in ("evidence", "known", "right", "weights", "made")
        )
    )


def weigh_library(rounds: Asked, others: Asked) -> Asked:
    """One library: its rounds, and the other sets at half of the weight of the rounds' strangers."""
    share = 0.5 * calibration.STRANGERS / len(others.weights)
    return join([rounds, Asked(others.evidence, others.known, others.right, others.weights * share, others.made)])


def fit(asked: Asked) -> list[tuple[Curve, Curve]]:
    """The curves that a motion is known, and that its guess is right."""
    found = []
    for positive in (asked.known, asked.right):
        curves = []
        for kept, count in ((np.ones(len(positive), bool), len(EVIDENCE)), (~asked.made, len(EVIDENCE) - 1)):
            curve = fit_curve(asked.evidence[kept, :count], positive[kept], asked.weights[kept])
            slopes = tuple(round(slope, 2) for slope in curve.slopes)
            curves.append(Curve(round(curve.intercept, 2), slopes + (0.0,) * (len(EVIDENCE) - count)))
        found.append((curves[0], curves[1]))
    return found


def measure(curves: Sequence[Sequence[Curve]], asked: Asked) -> str:
    """The error of the confidence by the curves over the poses."""
    known, sure = (one[0].evaluate(asked.evidence) for one in curves)
    said = np.minimum(known, sure)
    return f"{calibration_error(said, asked.right):.3f} ({said.mean():.2f}, {asked.right.mean():.2f})"


def main() -> None:
    """Fit and print."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    libraries = {name: learn(name) for name in NAMES}
    weighed = {name: weigh_library(rounds, others) for name, (rounds, _, others) in libraries.items()}
    for name, (_, person, others) in libraries.items():
        curves = fit(join([one for other, one in weighed.items() if other != name]))
        print(
            f"without {name}: the person {measure(curves, person)}, the other sets {measure(curves, others)}",
            flush=True,
        )
    for curves in fit(join(list(weighed.values()))):
        print(curves)


if __name__ == "__main__":
    main()
