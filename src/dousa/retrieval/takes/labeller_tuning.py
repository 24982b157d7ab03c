"""Choose sequence weights, calibration and threshold of a labeller on takes of people left out of its training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.retrieval.forest.pose_space import climb_likelihood
from dousa.retrieval.takes.label import describe_run
from dousa.retrieval.takes.sequence import Run, SequenceModel, SequenceWeights

UNCOUNTED, STRANGE = -1, -2
"""States of moments: not annotated; of categories unknown to a fold."""

# Weight of unknown categories, as one action in twenty is unknown in use (lab/notes/takes.md).
_STRANGERS = 0.2
_DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD = (3.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0), 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A take of a person left out: probabilities of the phases (M, 3 C + 1), and true states (M,), C for nothing.

    ``pieces`` are its actions of categories known to the fold, ``strange`` the others.
    """

    shares: NDArray[np.float32]
    states: IntArray
    pieces: list[Run]
    strange: list[Run] = field(default_factory=list)

    def answer(self, sequence: SequenceModel) -> list[Answer]:
        """Return the segments of the model with their evidence and truth."""
        answers, n_categories = [], len(sequence.log_lengths) - 1
        for run in sequence.find_runs(self.shares):
            if run.state < n_categories:
                true = self.states[run.start : run.stop]
                true = true[true != UNCOUNTED]
                if len(true):
                    evidence = describe_run(self.shares, run, sequence)
                    right, strange = (float((true == state).mean()) for state in (run.state, STRANGE))
                    found = any(_is_same(run, piece) for piece in self.pieces)
                    placed = any(_is_there(run, piece) for piece in (*self.pieces, *self.strange))
                    answers.append(Answer(evidence, len(true), right, strange, found, placed))
        return answers


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """A segment: evidence (K,), counted moments, shares of right moments and of unknown categories.

    ``found`` and ``placed`` : whether it overlaps a true one by half, of its category or of any.
    """

    evidence: FloatArray
    length: int
    right: float
    strange: float
    found: bool
    placed: bool


def choose_weights(sequence: SequenceModel, trials: Sequence[Trial], most_work: int = 300_000) -> SequenceWeights:
    """Choose the weights that label takes of people left out best, one at a time.

    ``most_work`` bounds the moments, times states, by which they are tried.
    """
    best = sequence.weights
    if not trials:
        return best
    most = most_work / trials[0].shares.shape[1]
    sizes = np.cumsum([len(one.shares) for one in trials])
    step = max(round(float(sizes[-1]) / most), 1)
    some = list(trials)[::step]
    # Weights, values tried, and the weight of the F of segments (lab/notes/takes.md): to find an action matters more
    # than its edges; false actions are rejected later, when segments are judged as clips.
    edges, nothing = ("edges", (0.0, 0.25, 0.5, 1.0, 1.5, 2.0), 1.0), ("nothing", (1.0, 0.0, -1.0, -2.0), 0.3)
    for name, values, events in (edges, nothing, ("evidence", (0.2, 0.4, 0.8, 1.6), 1.0), edges, nothing):
        best = max(
            (replace(best, **{name: one}) for one in dict.fromkeys((getattr(best, name), *values))),
            key=lambda weights: _rate(replace(sequence, weights=weights), some, events),
        )
    return best


def _rate(sequence: SequenceModel, trials: Sequence[Trial], events: float, of_nothing: float = 0.5) -> float:
    """Return the mean share of right moments over categories and nothing, plus ``events`` times the F of segments.

    Nothing weighs ``of_nothing`` of a category, as unnamed moments may be actions.
    """
    n_states = len(sequence.log_lengths)
    right, total = np.zeros(n_states), np.zeros(n_states)
    matched = said = true = 0
    for trial in trials:
        runs = sequence.find_runs(trial.shares)
        answer = np.concatenate([np.full(run.stop - run.start, run.state) for run in runs])
        counted = trial.states >= 0
        total += np.bincount(trial.states[counted], minlength=n_states)
        right += np.bincount(trial.states[counted & (answer == trial.states)], minlength=n_states)
        actions = [run for run in runs if run.state < n_states - 1]
        said, true = said + len(actions), true + len(trial.pieces)
        matched += sum(any(_is_same(run, piece) for run in actions) for piece in trial.pieces)
    counts = np.where(total > 0, np.append(np.ones(n_states - 1), of_nothing), 0.0)
    return float(counts @ (right / np.maximum(total, 1.0)) / max(counts.sum(), 1e-9)) + events * 2.0 * matched / max(
        said + true, 1
    )


def _is_same(one: Run, other: Run) -> bool:
    return one.state == other.state and _is_there(one, other)


def _is_there(one: Run, other: Run) -> bool:
    shared = min(one.stop, other.stop) - max(one.start, other.start)
    return 2 * shared >= max(one.stop, other.stop) - min(one.start, other.start)


def calibrate(answers: Sequence[Answer], enough: int = 8) -> tuple[tuple[float, ...], float]:
    """Return weights of the log odds that an answer is right, and the confidence from which answering pays.

    Fewer than ``enough`` right or wrong answers give defaults. It pays if frames are right more often than of unknown
    categories, which are weighted down, as folds have too many.
    """
    if not answers:
        return _DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD
    evidence = np.stack([one.evidence for one in answers])
    lengths, right, strange, found = (
        np.array([getattr(one, name) for one in answers], np.float64)
        for name in ("length", "right", "strange", "found")
    )
    if min(found.sum(), (1.0 - found).sum()) < enough:
        return _DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD
    often = np.where(strange > 0.5, _STRANGERS, 1.0)
    offset, *weights = fit_logistic(evidence, found, often)
    sure = 1.0 / (1.0 + np.exp(-(evidence @ np.array(weights) + offset)))
    order = np.argsort(-sure, kind="stable")
    gained = np.cumsum(((right - _STRANGERS * strange) * lengths)[order])
    best = int(gained.argmax())
    if gained[best] <= 0:
        return (offset, *weights), 1.0
    # Halfway to the next answer, which no longer pays.
    following = sure[order[best + 1]] if best + 1 < len(order) else 0.0
    return (offset, *weights), float(0.5 * (sure[order[best]] + following))


def calibrate_places(answers: Sequence[Answer], enough: int = 8) -> tuple[float, ...]:
    """Return weights of the log odds that an answer lies where any action is.

    Libraries differ most in false actions: rare in joined clips, frequent where people walk between annotated actions.
    """
    placed = np.array([one.placed for one in answers], bool)
    if len(placed) < enough:
        return _DEFAULT_CALIBRATION
    often = np.array([_STRANGERS if one.strange > 0.5 else 1.0 for one in answers])
    # Platt's targets avoid certainty if all answers are in place.
    there, away = int(placed.sum()), int((~placed).sum())
    truth = np.where(placed, (there + 1.0) / (there + 2.0), 1.0 / (away + 2.0))
    return fit_logistic(np.stack([one.evidence for one in answers]), truth, often)


def fit_logistic(
    columns: FloatArray, truth: FloatArray, counts: FloatArray, penalty_on_weights: float = 0.3
) -> tuple[float, ...]:
    """Fit offset and weights of the log odds, with a penalty on the squares of the weights.

    ``columns`` (N, K) are evidence, ``truth`` (N,) is 0 to 1, ``counts`` (N,) the weight of each row.
    """
    pull = np.array([1e-6] + [penalty_on_weights] * columns.shape[1])
    return tuple(climb_likelihood(columns, truth, counts, np.zeros(len(pull)), pull).tolist())
