"""Commands that prepare films: their times, their cameras and their keypoints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import print_json, progress_bar, say, warn
from dousa.app.requests.estimation import CalibrationRequest, Films, KeypointRequest
from dousa.app.targets import CAMERAS, SYNC, check_targets
from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.estimation import Calibration, Synchronisation

_PICTURES = (".png", ".svg", ".pdf")
_BASIS = {
    "reference": "sync.basis_reference",
    "movement": "sync.basis_movement",
    "sound": "sync.basis_sound",
    "both": "sync.basis_both",
}


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    for command in (sync, calibrate, keypoints):
        app.command(rich_help_panel="Estimation")(command)


def sync(
    films: Films,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help="Time offsets to write (.toml).")
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", metavar="FILE", help="Calibration, if there is one: more exact."),
    ] = None,
    json: Json = False,
) -> None:
    """Find the time offsets of films of one scene, to a fraction of a frame.

    By the movement of a person whom all cameras see, and by sound where the
    films have it. A film's own time plus its offset is the time of the first
    film.

    Example: dousa sync left.mp4 front.mp4 right.mp4 -o sync.toml
    """
    from dousa.app.pipelines.film_cameras import sync_films

    check_targets({"--output": output}, (*films, cameras), SYNC)
    with progress_bar() as progress:
        names, found = sync_films(films, cameras, progress)
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
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="Cameras to write (.toml), for --cameras; and a picture (.png, .svg, .pdf) of where they stand.",
        ),
    ] = None,
    *,
    given: Annotated[dict[str, Any], CalibrationRequest],
    json: Json = False,
) -> None:
    """Find where the cameras of films stand, from a person who moves before them or from a board.

    The cameras stand still. With a person nothing else is needed but the
    stature; up and floor come from the feet. The file is for --cameras of
    estimate and render.

    Example: dousa calibrate left.mp4 front.mp4 right.mp4 --stature 1.75 -o calib.toml

    Example: dousa calibrate a.mp4 b.mp4 --board charuco:5x7:40mm:30mm -o calib.toml
    """
    from dousa.app.pipelines.film_cameras import calibrate_films

    request = CalibrationRequest(tuple(films), **given)
    pictures = [path for path in output or () if path.suffix.lower() in _PICTURES]
    tables = [path for path in output or () if path not in pictures]
    if len(pictures) > 1 or len(tables) > 1:
        kind = pictures if len(pictures) > 1 else tables
        raise OptionError("outputs.two_of_a_kind", path=kind[1], other=kind[0])
    table, picture = next(iter(tables), None), next(iter(pictures), None)
    for path in (table, picture):
        check_targets({"--output": path}, (*films, request.cameras, request.offsets), CAMERAS)
    with progress_bar() as progress:
        found, times = calibrate_films(request, progress)
    notes = (*(times.warnings if times is not None else ()), *found.warnings)
    for note in notes:
        warn(note)
    if table is not None:
        from dousa.estimation import write_cameras

        write_cameras(table, found.cameras)
    if picture is not None:
        from dousa.app.pipelines.film_cameras import draw_cameras

        draw_cameras(found, picture)
    if json:
        print_json(_describe(found, times, notes, table))
        return
    for camera, view in zip(found.cameras, found.views, strict=True):
        x, y, z = camera.position
        values = {"x": x, "y": y, "z": z, "focal": camera.matrix[0, 0], "residual": view.residual}
        values |= {"share": 100 * view.share, "degrees": math.degrees(view.turn)}
        say(Message("calibration.row", camera=camera.name, **values))
    say(Message("calibration.parallax", degrees=math.degrees(found.parallax)))
    for path in (table, picture):
        if path is not None:
            say(Message("estimated.wrote", path=path))


def _describe(
    found: Calibration, times: Synchronisation | None, notes: tuple[Message, ...], output: Path | None
) -> dict[str, object]:
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


_STATES = {"installed": "models.state_installed", "missing": "models.state_missing", "damaged": "models.state_damaged"}


def keypoints(
    films: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILM...]",
            help="Films of people, one for each view. Without any the models are listed.",
        ),
    ] = None,
    *,
    given: Annotated[dict[str, Any], KeypointRequest],
    install: Annotated[
        bool,
        typer.Option(
            "--install",
            help="Install the models. FILM is then a package that you have (.tgz of npm, .whl of MediaPipe) or a model "
            "(.tflite), instead of fetching.",
        ),
    ] = False,
    clear_cache: Annotated[
        bool, typer.Option("--clear-cache", help="Delete the keypoints that are kept of films.")
    ] = False,
    json: Json = False,
) -> None:
    """Find keypoints of the people in films: 33 points of each body, frame by frame, and who is who.

    Needs models: --install takes them out of a published package (npm
    @mediapipe/pose, else the pip wheel of mediapipe), checks their SHA-256 and
    keeps them in the user's cache folder, or that of DOUSA_MODELS. Nothing is
    fetched otherwise. The keypoints of films are kept in the user's cache, 4 GB
    of them; an interrupted run resumes when the same command is run again.

    Example: dousa keypoints --install

    Example: dousa keypoints left.mp4 front.mp4 -o keypoints --sheet
    """
    if install or clear_cache or not films:
        if (install and len(films or ()) > 1) or (films and not install):
            raise OptionError("models.one_source")
        _manage_models(films[0] if films else None, install=install, clear_cache=clear_cache, json=json)
        return
    from dousa.app.pipelines.keypoints import describe_found, find_in_films

    request = KeypointRequest(tuple(films), **given)
    with progress_bar() as progress:
        done = find_in_films(request, progress)
    for found in done:
        for text in found.keypoints.warnings:
            warn(text)
    if json:
        print_json({"model": request.model, "films": [found.to_json() for found in done]})
        return
    for found in done:
        for line in describe_found(found):
            say(line)


def _manage_models(source: Path | None, *, install: bool, clear_cache: bool, json: bool) -> None:
    from dousa.estimation.keypoints import keypoint_cache, pose_models

    cache = pose_models.user_cache() / "keypoints"
    installed: tuple[Path, ...] = ()
    if install:
        with progress_bar() as progress:
            installed = pose_models.install_models((), source, progress)
    removed = keypoint_cache.clear_kept(cache) if clear_cache else []
    kept = keypoint_cache.list_kept(cache)
    rows = [(model, pose_models.check_pose_model(model)) for model in pose_models.POSE_MODELS]
    folder = pose_models.models_folder()
    if json:
        answer = {
            "folder": str(folder),
            "models": {model.name: {"file": model.file_name, "state": state} for model, state in rows},
            "installed": [str(path) for path in installed],
            "cache": {"folder": str(cache), "films": len(kept), "bytes": sum(film.n_bytes for film in kept)},
            "removed": len(removed),
        }
        print_json(answer)
        return
    lines = [Message("models.folder", path=folder)]
    for model, state in rows:
        size = model.forms[0].n_bytes / 1e6
        lines.append(Message("models.row", model=model.name, megabytes=size, state=Message(_STATES[state])))
    if removed:
        lines.append(Message("models.cleared", n=len(removed), megabytes=sum(film.n_bytes for film in removed) / 1e6))
    lines.append(Message("models.cache", n=len(kept), megabytes=sum(film.n_bytes for film in kept) / 1e6, path=cache))
    lines.append(Message("models.licence", npm=pose_models.NPM_PACKAGE, pip=pose_models.PIP_PACKAGE))
    for line in lines:
        say(line)
