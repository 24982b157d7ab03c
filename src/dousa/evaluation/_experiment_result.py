"""What an experiment with injected errors gives: trials, and the scores over them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dousa.evaluation._event_matching import compute_overlap, find_counterpart, match_events
from dousa.evaluation._injection_truth import Error
from dousa.evaluation._types import ErrorEvent
from dousa.evaluation.injection import KINDS

__all__ = [
    "ClassScore",
    "ErrorExperimentResult",
    "ErrorScores",
    "FalseAlarms",
    "SweepRow",
    "Trial",
    "compute_error_scores",
    "compute_false_alarms",
]

_TOUCH = 0.1  # intersection over union from which an event has to do with an error


@dataclass(frozen=True, slots=True)
class Trial:
    """One performance with known errors, assessed blind.

    Parameters
    ----------
    name : of the motion.
    held_out : whether nobody tuned on it.
    repeat : from 0.
    duration_s : of the performance.
    errors : injected, in order of time; none for a clean trial.
    missing : classes for which the motion has no place where they could be seen.
    events : what the assessment said.
    problem : why it said nothing, if it refused.
    """

    name: str
    held_out: bool
    repeat: int
    duration_s: float
    errors: tuple[Error, ...]
    missing: tuple[str, ...]
    events: tuple[ErrorEvent, ...]
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class ClassScore:
    """How well one class of error was located.

    Parameters
    ----------
    n_errors, n_events, n_matched : injected, reported, and both at an intersection over union of 0.5.
    """

    n_errors: int
    n_events: int
    n_matched: int

    @property
    def precision(self) -> float:
        """Share of the events that are true; nan without events."""
        return self.n_matched / self.n_events if self.n_events else float("nan")

    @property
    def recall(self) -> float:
        """Share of the errors that were found; nan without errors."""
        return self.n_matched / self.n_errors if self.n_errors else float("nan")

    @property
    def f_measure(self) -> float:
        """Harmonic mean of both; nan if there are neither errors nor events."""
        total = self.n_errors + self.n_events
        return 2.0 * self.n_matched / total if total else float("nan")


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """What was reported where nothing is wrong.

    Parameters
    ----------
    n_takes : performances.
    minutes : their length together.
    by_kind : events of each class.
    events : (name of the performance, event).
    """

    n_takes: int
    minutes: float
    by_kind: dict[str, int]
    events: tuple[tuple[str, ErrorEvent], ...]

    @property
    def per_minute(self) -> float:
        """Events a minute; nan without takes."""
        return len(self.events) / self.minutes if self.minutes > 0.0 else float("nan")

    def to_json(self) -> dict[str, Any]:
        """All as plain numbers and lists."""
        return {
            "n_takes": self.n_takes,
            "minutes": self.minutes,
            "per_minute": _plain(self.per_minute),
            "by_kind": dict(self.by_kind),
            "events": [
                {
                    "name": name,
                    "kind": event.kind,
                    "start_s": event.start_s,
                    "end_s": event.end_s,
                    "segments": list(event.segments),
                    "severity": event.severity,
                }
                for name, event in self.events
            ],
        }


@dataclass(frozen=True, slots=True)
class ErrorScores:
    """Scores over a set of trials.

    Parameters
    ----------
    n_motions, n_trials : with errors and clean.
    classes : by class; events and errors of the trials with errors.
    macro_precision, macro_recall, macro_f : means over the classes that were injected. A class without
        events has precision 0.
    onset_s, offset_s : median absolute error of start and end over the matched events.
    lag_mae_ms : mean absolute error over the matched shifts.
    shortfall_mae_deg, shortfall_mae_percent : the same over the matched incomplete motions.
    segment_jaccard : mean over the matched partial errors and incomplete motions: segments named rightly, as a
        share of those that are wrong or named.
    confusion : injected class (last: ``"no error"``) -> class of the event that overlaps it best, or
        ``"none"``, -> count.
    variants : variant -> (found as its class, injected).
    false_alarms : on the clean trials.
    missing : class -> trials whose motion had no place for it.
    problems : messages of the trials that were refused.
    """

    n_motions: int
    n_trials: int
    classes: dict[str, ClassScore]
    macro_precision: float
    macro_recall: float
    macro_f: float
    onset_s: float
    offset_s: float
    lag_mae_ms: float
    shortfall_mae_deg: float
    shortfall_mae_percent: float
    segment_jaccard: float
    confusion: dict[str, dict[str, int]]
    variants: dict[str, tuple[int, int]]
    false_alarms: FalseAlarms
    missing: dict[str, int]
    problems: tuple[str, ...]

    def to_rows(self) -> list[tuple[str, int, int, float, float, float]]:
        """A row a class: name, errors, events, precision, recall, F; the last row holds the means."""
        rows: list[tuple[str, int, int, float, float, float]] = [
            (kind, s.n_errors, s.n_events, s.precision, s.recall, s.f_measure)
            for kind, s in self.classes.items()
        ]
        errors, events = sum(row[1] for row in rows), sum(row[2] for row in rows)
        return [*rows, ("macro", errors, events, self.macro_precision, self.macro_recall, self.macro_f)]

    def to_json(self) -> dict[str, Any]:
        """All as plain numbers and lists; null for what has nothing to count."""
        return {
            "n_motions": self.n_motions,
            "n_trials": self.n_trials,
            "classes": {
                kind: {
                    **asdict(score),
                    "precision": _plain(score.precision),
                    "recall": _plain(score.recall),
                    "f_measure": _plain(score.f_measure),
                }
                for kind, score in self.classes.items()
            },
            **{name: _plain(getattr(self, name)) for name in _NUMBERS},
            "confusion": {kind: dict(row) for kind, row in self.confusion.items()},
            "variants": {
                name: {"found": found, "injected": count} for name, (found, count) in self.variants.items()
            },
            "false_alarms": self.false_alarms.to_json(),
            "missing": dict(self.missing),
            "problems": list(self.problems),
        }


_NUMBERS = (
    "macro_precision",
    "macro_recall",
    "macro_f",
    "onset_s",
    "offset_s",
    "lag_mae_ms",
    "shortfall_mae_deg",
    "shortfall_mae_percent",
    "segment_jaccard",
)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """How often an error of one size is found.

    Parameters
    ----------
    kind : class.
    size : lag in ms (shift), missing share (incomplete), degrees (partial: a limb rotated).
    n_errors : injected.
    n_found : reported as that class at an intersection over union of 0.5.
    n_noticed : overlapped by an event of any class.
    """

    kind: str
    size: float
    n_errors: int
    n_found: int
    n_noticed: int


@dataclass(frozen=True, slots=True)
class ErrorExperimentResult:
    """All trials of an experiment and what they were made with.

    Parameters
    ----------
    trials : in the order of motions, repeats and classes.
    repeats, seed, noise_deg, timing_ms : as asked for.
    """

    trials: tuple[Trial, ...]
    repeats: int
    seed: int
    noise_deg: float
    timing_ms: float

    @property
    def scores(self) -> ErrorScores:
        """Over all trials."""
        return compute_error_scores(self.trials)

    def to_json(self) -> dict[str, Any]:
        """Settings and scores: of all trials, of those tuned on and of those held out."""
        sets = {"all": self.trials}
        for name, held_out in (("tuning", False), ("held-out", True)):
            sets[name] = tuple(trial for trial in self.trials if trial.held_out is held_out)
        return {
            "repeats": self.repeats,
            "seed": self.seed,
            "noise_deg": self.noise_deg,
            "timing_ms": self.timing_ms,
            "sets": {name: compute_error_scores(trials).to_json() for name, trials in sets.items() if trials},
        }


def compute_error_scores(trials: Sequence[Trial]) -> ErrorScores:
    """Scores over trials, those with errors and clean ones.

    Parameters
    ----------
    trials : any; none gives scores of nan.

    Returns
    -------
    The scores. Events on clean trials count as false alarms and not against the precision.
    """
    wrong = [trial for trial in trials if trial.errors]
    matches = [
        (trial.errors[i], trial.events[j])
        for trial in wrong
        for i, j in match_events(trial.errors, trial.events)
    ]
    classes = _score_classes(wrong, matches)
    injected = [score for score in classes.values() if score.n_errors]
    found = Counter(error.variant for error, _ in matches)
    variants = Counter(error.variant for trial in wrong for error in trial.errors)
    return ErrorScores(
        n_motions=len({trial.name for trial in trials}),
        n_trials=len(trials),
        classes=classes,
        macro_precision=_mean(score.precision if score.n_events else 0.0 for score in injected),
        macro_recall=_mean(score.recall for score in injected),
        macro_f=_mean(score.f_measure for score in injected),
        onset_s=_median(abs(event.start_s - error.start_s) for error, event in matches),
        offset_s=_median(abs(event.end_s - error.end_s) for error, event in matches),
        lag_mae_ms=_mean_error(matches, "shift", lambda item: item.lag_ms),
        shortfall_mae_deg=_mean_error(matches, "incomplete", lambda item: item.shortfall_deg),
        shortfall_mae_percent=_mean_error(matches, "incomplete", lambda item: item.shortfall_percent),
        segment_jaccard=_mean(
            _compare_segments(error, event)
            for error, event in matches
            if error.kind in ("partial", "incomplete")
        ),
        confusion=_confuse(wrong),
        variants={name: (found[name], variants[name]) for name in sorted(variants)},
        false_alarms=compute_false_alarms(
            [trial for trial in trials if not trial.errors and not trial.missing]
        ),
        missing={kind: sum(kind in trial.missing for trial in trials) for kind in KINDS},
        problems=tuple(f"{trial.name}: {trial.problem}" for trial in trials if trial.problem),
    )


def compute_false_alarms(trials: Sequence[Trial]) -> FalseAlarms:
    """Everything that was reported, of trials without errors."""
    events = tuple((trial.name, event) for trial in trials for event in trial.events)
    return FalseAlarms(
        n_takes=len(trials),
        minutes=sum(trial.duration_s for trial in trials) / 60.0,
        by_kind={kind: sum(event.kind == kind for _, event in events) for kind in KINDS},
        events=events,
    )


def _score_classes(
    trials: Sequence[Trial], matches: Sequence[tuple[Error, ErrorEvent]]
) -> dict[str, ClassScore]:
    errors = Counter(error.kind for trial in trials for error in trial.errors)
    events = Counter(event.kind for trial in trials for event in trial.events)
    matched = Counter(error.kind for error, _ in matches)
    return {kind: ClassScore(errors[kind], events[kind], matched[kind]) for kind in KINDS}


def _confuse(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    table = {kind: dict.fromkeys((*KINDS, "none"), 0) for kind in (*KINDS, "no error")}
    for trial in trials:
        for error in trial.errors:
            event = find_counterpart(error, trial.events, _TOUCH)
            table[error.kind]["none" if event is None else event.kind] += 1
        for event in trial.events:
            if not any(compute_overlap(error, event) >= _TOUCH for error in trial.errors):
                table["no error"][event.kind] += 1
    del table["no error"]["none"]
    return table


def _mean_error(
    matches: Sequence[tuple[Error, ErrorEvent]],
    kind: str,
    read: Callable[[Error | ErrorEvent], float | None],
) -> float:
    """Mean absolute difference of one quantity; an event of the class without that number is left out."""
    pairs = [(read(error), read(event)) for error, event in matches if error.kind == kind]
    return _mean(abs(true - said) for true, said in pairs if true is not None and said is not None)


def _compare_segments(error: Error, event: ErrorEvent) -> float:
    true, said = set(error.segments), set(event.segments)
    return len(true & said) / len(true | said) if true | said else float("nan")


def _mean(values: Iterable[float]) -> float:
    numbers = list(values)
    return float(np.mean(numbers)) if numbers else float("nan")


def _median(values: Iterable[float]) -> float:
    numbers = list(values)
    return float(np.median(numbers)) if numbers else float("nan")


def _plain(number: float) -> float | None:
    return None if np.isnan(number) else float(number)
