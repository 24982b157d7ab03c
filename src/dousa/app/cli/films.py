"""Commands that prepare films of one scene: their times and their cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app.cli.options import shared as o
from dousa.app.output import print_json, progress_bar, say, warn
from dousa.messages import Message

Films = Annotated[
    list[Path],
    typer.Argument(metavar="FILM...", help="A film for each camera, or a file of its keypoints (.npz, .json)."),
]
Model = Annotated[
    Literal["lite", "full", "heavy"],
    typer.Option("--model", help="The pose model that finds keypoints in films: the more precise the slower."),
]
_BASIS = {
    "reference": "sync.basis_reference",
    "movement": "sync.basis_movement",
    "sound": "sync.basis_sound",
    "both": "sync.basis_both",
}


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    app.command(rich_help_panel="Estimation")(sync)


def sync(
    films: Films,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help="Time offsets to write (.toml).")
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", metavar="FILE", help="Calibration, if there is one: more exact."),
    ] = None,
    sound: Annotated[bool, typer.Option("--sound/--no-sound", help="Listen to the sound of the films too.")] = True,
    model: Model = "full",
    json: o.Json = False,
) -> None:
    """The time offsets of films of one scene, to a fraction of a frame.

    By the movement of a person whom all cameras see, and by sound where the
    films have it. A film's own time plus its offset is the time of the first
    film.

    Example: dousa sync left.mp4 front.mp4 right.mp4 -o sync.toml
    """
    from dousa.app.films.film_sync import sync_films

    with progress_bar() as progress:
        names, found = sync_films(films, cameras, sound, model, progress)
    for note in found.warnings:
        warn(note)
    if output is not None:
        from dousa.estimation import write_offsets

        write_offsets(output, names, found)
    if json:
        rows = zip(names, found.offsets, found.spreads, found.basis, found.by_sound, strict=True)
        keys = ("name", "offset", "spread", "basis", "by_sound")
        warnings = [note.to_json() for note in found.warnings]
        answer = {"films": [dict(zip(keys, row, strict=True)) for row in rows], "misfit": found.misfit}
        print_json({**answer, "warnings": warnings, "output": None if output is None else str(output)})
        return
    for name, offset, spread, basis in zip(names, found.offsets, found.spreads, found.basis, strict=True):
        values = {"offset": offset, "spread": 1e3 * spread, "basis": Message(_BASIS[basis])}
        say(Message("sync.row" if basis != "reference" else "sync.row_reference", film=name, **values))
    if output is not None:
        say(Message("estimated.wrote", path=output))
