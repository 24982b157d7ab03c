"""The request of an estimation: what the command line, the studio and the demonstration ask for, in one form."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.estimation.tracking.settings import TrackerSettings
    from dousa.formats.motion_files import ReadOptions

Sex = Literal["average", "female", "male"]
SourceKind = Literal["mask", "video"]
BackgroundMethod = Literal["plate", "median", "mog2"]
Bones = Literal["auto", "tables", "start"]
Preset = Literal["default", "paper"]
Cues = Literal["keypoints", "silhouettes"]
Model = Literal["lite", "full", "heavy"]


@dataclasses.dataclass(frozen=True, slots=True)
class Outputs:
    """The files to write.

    Parameters
    ----------
    motion : any motion file that dousa writes.
    trc : canonical joints as TRC.
    angles : joint angles as CSV.
    overlay : video of the outlines.
    sheet : contact sheet of the outlines.
    """

    motion: Path | None = None
    trc: Path | None = None
    angles: Path | None = None
    overlay: Path | None = None
    sheet: Path | None = None

    @property
    def named(self) -> tuple[tuple[str, Path], ...]:
        """(option, file) of those that are given, the motion first."""
        pairs = (
            ("--output", self.motion),
            ("--trc", self.trc),
            ("--angles", self.angles),
            ("--sheet", self.sheet),
            ("--overlay", self.overlay),
        )
        return tuple((option, path) for option, path in pairs if path is not None)

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
    """What is to be estimated from what.

    Parameters
    ----------
    sources : npz of silhouettes, or folders of masks, or videos; a view each, except for an npz of several.
    settings : of the tracker; its defaults where there are none.
    outputs : files to write.
    cameras : calibration; None where the npz has the cameras in it.
    backgrounds : plates of the videos, in their order.
    background_method : of the foreground; None lets the sources decide.
    kind : what videos and folders show; None lets the sources decide.
    rate : Hz of folders of images, and of videos that state it wrongly.
    frames : ``A:B``, all by default.
    mirrored : the images are mirror images: left and right are exchanged before anything else, and the calibration
        is that of the images so exchanged.
    body, stature, sex : body file, body height in m, and proportions, see `choose_body`.
    start : ``FILE:FRAME``; found by default.
    bones : ``"tables"``; ``"start"``: as long as the joints of the start; ``"auto"``, see `choose_body`.
    cues : what of the pictures is fitted; None takes keypoints for films without plates where models are installed.
    model : that finds keypoints; None for the most precise that is installed.
    person : whose motion, by how much is seen of them: 1 is who is seen most.
    everybody : one motion for each person.
    offsets : of films in time: ``"auto"`` finds them, ``"none"`` where they start together, or a file of them.
    focal : px, focal length of all cameras of films without a calibration; found or assumed by default.
    options : how motion files are read.

    Raises
    ------
    OptionError : a choice that there is not.
    """

    sources: tuple[Path, ...]
    settings: TrackerSettings = dataclasses.field(default_factory=lambda: choose_settings({}))
    outputs: Outputs = dataclasses.field(default_factory=Outputs)
    cameras: Path | None = None
    backgrounds: tuple[Path, ...] = ()
    background_method: BackgroundMethod | None = None
    kind: SourceKind | None = None
    rate: float | None = None
    frames: str | None = None
    mirrored: bool = False
    body: Path | None = None
    stature: float | None = None
    sex: Sex = "average"
    start: str | None = None
    bones: Bones = "auto"
    cues: Cues | None = None
    model: Model | None = None
    person: int = 1
    everybody: bool = False
    offsets: str = "auto"
    focal: float | None = None
    options: ReadOptions = dataclasses.field(default_factory=lambda: _read_options({}))

    def __post_init__(self) -> None:
        for name, choices in (
            ("background_method", (None, *get_args(BackgroundMethod))),
            ("kind", (None, *get_args(SourceKind))),
            ("sex", get_args(Sex)),
            ("bones", get_args(Bones)),
            ("cues", (None, *get_args(Cues))),
            ("model", (None, *get_args(Model))),
        ):
            if getattr(self, name) not in choices:
                expected = [choice for choice in choices if choice is not None]
                raise OptionError("estimate.not_a_choice", name=name, expected=expected, found=getattr(self, name))

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> EstimationRequest:
        """The request of plain values under the names of its parts: options of a command, JSON, `to_dict`.

        Parameters
        ----------
        given : sources and backgrounds as lists of paths; the fields of `Outputs` and `ReadOptions` by their names;
            ``method``, ``reading``, ``evidence``, ``smoothing``, ``beam`` or all ``settings`` of the tracker. What is
            None or missing has its default; other names are passed over.

        Raises
        ------
        OptionError : a value out of its range.
        """
        values = {name: value for name, value in given.items() if value is not None}
        for name in ("cameras", "body", *_names(Outputs)):
            if name in values:
                values[name] = Path(values[name])
        for name in ("sources", "backgrounds"):
            if name in values:
                values[name] = tuple(Path(path) for path in values[name])
        values["settings"] = choose_settings(values)
        values["outputs"] = Outputs(**_pick(values, Outputs))
        values["options"] = _read_options(values)
        return cls(**_pick(values, cls))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, from which `from_dict` makes the same request."""
        nested = ("outputs", "options", "settings")
        values = {name: getattr(self, name) for name in _names(EstimationRequest) if name not in nested}
        values |= dataclasses.asdict(self.outputs) | dataclasses.asdict(self.options)
        plain = {name: _to_plain(value) for name, value in values.items()}
        return {**plain, "settings": dataclasses.asdict(self.settings)}

    @property
    def inputs(self) -> tuple[Path, ...]:
        """All files that are read, of the start without its frame."""
        start = None if self.start is None else parse_start(self.start)[0]
        optional = (path for path in (self.cameras, self.body, start) if path is not None)
        return (*self.sources, *self.backgrounds, *optional)


def _names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


def _pick(values: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    return {name: values[name] for name in _names(kind) if name in values}


def _to_plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_to_plain(item) for item in value]
    return os.fspath(value) if isinstance(value, os.PathLike) else value


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

    settings = given.get("settings")
    if isinstance(settings, TrackerSettings):
        return settings
    if settings is not None:
        stored: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()
        }
        return TrackerSettings(**stored)
    preset = PAPER if given.get("method") == "paper" else TrackerSettings()
    names = ("reading", "evidence", "smoothing", "beam")
    changed: dict[str, Any] = {name: given[name] for name in names if given.get(name) is not None}
    changed = {name: str(value) if isinstance(value, str) else value for name, value in changed.items()}
    return dataclasses.replace(preset, **changed)


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
