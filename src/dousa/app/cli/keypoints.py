"""Commands of learned evidence: the models, and the keypoints of films."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app.cli.options import shared as o
from dousa.app.output import print_json, progress_bar, say, warn
from dousa.errors import OptionError
from dousa.messages import Message

_STATES = {"installed": "models.state_installed", "missing": "models.state_missing", "damaged": "models.state_damaged"}


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    app.command(rich_help_panel="Estimation")(keypoints)
    app.command(rich_help_panel="Estimation")(models)


def keypoints(
    films: Annotated[list[Path], typer.Argument(metavar="FILM...", help="Films of people; one for each view.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for NAME.npz of each film NAME.")
    ] = Path("keypoints"),
    model: Annotated[
        Literal["lite", "full", "heavy"],
        typer.Option("--model", help="From the quickest to the most precise."),
    ] = "full",
    people: Annotated[
        int, typer.Option("--people", min=1, max=16, metavar="N", help="People that are followed at a time, at most.")
    ] = 4,
    overlay: Annotated[
        bool, typer.Option("--overlay", help="Write NAME_keypoints.mp4 too: the keypoints over the film.")
    ] = False,
    sheet: Annotated[
        bool, typer.Option("--sheet", help="Write NAME_keypoints.png too: the same as a contact sheet.")
    ] = False,
    json: o.Json = False,
) -> None:
    """Keypoints of the people in films: 33 points of each body, frame by frame, and who is who.

    Needs the models once: dousa models install. What was found in a film is
    kept in the user's cache; an interrupted run resumes when the same
    command is run again.

    Example: dousa keypoints left.mp4 front.mp4 -o keypoints --sheet
    """
    from dousa.app.pipelines.keypoints import KeypointRequest, describe_found, find_in_films

    request = KeypointRequest(films, output, model, people, overlay, sheet)
    with progress_bar() as progress:
        done = find_in_films(request, progress)
    for found in done:
        for text in found.keypoints.warnings:
            warn(text)
    if json:
        print_json({"model": model, "films": [found.to_json() for found in done]})
        return
    for found in done:
        for line in describe_found(found):
            say(line)


def models(
    action: Annotated[
        Literal["list", "install", "clear-cache"],
        typer.Argument(metavar="list|install|clear-cache", help="What to do."),
    ] = "list",
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="detector, lite, full, heavy. Default: all."),
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="A package that you have (.tgz of npm, .whl of MediaPipe) or a model (.tflite), instead of fetching.",
        ),
    ] = None,
    json: o.Json = False,
) -> None:
    """The optional models that find people's keypoints in films: list them, or install them.

    install takes them out of a published package (npm @mediapipe/pose, else
    the pip wheel of mediapipe), checks their SHA-256 and keeps them in the
    user's cache folder, or that of DOUSA_MODELS. dousa takes nothing from
    the net unless this command is run. clear-cache forgets the keypoints of
    all films; 4 GB of them are kept, those used last.

    Example: dousa models install

    Example: dousa models install --from mediapipe-pose-0.5.1675469404.tgz
    """
    from dousa.estimation.keypoints import keypoint_cache, model_archives, pose_models

    cache = pose_models.user_cache() / "keypoints"
    installed: tuple[Path, ...] = ()
    if action == "install":
        with progress_bar() as progress:
            installed = model_archives.install_models(names or (), source, progress)
    elif names or source is not None:
        raise OptionError("models.needs_install")
    removed = keypoint_cache.clear_kept(cache) if action == "clear-cache" else []
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
    lines.append(Message("models.licence", npm=model_archives.NPM_PACKAGE, pip=model_archives.PIP_PACKAGE))
    for line in lines:
        say(line)
