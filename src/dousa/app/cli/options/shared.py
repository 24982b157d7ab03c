"""Options that several commands share, spelled once: one by one, or in groups.

A group is a dataclass. A command that has a parameter of such a type, after a ``*``, has the options of its fields, and
gets their values in one object: `dousa.app.cli.usage.to_typer_command`.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.formats.motion_files import ReadOptions


class FeatureSetName(enum.StrEnum):
    """The feature set of a forest."""

    PAPER = "paper"
    EXTENDED = "extended"


class Reading(enum.StrEnum):
    """Readings of eq. 2 of the paper."""

    MASKED = "masked"
    RESIDUAL = "residual"
    UNION = "union"
    PLAIN = "plain"
    LITERAL = "literal"


class Evidence(enum.StrEnum):
    """How the mismatch is weighted against inertia."""

    LOG = "log"
    LOCAL = "local"
    GLOBAL = "global"


Json = Annotated[bool, typer.Option("--json", help="Answer as JSON on standard output.")]


@dataclass(frozen=True, slots=True)
class FileOptions:
    """What a motion file does not say of itself."""

    unit: Annotated[
        str | None,
        typer.Option(
            "--unit",
            help="Unit of the file: mm, cm, m, inch, ft or metres per unit. Default: declared, else inferred.",
        ),
    ] = None
    up: Annotated[
        str | None,
        typer.Option("--up", help="Axis of the file that points up: y, z, x, -y ... Default: inferred."),
    ] = None
    skeleton: Annotated[
        Path | None,
        typer.Option(
            "--skeleton",
            help="The .asf of an .amc (default: searched for next to and above it), the .pmx of a .vmd, or the body"
            " model of SMPL poses.",
        ),
    ] = None
    file_rate: Annotated[
        float | None,
        typer.Option("--file-rate", metavar="HZ", help="Frame rate of a file that does not say it: arrays, JSON."),
    ] = None

    @property
    def files(self) -> tuple[Path | None, ...]:
        """The files that the options name."""
        return (self.skeleton,)

    def load(self) -> ReadOptions:
        """The options in the form in which files are read; the files that they name are read."""
        from dousa.formats.motion_files import ReadOptions

        return ReadOptions(unit=self.unit, up=self.up, skeleton=self.skeleton, frame_rate=self.file_rate)


@dataclass(frozen=True, slots=True)
class MotionOptions(FileOptions):
    """What a motion file does not say of itself, and which of its joints is which."""

    joint_map: Annotated[
        Path | None,
        typer.Option(
            "--joint-map",
            help="File that names the canonical joints: lines 'left_knee = L_Kn' (or a mean: 'left_knee = LKNE, LKNM'),"
            " TOML or JSON.",
        ),
    ] = None
    any_skeleton: Annotated[
        bool, typer.Option("--any-skeleton", help="Also take skeletons that are not human, such as animals.")
    ] = False

    @property
    def files(self) -> tuple[Path | None, ...]:
        """The files that the options name."""
        return (self.skeleton, self.joint_map)

    def load(self) -> ReadOptions:
        """The options in the form in which files are read; the files that they name are read."""
        options = replace(FileOptions.load(self), any_skeleton=self.any_skeleton)
        if self.joint_map is None:
            return options
        from dousa.motion import read_joint_map

        return replace(options, joint_map=read_joint_map(self.joint_map))


@dataclass(frozen=True, slots=True)
class CharacterOptions:
    """On whose skeleton a motion is written, and how often a second."""

    onto: Annotated[
        Path | None,
        typer.Option("--onto", metavar="CHARACTER", help="Put the motion onto the skeleton of this file."),
    ] = None
    keep_reach: Annotated[
        bool, typer.Option("--keep-reach", help="With --onto: hands reach the same places, instead of arm directions.")
    ] = False
    frame_rate: Annotated[float | None, typer.Option("--frame-rate", help="Resample to this rate in Hz.")] = None


def _check_jobs(jobs: int | None) -> int | None:
    if jobs == 0:
        raise OptionError("usage.jobs")
    return jobs


Jobs = Annotated[
    int | None,
    typer.Option("--jobs", "-j", min=-1, callback=_check_jobs, help="Workers; default: all cores."),
]


Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Let the workers of a Dask scheduler, such as tcp://HOST:8786, read, describe and grow trees.",
    ),
]


Wait = Annotated[
    float,
    typer.Option("--wait", metavar="SECONDS", min=0, help="How long to wait while other programs write."),
]


@dataclass(frozen=True, slots=True)
class LabelOptions:
    """The rules that tell what is in a file, and whose it is."""

    category_from: Annotated[
        str,
        typer.Option(
            "--category-from",
            help="Where categories come from: folder, name:REGEX, path:REGEX, csv:FILE or none.",
        ),
    ] = "folder"
    performer_from: Annotated[
        str | None,
        typer.Option(
            "--performer-from", help="Where performers come from: folder, name:REGEX, path:REGEX or csv:FILE."
        ),
    ] = None


Select = Annotated[
    str | None,
    typer.Option("--select", metavar="NAME", help="Only clips of a saved search or selection (see dousa tag --list)."),
]

LibraryPath = Annotated[
    str, typer.Argument(metavar="LIB", help="The library: a file such as moves.dousa, or a database URL.")
]


def list_values(*groups: Any) -> dict[str, Any]:
    """The values of some groups, or other dataclasses, under the names of their fields."""
    return {field.name: getattr(group, field.name) for group in groups for field in fields(group)}
