"""The options that the experiments on labelled clips share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from dousa.app.output import console, print_json, warn_skipped
from dousa.app.requests.library import FeatureSet
from dousa.app.tables.lines import print_tables
from dousa.experiments.table import Result
from dousa.formats.motion_files import Skipped


@dataclass(frozen=True, slots=True)
class ForestOptions:
    """What the forest sees, and how it is grown."""

    features: Annotated[
        FeatureSet,
        typer.Option("--features", help="paper: the 56 pose features; extended: also speeds, spreads, trends."),
    ] = "extended"
    trees: Annotated[int, typer.Option("--trees", min=1, help="Trees of the forest.")] = 100
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0

    def to_arguments(self) -> dict[str, Any]:
        """Return the arguments of an experiment."""
        return {"feature_set": self.features, "n_trees": self.trees, "random_state": self.seed}


def print_result(result: Result, skipped: list[Skipped], *, json: bool) -> None:
    """Print the answer of an experiment and the files that it left out."""
    warn_skipped(skipped)
    if json:
        print_json({**result.to_json(), "skipped": [item.to_json() for item in skipped]})
    else:
        print_tables(console(), result.to_tables())
