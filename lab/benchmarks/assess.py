"""A whole assessment, its report, and the running one that takes a frame at a time.

    python -m lab.benchmarks.assess [--minutes M] [--rate HZ] [--file DANCE] [--agreement N]

The reference is the synthetic dance (or a file), danced to and fro until it is long enough; the performance is that
with twelve errors, by a simulated performer. Measured are the whole assessment, its memory and its report, and the
running assessment of a minute at 30 and 120 Hz, on one core. With --agreement only the running assessment of N other
performances of a minute at 30 Hz is held against that of the whole, half of them with three takes of the reference.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dousa.evaluation import ErrorEvent, IncrementalAssessor, assess
from dousa.motion import CanonicalMotion, canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import Performer
from lab.benchmarks.timing import Row, Spent, measure_memory, run, spend, take_turns
from lab.injection.injection import inject_many, simulate_performer

KINDS = ("shift", "incomplete", "partial", "global")


def read_dance(name: str | None) -> CanonicalMotion:
    if name is None:
        return canonicalise(make_dance(Performer(), 0, 30.0).motion)
    from dousa.formats.registry import read_motion

    return canonicalise(read_motion(name))


def lengthen(dance: CanonicalMotion, seconds: float, rate: float) -> CanonicalMotion:
    """To and fro, at another rate."""
    last = dance.n_frames - 1
    place = np.arange(round(seconds * rate)) / rate * dance.frame_rate % (2 * last)
    place = np.where(place > last, 2 * last - place, place)
    low = np.minimum(place.astype(np.intp), last - 1)
    share = (place - low)[:, None, None]
    positions = dance.positions[low] * (1 - share) + dance.positions[low + 1] * share
    return replace(dance, positions=positions, frame_rate=rate, missing=None)


def make_pair(
    name: str | None, seconds: float, rate: float, n_errors: int = 12, seed: int = 1
) -> tuple[CanonicalMotion, CanonicalMotion]:
    reference = lengthen(read_dance(name), seconds, rate)
    rng = np.random.default_rng(seed)
    wrong = inject_many(reference, (KINDS * n_errors)[:n_errors], rng)
    return reference, simulate_performer(reference if wrong is None else wrong.motion, rng)


def play(reference: CanonicalMotion, performance: CanonicalMotion) -> tuple[list[Spent], int]:
    """What each frame of a running assessment takes, and the number of errors that were found."""
    assessor = IncrementalAssessor(reference, performance.frame_rate)
    waits = [spend(lambda joints=joints: assessor.push(joints))[0] for joints in performance.positions]
    return waits, len(assessor.settled)


def agree(name: str | None, n_pairs: int) -> str:
    """How running assessments agree with those of the whole, in words."""
    found = known = settled = true = 0
    behind, lags, angles = [], [], []
    for seed in range(2, 2 + n_pairs):
        reference, performance = make_pair(name, 60.0, 30.0, 9, seed)
        takes = [reference, *(simulate_performer(reference, seed + 100 * n) for n in (1, 2) if seed % 2)]
        assessor, whole = IncrementalAssessor(takes, 30.0), assess(takes, performance)
        states = []
        for joints in performance.positions:
            states.append(assessor.push(joints))
            behind += [states[-1].time_s - one.end_s for one in assessor.settled[len(behind) - settled :]]
        ended = [one for one in whole.events if one.end_s < states[-1].time_s - 3.0]
        settled += len(assessor.settled)
        known += len(ended)
        found += sum(any(map(partial(is_same, one), assessor.settled)) for one in ended)
        true += sum(any(map(partial(is_same, one), whole.events)) for one in assessor.settled)
        lags.append(np.array([one.lag_ms for one in states]) - 1000.0 * whole.lag)
        angles.append(np.degrees(np.array([one.residual for one in states]) - whole.residual)[60:])
    lag, angle = (float(np.nanmedian(np.abs(np.concatenate(parts)))) for parts in (lags, angles))
    return (
        f"{found} of {known} errors of the whole are told, {true} of the {settled} told are the whole's; told "
        f"{np.median(behind):.1f} s after their end ({np.max(behind):.1f} at most); "
        f"at once {lag:.0f} ms and {angle:.2f} deg from the whole, in the median"
    )


def is_same(one: ErrorEvent, other: ErrorEvent) -> bool:
    """Whether two errors are of one class and overlap by half."""
    common = min(one.end_s, other.end_s) - max(one.start_s, other.start_s)
    return one.kind == other.kind and common >= 0.5 * (max(one.end_s, other.end_s) - min(one.start_s, other.start_s))


def split_clocks(played: Sequence[tuple[list[Spent], int]]) -> tuple[list[list[float]], list[list[float]]]:
    """Waits of each run by the clock and of processors."""
    return [[one.wall for one in waits] for waits, _ in played], [[one.cpu for one in waits] for waits, _ in played]


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    from dousa.app.report.page import write_report

    if options.agreement:
        spent, note = spend(lambda: agree(options.file, options.agreement))
        yield Row(f"running assessments and those of the whole, {options.agreement} performances", spent, note=note)
        return
    reference, performance = make_pair(options.file, 60.0 * options.minutes, options.rate)
    assess(*make_pair(options.file, 20.0, 30.0, 2))  # compiles
    memory = measure_memory(lambda: assess(reference, performance))
    assessment = assess(reference, performance)
    whole = take_turns({"": lambda: assess(reference, performance)}, options.repeats)[""]
    what = f"{options.minutes:g} minutes at {options.rate:g} Hz"
    yield Row(f"assess {what}, {len(assessment.events)} errors", whole, note=memory)
    with tempfile.TemporaryDirectory() as folder:
        report = take_turns({"": lambda: write_report(assessment, Path(folder))}, options.repeats)[""]
        size = Path(write_report(assessment, Path(folder))).stat().st_size / 1e6
    yield Row(f"report of that, {size:.1f} MB", report)
    for rate in (30.0, 120.0):
        pair = make_pair(options.file, min(60.0, 60.0 * options.minutes), rate, 9)
        spent = take_turns({"": lambda pair=pair: play(*pair)}, options.repeats)[""]
        played = [play(*pair) for _ in range(options.repeats)]
        waits, n_found = played[0]
        # Of each frame the shortest: what other programs take is none of ours.
        longest, cpu = (1000 * max(min(each) for each in zip(*times, strict=True)) for times in split_clocks(played))
        note = f"the longest wait for a frame {longest:.0f} ms ({cpu:.0f} of CPU); {n_found} errors settled"
        yield Row(f"running assessment at {rate:g} Hz", spent, amount=len(waits), unit="frames/s", note=note)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--rate", type=float, default=120.0)
    parser.add_argument("--file", help="instead of the synthetic dance")
    parser.add_argument("--agreement", type=int, default=0, metavar="N", help="performances")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
