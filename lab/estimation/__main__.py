"""How accurate estimated poses are, on sequences whose true joints are known.

python -m lab.estimation FOLDER [--views 1,2,4] [--variant clean] [--json]
python -m lab.estimation SEQUENCE.npz --paper
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import ProgressCallback, console, print_json, progress_bar, warn
from dousa.errors import OptionError
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.experiments.table import Result
from dousa.messages import Message
from lab.command_line import Jobs, run_command


class ReadingName(enum.StrEnum):
    """Readings of eq. 2 of the paper."""

    MASKED = "masked"
    RESIDUAL = "residual"
    UNION = "union"
    PLAIN = "plain"
    LITERAL = "literal"


class Evidence(enum.StrEnum):
    """How the mismatch is weighted against inertia."""

    LOG = "log"
    LOCAL = "local"
    GLOBAL = "global"


class VariantName(enum.StrEnum):
    """Kinds of sequences, by the ends of their names."""

    CLEAN = "clean"
    NOISY = "noisy"


StartName = Literal["truth", "auto"]

BodyName = Literal["stature", "start"]

ViewChoiceName = Literal["first", "all"]


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """What the tracker is given, and how it searches."""

    views: Annotated[
        str, typer.Option("--views", metavar="N,N...", help="Numbers of views to evaluate, each in turn.")
    ] = "1,2,4"
    choice: Annotated[
        ViewChoiceName,
        typer.Option(
            "--choice",
            help="first: one view is the first, two are it and the one most nearly at right angles to it; all: "
            "every choice, averaged.",
        ),
    ] = "first"
    variant: Annotated[
        list[VariantName] | None,
        typer.Option(
            "--variant",
            help="Only files of a folder whose names end in this; can be repeated.",
            show_default="both",
        ),
    ] = None
    start: Annotated[
        StartName,
        typer.Option("--start", help="truth: the true joints of the first frame are given; auto: the start is found."),
    ] = "truth"
    body: Annotated[
        BodyName,
        typer.Option("--body", help="stature: from tables; start: also the bones that the first frame shows."),
    ] = "stature"
    reading: Annotated[
        list[ReadingName] | None,
        typer.Option("--reading", help="Reading of eq. 2; with --paper several.", show_default="masked"),
    ] = None
    evidence: Annotated[
        list[Evidence] | None,
        typer.Option(
            "--evidence",
            help="How image and inertia are weighted; with --paper several.",
            show_default="log",
        ),
    ] = None

    @property
    def readings(self) -> list[str]:
        """The readings named."""
        return [name.value for name in self.reading or ()]

    @property
    def evidences(self) -> list[str]:
        """The ways of weighting named."""
        return [name.value for name in self.evidence or ()]


@dataclass(frozen=True, slots=True)
class PaperOptions:
    """The experiment of the paper."""

    paper: Annotated[
        bool,
        typer.Option("--paper", help="The paper's experiment on one PATH: all readings, dR = 6 deg, s = 1 deg."),
    ] = False
    frames: Annotated[
        str | None,
        typer.Option("--frames", metavar="FIRST:STOP", help="Frames of --paper, from 0.", show_default="40:76"),
    ] = None


def experiment_estimation(
    path: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...",
            help="Sequences (.npz) with masks, cameras, stature and true joints, or folders of them.",
        ),
    ],
    *,
    trial_options: TrialOptions,
    paper_options: PaperOptions,
    jobs: Jobs = None,
    json: Json = False,
) -> None:
    """Measure the accuracy of estimated poses, with static-pose and constant-velocity baselines.

    The tracker is given the first frame's joints and the stature, nothing else.
    Errors in space are in mm: raw, with the hips moved onto the true ones, and
    after the best rotation and translation of each frame (posture).

    Example: python -m lab.estimation silhouette_bench/ --variant clean

    Example: python -m lab.estimation silhouette_bench/cmu86_walk_clean.npz --paper
    """
    from dousa.app.tables.lines import print_tables

    counts = _parse_views(trial_options.views)
    if paper_options.frames is not None and not paper_options.paper:
        raise OptionError("experiments_cli.frames_without_paper")
    result: Result
    problems: Sequence[Message] = ()
    with progress_bar() as progress:
        if paper_options.paper:
            _check_paper(path, trial_options)
            result = _run_paper(path[0], counts, trial_options, paper_options.frames, jobs, progress)
        else:
            from lab.estimation.experiment import run_bench

            result = bench = run_bench(
                path,
                views=counts,
                choice=trial_options.choice,
                variants=[name.value for name in trial_options.variant or VariantName],
                settings=_choose_settings(trial_options),
                start=trial_options.start,
                body=trial_options.body,
                n_jobs=jobs or -1,
                progress=progress,
            )
            problems = bench.problems
    if json:
        print_json(result)
        return
    print_tables(console(), result.to_tables())
    for problem in problems:
        warn(problem)


def _parse_views(text: str) -> list[int]:
    try:
        counts = [int(word) for word in text.split(",")]
    except ValueError:
        counts = []
    if not counts or min(counts) < 1:
        raise OptionError("experiments_cli.views", found=text)
    return list(dict.fromkeys(counts))


def _parse_frames(text: str) -> tuple[int, int]:
    first, colon, stop = text.partition(":")
    if not (colon and first.isdecimal() and stop.isdecimal() and int(first) + 1 < int(stop)):
        raise OptionError("experiments_cli.frames", found=text)
    return int(first), int(stop)


def _choose_settings(options: TrialOptions) -> TrackerSettings:
    from dousa.estimation.tracking.settings import TrackerSettings

    settings = TrackerSettings()
    for name, values in (("reading", options.readings), ("evidence", options.evidences)):
        if len(values) > 1:
            raise OptionError("experiments_cli.several_without_paper", option=f"--{name}")
        if values:
            settings = replace(settings, **{name: values[0]})  # type: ignore[arg-type]
    return settings


def _check_paper(path: Sequence[Path], options: TrialOptions) -> None:
    if len(path) != 1 or not path[0].is_file():
        raise OptionError("experiments_cli.paper_sequence")
    kept = ("truth", "stature", "first")
    if (options.start, options.body, options.choice) != kept or options.variant:
        raise OptionError("experiments_cli.paper_options")


def _run_paper(
    path: Path,
    views: Sequence[int],
    options: TrialOptions,
    frames: str | None,
    jobs: int | None,
    progress: ProgressCallback,
) -> Result:
    from dousa.estimation.tracking.settings import EVIDENCES, READINGS
    from lab.estimation.readings import WALKING, run_reading_table

    return run_reading_table(
        path,
        frames=WALKING if frames is None else _parse_frames(frames),
        views=views,
        readings=options.readings or READINGS,  # type: ignore[arg-type]  # checked by the option
        evidences=options.evidences or EVIDENCES,  # type: ignore[arg-type]
        n_jobs=jobs or -1,
        progress=progress,
    )


if __name__ == "__main__":
    run_command(experiment_estimation)
