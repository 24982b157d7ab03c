"""The options of experiment and experiment-estimation, in groups."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Annotated, Literal

import typer


class VariantName(enum.StrEnum):
    """Kinds of sequences, by the ends of their names."""

    CLEAN = "clean"
    NOISY = "noisy"


class ReadingName(enum.StrEnum):
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


StartName = Literal["truth", "auto"]

BodyName = Literal["stature", "start"]

ViewChoiceName = Literal["first", "all"]


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """What the tracker is given, and how it searches."""

    views: Annotated[
        str, typer.Option("--views", metavar="N,N...", help="Numbers of views to evaluate, each in turn.")
    ] = "1,2,4"
    choice: Annotated[
        ViewChoiceName,
        typer.Option(
            "--choice",
            help="first: one view is the first, two are it and the one most nearly at right angles to it; all: "
            "every choice, averaged.",
        ),
    ] = "first"
    variant: Annotated[
        list[VariantName] | None,
        typer.Option(
            "--variant",
            help="Only files of a folder whose names end in this; can be repeated.",
            show_default="both",
        ),
    ] = None
    start: Annotated[
        StartName,
        typer.Option("--start", help="truth: the true joints of the first frame are given; auto: the start is found."),
    ] = "truth"
    body: Annotated[
        BodyName,
        typer.Option("--body", help="stature: from tables; start: also the bones that the first frame shows."),
    ] = "stature"
    reading: Annotated[
        list[ReadingName] | None,
        typer.Option("--reading", help="Reading of eq. 2; with --paper several.", show_default="masked"),
    ] = None
    evidence: Annotated[
        list[Evidence] | None,
        typer.Option(
            "--evidence",
            help="How image and inertia are weighted; with --paper several.",
            show_default="log",
        ),
    ] = None

    @property
    def readings(self) -> list[str]:
        """The readings named."""
        return [name.value for name in self.reading or ()]

    @property
    def evidences(self) -> list[str]:
        """The ways of weighting named."""
        return [name.value for name in self.evidence or ()]


@dataclass(frozen=True, slots=True)
class PaperOptions:
    """The experiment of the paper."""

    paper: Annotated[
        bool,
        typer.Option("--paper", help="The paper's experiment on one PATH: all readings, dR = 6 deg, s = 1 deg."),
    ] = False
    frames: Annotated[
        str | None,
        typer.Option("--frames", metavar="FIRST:STOP", help="Frames of --paper, from 0.", show_default="40:76"),
    ] = None
