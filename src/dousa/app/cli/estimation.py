"""Commands between silhouettes and motion: estimate and render."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app import tables
from dousa.app.cli.options import shared as o
from dousa.app.cli.options.estimation import (
    BodyOptions,
    Frames,
    OutputOptions,
    PeopleOptions,
    SearchOptions,
    SequenceOptions,
    StartOptions,
    ViewOptions,
)
from dousa.app.output import console, print_json, progress_bar, say, warn
from dousa.app.pipelines import estimation_request as r
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
    output_options: OutputOptions,
    view_options: ViewOptions,
    body_options: BodyOptions,
    start_options: StartOptions,
    sequence_options: SequenceOptions,
    people_options: PeopleOptions,
    search_options: SearchOptions,
    motion_options: o.MotionOptions,
    json: o.Json = False,
) -> None:
    """Joint angles from films or silhouettes of one or more calibrated views.

    Films need nothing prepared once dousa models install was run: people are
    found by a learned network (--cues keypoints), and a body is fitted to
    them. Without --cameras, cameras are placed by the person (--stature).
    Otherwise silhouettes are tracked.

    --unit, --up, --skeleton and --joint-map are about the motion files of
    --start and --body. An interrupted run resumes when the same command is
    run again. A single view gives no depth.

    Example: dousa estimate jump.npz --start jump.trc:0 -o jump.bvh --overlay jump.mp4

    Example: dousa estimate cam1.mp4 cam2.mp4 --cameras calib.toml --background bg1.png bg2.png
    --stature 1.75 -o walk.bvh
    """
    from dousa.app.pipelines.film_estimate import estimate_sources

    groups = (output_options, view_options, body_options, start_options, sequence_options, search_options)
    given = o.list_values(*groups, people_options, motion_options.load())
    given["sources"], given["backgrounds"] = sort_sources(sources, view_options.backgrounds)
    request = r.EstimationRequest.from_dict(given)
    if not request.outputs.named:
        warn(Message("estimation_cli.no_output"))
    with progress_bar() as progress:
        answers = estimate_sources(request, progress, warn)
    for text in dict.fromkeys(text for done in answers for text in done.warnings):
        warn(text)
    if json:
        documents = [done.to_json() for done in answers]
        print_json({"people": documents} if people_options.everybody else documents[0])
    else:
        for done in answers:
            tables.print_estimation(console(), done)


def render(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="Motion file: BVH, AMC, C3D, TRC, NPZ.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Silhouettes to write: .npz (required)."),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", metavar="FILE", help="Calibration, as for estimate. Default: a ring of cameras."),
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
    body_options: BodyOptions,
    noise: Annotated[
        Literal["clean", "noisy"],
        typer.Option("--noise", help="noisy: holes, specks, shadow and ragged edges."),
    ] = "clean",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed of the noise.")] = 0,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Frames per second.")] = 30.0,
    frames: Frames = None,
    motion_options: o.MotionOptions,
    json: o.Json = False,
) -> None:
    """Silhouettes of a motion, as cameras would see it: the inverse of estimate, for tests and demos.

    Without --body and --stature the body has the bones of the motion. The
    true joints are written with the silhouettes.

    Example: dousa render walk.bvh --ring 4 -o walk_seen.npz
    """
    from dousa.app.pipelines.render import RenderRequest, parse_size, render_file

    if output is None:
        raise OptionError("estimation_cli.render_without_output")
    if cameras is not None and ring is not None:
        raise OptionError("estimation_cli.cameras_and_ring")
    request = RenderRequest(
        motion=motion,
        output=output,
        cameras=cameras,
        n_ring=4 if ring is None else ring,
        size=None if size is None else parse_size(size),
        noise=noise,
        seed=seed,
        rate=rate,
        frames=frames,
        options=motion_options.load(),
        **o.list_values(body_options),
    )
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
    """Sources and backgrounds: images that follow the first ``--background`` reach us as sources, which none is."""
    if not background:
        return tuple(source), ()
    images = [path for path in source if path.suffix.lower() in _PICTURES and path.is_file()]
    return tuple(path for path in source if path not in images), (*background, *images)
