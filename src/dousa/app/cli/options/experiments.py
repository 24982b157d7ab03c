"""The options of experiment and experiment-estimation, in groups."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app.cli.options import shared as o

SplitName = Literal["half", "leave-performer-out"]


class SystemName(enum.StrEnum):
    """What is compared: the first four tell categories apart, the last seven rank."""

    FULL_TREE = "full_tree"
    RANDOM_TREE = "random_tree"
    FOREST = "forest"
    MOTION_TEMPLATES = "motion_templates"
    FUSED = "fused"
    HISTOGRAM = "histogram"
    LEAVES = "leaves"
    POSE = "pose"
    EUCLIDEAN = "euclidean"
    DTW = "dtw"


class VariantName(enum.StrEnum):
    """Kinds of sequences, by the ends of their names."""

    CLEAN = "clean"
    NOISY = "noisy"


StartName = Literal["truth", "auto"]

BodyName = Literal["stature", "start"]

ViewChoiceName = Literal["first", "all"]

SAMPLES = 8


@dataclass(frozen=True, slots=True)
class SplitOptions:
    """What is trained on and what is tested, and how often."""

    test: Annotated[
        list[Path] | None,
        typer.Option("--test", help="Train on PATH and test on this folder instead of splitting."),
    ] = None
    split: Annotated[SplitName | None, typer.Option("--split", help="How PATH is split.", show_default="half")] = None
    train_share: Annotated[
        float | None,
        typer.Option("--train-share", help="Share of every category to train on, instead of half.", show_default="0.5"),
    ] = None
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Number of repeats, with different seeds.")] = 1


@dataclass(frozen=True, slots=True)
class KindOptions:
    """What is asked; by default, which category clips are of."""

    ranking: Annotated[
        bool,
        typer.Option("--ranking", help="Evaluate the ranking of retrieved clips instead of their categories."),
    ] = False
    takes: Annotated[
        bool,
        typer.Option("--takes", help="Evaluate labelling and search of takes concatenated from clips, or annotated."),
    ] = False
    labels: Annotated[
        str | None,
        typer.Option(
            "--labels",
            metavar="RULE",
            help="With --takes: PATH holds takes, with tables of what happens when: beside, folder:FOLDER or csv:FILE.",
        ),
    ] = None
    tier: Annotated[
        str | None,
        typer.Option("--tier", help="Tier of these tables.", show_default="the first that has labels"),
    ] = None
    unknown: Annotated[
        bool,
        typer.Option("--unknown", help="Evaluate detection of unknown motions and learning of new categories."),
    ] = False


@dataclass(frozen=True, slots=True)
class SystemOptions:
    """The systems and what they look at."""

    features: Annotated[
        o.FeatureSetName | None,
        typer.Option(
            "--features",
            help="paper: the 56 pose features; extended: also speeds, spreads, trends.",
            show_default="paper; extended with --ranking, --takes and --unknown",
        ),
    ] = None
    system: Annotated[
        list[SystemName] | None,
        typer.Option(
            "--system",
            help="Only this system; can be repeated.",
            show_default="all four; with --ranking the last seven",
        ),
    ] = None
    samples: Annotated[
        int,
        typer.Option("--samples", min=1, help="Poses averaged for each of the 10 frames; 1 is plain downsampling."),
    ] = SAMPLES
    trees: Annotated[int, typer.Option("--trees", min=1, help="Trees of the forest.")] = 100
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0


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
        list[o.Reading] | None,
        typer.Option("--reading", help="Reading of eq. 2; with --paper several.", show_default="masked"),
    ] = None
    evidence: Annotated[
        list[o.Evidence] | None,
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
