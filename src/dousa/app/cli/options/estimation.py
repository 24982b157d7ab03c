"""The options of estimate and render, in groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dousa.app.cli.options import shared as o
from dousa.app.pipelines import estimation_request as r

Frames = Annotated[
    str | None,
    typer.Option("--frames", metavar="A:B", help="Only the frames from A to before B, counted from 0."),
]


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """The files to write."""

    motion: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Motion to write: .bvh, .trc, .c3d or .npz."),
    ] = None
    trc: Annotated[Path | None, typer.Option("--trc", metavar="OUT", help="Write the canonical joints as TRC too.")] = (
        None
    )
    angles: Annotated[
        Path | None, typer.Option("--angles", metavar="OUT", help="Write the joint angles as CSV too.")
    ] = None
    overlay: Annotated[
        Path | None,
        typer.Option("--overlay", metavar="OUT", help="Video (.mp4): outlines of silhouette and model, per view."),
    ] = None
    sheet: Annotated[
        Path | None, typer.Option("--sheet", metavar="OUT", help="The same as a contact sheet (.png).")
    ] = None


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What is seen, and from where."""

    cameras: Annotated[
        Path | None,
        typer.Option(
            "--cameras",
            metavar="FILE",
            help="Calibration: Qualisys XML, OpenCV YAML, XML or JSON, Pose2Sim TOML, or an npz with cameras. Cameras "
            "are matched to the views by name, else by order.",
        ),
    ] = None
    backgrounds: Annotated[
        list[Path] | None,
        typer.Option(
            "--background",
            metavar="FILE",
            help="Background picture without the person; one per video, in order.",
        ),
    ] = None
    background_method: Annotated[
        r.BackgroundMethod | None,
        typer.Option("--background-method", help="Default: plate if there are plates, else median."),
    ] = None
    kind: Annotated[
        r.SourceKind | None, typer.Option("--kind", help="Whether a video or folder contains masks or pictures.")
    ] = None


@dataclass(frozen=True, slots=True)
class BodyOptions:
    """Who is seen."""

    body: Annotated[
        Path | None,
        typer.Option(
            "--body",
            metavar="FILE",
            help="The person's body: a body file (TOML), or a motion file with the person's bones.",
        ),
    ] = None
    stature: Annotated[
        float | None,
        typer.Option("--stature", metavar="M", help="Stature in metres, if there is no body file."),
    ] = None
    sex: Annotated[r.Sex, typer.Option("--sex", help="Body proportions for --stature.")] = "average"


@dataclass(frozen=True, slots=True)
class StartOptions:
    """The first pose, and what it says about the body."""

    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            metavar="FILE:FRAME",
            help="The pose of the first frame with a person in it, in the cameras' world: a frame (from 0) of a "
            "motion file. Default: found.",
        ),
    ] = None
    bones: Annotated[
        r.Bones,
        typer.Option(
            "--bones",
            help="How long the limbs are: as the tables of --stature or the file of --body say, or as the joints of "
            "--start. auto: the start's where it agrees with the stature within 7 % and there is no --body.",
        ),
    ] = "auto"


@dataclass(frozen=True, slots=True)
class SequenceOptions:
    """Which images, and how they follow each other."""

    frames: Frames = None
    rate: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Frame rate if the source does not specify it."),
    ] = None
    mirrored: Annotated[
        bool,
        typer.Option(
            "--mirror-left-right",
            help="The images are mirrored, as with some depth cameras: swap left and right first. The "
            "calibration is then that of the exchanged images.",
        ),
    ] = False


@dataclass(frozen=True, slots=True)
class SearchOptions:
    """How poses are searched for."""

    method: Annotated[
        r.Preset,
        typer.Option("--method", help="paper: the search as published; the next four options change a preset."),
    ] = "default"
    reading: Annotated[
        o.Reading | None,
        typer.Option("--reading", help="Reading of eq. 2.", show_default="masked; residual with paper"),
    ] = None
    evidence: Annotated[
        o.Evidence | None,
        typer.Option(
            "--evidence",
            help="How image and inertia are weighted.",
            show_default="log; global with paper",
        ),
    ] = None
    smoothing: Annotated[
        float | None,
        typer.Option(
            "--smoothing",
            min=0.0,
            metavar="HZ",
            help="Cut-off frequency of the smoothing; 0 for none.",
            show_default="6; 0 with paper",
        ),
    ] = None
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
    ] = None


@dataclass(frozen=True, slots=True)
class PeopleOptions:
    """What of films is taken, and whose motion."""

    cues: Annotated[
        r.Cues | None,
        typer.Option(
            "--cues",
            help="What is fitted: keypoints of a learned network, or silhouettes. Default: keypoints for films "
            "without --background and --start, if dousa models install was run.",
        ),
    ] = None
    model: Annotated[
        r.Model | None,
        typer.Option("--model", help="Network for keypoints. Default: the most precise that is installed."),
    ] = None
    person: Annotated[
        int, typer.Option("--person", min=1, metavar="N", help="Whose motion: 1 is the person seen most.")
    ] = 1
    everybody: Annotated[
        bool,
        typer.Option("--everybody", help="One motion for each person: OUT.bvh, OUT-2.bvh and so on."),
    ] = False
    offsets: Annotated[
        str,
        typer.Option(
            "--offsets",
            metavar="auto|none|FILE",
            help="When films begin: found by the movement of the person, together, or as dousa sync wrote.",
        ),
    ] = "auto"
    focal: Annotated[
        float | None,
        typer.Option(
            "--focal-length",
            metavar="PX",
            help="Focal length of all cameras in pixels, without --cameras. Default: that of the film's metadata, "
            "else found or that of a phone.",
        ),
    ] = None
