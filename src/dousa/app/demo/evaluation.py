"""The demonstration's second act: a dance, a pupil who makes one mistake of each kind, and what is found of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.demo.takes import say

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import ErrorEvent
    from dousa.motion.synthetic import Mistake

REFERENCE, PUPIL, REPORT = "dance_reference.bvh", "dance_pupil.bvh", "report"

_PUPIL = 41  # number of the performer who plays the pupil
_TOUCH = 0.1  # intersection over union from which an event has to do with a mistake


def write_dance(output: Path, seed: int = 0) -> tuple[Path, Path, tuple[Mistake, ...]]:
    """Write the reference dance and the pupil's as BVH files.

    Parameters
    ----------
    output : folder, must exist.
    seed : of the dancers, their takes and the mistakes.

    Returns
    -------
    reference, pupil : the files.
    mistakes : what was done wrong on purpose, in order of time.

    Raises
    ------
    MotionWriteError : the files cannot be written.
    OptionError : a negative seed.
    """
    import dataclasses

    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic import Performer, draw_performer, make_dance, make_mistakes

    reference = make_dance(Performer(name="teacher", seed=1000 * seed), seed)
    # Another body and posture, but someone who has learned the dance: the mistakes are put in afterwards.
    drawn = draw_performer(1000 * seed + _PUPIL, "pupil")
    pupil = dataclasses.replace(drawn, amplitude=1.0, noise=1.0, left_handed=False)
    performed, mistakes = make_mistakes(make_dance(pupil, seed + 1), seed)
    paths = output / REFERENCE, output / PUPIL
    write_motion(reference.motion, paths[0])
    write_motion(performed, paths[1])
    return *paths, mistakes


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
    reference, pupil, mistakes = write_dance(output, seed)
    say(
        console,
        f"\nA dance of six figures: {reference}, and a pupil of another build who makes {len(mistakes)} mistakes on "
        f"purpose: {pupil}",
    )
    folder = output / REPORT
    with progress_bar() as progress:
        done = evaluate_files([reference], pupil, options=ReadOptions(), progress=progress)
        page = write_report(done.assessment, folder)
    print_assessment(console, done.assessment)
    for text in done.assessment.warnings:
        warn(str(text))
    _print_comparison(console, mistakes, done.assessment.events)
    console.print(f"Evaluated in {time.perf_counter() - started:.0f} s. The same again:")
    say(console, f"  dousa evaluate {reference} --performance {pupil} -o {folder}")
    say(console, f"Open the report in a browser: {page}")


def match_mistakes(mistakes: Sequence[Mistake], events: Sequence[ErrorEvent]) -> list[ErrorEvent | None]:
    """Return for each mistake the event that overlaps it most, of its kind if there is one, else None."""

    def overlap(mistake: Mistake, event: ErrorEvent) -> tuple[bool, float]:
        shared = min(mistake.end_s, event.end_s) - max(mistake.start_s, event.start_s)
        parts = not mistake.segments or bool(set(mistake.segments) & set(event.segments))
        share = shared / (max(mistake.end_s, event.end_s) - min(mistake.start_s, event.start_s)) if parts else 0.0
        return event.kind == mistake.kind and share >= _TOUCH, share

    best = [max(events, key=lambda event: overlap(mistake, event), default=None) for mistake in mistakes]
    return [
        event if event is not None and overlap(mistake, event)[1] >= _TOUCH else None
        for mistake, event in zip(mistakes, best, strict=True)
    ]


def _print_comparison(console: Console, mistakes: Sequence[Mistake], events: Sequence[ErrorEvent]) -> None:
    from rich.table import Table

    from dousa.evaluation.words import KINDS, describe_segments, format_time

    found = match_mistakes(mistakes, events)
    table = Table(box=None, title="What was done wrong on purpose, and what of it was found", title_justify="left")
    for name in ("time", "injected", "where and how much", "found", "start off by"):
        table.add_column(name)
    for mistake, event in zip(mistakes, found, strict=True):
        when = f"{format_time(mistake.start_s)}-{format_time(mistake.end_s)}"
        where = (describe_segments(mistake.segments) if mistake.segments else "whole body") + _describe_size(mistake)
        verdict, onset = "[red]no[/]", ""
        if event is not None:
            verdict = "[green]yes[/]" if event.kind == mistake.kind else f"[yellow]as {KINDS[event.kind]}[/]"
            verdict += _describe_size(event)
            onset = f"{1000 * (event.start_s - mistake.start_s):+.0f} ms"
        table.add_row(when, str(KINDS[mistake.kind]), where, verdict, onset)
    console.print(table)
    right = sum(
        event is not None and event.kind == mistake.kind for mistake, event in zip(mistakes, found, strict=True)
    )
    others = sum(not any(event is other for other in found) for event in events)
    plural = "event" if others == 1 else "events"
    console.print(f"{right} of {len(mistakes)} found and named right; {others} other {plural} reported.")


def _describe_size(what: Mistake | ErrorEvent) -> str:
    if what.lag_ms is not None:
        return f", {abs(what.lag_ms):.0f} ms {'late' if what.lag_ms > 0 else 'early'}"
    if what.shortfall_deg is not None:
        return f", {what.shortfall_deg:.0f} deg short"
    return ""
