"""What an experiment with injected errors gives: trials, the scores over them, and their tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dousa.evaluation.grade.result import ErrorEvent
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.files.json_values import to_json_value
from dousa.messages import Message
from lab.injection.injection import KINDS, Error


class Stretch(Protocol):
    """A stretch of time of a class: an error as it was made, or as somebody reports it."""

    @property
    def kind(self) -> str: ...

    @property
    def start_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...


def compute_overlap(error: Stretch, event: Stretch) -> float:
    """Intersection over union of two stretches of time, 0 to 1."""
    common = min(error.end_s, event.end_s) - max(error.start_s, event.start_s)
    union = max(error.end_s, event.end_s) - min(error.start_s, event.start_s)
    return max(common, 0.0) / union if union > 0.0 else 0.0


def match_events(
    errors: Sequence[Stretch], events: Sequence[Stretch], least: float = 0.5
) -> tuple[tuple[int, int], ...]:
    """Pair errors with events of the same class, best overlap first, each at most once.

    Parameters
    ----------
    errors, events : of one performance.
    least : smallest intersection over union.

    Returns
    -------
    (index of error, index of event) pairs, in order of the errors.
    """
    pairs = [
        (compute_overlap(error, event), i, j)
        for i, error in enumerate(errors)
        for j, event in enumerate(events)
        if error.kind == event.kind
    ]
    matched: dict[int, int] = {}
    used: set[int] = set()
    for overlap, i, j in sorted(pairs, key=lambda pair: (-pair[0], pair[1], pair[2])):
        if overlap >= least and i not in matched and j not in used:
            matched[i] = j
            used.add(j)
    return tuple(sorted(matched.items()))


def find_counterpart(error: Error, events: Sequence[ErrorEvent], least: float = 0.1) -> ErrorEvent | None:
    """The event of any class that overlaps an error best; None if none overlaps it by ``least``."""
    best = max(events, key=lambda event: compute_overlap(error, event), default=None)
    return best if best is not None and compute_overlap(error, best) >= least else None


_TOUCH = 0.1  # intersection over union from which an event has to do with an error


@dataclass(frozen=True, slots=True)
class Trial:
    """One performance with known errors, assessed blind.

    Parameters
    ----------
    name : of the motion.
    held_out : see `is_held_out`.
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
    problem: Message | None = None


@dataclass(frozen=True, slots=True)
class ClassScore(Result):
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

    def to_json(self) -> dict[str, Any]:
        """The counts and what follows from them."""
        shares = {name: to_json_value(getattr(self, name)) for name in ("precision", "recall", "f_measure")}
        return {**Result.to_json(self), **shares}


@dataclass(frozen=True, slots=True)
class FalseAlarms(Result):
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
        """The fields, the events a minute, and of each event what it is."""
        events = [
            {"name": name, **{field: to_json_value(getattr(event, field)) for field in _EVENT_FIELDS}}
            for name, event in self.events
        ]
        return {
            "n_takes": self.n_takes,
            "minutes": self.minutes,
            "per_minute": to_json_value(self.per_minute),
            "by_kind": dict(self.by_kind),
            "events": events,
        }


_EVENT_FIELDS = ("kind", "start_s", "end_s", "segments", "severity")


@dataclass(frozen=True, slots=True)
class ErrorScores(Result):
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
    problems: tuple[Message, ...]

    def to_json(self) -> dict[str, Any]:
        """All as plain numbers and lists; null for what has nothing to count."""
        variants = {name: {"found": found, "injected": count} for name, (found, count) in self.variants.items()}
        return {**Result.to_json(self), "variants": variants}

    def tabulate(self, title: Message) -> ResultTable:
        """A row a class, the means below."""
        rows: list[tuple[Cell, ...]] = [
            (
                kind,
                *(str(number) for number in (one.n_errors, one.n_events, one.n_matched)),
                *map(show, (one.precision, one.recall, one.f_measure)),
            )
            for kind, one in self.classes.items()
        ]
        means = map(show, (self.macro_precision, self.macro_recall, self.macro_f))
        notes = (
            Message(
                "trial_errors.sizes",
                onset=show(self.onset_s, 0, 1000.0),
                offset=show(self.offset_s, 0, 1000.0),
                lag=show(self.lag_mae_ms, 0),
                shortfall=show(self.shortfall_mae_deg, 1),
            ),
            Message(
                "trial_errors.false_alarms",
                events=len(self.false_alarms.events),
                minutes=self.false_alarms.minutes,
                rate=show(self.false_alarms.per_minute, 2),
            ),
        )
        return ResultTable(
            _CLASS_HEADS,
            (*rows, (Message("trial_errors.mean"), "", "", "", *means)),
            title=Message("trial_errors.set", what=title, motions=self.n_motions, trials=self.n_trials),
            notes=notes,
            bold=frozenset([len(rows)]),
        )

    def tabulate_variants(self) -> ResultTable:
        """How often each way of doing it wrong was found."""
        heads = (
            Message("trial_errors.variant"),
            Message("trial_errors.injected"),
            Message("trial_errors.found"),
            Message("trial_words.recall"),
        )
        return ResultTable(
            heads,
            tuple(
                (name, str(count), str(found), show(found / count if count else None))
                for name, (found, count) in self.variants.items()
            ),
            title=Message("trial_errors.recall_by_variant"),
            framed=False,
        )

    def tabulate_confusion(self) -> ResultTable:
        """What was injected, and as what it was reported."""
        columns = tuple(dict.fromkeys(kind for row in self.confusion.values() for kind in row))
        return ResultTable(
            (Message("trial_errors.injected"), *columns),
            tuple((kind, *(str(row.get(column, "")) for column in columns)) for kind, row in self.confusion.items()),
            title=Message("trial_errors.reported_as"),
            framed=False,
        )


