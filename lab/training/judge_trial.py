"""The judge on trial: trained without a generator, tried on that generator's errors in people and motions left out."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dousa.evaluation.errors.descriptors import N_LIMBS, Descriptors
from dousa.evaluation.errors.judge import Decoding, Judge, decode
from lab.injection.injection import Error
from lab.training.judge_material import Generator, Performer, Recording, Trial, make_trials
from lab.training.judge_metrics import Report, Score
from lab.training.judge_trees import Labels, describe_trial, stack_body, stack_limbs, train_trees

_THIN_RATE = 30.0
_EVERY = 3  # moments of a performance that are learned from: neighbours are alike
Judging = Callable[[Sequence[Any], Any], Sequence[Report]]


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """A trial as the judge sees it, without its motion."""

    set_name: str
    generator: str
    carrier: str
    n_references: int
    errors: tuple[Error, ...]
    duration_s: float
    descriptors: Descriptors
    labels: Labels


def is_left_out(one: Recording | Trial) -> bool:
    """Whether a person (or, of Bandai, a motion) is one of those that choices are made on and nothing is trained on."""
    if one.set_name == "HDM05":
        return one.person == "bk"
    if one.set_name == "UTD-MHAD":
        return one.person == "s5"
    if one.set_name == "Bandai":
        return zlib.crc32(b"c" + one.motion_name.encode()) % 4 == 0
    return one.motion_name.endswith("_2")


def thin(recording: Recording) -> Recording:
    """The recording at about 30 Hz: what is judged is, and errors are made faster."""
    motion = recording.motion
    step = max(1, round(motion.frame_rate / _THIN_RATE))
    if step == 1:
        return recording
    missing = None if motion.missing is None else motion.missing[::step]
    rate = motion.frame_rate / step
    return replace(
        recording, motion=replace(motion, positions=motion.positions[::step], frame_rate=rate, missing=missing)
    )


def describe_trials(
    recordings: Sequence[Recording],
    generators: Mapping[str, Generator],
    performers: Sequence[Performer],
    *,
    seed: int,
    rounds: int = 1,
    whole: bool = False,
    n_jobs: int = 2,
) -> list[Described]:
    """Make trials and describe them.

    Parameters
    ----------
    recordings, generators, performers, seed, rounds : see `make_trials`.
    whole : keep all moments, for decoding; else every third, for training.
    n_jobs : processes.
    """
    import joblib

    trials = make_trials([thin(one) for one in recordings], generators, performers, seed=seed, rounds=rounds)
    work = joblib.delayed(_describe)
    found = joblib.Parallel(n_jobs, batch_size=16)(work(trial, number, whole) for number, trial in enumerate(trials))
    return [one for one in found if one is not None]


def _describe(trial: Trial, number: int, whole: bool) -> Described:
    descriptors, labels = describe_trial(trial, slice(None) if whole else slice(number % _EVERY, None, _EVERY))
    return Described(
        trial.set_name,
        trial.generator,
        trial.carrier,
        len(trial.references),
        trial.errors,
        trial.performance.duration,
        descriptors,
        labels,
    )


def train_judge(described: Sequence[Described], decoding: Decoding | None = None, **settings: Any) -> Judge:
    """A judge of trials; settings as for `train_trees`."""
    pairs = [(one.descriptors, one.labels) for one in described]
    limbs = train_trees(stack_limbs(pairs), **settings)
    return Judge(limbs, train_trees(stack_body(pairs), **settings), decoding or Decoding())


def weigh_all(judge: Judge, described: Sequence[Described]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Log probabilities of the moments of each trial, for `score_decoding`."""
    return [judge.weigh(one.descriptors) for one in described]


def score_decoding(
    logs: Sequence[tuple[np.ndarray, np.ndarray]], described: Sequence[Described], how: Decoding
) -> Score:
    """Agreement of the errors that decoding finds with the true ones."""
    score = Score()
    for (limbs, body), one in zip(logs, described, strict=True):
        rate = len(body) / one.duration_s
        reports = [
            Report(suspect.kind, (suspect.start - 0.25) / rate, (suspect.end - 0.25) / rate, suspect.segments)
            for suspect in decode(limbs.reshape(len(body), N_LIMBS, -1), body, rate, how)
        ]
        score.add(reports, one.errors, one.duration_s)
    return score


def choose_decoding(logs: Sequence[tuple[np.ndarray, np.ndarray]], described: Sequence[Described]) -> Decoding:
    """The best prices by `_rate`: one after the other, round by round, from several starts."""
    found = [_improve(start, logs, described) for start in _STARTS]
    return max(found, key=lambda pair: pair[1])[0]


def _improve(
    start: Decoding, logs: Sequence[tuple[np.ndarray, np.ndarray]], described: Sequence[Described]
) -> tuple[Decoding, float]:
    best, most = start, _rate(logs, described, start)
    for _ in range(_ROUNDS_OF_CHOICE):
        for name, values in _CHOICES.items():
            for value in values:
                how = replace(best, **{name: value})
                found = _rate(logs, described, how)
                if found > most:
                    best, most = how, found
    return best, most


def _rate(
    logs: Sequence[tuple[np.ndarray, np.ndarray]],
    described: Sequence[Described],
    how: Decoding,
    *,
    false_price: float = 0.01,
) -> float:
    """Macro F, less a price for each false event a minute of real second takes in which nothing was put."""
    clean = [k for k, one in enumerate(described) if not one.generator and one.carrier == "take"]
    false = score_decoding([logs[k] for k in clean], [described[k] for k in clean], how).false_per_minute
    return score_decoding(logs, described, how).macro_f - false_price * float(np.nan_to_num(false))


_STARTS = (Decoding(), Decoding(change=2.0, shift=1.0, incomplete=0.5), Decoding(change=5.0, shift=1.5, surest=0.5))
_ROUNDS_OF_CHOICE = 3
_BIASES = tuple(np.arange(-1.0, 4.1, 0.5).tolist())
_CHOICES: dict[str, tuple[float, ...]] = {
    "change": (2.0, 3.0, 5.0, 8.0),
    "shift": _BIASES,
    "incomplete": _BIASES,
    "limb": _BIASES,
    "whole": _BIASES,
    "surest": (0.0, 0.5, 1.0, 1.5, 2.0),
    "shortest_s": (0.2, 0.3, 0.4),
}
