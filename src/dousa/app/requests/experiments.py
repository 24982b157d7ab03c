"""The request of an experiment on recognition or on takes."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dousa.app.requests.library import FeatureSet
from dousa.errors import OptionError


class SystemName(enum.StrEnum):
    """Classifiers that are compared."""

    FULL_TREE = "full_tree"
    RANDOM_TREE = "random_tree"
    FOREST = "forest"
    MOTION_TEMPLATES = "motion_templates"


@dataclass(frozen=True, slots=True)
class ExperimentRequest:
    """What is measured, on which clips, and which systems are compared."""

    test: Annotated[
        list[Path] | None,
        typer.Option("--test", help="Train on PATH and test on this folder instead of splitting."),
    ] = None
    split: Annotated[
        str | None,
        typer.Option(
            "--split",
            metavar="half|leave-performer-out|SHARE",
            help="How PATH is split; SHARE: of every category to train on.",
            show_default="half",
        ),
    ] = None
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Number of repeats, with different seeds.")] = 1
    takes: Annotated[
        bool,
        typer.Option("--takes", help="Evaluate labelling and search of takes concatenated from clips, or annotated."),
    ] = False
    features: Annotated[
        FeatureSet | None,
        typer.Option(
            "--features",
            help="paper: the 56 pose features; extended: also speeds, spreads, trends.",
            show_default="paper; extended with --takes",
        ),
    ] = None
    system: Annotated[
        list[SystemName] | None,
        typer.Option(
            "--system",
            help="Only this system; can be repeated.",
            show_default="all four",
        ),
    ] = None
    trees: Annotated[int, typer.Option("--trees", min=1, help="Trees of the forest.")] = 100

    @property
    def train_share(self) -> float | None:
        """The share of every category to train on, where ``split`` is one.

        Raises
        ------
        OptionError : ``split`` is neither a way nor a number.
        """
        if self.split in (None, "half", "leave-performer-out"):
            return None
        try:
            return float(self.split or "")
        except ValueError:
            raise OptionError("experiments_cli.split", found=self.split) from None
