"""Commands between silhouettes and motion: estimate and render."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app.cli import options as o
from dousa.app.output import console, print_json, progress_bar, warn
from dousa.app.pipelines import estimation_request as r
from dousa.errors import OptionError
from dousa.messages import Message

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


BodyFile = Annotated[
    Path | None,
    typer.Option(
        "--body",
        metavar="FILE",
        help="The person's body: a body file (TOML), or a motion file with the person's bones.",
    ),
]
Stature = Annotated[
    float | None,
    typer.Option("--stature", metavar="M", help="Stature in metres, if there is no body file."),
]
SexOption = Annotated[r.Sex, typer.Option("--sex", help="Body proportions for --stature.")]
Frames = Annotated[
    str | None,
    typer.Option("--frames", metavar="A:B", help="Only the frames from A to before B, counted from 0."),
]


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
    motion: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Motion to write: .bvh, .trc, .c3d or .npz."),
    ] = None,
    trc: Annotated[
        Path | None, typer.Option("--trc", metavar="OUT", help="Write the canonical joints as TRC too.")
    ] = None,
    angles: Annotated[
        Path | None, typer.Option("--angles", metavar="OUT", help="Write the joint angles as CSV too.")
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option("--overlay", metavar="OUT", help="Video (.mp4): outlines of silhouette and model, per view."),
    ] = None,
    sheet: Annotated[
        Path | None, typer.Option("--sheet", metavar="OUT", help="The same as a contact sheet (.png).")
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option(
            "--cameras",
            metavar="FILE",
            help="Calibration: Qualisys XML, OpenCV YAML, XML or JSON, Pose2Sim TOML, or an npz with cameras. Cameras "
            "are matched to the views by name, else by order.",
        ),
    ] = None,
    backgrounds: Annotated[
        list[Path] | None,
        typer.Option(
            "--background",
            metavar="FILE",
            help="Background picture without the person; one per video, in order.",
        ),
    ] = None,
    background_method: Annotated[
        r.BackgroundMethod | None,
        typer.Option("--background-method", help="Default: plate if there are plates, else median."),
    ] = None,
    kind: Annotated[
        r.SourceKind | None, typer.Option("--kind", help="Whether a video or folder contains masks or pictures.")
    ] = None,
    body: BodyFile = None,
    stature: Stature = None,
    sex: SexOption = "average",
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            metavar="FILE:FRAME",
            help="The pose of the first frame with a person in it, in the cameras' world: a frame (from 0) of a "
            "motion file. Default: found.",
        ),
    ] = None,
    bones: Annotated[
        r.Bones,
        typer.Option(
            "--bones",
            help="How long the limbs are: as the tables of --stature or the file of --body say, or as the joints of "
            "--start. auto: the start's where it agrees with the stature within 7 % and there is no --body.",
        ),
    ] = "auto",
    frames: Frames = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Frame rate if the source does not specify it."),
    ] = None,
    mirrored: Annotated[
        bool,
        typer.Option(
            "--mirror-left-right",
            help="The images are mirrored, as with some depth cameras: swap left and right first. The "
            "calibration is then that of the exchanged images.",
        ),
    ] = False,
    method: Annotated[
        r.Preset,
        typer.Option("--method", help="paper: the search as published; the next four options change a preset."),
    ] = "default",
    reading: Annotated[
        o.Reading | None,
        typer.Option("--reading", help="Reading of eq. 2.", show_default="masked; residual with paper"),
    ] = None,
    evidence: Annotated[
        o.Evidence | None,
        typer.Option(
            "--evidence",
            help="How image and inertia are weighted.",
            show_default="log; global with paper",
        ),
    ] = None,
    smoothing: Annotated[
        float | None,
        typer.Option(
            "--smoothing",
            min=0.0,
            metavar="HZ",
            help="Cut-off frequency of the smoothing; 0 for none.",
            show_default="6; 0 with paper",
        ),
    ] = None,
    beam: Annotated[
        int | None,
        typer.Option(
            "--beam",
            min=1,
            max=64,
            metavar="N",
            help="Beam width: poses kept per frame; more is slower.",
            show_default="3; 1 with paper",
        ),
    ] = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    json: o.Json = False,
) -> None:
    """Joint angles from silhouettes of one or more calibrated views.

    --unit, --up, --skeleton and --joint-map are about the motion files of
    --start and --body. An interrupted run resumes when the same command is
    run again. A single view gives no depth.

    Example: dousa estimate jump.npz --start jump.trc:0 -o jump.bvh --overlay jump.mp4

    Example: dousa estimate cam1.mp4 cam2.mp4 --cameras calib.toml --background bg1.png bg2.png
    --stature 1.75 -o walk.bvh
    """
    given = dict(locals())
    from dousa.app.pipelines.estimate import estimate_files

    given["sources"], given["backgrounds"] = sort_sources(sources, backgrounds)
    given["joint_map"] = o.load_joint_map(joint_map)
    request = r.EstimationRequest.from_dict(given)
    if not request.outputs.named:
        warn(Message("estimation_cli.no_output"))
    with progress_bar() as progress:
        done = estimate_files(request, progress, warn)
    for text in done.warnings:
        warn(text)
    if json:
        print_json(done.to_json())
    else:
        from dousa.app.tables.answers import print_estimation

        print_estimation(console(), done)


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
    body: BodyFile = None,
    stature: Stature = None,
    sex: SexOption = "average",
    noise: Annotated[
        Literal["clean", "noisy"],
        typer.Option("--noise", help="noisy: holes, specks, shadow and ragged edges."),
    ] = "clean",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed of the noise.")] = 0,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Frames per second.")] = 30.0,
    frames: Frames = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    json: o.Json = False,
) -> None:
    """Silhouettes of a motion, as cameras would see it: the inverse of estimate, for tests and demos.

    Without --body and --stature the body has the bones of the motion. The
    true joints are written with the silhouettes.

    Example: dousa render walk.bvh --ring 4 -o walk_seen.npz
    """
    given = dict(locals())
    from dousa.app.pipelines.render import RenderRequest, parse_size, render_file
    from dousa.formats.motion_files import ReadOptions

    if output is None:
        raise OptionError("estimation_cli.render_without_output")
    if cameras is not None and ring is not None:
        raise OptionError("estimation_cli.cameras_and_ring")
    given = {**given, "n_ring": ring, "size": None if size is None else parse_size(size)}
    given["options"] = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    names = {field.name for field in dataclasses.fields(RenderRequest)}
    request = RenderRequest(**{name: value for name, value in given.items() if name in names and value is not None})
    with progress_bar() as progress:
        answer = render_file(request, progress)
    for text in answer["warnings"]:
        warn(text)
    if json:
        print_json(answer)
    else:
        shape = {"n": answer["n_frames"], "rate": answer["frame_rate"], "views": len(answer["views"])}
        words = Message("estimation_cli.rendered", path=output, **shape)
        console().print(str(words), markup=False, soft_wrap=True)


def sort_sources(source: list[Path], background: list[Path] | None) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Sources and backgrounds: images that follow the first ``--background`` reach us as sources, which none is."""
    if not background:
        return tuple(source), ()
    images = [path for path in source if path.suffix.lower() in _PICTURES and path.is_file()]
    return tuple(path for path in source if path not in images), (*background, *images)
