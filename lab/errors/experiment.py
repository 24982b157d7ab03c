"""Errors injected into real motion and located blind: how far can the assessment be trusted?

For every motion and class an error is put into a copy of it, a simulated performer dances that, and the
assessment compares it with the clean motion. It knows nothing else. The same is done without an error, for the
false alarms.

Conventions. An error counts as found if an event of its class overlaps it by half (intersection over union);
events and errors pair up best overlap first, each once. 30 % of the motions, chosen by their names, are held out:
the thresholds were never chosen on them.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dousa.errors import DousaError, OptionError
from dousa.evaluation.grade.result import ErrorEvent
from dousa.experiments.runner import Steps, check_at_least, check_choice, check_some
from dousa.messages import Message, Progress
from dousa.motion.canonical.canonicalise import CanonicalMotion
from lab.errors.results import (
    ErrorExperimentResult,
    FalseAlarms,
    SecondTakes,
    SweepRow,
    Trial,
    compute_false_alarms,
    find_counterpart,
    match_events,
)
from lab.injection.injection import (
    KINDS,
    Injection,
    Limits,
    inject,
    inject_many,
    simulate_performer,
)
from lab.tasks import run_tasks

Assess = Callable[[Sequence[CanonicalMotion], CanonicalMotion], Any]

SETS: tuple[str, ...] = ("all", "tuning", "held-out")
SWEEP_SIZES: dict[str, tuple[float, ...]] = {
    "shift": (50.0, 80.0, 120.0, 180.0, 250.0, 350.0),
    "incomplete": (0.1, 0.2, 0.3, 0.45, 0.6, 0.75),
    "partial": (10.0, 20.0, 30.0, 45.0, 60.0, 80.0),
}
"""Sizes of a severity sweep: lag in ms, missing share, degrees of a limb that is rotated."""

_LONG_S = 15.0  # a longer take gets several errors of all classes at once
_S_PER_ERROR = 7.5
_N_DONORS = 8

# In a sweep the small errors are the point: only what leaves no trace at all is refused.
_ANY_SIZE = Limits(
    seen_deg=1.5,
    seen_share=0.3,
    shift_rms=0.0,
    shift_peak=0.0,
    shortfall_deg=0.0,
    shortfall_percent=0.0,
    partial_mean=0.0,
    partial_low=0.0,
    partial_outside=0.0,
)


@dataclass(frozen=True, slots=True, eq=False)
class NamedMotion:
    """A motion and the file it comes from.

    Parameters
    ----------
    name : path or file name; it decides whether the motion is held out.
    motion : canonical joints.
    """

    name: str
    motion: CanonicalMotion


def is_held_out(name: str) -> bool:
    """Whether a motion belongs to the 30 % that no limit of the explanations was chosen on.

    The judge that the package ships has learned from people, not from files: people of the sets that it knows are in
    both parts.

    Parameters
    ----------
    name : file name; folders do not count.
    """
    return zlib.crc32(_file_name(name).encode()) % 10 < 3


def _file_name(name: str) -> str:
    return os.path.basename(name.replace("\\", "/"))


def run_error_experiment(
    motions: Sequence[NamedMotion],
    *,
    repeats: int = 1,
    seed: int = 0,
    noise_deg: float = 3.0,
    timing_ms: float = 20.0,
    which: str = "all",
    limits: Limits | None = None,
    assess: Assess | None = None,
    progress: Progress | None = None,
    n_jobs: int | None = None,
) -> ErrorExperimentResult:
    """Inject errors of all classes into motions and let the assessment find them.

    Parameters
    ----------
    motions : clean motions; each is the reference of its own trials, and lends limbs and sections to others.
    repeats : how often, 1 or more.
    seed : 0 or more; the same seed and motions give the same trials, whatever the number of processes.
    noise_deg, timing_ms : of the simulated performer.
    which : ``"all"``, ``"tuning"`` or ``"held-out"``: only motions of that set are looked at.
    limits : what an error must be to be injected.
    assess : called with ([reference], performance), gives an object with ``events``; `assess` of this package
        if None.
    progress : called with trials done, their total, and the motion's name.
    n_jobs : processes; None for one.

    Returns
    -------
    ErrorExperimentResult. A motion longer than 15 s gets an error every 7.5 s in one trial; a shorter one gets
    one trial a class. One more trial a motion and repeat has no error.

    Raises
    ------
    OptionError : no motions in the set, or a number outside its range.
    """
    check_choice("which", which, SETS)
    check_at_least(repeats=(repeats, 1), seed=(seed, 0), noise_deg=(noise_deg, 0.0), timing_ms=(timing_ms, 0.0))
    chosen = [motion for motion in motions if which == "all" or is_held_out(motion.name) == (which != "tuning")]
    if not chosen:
        raise OptionError("trials.no_motions", which=which, count=len(motions))
    tasks = [
        _Task(motion, kinds, repeat, _draw_donors(chosen, number, repeat, seed))
        for number, motion in enumerate(chosen)
        for repeat in range(repeats)
        for kinds in _plan(motion.motion)
    ]
    settings = _Settings(seed, noise_deg, timing_ms, limits or Limits(), assess)
    trials = tuple(_run_all(tasks, settings, progress, n_jobs))
    return ErrorExperimentResult(trials, repeats, seed, noise_deg, timing_ms)


def run_severity_sweep(
    motions: Sequence[NamedMotion],
    *,
    sizes: Mapping[str, Sequence[float]] | None = None,
    repeats: int = 1,
    seed: int = 0,
    noise_deg: float = 3.0,
    timing_ms: float = 20.0,
    assess: Assess | None = None,
    progress: Progress | None = None,
    n_jobs: int | None = None,
) -> tuple[SweepRow, ...]:
    """How large an error must be to be found.

    Parameters
    ----------
    motions, repeats, seed, noise_deg, timing_ms, assess, progress, n_jobs : as for `run_error_experiment`; one
        error a trial.
    sizes : class -> sizes; `SWEEP_SIZES` if None. Global errors have no size.

    Returns
    -------
    A row a class and size, in that order. Errors are injected however small, so that the first rows tell the
    chance level.

    Raises
    ------
    OptionError : no motions, or a class without sizes.
    """
    sizes = SWEEP_SIZES if sizes is None else sizes
    check_some("sizes", tuple(sizes), SWEEP_SIZES)
    if not motions:
        raise OptionError("trials.sweep_motions")
    plan = [(kind, float(size)) for kind, some in sizes.items() for size in some]
    tasks = [
        _Task(motion, (kind,), repeat, (), size)
        for kind, size in plan
        for motion in motions
        for repeat in range(repeats)
    ]
    settings = _Settings(seed, noise_deg, timing_ms, _ANY_SIZE, assess)
    trials = _run_all(tasks, settings, progress, n_jobs)
    per_row = len(motions) * repeats
    return tuple(_make_row(kind, size, trials[k * per_row : (k + 1) * per_row]) for k, (kind, size) in enumerate(plan))


def _make_row(kind: str, size: float, trials: Sequence[Trial]) -> SweepRow:
    wrong = [trial for trial in trials if trial.errors]
    noticed = [find_counterpart(trial.errors[0], trial.events) is not None for trial in wrong]
    found = [len(match_events(trial.errors, trial.events)) for trial in wrong]
    return SweepRow(kind, size, len(wrong), sum(found), sum(noticed))


def measure_false_alarms(
    takes: Sequence[NamedMotion],
    *,
    n_references: int = 5,
    seed: int = 0,
    assess: Assess | None = None,
    progress: Progress | None = None,
    n_jobs: int | None = None,
) -> FalseAlarms:
    """What is reported between real takes of the same motion by the same person.

    Parameters
    ----------
    takes : of one motion; each in turn is the performance, against others drawn with the seed.
    n_references : how many others, if there are as many.
    seed, assess, progress, n_jobs : as for `run_error_experiment`.

    Returns
    -------
    FalseAlarms; every event counts, since nobody erred on purpose.

    Raises
    ------
    OptionError : fewer than two takes, or no reference asked for.
    """
    check_at_least(takes=(len(takes), 2), n_references=(n_references, 1))
    tasks = []
    for number, take in enumerate(takes):
        others = [k for k in range(len(takes)) if k != number]
        drawn = np.random.default_rng([seed, number]).permutation(len(others))[:n_references]
        tasks.append(_Task(take, None, 0, tuple(takes[others[k]].motion for k in sorted(drawn))))
    settings = _Settings(seed, 0.0, 0.0, Limits(), assess)
    return compute_false_alarms(_run_all(tasks, settings, progress, n_jobs))


def measure_second_takes(
    groups: Mapping[str, Sequence[NamedMotion]],
    *,
    n_references: int = 5,
    seed: int = 0,
    assess: Assess | None = None,
    progress: Progress | None = None,
    n_jobs: int | None = None,
) -> SecondTakes:
    """`measure_false_alarms` for takes of several motions, or persons.

    Parameters
    ----------
    groups : name -> takes; groups of one take are left out.
    n_references, seed, assess, n_jobs : as for `measure_false_alarms`.
    progress : called with the groups done, their number, and the next one's name.
    """
    several = {name: takes for name, takes in sorted(groups.items()) if len(takes) > 1}
    steps = Steps(progress, len(several))
    found: dict[str, FalseAlarms] = {}
    for name, takes in several.items():
        steps.say(Message("text.verbatim", text=name))
        found[name] = measure_false_alarms(takes, n_references=n_references, seed=seed, assess=assess, n_jobs=n_jobs)
        steps.done += 1
    minutes = sum(alarms.minutes for alarms in found.values())
    n_events = sum(len(alarms.events) for alarms in found.values())
    return SecondTakes(
        n_references=n_references,
        n_groups=len(several),
        n_alone=len(groups) - len(several),
        n_takes=sum(alarms.n_takes for alarms in found.values()),
        n_with_fewer_references=sum(len(t) for t in several.values() if len(t) <= n_references),
        minutes=minutes,
        per_minute=n_events / minutes if minutes > 0.0 else float("nan"),
        groups=found,
    )


# One trial


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """A trial to run: classes to inject, () for a clean one, None for a real take against others."""

    motion: NamedMotion
    kinds: tuple[str, ...] | None
    repeat: int
    others: tuple[CanonicalMotion, ...]
    size: float | None = None


@dataclass(frozen=True, slots=True)
class _Settings:
    seed: int
    noise_deg: float
    timing_ms: float
    limits: Limits
    assess: Assess | None


def _plan(motion: CanonicalMotion) -> list[tuple[str, ...]]:
    """The classes of each trial of a motion; the last trial is clean."""
    if motion.duration > _LONG_S:
        count = max(round(motion.duration / _S_PER_ERROR), len(KINDS))
        return [tuple(KINDS[k % len(KINDS)] for k in range(count)), ()]
    return [*((kind,) for kind in KINDS), ()]


def _draw_donors(motions: Sequence[NamedMotion], number: int, repeat: int, seed: int) -> tuple[CanonicalMotion, ...]:
    rng = np.random.default_rng([seed, number, repeat, len(KINDS) + 2])
    others = [k for k in rng.permutation(len(motions)) if k != number]
    return tuple(motions[k].motion for k in others[:_N_DONORS])


def _run_all(tasks: Sequence[_Task], settings: _Settings, progress: Progress | None, n_jobs: int | None) -> list[Trial]:
    """Trials in the order of the tasks."""
    # Processes: much of an assessment is Python between kernels, which threads would take turns in.
    work = partial(_run_trial, settings=settings)
    return list(run_tasks(work, tasks, _name_task, n_jobs=n_jobs, progress=progress, in_processes=True))


def _name_task(task: _Task) -> Message:
    return Message("text.verbatim", text=task.motion.name)


def _run_trial(task: _Task, settings: _Settings) -> Trial:
    """Inject, perform, assess; randomness comes from the names of things, never from the order of trials."""
    motion, kinds = task.motion.motion, task.kinds
    trial = Trial(
        task.motion.name,
        is_held_out(task.motion.name),
        task.repeat,
        motion.duration,
        errors=(),
        missing=(),
        events=(),
    )
    if kinds is None:
        return _assess(trial, task.others, motion, settings.assess)
    number = KINDS.index(kinds[0]) if len(kinds) == 1 else len(KINDS) + (not kinds)
    name = zlib.crc32(_file_name(task.motion.name).encode())
    injecting, performing = np.random.default_rng([settings.seed, name, task.repeat, number]).spawn(2)
    if kinds:
        injection = _inject(task, kinds, injecting, settings.limits)
        errors = injection.errors if injection else ()
        found = [error.kind for error in errors]
        trial = replace(trial, errors=errors, missing=tuple(sorted(set(kinds) - set(found))))
        if injection is None:
            return trial
        motion = injection.motion
    performance = simulate_performer(motion, performing, noise_deg=settings.noise_deg, timing_ms=settings.timing_ms)
    return _assess(trial, (task.motion.motion,), performance, settings.assess)


def _inject(task: _Task, kinds: tuple[str, ...], rng: np.random.Generator, limits: Limits) -> Injection | None:
    motion = task.motion.motion
    if len(kinds) > 1:
        return inject_many(motion, kinds, rng, donors=task.others, limits=limits)
    variant = "limb rotated" if task.size is not None and kinds == ("partial",) else None
    return inject(motion, kinds[0], rng, donors=task.others, variant=variant, size=task.size, limits=limits)


def _assess(
    trial: Trial, references: Sequence[CanonicalMotion], performance: CanonicalMotion, assess: Assess | None
) -> Trial:
    if assess is None:
        from dousa.evaluation.grade.assessment import assess as assess_default

        assess = assess_default
    try:
        events: Sequence[ErrorEvent] = assess(list(references), performance).events
    except DousaError as error:
        return replace(trial, problem=error.message)
    return replace(trial, events=tuple(events))