_CLASS_HEADS = (
    Message("trial_errors.error"),
    Message("trial_errors.injected"),
    Message("trial_errors.reported"),
    Message("trial_errors.found"),
    Message("trial_words.precision"),
    Message("trial_words.recall"),
    "F",
)

_SET_WORDS = {
    "tuning": Message("trial_errors.tuning"),
    "held-out": Message("trial_errors.held_out"),
    "all": Message("trial_errors.all"),
}


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
class ErrorExperimentResult(Result):
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

    @property
    def sets(self) -> dict[str, ErrorScores]:
        """Over all trials, over those tuned on and over those held out; without sets that are empty."""
        trials = {
            "all": self.trials,
            "tuning": tuple(trial for trial in self.trials if not trial.held_out),
            "held-out": tuple(trial for trial in self.trials if trial.held_out),
        }
        return {name: compute_error_scores(some) for name, some in trials.items() if some}

    @property
    def problems(self) -> tuple[Message, ...]:
        """Of the trials that were refused."""
        return self.scores.problems

    def to_json(self) -> dict[str, Any]:
        """Settings and scores: of all trials, of those tuned on and of those held out."""
        names = ("repeats", "seed", "noise_deg", "timing_ms", "sets")
        return {name: to_json_value(getattr(self, name)) for name in names}

    def to_tables(self) -> tuple[ResultTable, ...]:
        """Every set, or all trials where they are one set; then what was reported as what, over all."""
        sets = self.sets
        names = [name for name in _SET_WORDS if name in sets and (name != "all" or len(sets) == 3)]
        if not names:
            return ()
        last = sets[names[-1]]
        return (
            *(sets[name].tabulate(_SET_WORDS[name]) for name in names),
            last.tabulate_variants(),
            last.tabulate_confusion(),
        )


_SHOWN_GROUPS = 20


@dataclass(frozen=True, slots=True)
class SecondTakes(Result):
    """False alarms between takes of the same motions.

    Parameters
    ----------
    n_references : for each take, where there were as many.
    n_groups, n_alone : groups of takes, and those of one take, which are left out.
    n_takes, n_with_fewer_references : takes of the groups, and those with fewer references.
    minutes, per_minute : of all takes, and events in each.
    groups : by name.
    """

    n_references: int
    n_groups: int
    n_alone: int
    n_takes: int
    n_with_fewer_references: int
    minutes: float
    per_minute: float
    groups: dict[str, FalseAlarms]

    def to_tables(self) -> tuple[ResultTable, ...]:
        """A row a group, those with most false alarms first."""
        order = sorted(self.groups.items(), key=lambda item: -len(item[1].events))
        rows: list[tuple[Cell, ...]] = [
            (name, str(one.n_takes), show(one.minutes, 1), str(len(one.events)), show(one.per_minute, 2))
            for name, one in order[:_SHOWN_GROUPS]
        ]
        if len(order) > _SHOWN_GROUPS:
            rows.append((Message("trial_errors.more_groups", n=len(order) - _SHOWN_GROUPS), "", "", "", ""))
        total = sum(len(one.events) for _, one in order)
        everything = (str(self.n_takes), show(self.minutes, 1), str(total), show(self.per_minute, 2))
        note = Message(
            "trial_errors.fewer_references",
            takes=self.n_with_fewer_references,
            references=self.n_references,
            alone=self.n_alone,
        )
        heads = (
            Message("trial_errors.takes_of"),
            Message("trial_errors.takes"),
            Message("trial_errors.minutes"),
            Message("trial_errors.alarms"),
            Message("trial_errors.per_minute"),
        )
        return (
            ResultTable(
                heads,
                (*rows, (Message("trial_errors.all_groups"), *everything)),
                title=Message("trial_errors.second_takes", references=self.n_references, takes=self.n_takes),
                notes=(note,) if self.n_with_fewer_references else (),
                bold=frozenset([len(rows)]),
            ),
        )


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
        (trial.errors[i], trial.events[j]) for trial in wrong for i, j in match_events(trial.errors, trial.events)
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
            _compare_segments(error, event) for error, event in matches if error.kind in ("partial", "incomplete")
        ),
        confusion=_confuse(wrong),
        variants={name: (found[name], variants[name]) for name in sorted(variants)},
        false_alarms=compute_false_alarms([trial for trial in trials if not trial.errors and not trial.missing]),
        missing={kind: sum(kind in trial.missing for trial in trials) for kind in KINDS},
        problems=tuple(
            Message("trial_errors.problem", name=trial.name, problem=trial.problem) for trial in trials if trial.problem
        ),
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


def _score_classes(trials: Sequence[Trial], matches: Sequence[tuple[Error, ErrorEvent]]) -> dict[str, ClassScore]:
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
