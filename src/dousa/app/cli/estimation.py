"""Commands between silhouettes and motion: estimate and render."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from dousa.app import tables
from dousa.app.cli.usage import Json
from dousa.app.output import console, print_json, progress_bar, say, warn
from dousa.app.requests.estimation import EstimationRequest, Outputs, RenderRequest, read_settings
from dousa.app.requests.reading import Reading
from dousa.errors import OptionError
from dousa.messages import Message

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    app.command(rich_help_panel="Estimation")(estimate)
    app.command(rich_help_panel="Estimation")(render)


def estimate(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="One npz of silhouettes (all views and the cameras in it), or one folder of masks or one video for "
            "each view.",
        ),
    ],
    *,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="File to write; repeatable. The motion: .bvh, .trc, .c3d, .npz ...; the canonical joints as .trc too; "
            "a video (.mp4) or contact sheet (.png) of the outlines of silhouette and model.",
        ),
    ] = None,
    angles: Annotated[
        Path | None, typer.Option("--angles", metavar="OUT", help="Write the joint angles as CSV too.")
    ] = None,
    backgrounds: Annotated[
        list[Path] | None,
        typer.Option(
            "--background", metavar="FILE", help="Background picture without the person; one per video, in order."
        ),
    ] = None,
    given: Annotated[dict[str, Any], EstimationRequest],
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings",
            metavar="FILE",
            help="What is rarely changed (.toml): method = 'paper', reading, evidence, beam, smoothing and all others "
            "of the tracker; sex, bones, kind, background_method, model.",
        ),
    ] = None,
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
    """
    from dousa.app.pipelines.film_estimate import estimate_sources

    values = {**read_settings(settings), **given, **asdict(reading.load())}
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
            tables.print_estimation(console(), done)


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
    from dousa.app.pipelines.render import parse_size, render_file

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
    images = [path for path in source if path.suffix.lower() in _PICTURES and path.is_file()]
    return tuple(path for path in source if path not in images), (*background, *images)
