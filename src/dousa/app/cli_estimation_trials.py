"""The command that measures estimation against the truth: experiment-estimation."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app import _options as o
from dousa.app._output import ProgressCallback, console, print_json, progress_bar, warn
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.estimation._types import TrackerSettings

__all__ = ["register"]


class StartName(enum.StrEnum):
    """What the tracker is told about the first frame."""

    TRUTH = "truth"
    AUTO = "auto"


class BodyName(enum.StrEnum):
    """What the body is made from."""

    STATURE = "stature"
    START = "start"


class ViewChoiceName(enum.StrEnum):
    """Which views stand for fewer than all."""

    FIRST = "first"
    ALL = "all"


class VariantName(enum.StrEnum):
    """Kinds of sequences, told by the ends of their names."""

    CLEAN = "clean"
    NOISY = "noisy"


def register(app: typer.Typer) -> None:
    """Hang this module's command on the application."""
    app.command("experiment-estimation", rich_help_panel="Estimation")(experiment_estimation)


def experiment_estimation(
    path: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...",
            help="Sequences (.npz) with masks, cameras, stature and true joints, or folders of them.",
        ),
    ],
    views: Annotated[
        str, typer.Option("--views", metavar="N,N...", help="How many views to look at, each number in turn.")
    ] = "1,2,4",
    choice: Annotated[
        ViewChoiceName,
        typer.Option(
            "--choice",
            help="first: one view is the first, two are it and the one most nearly square to it; all: every choice, "
            "averaged.",
        ),
    ] = ViewChoiceName.FIRST,
    variant: Annotated[
        list[VariantName] | None,
        typer.Option(
            "--variant",
            help="Only files of a folder whose names end so; can be given twice.",
            show_default="both",
        ),
    ] = None,
    start: Annotated[
        StartName,
        typer.Option(
            "--start", help="truth: the true joints of the first frame are told; auto: the start is found."
        ),
    ] = StartName.TRUTH,
    body: Annotated[
        BodyName,
        typer.Option(
            "--body", help="stature: from tables; start: also the bones that the first frame shows."
        ),
    ] = BodyName.STATURE,
    reading: Annotated[
        list[o.Reading] | None,
        typer.Option("--reading", help="How eq. 2 is read; with --paper several.", show_default="masked"),
    ] = None,
    evidence: Annotated[
        list[o.Evidence] | None,
        typer.Option(
            "--evidence",
            help="How the image is weighed against inertia; with --paper several.",
            show_default="log",
        ),
    ] = None,
    paper: Annotated[
        bool,
        typer.Option(
            "--paper", help="The paper's experiment on one PATH: all readings, dR = 6 deg, s = 1 deg."
        ),
    ] = False,
    frames: Annotated[
        str | None,
        typer.Option(
            "--frames", metavar="FIRST:STOP", help="Frames of --paper, from 0.", show_default="40:76"
        ),
    ] = None,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """How near do estimated poses come to the truth? Beside the first pose held, and constant velocity.

    The tracker is told the first frame's joints and the stature, nothing else.
    Errors in space are in mm: raw, with the hips moved onto the true ones, and
    after the best rotation and translation of each frame (posture).

    Example: dousa experiment-estimation silhouette_bench/ --variant clean

    Example: dousa experiment-estimation silhouette_bench/cmu86_walk_clean.npz --paper
    """
    counts = _parse_views(views)
    if frames is not None and not paper:
        raise OptionError("--frames belongs to --paper; leave it out, or add --paper")
    readings, evidences = ([name.value for name in names or ()] for names in (reading, evidence))
    with progress_bar() as progress:
        if paper:
            _check_paper(path, start, body, choice, variant)
            answer = _run_paper(path[0], counts, readings, evidences, frames, jobs, progress)
        else:
            from dousa.estimation.experiment import run_bench

            answer = run_bench(
                path,
                views=counts,
                choice=choice.value,  # type: ignore[arg-type]  # of the same words
                variants=[name.value for name in variant or VariantName],
                settings=_choose_settings(readings, evidences),
                start=start.value,  # type: ignore[arg-type]
                body=body.value,  # type: ignore[arg-type]
                n_jobs=jobs or -1,
                progress=progress,
            ).to_json()
    if json:
        print_json(answer)
        return
    from dousa.app import _estimation_trial_tables as tables

    (tables.print_paper if paper else tables.print_bench)(console(), answer)
    for row in answer.get("clips", ()):
        if row["problem"]:
            where = f"{row['clip']} {row['variant']}, views {', '.join(map(str, row['views']))}"
            warn(f"{where}: {row['problem']}")


def _parse_views(text: str) -> list[int]:
    try:
        counts = [int(word) for word in text.split(",")]
    except ValueError:
        counts = []
    if not counts or min(counts) < 1:
        raise OptionError(f"--views: expected numbers of views such as 1,2,4, got '{text}'")
    return list(dict.fromkeys(counts))


def _parse_frames(text: str) -> tuple[int, int]:
    first, colon, stop = text.partition(":")
    if not (colon and first.isdecimal() and stop.isdecimal() and int(first) + 1 < int(stop)):
        raise OptionError(f"--frames: expected two frames or more, such as 40:76, got '{text}'")
    return int(first), int(stop)


def _choose_settings(readings: Sequence[str], evidences: Sequence[str]) -> TrackerSettings:
    from dousa.estimation._types import TrackerSettings

    settings = TrackerSettings()
    for name, values in (("reading", readings), ("evidence", evidences)):
        if len(values) > 1:
            raise OptionError(f"--{name}: several are compared with --paper only; give one, or add --paper")
        if values:
            settings = replace(settings, **{name: values[0]})  # type: ignore[arg-type]
    return settings


def _check_paper(
    path: Sequence[Path],
    start: StartName,
    body: BodyName,
    choice: ViewChoiceName,
    variant: Sequence[VariantName] | None,
) -> None:
    if len(path) != 1 or not path[0].is_file():
        raise OptionError(
            "--paper repeats the experiment on one sequence; give one .npz file, such as cmu86_walk_clean.npz"
        )
    kept = (StartName.TRUTH, BodyName.STATURE, ViewChoiceName.FIRST)
    if (start, body, choice) != kept or variant:
        raise OptionError(
            "--paper goes by the true start, the stature and the first choice of views; leave --start, --body, "
            "--choice and --variant out"
        )


def _run_paper(
    path: Path,
    views: Sequence[int],
    readings: Sequence[str],
    evidences: Sequence[str],
    frames: str | None,
    jobs: int | None,
    progress: ProgressCallback,
) -> dict[str, Any]:
    from dousa.estimation._types import EVIDENCES, READINGS
    from dousa.estimation.experiment import WALKING, run_reading_table

    return run_reading_table(
        path,
        frames=WALKING if frames is None else _parse_frames(frames),
        views=views,
        readings=readings or READINGS,  # type: ignore[arg-type]  # checked by the option
        evidences=evidences or EVIDENCES,  # type: ignore[arg-type]
        n_jobs=jobs or -1,
        progress=progress,
    ).to_json()
