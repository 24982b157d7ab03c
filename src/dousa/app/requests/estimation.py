"""What is estimated from films or silhouettes, rendered as silhouettes, synchronised, calibrated and looked for."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.estimation.tracking.settings import TrackerSettings
    from dousa.formats.motion_files import ReadOptions

Sex = Literal["average", "female", "male"]
SourceKind = Literal["mask", "video"]
BackgroundMethod = Literal["plate", "median", "mog2"]
Bones = Literal["auto", "tables", "start"]
Preset = Literal["default", "paper"]
Cues = Literal["keypoints", "silhouettes", "both"]
Model = Literal["lite", "full", "heavy"]

_VIDEOS, _DRAWINGS = (".mp4", ".avi", ".mkv"), (".png", ".svg", ".pdf")

Sources = Annotated[
    list[Path],
    typer.Argument(
        metavar="SOURCE...",
        help="One npz of silhouettes (all views and the cameras in it), or for each view a folder of masks, a "
        "video, or its keypoints as another program wrote them (.json, a folder of .json, .csv). Masks beside "
        "keypoints are of the same views, by name, else in order.",
    ),
]
Backgrounds = Annotated[
    list[Path] | None,
    typer.Option(
        "--background", metavar="FILE", help="Background picture without the person; one per video, in order."
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        metavar="FILE",
        help="What is rarely changed (.toml): method = 'paper', reading, evidence, beam, smoothing and all others "
        "of the tracker; sex, bones, kind, background_method, model.",
    ),
]
CamerasFile = Annotated[
    Path | None,
    typer.Option(
        "--cameras",
        "--calibration",
        metavar="FILE",
        help="Calibration: TOML of Pose2Sim, Anipose or Caliscope, XML of Qualisys, .xcp of Vicon, EasyMocap, "
        "OpenCap, BioCV, OpenCV YAML, XML or JSON, an npz with cameras; or their folder. Cameras are matched to "
        "the views by name, else by order. calibrate takes focal lengths and distortion from it, sync is more exact "
        "with it, and render sets a ring of cameras without it.",
    ),
]
Films = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILM...",
        help="A film for each camera, or its keypoints: .npz, .json of OpenPose, AlphaPose, MMPose, RTMPose or COCO, a "
        "folder of .json files, .csv of DeepLabCut; or the folder of a project.",
    ),
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", help="Frame rate if the source does not specify it.")
]
PictureSize = Annotated[
    str | None,
    typer.Option(
        "--size", metavar="WxH", help="Size of the pictures of keypoints, in pixels. Default: that of the calibration."
    ),
]
Offsets = Annotated[
    str,
    typer.Option(
        "--offsets",
        metavar="auto|none|FILE",
        help="When films begin: found by the movement of the person, together, or as dousa sync wrote.",
    ),
]
FocalLength = Annotated[
    float | None,
    typer.Option(
        "--focal-length",
        metavar="PX",
        help="Focal length of all cameras in pixels, without --cameras. Default: that of the film's metadata, else "
        "found or that of a phone.",
    ),
]
Frames = Annotated[
    str | None,
    typer.Option("--frames", metavar="A:B", help="Only the frames from A to before B, counted from 0."),
]
BodyFile = Annotated[
    Path | None,
    typer.Option(
        "--body",
        metavar="FILE",
        help="The person's body: a body file (TOML), or a motion file with the person's bones.",
    ),
]
Stature = Annotated[float | None, typer.Option("--stature", metavar="M", help="Stature of the person in metres.")]


def _check_stature(request: Any) -> None:
    """Check the stature before anything is read."""
    if request.stature is not None:
        from dousa.estimation.body.human import check_stature

        check_stature(request.stature)


@dataclasses.dataclass(frozen=True, slots=True)
class Outputs:
    """The files to write.

    Parameters
    ----------
    motions : motion files that dousa writes; those of points have the canonical joints.
    angles : joint angles as CSV.
    overlay : video of the outlines.
    sheet : contact sheet of the outlines.
    """

    motions: tuple[Path, ...] = ()
    angles: Path | None = None
    overlay: Path | None = None
    sheet: Path | None = None

    @classmethod
    def from_paths(cls, paths: Iterable[Path], angles: Path | None = None) -> Outputs:
        """The outputs of several ``--output``: their suffixes tell motion, video and contact sheet apart.

        Raises
        ------
        OptionError : two videos or two contact sheets.
        """
        found: dict[str, Path] = {}
        motions: list[Path] = []
        for path in paths:
            suffix = path.suffix.lower()
            kind = "overlay" if suffix in _VIDEOS else "sheet" if suffix in _DRAWINGS else ""
            if not kind:
                motions.append(path)
                continue
            if kind in found:
                raise OptionError("outputs.two_of_a_kind", path=path, other=found[kind])
            found[kind] = path
        return cls(tuple(motions), angles, **found)

    @property
    def named(self) -> tuple[tuple[str, Path], ...]:
        """(kind, file) of those that are given, the motions first."""
        kinds = ("angles", "sheet", "overlay")
        others = ((kind, getattr(self, kind)) for kind in kinds if getattr(self, kind) is not None)
        return (*(("motion", path) for path in self.motions), *others)

    @property
    def has_drawings(self) -> bool:
        """Whether the silhouettes are drawn."""
        return self.overlay is not None or self.sheet is not None

    @property
    def first(self) -> Path | None:
        """The file beside which the partial track lies."""
        return self.named[0][1] if self.named else None


@dataclasses.dataclass(frozen=True, slots=True)
class EstimationRequest:
    """What is to be estimated from what; other fields are described by the help of their options.

    Parameters
    ----------
    sources : npz of silhouettes, folders of masks, videos, or keypoints; a view each, except for an npz of several.
    settings : of the tracker; its defaults where there are none.
    outputs : files to write.
    backgrounds : plates of the videos, in their order.
    background_method : of the foreground; None lets the sources decide.
    kind : content of videos and folders; None lets the sources decide.
    sex : body proportions for ``stature``.
    bones : ``"tables"``; ``"start"``: as long as the joints of the start; ``"auto"``, see `choose_body`.
    model : that finds keypoints; None for the most precise that is installed.
    options : how motion files are read.

    Raises
    ------
    OptionError : an unknown choice.
    """

    sources: tuple[Path, ...]
    settings: TrackerSettings = dataclasses.field(default_factory=lambda: choose_settings({}))
    outputs: Outputs = dataclasses.field(default_factory=Outputs)
    cameras: CamerasFile = None
    backgrounds: tuple[Path, ...] = ()
    background_method: BackgroundMethod | None = None
    kind: SourceKind | None = None
    rate: Rate = None
    size: PictureSize = None
    frames: Frames = None
    mirrored: Annotated[
        bool,
        typer.Option(
            "--mirror-left-right",
            help="The images are mirrored, as with some depth cameras: swap left and right first. The calibration is "
            "then that of the exchanged images.",
        ),
    ] = False
    body: BodyFile = None
    stature: Stature = None
    sex: Sex = "average"
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            metavar="FILE:FRAME",
            help="The pose of the first frame with a person in it, in the cameras' world: a frame (from 0) of a "
            "motion file. Default: found.",
        ),
    ] = None
    bones: Bones = "auto"
    cues: Annotated[
        Cues | None,
        typer.Option(
            "--cues",
            help="What is fitted: keypoints of a learned network, silhouettes, or both at once. Default: both for "
            "films without --start, if dousa keypoints --install was run.",
        ),
    ] = None
    model: Model | None = None
    person: Annotated[
        int, typer.Option("--person", min=1, metavar="N", help="Whose motion: 1 is the person seen most.")
    ] = 1
    everybody: Annotated[
        bool, typer.Option("--everybody", help="One motion for each person: OUT.bvh, OUT-2.bvh and so on.")
    ] = False
    offsets: Offsets = "auto"
    focal: FocalLength = None
    options: ReadOptions = dataclasses.field(default_factory=lambda: _read_options({}))

    def __post_init__(self) -> None:
        _check_stature(self)
        for name, choices in _CHOICES.items():
            found = getattr(self, name)
            if found not in get_args(choices) and not (found is None and name in _OPTIONAL):
                raise OptionError("estimate.not_a_choice", name=name, expected=get_args(choices), found=found)

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> EstimationRequest:
        """The request of plain values under the names of its parts: options of a command, JSON, `to_dict`.

        Parameters
        ----------
        given : sources and backgrounds as lists of paths; `Outputs`, or its fields, and those of `ReadOptions` by their
            names; ``method`` and fields of `TrackerSettings`, or all ``settings`` of the tracker. What is None or
            missing has its default; other names are passed over.

        Raises
        ------
        OptionError : a value out of its range.
        """
        values = {name: value for name, value in given.items() if value is not None}
        for name in ("cameras", "body", "angles", "overlay", "sheet"):
            if name in values:
                values[name] = Path(values[name])
        for name in ("sources", "backgrounds", "motions"):
            if name in values:
                values[name] = tuple(Path(path) for path in values[name])
        values["settings"] = choose_settings(values)
        values.setdefault("outputs", Outputs(**_pick(values, Outputs)))
        own = _names(cls)  # a person of the films is not one of the motion files
        values.setdefault("options", _read_options({name: value for name, value in values.items() if name not in own}))
        return cls(**_pick(values, cls))

    @property
    def inputs(self) -> tuple[Path, ...]:
        """All files that are read, of the start without its frame."""
        start = None if self.start is None else parse_start(self.start)[0]
        optional = (path for path in (self.cameras, self.body, start) if path is not None)
        return (*self.sources, *self.backgrounds, *optional)


_CHOICES: Mapping[str, Any] = {
    "background_method": BackgroundMethod,
    "kind": SourceKind,
    "sex": Sex,
    "bones": Bones,
    "cues": Cues,
    "model": Model,
}
_OPTIONAL = ("background_method", "kind", "cues", "model")
_RARE = ("background_method", "kind", "bones", "sex", "model", "method")


def read_settings(path: Path | None) -> dict[str, Any]:
    """Read ``--settings``: what of an `EstimationRequest` has no option, and the settings of the tracker.

    Parameters
    ----------
    path : TOML file of ``background_method``, ``kind``, ``bones``, ``sex``, ``model``, ``method`` (default or
        paper) and fields of `TrackerSettings`; None for an empty one.

    Raises
    ------
    OptionError : a file that cannot be read, an unknown key, a value of another type or out of its range.
    """
    if path is None:
        return {}
    import tomllib

    from dousa.estimation.tracking.settings import TrackerSettings

    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OptionError("estimate.settings_unreadable", path=path, reason=error) from error
    known = (*_RARE, *_names(TrackerSettings))
    for key, value in values.items():
        if key not in known:
            raise OptionError("estimate.unknown_setting", path=path, found=key, known=known)
        is_negative = isinstance(value, int | float) and value < 0
        if not isinstance(value, _find_types(key)) or isinstance(value, bool) or is_negative:
            raise OptionError("estimate.setting_type", path=path, key=key, found=value)
        if isinstance(value, list):
            values[key] = tuple(value)
    if values.get("method", "default") not in get_args(Preset):
        raise OptionError("estimate.not_a_choice", name="method", expected=get_args(Preset), found=values["method"])
    return values


def _find_types(key: str) -> tuple[type, ...]:
    """The types in TOML of a setting."""
    from dousa.estimation.tracking.settings import TrackerSettings

    default = getattr(TrackerSettings(), key, "")
    if isinstance(default, tuple):
        return (list,)
    if isinstance(default, float):
        return (float, int)
    return (int,) if isinstance(default, int) or default is None else (str,)


def _names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


def _pick(values: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    return {name: values[name] for name in _names(kind) if name in values}


def _read_options(values: Mapping[str, Any]) -> ReadOptions:
    from dousa.formats.motion_files import ReadOptions

    return ReadOptions(**_pick(values, ReadOptions))


def choose_settings(given: Mapping[str, Any]) -> TrackerSettings:
    """The settings of the tracker: ``settings``, or those of the preset ``method`` with the others that are given.

    Raises
    ------
    OptionError : a value out of its range.
    """
    from dousa.estimation.tracking.settings import PAPER, TrackerSettings

    if isinstance(given.get("settings"), TrackerSettings):
        return given["settings"]  # type: ignore[no-any-return]
    preset = PAPER if given.get("method") == "paper" else TrackerSettings()
    changed = {name: value for name, value in _pick(given, TrackerSettings).items() if value is not None}
    return dataclasses.replace(preset, **changed)


def parse_size(text: str) -> tuple[int, int]:
    """``WxH`` in pixels.

    Raises
    ------
    OptionError : something else.
    """
    found = re.fullmatch(r"(\d{1,5})\s*[x×X,]\s*(\d{1,5})", text.strip())
    if found is None or min(int(found[1]), int(found[2])) < 8:
        raise OptionError("render.size", found=text)
    return int(found[1]), int(found[2])


def parse_start(text: str) -> tuple[Path, int]:
    """``FILE:FRAME`` or ``FILE``, which means its frame 0; a file of exactly this name comes first.

    Raises
    ------
    OptionError : no such file, or nothing where the frame should be.
    """
    if os.path.isfile(text):
        return Path(text), 0
    found = re.fullmatch(r"(.+):(\d{1,9})", text, re.DOTALL)
    if found is not None and (os.path.isfile(found[1]) or len(found[1]) > 1):
        path, frame = Path(found[1]), int(found[2])
    else:
        path, frame = Path(text), 0
    if path.is_dir():
        raise OptionError("start.folder", text=text, path=path)
    if not path.is_file():
        tail = re.fullmatch(r"(.+):([^:\\/]*)", text, re.DOTALL)
        if tail is not None and os.path.isfile(tail[1]):
            raise OptionError("start.not_a_frame", text=text, found=tail[2])
        raise OptionError("start.no_file", text=text, path=path)
    return path, frame


@dataclasses.dataclass(frozen=True, slots=True)
class RenderRequest:
    """What is to be rendered; other fields are described by the help of their options.

    Parameters
    ----------
    motion : file.
    output : npz to write.
    n_ring : cameras on a ring, without a calibration.
    size : px, width and height; None for the calibration's own, or 320 x 240.
    options : how motion files are read.
    """

    motion: Path
    output: Path
    cameras: CamerasFile = None
    n_ring: int = 4
    size: tuple[int, int] | None = None
    body: BodyFile = None
    stature: Stature = None
    sex: Sex = "average"
    seed: int = 0
    noise: Annotated[
        Literal["clean", "noisy"], typer.Option("--noise", help="noisy: holes, specks, shadow and ragged edges.")
    ] = "clean"
    rate: Annotated[float, typer.Option("--rate", metavar="HZ", help="Frames per second.")] = 30.0
    frames: Frames = None
    options: ReadOptions = dataclasses.field(default_factory=lambda: _read_options({}))

    def __post_init__(self) -> None:
        _check_stature(self)


@dataclasses.dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """The films, or files of their keypoints, and what is known of their cameras and times."""

    films: tuple[Path, ...]
    stature: Stature = None
    board: Annotated[
        str | None,
        typer.Option(
            "--board",
            metavar="BOARD",
            help="Instead of a person: chessboard:9x6:25mm (inner corners, square) or charuco:5x7:40mm:30mm "
            "(squares, square, marker; DICT_4X4_50 or :DICTIONARY).",
        ),
    ] = None
    cameras: CamerasFile = None
    focal: FocalLength = None
    offsets: Offsets = "auto"
    rate: Rate = None
    size: PictureSize = None

    def __post_init__(self) -> None:
        _check_stature(self)


@dataclasses.dataclass(frozen=True, slots=True)
class SynchronisationRequest:
    """The films, or files of their keypoints, whose times are compared."""

    films: tuple[Path, ...]
    cameras: CamerasFile = None
    rate: Rate = None
    size: PictureSize = None


@dataclasses.dataclass(frozen=True, slots=True)
class KeypointRequest:
    """The films, one for each view, and what is looked for in them and written."""

    films: tuple[Path, ...]
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for NAME.npz of each film NAME.")
    ] = Path("keypoints")
    model: Annotated[Model, typer.Option("--model", help="From the quickest to the most precise.")] = "full"
    overlay: Annotated[
        bool, typer.Option("--overlay", help="Write NAME_keypoints.mp4 too: the keypoints over the film.")
    ] = False
