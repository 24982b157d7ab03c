"""Performances with known errors, from recordings of people: what the judge learns from, and what it is tried on.

A trial is a performance, the takes that are its reference, and the truth. The carrier of the errors is either a made-up
performer of the reference itself, or a real second take of the same person. People, motions and generators are kept
apart by the names that every trial bears.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.motion import CanonicalMotion
from lab.injection.injection import Error, Injection, simulate_performer

Generator = Callable[[CanonicalMotion, np.random.Generator, Sequence[CanonicalMotion], int], Injection | None]
"""Puts about so many errors into a motion; the others lend limbs and figures."""
Performer = Callable[[CanonicalMotion, np.random.Generator], CanonicalMotion]
"""The same motion by another person."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording of somebody doing something.

    Parameters
    ----------
    set_name : of the data set.
    person : who.
    motion_name : what; recordings of the same person and motion are takes.
    motion : canonical joints.
    """

    set_name: str
    person: str
    motion_name: str
    motion: CanonicalMotion


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A performance to be judged.

    Parameters
    ----------
    references : takes, the first gives the clock.
    performance : what is judged.
    errors : the truth, in seconds of the performance; none of a clean one.
    set_name, person, motion_name : of the recording.
    generator : who put the errors in; ``""`` of a clean one.
    carrier : ``"performer"`` or ``"take"``.
    """

    references: tuple[CanonicalMotion, ...]
    performance: CanonicalMotion
    errors: tuple[Error, ...]
    set_name: str
    person: str
    motion_name: str
    generator: str
    carrier: str


_SHORTEST_S = 1.0


def make_trials(
    recordings: Sequence[Recording],
    generators: Mapping[str, Generator],
    performers: Sequence[Performer],
    *,
    seed: int = 0,
    rounds: int = 1,
) -> Iterator[Trial]:
    """For every recording and generator a performance with errors, and for every recording a clean one.

    Parameters
    ----------
    recordings : takes of one motion by one person are each other's references.
    generators : by name.
    performers : of whom one is drawn for each trial.
    seed : of everything drawn; a recording's trials do not depend on the other recordings.
    rounds : trials of each recording and generator.
    """
    takes: dict[tuple[str, str, str], list[CanonicalMotion]] = defaultdict(list)
    donors: dict[str, list[CanonicalMotion]] = defaultdict(list)
    for one in recordings:
        if one.motion.duration < _SHORTEST_S:
            continue
        takes[one.set_name, one.person, one.motion_name].append(one.motion)
        donors[one.set_name].append(one.motion)
    for number, one in enumerate(recordings):
        others = [take for take in takes[one.set_name, one.person, one.motion_name] if take is not one.motion]
        for name in ("", *generators):
            for turn in range(rounds):
                rng = np.random.default_rng([seed, number, zlib.crc32(name.encode()), turn])
                lent = [donors[one.set_name][i] for i in rng.integers(len(donors[one.set_name]), size=6)]
                trial = _make_trial(one, others, name, generators.get(name), performers, lent, rng)
                if trial is not None:
                    yield trial


def _make_trial(
    one: Recording,
    others: Sequence[CanonicalMotion],
    name: str,
    generator: Generator | None,
    performers: Sequence[Performer],
    donors: Sequence[CanonicalMotion],
    rng: np.random.Generator,
) -> Trial | None:
    perform = performers[int(rng.integers(len(performers)))]
    by_take = bool(others) and rng.random() < 0.6
    n_references = int(rng.choice([1, 2, 3, 5], p=[0.55, 0.1, 0.15, 0.2]))
    if one.motion.duration < _SHORTEST_S:
        return None
    motion = one.motion
    errors: tuple[Error, ...] = ()
    if generator is not None:
        n_errors = 1 + int(rng.random() < 0.35) + int(one.motion.duration / 8.0)
        injection = generator(one.motion, rng, donors, n_errors)
        if injection is None:
            return None
        motion, errors = injection.motion, injection.errors
    if by_take:
        chosen = [others[i] for i in rng.permutation(len(others))[:n_references]]
        # A take is somebody's own already; sometimes it is another body's.
        performance = perform(motion, rng) if rng.random() < 0.3 else motion
    else:
        chosen = [one.motion, *(perform(one.motion, rng) for _ in range(n_references - 1))]
        performance = perform(motion, rng)
    names = (one.set_name, one.person, one.motion_name)
    return Trial(tuple(chosen), performance, tuple(errors), *names, name, "take" if by_take else "performer")


def perform_steadily(motion: CanonicalMotion, rng: np.random.Generator) -> CanonicalMotion:
    """`simulate_performer` of a steadiness that is drawn."""
    return simulate_performer(
        motion,
        rng,
        noise_deg=float(rng.uniform(1.0, 4.5)),
        bias_deg=float(rng.uniform(0.0, 6.0)),
        timing_ms=float(rng.uniform(5.0, 35.0)),
    )
