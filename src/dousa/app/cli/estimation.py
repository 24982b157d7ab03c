"""Commands of estimation: estimate and render, and those that prepare films: sync, calibrate and keypoints."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import console, print_json, progress_bar, say, warn
from dousa.app.requests.estimation import (
    Backgrounds,
    CalibrationRequest,
    EstimationRequest,
    Films,
    KeypointRequest,
    Outputs,
    RenderRequest,
    SettingsFile,
    Sources,
    SynchronisationRequest,
    parse_size,
    read_settings,
)
from dousa.app.requests.reading import Reading
from dousa.app.targets import CAMERAS, PICTURES, SYNC, check_targets
from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.estimation import Calibration, Synchronisation

_BASIS = {
    "reference": "sync.basis_reference",
    "movement": "sync.basis_movement",
    "sound": "sync.basis_sound",
    "both": "sync.basis_both",
}
_STATES = {"installed": "models.state_installed", "missing": "models.state_missing", "damaged": "models.state_damaged"}


def estimate(
    sources: Sources,
    *,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="File to write; repeatable. Motions: .bvh, .trc, .c3d, .mot, .npz ...; a video (.mp4) or contact "
            "sheet (.png) of the outlines of silhouette and model.",
        ),
    ] = None,
    angles: Annotated[
        Path | None,
        typer.Option("--angles", metavar="OUT", help="Write the joint angles as CSV too: degrees, OpenSim's names."),
    ] = None,
    backgrounds: Backgrounds = None,
    given: Annotated[dict[str, Any], EstimationRequest],
    settings: SettingsFile = None,
    reading: Reading,
    json: Json = False,
) -> None:
    """Estimate joint angles from films or silhouettes of one or more calibrated views.

    Films need nothing prepared once dousa keypoints --install was run: people are
    found by a learned network (--cues keypoints), and a body is fitted to
    them. Without --cameras, cameras are placed by the person (--stature).
    Otherwise silhouettes are tracked.

    --read is about the motion files of --start and --body. An interrupted run resumes when the same command is
    run again. A single view gives no depth.

    Example: dousa estimate jump.npz --start jump.trc:0 -o jump.bvh -o jump.mp4

    Example: dousa estimate cam1.mp4 cam2.mp4 --cameras calib.toml --background bg1.png bg2.png
    --stature 1.75 -o walk.bvh

    Example: dousa estimate cam01_json cam02_json --calibration Calib.toml --rate 60 -o walk.bvh
    """
    from dousa.app.pipelines.estimate import estimate_sources
    from dousa.app.tables.estimation import print_estimation

    values = {**read_settings(settings), **given, "options": reading.load()}
    values["outputs"] = Outputs.from_paths(output or (), angles)
    values["sources"], values["backgrounds"] = sort_sources(sources, backgrounds)
    request = EstimationRequest.from_dict(values)
    if not request.outputs.named:
        warn(Message("estimation_cli.no_output"))
    with progress_bar() as progress:
        answers = estimate_sources(request, progress, warn)
    for text in dict.fromkeys(text for done in answers for text in done.warnings):
        warn(text)
    if json:
        documents = [done.to_json() for done in answers]
        print_json({"people": documents} if request.everybody else documents[0])
    else:
        for done in answers:
            print_estimation(console(), done)


def render(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="Motion file: BVH, AMC, C3D, TRC, NPZ.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Silhouettes to write: .npz (required)."),
    ] = None,
    ring: Annotated[
        int | None,
        typer.Option("--ring", min=1, max=100, metavar="N", help="Cameras on the ring. Default: 4."),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option("--size", metavar="WxH", help="Size of the images. Default: the calibration's, or 320x240."),
    ] = None,
    *,
    given: Annotated[dict[str, Any], RenderRequest],
    reading: Reading,
    json: Json = False,
) -> None:
    """Draw silhouettes of a motion, as cameras would see it: the inverse of estimate, for tests and demos.

    Without --body and --stature the body has the bones of the motion. The
    true joints are written with the silhouettes.

    Example: dousa render walk.bvh --ring 4 -o walk_seen.npz
    """
    from dousa.app.pipelines.render import render_file

    if output is None:
        raise OptionError("estimation_cli.render_without_output")
    if given["cameras"] is not None and ring is not None:
        raise OptionError("estimation_cli.cameras_and_ring")
    given |= {"n_ring": 4 if ring is None else ring, "size": None if size is None else parse_size(size)}
    request = RenderRequest(motion, output, **given, options=reading.load())
    with progress_bar() as progress:
        answer = render_file(request, progress)
    for text in answer["warnings"]:
        warn(text)
    if json:
        print_json(answer)
    else:
        shape = {"n": answer["n_frames"], "rate": answer["frame_rate"], "views": len(answer["views"])}
        say(Message("estimation_cli.rendered", path=output, **shape))


def sort_sources(source: list[Path], background: list[Path] | None) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Tell sources and backgrounds apart: images after the first ``--background`` arrive as sources, which none is."""
    if not background:
        return tuple(source), ()
    endings = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
    images = [path for path in source if path.suffix.lower() in endings and path.is_file()]
    return tuple(path for path in source if path not in images), (*background, *images)


