"""The demonstration's second act: a dance, a pupil who makes one error of each class, and what is found of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.demo.takes import say
from dousa.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import ErrorEvent
    from dousa.experiments.injection.injection import Error, Injection
    from dousa.motion import CanonicalMotion
    from dousa.motion.synthetic.performers import Performer

REFERENCE, PUPIL, REPORT = "dance_reference.bvh", "dance_pupil.bvh", "report"

_KINDS = ("shift", "incomplete", "partial", "global")
_APART_S = 3.0  # between two errors
_N_DRAWS = 20  # of places for them, until all four have one
_PUPIL = 41  # number of the performer who plays the pupil
_TOUCH = 0.1  # intersection over union from which an event has to do with an error


def write_dance(output: Path, seed: int = 0) -> tuple[Path, Path, tuple[Error, ...]]:
    """Write the reference dance and the pupil's as BVH files.

    Parameters
    ----------
    output : folder, must exist.
    seed : of the dancers, their takes and the errors.

    Returns
    -------
    reference, pupil : the files.
    errors : what was done wrong on purpose, in order of time.

    Raises
    ------
    MotionWriteError : the files cannot be written.
    OptionError : a negative seed.
    """
    from dousa.experiments import simulate_performer
    from dousa.formats.registry import write_motion
    from dousa.motion import canonicalise, fit_motion
    from dousa.motion.synthetic.dance import make_dance
    from dousa.motion.synthetic.performers import Performer

    reference = make_dance(Performer(name="teacher", seed=1000 * seed), seed)
    pupil = canonicalise(make_dance(_draw_pupil(seed), seed + 1).motion)
    injection = _inject_all_kinds(pupil, seed)
    performed = simulate_performer(injection.motion, seed, noise_deg=1.5, bias_deg=1.0)
    paths = output / REFERENCE, output / PUPIL
    write_motion(reference.motion, paths[0])
    write_motion(fit_motion(performed), paths[1])
    return *paths, injection.errors


def _draw_pupil(seed: int) -> Performer:
    """Draw a performer of another body and posture who knows the dance: the errors are injected afterwards."""
    import dataclasses

    from dousa.motion.synthetic.performers import draw_performer

    drawn = draw_performer(1000 * seed + _PUPIL, "pupil")
    return dataclasses.replace(drawn, amplitude=1.0, noise=1.0, left_handed=False)


def _inject_all_kinds(motion: CanonicalMotion, seed: int) -> Injection:
    """Inject one error of each class; places are drawn again only until each class has one."""
    import numpy as np

    from dousa.experiments import inject_many

    best: Injection | None = None
    for draw in range(_N_DRAWS):
        rng = np.random.default_rng([seed, draw])
        injection = inject_many(motion, _KINDS, rng, gap_s=_APART_S)
        if injection is not None and (best is None or len(injection.errors) > len(best.errors)):
            best = injection
        if best is not None and len(best.errors) == len(_KINDS):
            return best
    if best is None:
        raise OptionError("demo.no_place_for_an_error", seed=seed)
    return best


def run_dance_demo(console: Console, output: Path, *, seed: int = 0) -> None:
    """Make a dance and a pupil's performance of it, evaluate the files, and compare with the truth.

    Can be run again into the same folder, which gets both BVH files and the folder ``report``.
    """
    from dousa.app.output import make_folder, progress_bar, warn
    from dousa.app.pipelines.evaluate import evaluate_files
    from dousa.app.report import write_report
    from dousa.app.tables.evaluation import print_assessment
    from dousa.formats.motion_files import ReadOptions

    make_folder(output)
    started = time.perf_counter()
    reference, pupil, errors = write_dance(output, seed)
    say(
        console,
        f"\nA dance of six figures: {reference}, and a pupil of another build who makes {len(errors)} errors on "
        f"purpose: {pupil}",
    )
    folder = output / REPORT
    with progress_bar() as progress:
        done = evaluate_files([reference], pupil, options=ReadOptions(), progress=progress)
        page = write_report(done.assessment, folder)
    print_assessment(console, done.assessment)
    for text in done.assessment.warnings:
        warn(str(text))
    _print_comparison(console, errors, done.assessment.events)
    console.print(f"Evaluated in {time.perf_counter() - started:.0f} s. The same again:")
    say(console, f"  dousa evaluate {reference} --performance {pupil} -o {folder}")
    say(console, f"Open the report in a browser: {page}")


def compare_with_truth(
    errors: Sequence[Error], events: Sequence[ErrorEvent]
) -> tuple[list[tuple[Error, ErrorEvent | None, bool]], list[ErrorEvent]]:
    """Which event belongs to which injected error.

    Parameters
    ----------
    errors : the truth.
    events : what was found.

    Returns
    -------
    pairs : each error; the event that belongs to it or None; and whether that one is of the error's class and
        overlaps it by half (intersection over union), as in the experiment.
    others : events that belong to no error: false alarms, or what the pupil really does differently.
    """
    from dousa.experiments.error_results import compute_overlap, match_events

    matched = dict(match_events(errors, events))
    left = [event for j, event in enumerate(events) if j not in matched.values()]
    pairs: list[tuple[Error, ErrorEvent | None, bool]] = []
    for i, error in enumerate(errors):
        best = max(((compute_overlap(error, event), -j) for j, event in enumerate(left)), default=(0.0, 0))
        near = left[-best[1]] if best[0] >= _TOUCH else None
        pairs.append((error, events[matched[i]] if i in matched else near, i in matched))
    used = [event for _, event, _ in pairs]
    return pairs, [event for event in events if not any(event is other for other in used)]


def _print_comparison(console: Console, errors: Sequence[Error], events: Sequence[ErrorEvent]) -> None:
    from rich.table import Table

    from dousa.evaluation.words import KINDS, describe_segments, format_time

    pairs, others = compare_with_truth(errors, events)
    table = Table(box=None, title="What was done wrong on purpose, and what of it was found", title_justify="left")
    for name in ("time", "injected", "where and how much", "found", "start off by"):
        table.add_column(name)
    for error, event, right in pairs:
        when = f"{format_time(error.start_s)}-{format_time(error.end_s)}"
        where = describe_segments(error.segments) + _describe_size(error)
        verdict, onset = "[red]no[/]", ""
        if event is not None:
            kind = "in part" if event.kind == error.kind else f"as {KINDS[event.kind]}"
            verdict = "[green]yes[/]" if right else f"[yellow]{kind}[/]"
            verdict += _describe_size(event)
            onset = f"{1000 * (event.start_s - error.start_s):+.0f} ms"
        table.add_row(when, str(KINDS[error.kind]), where, verdict, onset)
    console.print(table)
    found = sum(right for _, _, right in pairs)
    plural = "event" if len(others) == 1 else "events"
    console.print(f"{found} of {len(pairs)} found and named right; {len(others)} other {plural} reported.")


def _describe_size(what: Error | ErrorEvent) -> str:
    if what.lag_ms is not None:
        return f", {abs(what.lag_ms):.0f} ms {'late' if what.lag_ms > 0 else 'early'}"
    if what.shortfall_deg is not None:
        return f", {what.shortfall_deg:.0f} deg short"
    return ""
