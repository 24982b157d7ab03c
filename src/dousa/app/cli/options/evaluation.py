"""The options of evaluate and experiment-errors, in groups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import typer

Which = Literal["all", "tuning", "held-out"]
"""Which motions an experiment uses."""


@dataclass(frozen=True, slots=True)
class InjectionOptions:
    """The performer who makes mistakes."""

    repeats: Annotated[
        int,
        typer.Option(
            "--repeats", min=0, help="Number of repeats, with different errors; 0: no errors (see --takes-from)."
        ),
    ] = 1
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0
    noise: Annotated[
        float,
        typer.Option(
            "--noise", min=0.0, max=90.0, metavar="DEG", help="Fluctuation of the simulated performer's pose."
        ),
    ] = 3.0
    timing: Annotated[
        float,
        typer.Option(
            "--timing", min=0.0, max=5000.0, metavar="MS", help="Fluctuation of the simulated performer's timing."
        ),
    ] = 20.0
    which: Annotated[
        Which,
        typer.Option("--which", help="held-out: the 30 % of the files, by name, that no limit was chosen on."),
    ] = "all"


@dataclass(frozen=True, slots=True)
class TakesOptions:
    """Second takes, in which nothing is wrong."""

    takes_from: Annotated[
        str | None,
        typer.Option(
            "--takes-from",
            metavar="RULE",
            help="Which files are takes of the same motion by one person (folder, name:REGEX, path:REGEX, csv:FILE): "
            "counts the false alarms between them.",
        ),
    ] = None
    references: Annotated[
        int, typer.Option("--references", min=1, help="Reference takes for each take of --takes-from.")
    ] = 5
