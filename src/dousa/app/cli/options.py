"""Options that several commands share, spelled once."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dousa.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


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
Unit = Annotated[
    str | None,
    typer.Option(
        "--unit",
        help="Unit of the file: mm, cm, m, inch, ft or metres per unit. Default: declared, else inferred.",
    ),
]
Up = Annotated[
    str | None,
    typer.Option("--up", help="Axis of the file that points up: y, z, x, -y ... Default: inferred."),
]
SkeletonFile = Annotated[
    Path | None,
    typer.Option("--skeleton", help="The .asf of an .amc. Default: searched for next to and above it."),
]
JointMap = Annotated[
    Path | None,
    typer.Option("--joint-map", help="File that names the canonical joints: lines 'left_knee = L_Kn', TOML or JSON."),
]


def _check_jobs(jobs: int | None) -> int | None:
    if jobs == 0:
        raise OptionError("usage.jobs")
    return jobs


Jobs = Annotated[
    int | None,
    typer.Option("--jobs", "-j", min=-1, callback=_check_jobs, help="Workers; default: all cores."),
]
CategoryFrom = Annotated[
    str,
    typer.Option(
        "--category-from",
        help="Where categories come from: folder, name:REGEX, path:REGEX, csv:FILE or none.",
    ),
]
PerformerFrom = Annotated[
    str | None,
    typer.Option("--performer-from", help="Where performers come from: folder, name:REGEX, path:REGEX or csv:FILE."),
]
LibraryPath = Annotated[
    str, typer.Argument(metavar="LIB", help="The library: a file such as moves.dousa, or a database URL.")
]


def load_joint_map(path: Path | None) -> Mapping[str, str | Sequence[str]] | None:
    """The joint map of ``--joint-map``, None if it was not given."""
    if path is None:
        return None
    from dousa.motion import read_joint_map

    mapping: Mapping[str, str | Sequence[str]] = read_joint_map(path)
    return mapping
