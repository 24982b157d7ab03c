"""What libraries can be asked: to add and train, to search, classify and label, and to export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

FeatureSet = Literal["paper", "extended"]
Ranking = Literal["fused", "histogram", "leaves", "pose"]

Share = Annotated[
    float | None,
    typer.Option(
        "--threshold",
        min=0,
        max=1,
        help="Confidence below which a motion is called unknown; 0: never.",
        show_default="0.5",
    ),
]
Mirror = Annotated[
    bool | None,
    typer.Option(
        "--mirror/--no-mirror",
        help="Also search for the mirror image of the motion, or never.",
        show_default="instead, where clearly likelier",
    ),
]


@dataclass(frozen=True, slots=True)
class LabelRules:
    """Where the labels of files come from; see `dousa.library.label_rules`."""

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


@dataclass(frozen=True, slots=True)
class TakeLabels:
    """Where takes have tables of what happens when; see `dousa.library.annotations.matching`."""

    labels: Annotated[
        str | None,
        typer.Option(
            "--labels",
            metavar="RULE",
            help="With --takes: where their tables of what happens when are: beside, folder:FOLDER or csv:FILE.",
        ),
    ] = None
    tier: Annotated[
        str | None,
        typer.Option("--tier", help="Tier of these tables.", show_default="the first that has labels"),
    ] = None


@dataclass(frozen=True, slots=True)
class TrainRequest:
    """How a forest is trained; `dousa.Library.train` takes more."""

    feature_set: Annotated[
        FeatureSet | None,
        typer.Option(
            "--features",
            help="Features of the trees: the 56 pose features of the paper, or also speeds, spreads and trends.",
            show_default="extended",
        ),
    ] = None
    n_trees: Annotated[int, typer.Option("--trees", min=1, help="Number of trees.")] = 100
    random_state: int = 0


@dataclass(frozen=True, slots=True)
class ClassifyRequest:
    """How motions are named."""

    mirror: Mirror = None
    explain: Annotated[bool, typer.Option("--explain", help="Explain the answer in words, with times.")] = False
    threshold: Share = None


@dataclass(frozen=True, slots=True)
class LabelRequest:
    """How a take is labelled."""

    threshold: Annotated[
        float | None,
        typer.Option(
            "--threshold",
            min=0,
            max=1,
            help="Minimum confidence of a label.",
            show_default="more likely right than wrong if there is an action",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """How clips like a motion are searched for."""

    k: Annotated[int, typer.Option("-k", "--limit", min=1, help="How many results.")] = 10
    ranking: Annotated[Ranking, typer.Option("--rank", help="Rank by votes, leaves, poses, or all three.")] = "fused"
    mirror: Mirror = None
    explain: Annotated[bool, typer.Option("--explain", help="Explain the answer in words, with times.")] = False
    threshold: Share = None
    same_category: Annotated[
        bool, typer.Option("--same-category", help="Only clips of the category that the motion is taken for.")
    ] = False


@dataclass(frozen=True, slots=True)
class Labels:
    """Clips of one category or performer."""

    category: Annotated[
        str | None, typer.Option("--category", help="Only clips of this category: walk, hdm05/ (all below it), kick*.")
    ] = None
    performer: Annotated[str | None, typer.Option("--performer", help="Only clips of this performer.")] = None


Text = Annotated[
    str | None, typer.Option("--text", "-t", help="Only clips that these words describe (see dousa search).")
]
Like = Annotated[
    str | None,
    typer.Option(
        "--like", metavar="QUERY", help="Only clips that are like this motion file or clip (see dousa search)."
    ),
]


@dataclass(frozen=True, slots=True)
class TaggedLabels(Labels):
    """Clips of one category, performer or tag, that words describe, or that are like a motion."""

    text: Text = None
    like: Like = None
    tag: Annotated[str | None, typer.Option("--tag", help="Only clips with this tag.")] = None


@dataclass(frozen=True, slots=True)
class Character:
    """On whose skeleton a motion is written, and how often a second."""

    onto: Annotated[
        Path | None,
        typer.Option("--onto", metavar="CHARACTER", help="Put the motion onto the skeleton of this file."),
    ] = None
    keep_reach: Annotated[
        bool, typer.Option("--keep-reach", help="With --onto: hands reach the same places, instead of arm directions.")
    ] = False
    frame_rate: Annotated[float | None, typer.Option("--frame-rate", help="Resample to this rate in Hz.")] = None