def sync(
    films: Films,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help="Time offsets to write (.toml).")
    ] = None,
    *,
    given: Annotated[dict[str, Any], SynchronisationRequest],
    json: Json = False,
) -> None:
    """Find the time offsets of films of one scene, to a fraction of a frame.

    By the movement of a person whom all cameras see, and by sound where the
    films have it. A film's own time plus its offset is the time of the first
    film.

    Example: dousa sync left.mp4 front.mp4 right.mp4 -o sync.toml
    """
    from dousa.app.pipelines.films import sync_films

    request = SynchronisationRequest(tuple(films), **given)
    check_targets({"--output": output}, (*films, request.cameras), SYNC)
    with progress_bar() as progress:
        names, found = sync_films(request, progress, warn)
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
    from dousa.app.pipelines.films import calibrate_films

    request = CalibrationRequest(tuple(films), **given)
    table, picture = _tell_apart(output or ())
    for target in (table, picture):
        check_targets({"--output": target}, (*films, request.cameras, request.offsets), CAMERAS)
    with progress_bar() as progress:
        found, times = calibrate_films(request, progress, warn)
    notes = (*(times.warnings if times is not None else ()), *found.warnings)
    for note in notes:
        warn(note)
    if table is not None:
        from dousa.estimation import write_cameras

        write_cameras(table, found.cameras)
    if picture is not None:
        from dousa.app.pictures.charts import draw_cameras

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
    for target in (table, picture):
        if target is not None:
            say(Message("estimated.wrote", path=target))


def _tell_apart(output: Iterable[Path]) -> tuple[Path | None, Path | None]:
    """The file for the cameras, and that for the picture of them."""
    targets: dict[bool, Path] = {}
    for path in output:
        kind = path.suffix.lower() in PICTURES
        if kind in targets:
            raise OptionError("outputs.two_of_a_kind", path=path, other=targets[kind])
        targets[kind] = path
    return targets.get(False), targets.get(True)


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
    json: Json = False,
) -> None:
    """Find keypoints of the people in films: 33 points of each body, frame by frame, and who is who.

    Needs models: --install takes them out of a published package (npm
    @mediapipe/pose, else the pip wheel of mediapipe), checks their SHA-256 and
    keeps them in the user's cache folder, or that of DOUSA_MODELS. Nothing is
    fetched otherwise. The keypoints of films are kept in the user's cache, 4 GB
    of them; an interrupted run resumes when the same command is run again.

    Example: dousa keypoints --install

    Example: dousa keypoints left.mp4 front.mp4 -o keypoints --overlay
    """
    if install or not films:
        if len(films or ()) > 1:
            raise OptionError("models.one_source")
        _manage_models(films[0] if films else None, install=install, json=json)
        return
    from dousa.app.pipelines.films import describe_found, find_in_films

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


def _manage_models(source: Path | None, *, install: bool, json: bool) -> None:
    from dousa.estimation.keypoints import keypoint_cache, pose_models

    cache = pose_models.user_cache() / "keypoints"
    installed: tuple[Path, ...] = ()
    if install:
        with progress_bar() as progress:
            installed = pose_models.install_models((), source, progress)
    kept = keypoint_cache.list_kept(cache)
    rows = [(model, pose_models.check_pose_model(model)) for model in pose_models.POSE_MODELS]
    folder = pose_models.models_folder()
    if json:
        answer = {
            "folder": str(folder),
            "models": {model.name: {"file": model.file_name, "state": state} for model, state in rows},
            "installed": [str(path) for path in installed],
            "cache": {"folder": str(cache), "films": len(kept), "bytes": sum(film.n_bytes for film in kept)},
        }
        print_json(answer)
        return
    lines = [Message("models.folder", path=folder)]
    for model, state in rows:
        size = model.forms[0].n_bytes / 1e6
        lines.append(Message("models.row", model=model.name, megabytes=size, state=Message(_STATES[state])))
    lines.append(Message("models.cache", n=len(kept), megabytes=sum(film.n_bytes for film in kept) / 1e6, path=cache))
    lines.append(Message("models.licence", npm=pose_models.NPM_PACKAGE, pip=pose_models.PIP_PACKAGE))
    for line in lines:
        say(line)
