"""Commands that prepare films of one scene: their times and their cameras."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from dousa.app.cli.options import shared as o
from dousa.app.output import print_json, progress_bar, say, warn
from dousa.app.targets import CAMERAS, SYNC, check_targets
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.estimation import Calibration, Synchronisation

Films = Annotated[
    list[Path],
    typer.Argument(metavar="FILM...", help="A film for each camera, or a file of its keypoints (.npz, .json)."),
]
Model = Annotated[
    Literal["lite", "full", "heavy"] | None,
    typer.Option("--model", help="Network for keypoints. Default: the most precise that is installed."),
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
    app.command(rich_help_panel="Estimation")(calibrate)


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
    model: Model = None,
    json: o.Json = False,
) -> None:
    """The time offsets of films of one scene, to a fraction of a frame.

    By the movement of a person whom all cameras see, and by sound where the
    films have it. A film's own time plus its offset is the time of the first
    film.

    Example: dousa sync left.mp4 front.mp4 right.mp4 -o sync.toml
    """
    from dousa.app.pipelines.film_cameras import sync_films

    check_targets({"--output": output}, (*films, cameras), SYNC)
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


def calibrate(
    films: Films,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help="Cameras to write (.toml), for --cameras.")
    ] = None,
    stature: Annotated[
        float | None, typer.Option("--stature", metavar="M", help="Stature of the person in metres.")
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(
            "--board",
            metavar="BOARD",
            help="Instead of a person: chessboard:9x6:25mm (inner corners, square) or charuco:5x7:40mm:30mm "
            "(squares, square, marker; DICT_4X4_50 or :DICTIONARY).",
        ),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", metavar="FILE", help="Calibration whose focal lengths and distortion are right."),
    ] = None,
    focal: Annotated[
        float | None,
        typer.Option(
            "--focal-length", "--focal", metavar="PX", help="Focal length of all cameras in pixels. Default: found."
        ),
    ] = None,
    offsets: Annotated[
        Path | None, typer.Option("--sync", metavar="FILE", help="Time offsets of dousa sync. Default: found.")
    ] = None,
    together: Annotated[bool, typer.Option("--together", help="The films begin at one moment.")] = False,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="OUT", help="Picture (.png, .svg, .pdf) of where the cameras stand."),
    ] = None,
    model: Model = None,
    json: o.Json = False,
) -> None:
    """Where the cameras of films stand, from a person who moves before them or from a board.

    The cameras stand still. With a person nothing else is needed but the
    stature; up and floor come from the feet. The file is for --cameras of
    estimate and render.

    Example: dousa calibrate left.mp4 front.mp4 right.mp4 --stature 1.75 -o calib.toml

    Example: dousa calibrate a.mp4 b.mp4 --board charuco:5x7:40mm:30mm -o calib.toml
    """
    from dousa.app.pipelines.film_cameras import CalibrationRequest, calibrate_films

    request = CalibrationRequest(tuple(films), stature, board, cameras, focal, offsets, together, model)
    check_targets({"--output": output, "--picture": picture}, (*films, cameras, offsets), CAMERAS)
    with progress_bar() as progress:
        found, times = calibrate_films(request, progress)
    notes = (*(times.warnings if times is not None else ()), *found.warnings)
    for note in notes:
        warn(note)
    if output is not None:
        from dousa.estimation import write_cameras

        write_cameras(output, found.cameras)
    if picture is not None:
        from dousa.app.pipelines.film_cameras import draw_cameras

        draw_cameras(found, picture)
    if json:
        print_json(_describe(found, times, notes, output))
        return
    for camera, view in zip(found.cameras, found.views, strict=True):
        x, y, z = camera.position
        values = {"x": x, "y": y, "z": z, "focal": camera.matrix[0, 0], "residual": view.residual}
        values |= {"share": 100 * view.share, "degrees": math.degrees(view.turn)}
        say(Message("calibration.row", camera=camera.name, **values))
    say(Message("calibration.parallax", degrees=math.degrees(found.parallax)))
    for path in (output, picture):
        if path is not None:
            say(Message("estimated.wrote", path=path))


def _describe(
    found: Calibration, times: Synchronisation | None, notes: tuple[Message, ...], output: Path | None
) -> dict[str, object]:
    """The answer of ``dousa calibrate --json``."""
    rows = [
        {
            "name": camera.name,
            "position": camera.position,
            "focal": camera.matrix[0, 0],
            "residual_px": view.residual,
            "share": view.share,
            "turn_degrees": math.degrees(view.turn),
            "n_points": view.n_points,
        }
        for camera, view in zip(found.cameras, found.views, strict=True)
    ]
    return {
        "cameras": rows,
        "parallax_degrees": math.degrees(found.parallax),
        "offsets": None if times is None else times.offsets,
        "warnings": [note.to_json() for note in notes],
        "output": None if output is None else str(output),
    }
