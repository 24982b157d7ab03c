"""Commands between silhouettes and motion: estimate and render."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dousa.app import _options as o
from dousa.app._output import console, print_json, progress_bar, warn
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.estimation._types import TrackerSettings

__all__ = ["register"]

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class Sex(enum.StrEnum):
    """Proportions of the body."""

    AVERAGE = "average"
    FEMALE = "female"
    MALE = "male"


class Kind(enum.StrEnum):
    """What the images show."""

    MASK = "mask"
    VIDEO = "video"


class Method(enum.StrEnum):
    """How the foreground of a video is found."""

    PLATE = "plate"
    MEDIAN = "median"
    MOG2 = "mog2"


class Search(enum.StrEnum):
    """Preset of the tracker."""

    DEFAULT = "default"
    PAPER = "paper"


class Bones(enum.StrEnum):
    """Where the lengths of the limbs come from."""

    AUTO = "auto"
    TABLES = "tables"
    START = "start"


class Noise(enum.StrEnum):
    """Whether rendered silhouettes are spoiled."""

    CLEAN = "clean"
    NOISY = "noisy"


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
    typer.Option("--stature", metavar="M", help="Stature in metres, where there is no body file."),
]
SexOption = Annotated[Sex, typer.Option("--sex", help="Proportions that go with --stature.")]
Frames = Annotated[
    str | None,
    typer.Option("--frames", metavar="A:B", help="Only the frames from A to before B, counted from 0."),
]


def register(app: typer.Typer) -> None:
    """Hang this module's commands on the application."""
    app.command(rich_help_panel="Estimation")(estimate)
    app.command(rich_help_panel="Estimation")(render)


