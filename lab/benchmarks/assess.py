"""A whole assessment, its report, and the running one that takes a frame at a time.

    python -m lab.benchmarks.assess [--minutes M] [--rate HZ] [--file DANCE]

The reference is the synthetic dance (or a file), danced to and fro until it is long enough; the performance is that
with twelve errors, by a simulated performer. Measured are the whole assessment, its memory and its report, and the
running assessment of a minute at 30 and 120 Hz, on one core.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.evaluation import IncrementalAssessor, assess
from dousa.motion import CanonicalMotion, canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import Performer
from lab.benchmarks.timing import Row, measure_memory, run, take_turns, timed
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
    name: str | None, seconds: float, rate: float, n_errors: int = 12
) -> tuple[CanonicalMotion, CanonicalMotion]:
    reference = lengthen(read_dance(name), seconds, rate)
    rng = np.random.default_rng(1)
    wrong = inject_many(reference, (KINDS * n_errors)[:n_errors], rng)
    return reference, simulate_performer(reference if wrong is None else wrong.motion, rng)


def play(reference: CanonicalMotion, performance: CanonicalMotion) -> tuple[list[float], int]:
    """The wait for each frame of a running assessment, s, and the errors that were found."""
    assessor = IncrementalAssessor(reference, performance.frame_rate)
    waits = [timed(lambda joints=joints: assessor.push(joints))[0] for joints in performance.positions]
    return waits, len(assessor.settled)


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    from dousa.app.report.page import write_report

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
        waits, n_found = play(*pair)
        note = f"the longest wait for a frame {1000 * max(waits):.0f} ms; {n_found} errors settled"
        yield Row(f"running assessment at {rate:g} Hz", spent, amount=len(waits), unit="frames/s", note=note)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--rate", type=float, default=120.0)
    parser.add_argument("--file", help="instead of the synthetic dance")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