def estimate(
    source: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="One npz of silhouettes (all views and the cameras in it), or one folder of masks or one video for "
            "each view.",
        ),
    ],
    output: Annotated[
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
        typer.Option(
            "--overlay", metavar="OUT", help="Video (.mp4): outlines of silhouette and model, per view."
        ),
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
    background: Annotated[
        list[Path] | None,
        typer.Option(
            "--background",
            metavar="FILE",
            help="Picture without the person; one for each video, in their order.",
        ),
    ] = None,
    background_method: Annotated[
        Method | None,
        typer.Option("--background-method", help="Default: plate where there are plates, else median."),
    ] = None,
    kind: Annotated[
        Kind | None, typer.Option("--kind", help="Whether a video or folder holds masks or pictures.")
    ] = None,
    body: BodyFile = None,
    stature: Stature = None,
    sex: SexOption = Sex.AVERAGE,
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            metavar="FILE:FRAME",
            help="The pose of the first frame with somebody in it, in the world of the cameras: a frame (from 0) of a "
            "motion file. Default: found.",
        ),
    ] = None,
    bones: Annotated[
        Bones,
        typer.Option(
            "--bones",
            help="How long the limbs are: as the tables of --stature or the file of --body say, or as the joints of "
            "--start. auto: the start's where it agrees with the stature within 7 % and there is no --body.",
        ),
    ] = Bones.AUTO,
    frames: Frames = None,
    rate: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Frame rate where the source does not say it."),
    ] = None,
    mirrored: Annotated[
        bool,
        typer.Option(
            "--mirror-left-right",
            help="The images are mirror images, as of some depth cameras: exchange left and right first. The "
            "calibration is then that of the exchanged images.",
        ),
    ] = False,
    method: Annotated[
        Search,
        typer.Option(
            "--method", help="paper: the search as published; the next four options change a preset."
        ),
    ] = Search.DEFAULT,
    reading: Annotated[
        o.Reading | None,
        typer.Option("--reading", help="How eq. 2 is read.", show_default="masked; residual with paper"),
    ] = None,
    evidence: Annotated[
        o.Evidence | None,
        typer.Option(
            "--evidence",
            help="How the image is weighed against inertia.",
            show_default="log; global with paper",
        ),
    ] = None,
    smoothing: Annotated[
        float | None,
        typer.Option(
            "--smoothing",
            min=0.0,
            metavar="HZ",
            help="Cut-off of the smoothing; 0 for none.",
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
            help="Poses kept from frame to frame; more is slower.",
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
    --start and --body. Interrupted work goes on where it stopped when the
    same command is run again. One view alone does not tell depth.

    Example: dousa estimate jump.npz --start jump.trc:0 -o jump.bvh --overlay jump.mp4

    Example: dousa estimate cam1.mp4 cam2.mp4 --cameras calib.toml --background bg1.png bg2.png
    --stature 1.75 -o walk.bvh
    """
    from dousa.app._estimation_output import Outputs
    from dousa.app.estimating import Request, estimate_files
    from dousa.library import ReadOptions

    sources, backgrounds = _sort_out(source, background)
    request = Request(
        sources=sources,
        settings=_make_settings(method, reading, evidence, smoothing, beam),
        outputs=Outputs(output, trc, angles, overlay, sheet),
        cameras=cameras,
        backgrounds=backgrounds,
        background_method=None if background_method is None else background_method.value,
        kind=None if kind is None else kind.value,
        rate=rate,
        frames=frames,
        mirrored=mirrored,
        body=body,
        stature=stature,
        sex=sex.value,
        start=start,
        bones=bones.value,
        options=ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton),
    )
    if not request.outputs.named:
        warn("without -o OUT.bvh the motion is not kept; only the numbers are shown")
    with progress_bar() as progress:
        done = estimate_files(request, progress, warn)
    for text in done.warnings:
        warn(text)
    if json:
        print_json(done.to_json())
    else:
        from dousa.app._estimation_tables import print_estimation

        print_estimation(console(), done)


def _make_settings(
    method: Search,
    reading: o.Reading | None,
    evidence: o.Evidence | None,
    smoothing: float | None,
    beam: int | None,
) -> TrackerSettings:
    """The preset's own values where nothing was said."""
    import dataclasses

    from dousa.estimation._types import PAPER, TrackerSettings

    preset = PAPER if method is Search.PAPER else TrackerSettings()
    return dataclasses.replace(
        preset,
        reading=preset.reading if reading is None else reading.value,
        evidence=preset.evidence if evidence is None else evidence.value,
        smoothing=preset.smoothing if smoothing is None else smoothing,
        beam=preset.beam if beam is None else beam,
    )


def render(
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help="Motion file: BVH, AMC, C3D, TRC, NPZ.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Silhouettes to write: .npz (required)."),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option(
            "--cameras", metavar="FILE", help="Calibration, as for estimate. Default: a ring of cameras."
        ),
    ] = None,
    ring: Annotated[
        int | None,
        typer.Option("--ring", min=1, max=100, metavar="N", help="Cameras on the ring. Default: 4."),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            "--size", metavar="WxH", help="Size of the images. Default: the calibration's, or 320x240."
        ),
    ] = None,
    body: BodyFile = None,
    stature: Stature = None,
    sex: SexOption = Sex.AVERAGE,
    noise: Annotated[
        Noise, typer.Option("--noise", help="noisy: holes, specks, shadow and ragged edges.")
    ] = Noise.CLEAN,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the noise.")] = 0,
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Frames a second.")] = 30.0,
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
    from dousa.app.rendering_files import RenderRequest, parse_size, render_file
    from dousa.library import ReadOptions

    if output is None:
        raise OptionError("-o OUT.npz is missing: where shall the silhouettes go?")
    if cameras is not None and ring is not None:
        raise OptionError("--cameras and --ring exclude each other")
    request = RenderRequest(
        motion=motion,
        output=output,
        cameras=cameras,
        n_ring=4 if ring is None else ring,
        size=None if size is None else parse_size(size),
        body=body,
        stature=stature,
        sex=sex.value,
        noise=noise.value,
        seed=seed,
        rate=rate,
        frames=frames,
        options=ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton),
    )
    with progress_bar() as progress:
        answer = render_file(request, progress)
    for text in answer["warnings"]:
        warn(text)
    if json:
        print_json(answer)
    else:
        console().print(
            f"{output}: {answer['n_frames']} frames at {answer['frame_rate']:g} Hz in {len(answer['views'])} views",
            markup=False,
            soft_wrap=True,
        )


def _sort_out(source: list[Path], background: list[Path] | None) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Sources and backgrounds: images that follow the first ``--background`` reach us as sources, which none is."""
    if not background:
        return tuple(source), ()
    images = [path for path in source if path.suffix.lower() in _PICTURES and path.is_file()]
    return tuple(path for path in source if path not in images), (*background, *images)
