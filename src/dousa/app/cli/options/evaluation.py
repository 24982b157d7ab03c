"""The options of evaluate and experiment-errors, in groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

Which = Literal["all", "tuning", "held-out"]
"""Which motions an experiment uses."""

_EQUAL = Path("equal")  # as --weights


@dataclass(frozen=True, slots=True)
class JudgingOptions:
    """What the two motions are compared by, and how much is told."""

    furi: Annotated[
        Path | None,
        typer.Option(
            "--furi",
            metavar="FILE",
            help="Boundaries of the figures, in frames or seconds of the first REFERENCE. Default: detected.",
        ),
    ] = None
    mirror: Annotated[
        bool, typer.Option("--mirror", help="The performer faced the reference and danced its mirror image.")
    ] = False
    tempo: Annotated[
        Literal["same", "free"] | None,
        typer.Option(
            "--tempo",
            help="same: lateness counts; free: being slower throughout does not. Default: same; with --repetitions "
            "free.",
            show_default=False,
        ),
    ] = None
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights",
            metavar="FILE",
            help="Weights: lines such as 'arms = 2', 'left_shank = 0', multiplied with what matters in the reference. "
            "'equal' instead of a file: as --importance equal.",
        ),
    ] = None
    importance: Annotated[
        Literal["learned", "equal"],
        typer.Option(
            "--importance",
            help="learned: in the grade segments count as they matter in the reference; equal: all alike.",
        ),
    ] = "learned"
    detail: Annotated[
        Literal["brief", "full"],
        typer.Option(
            "--detail", help="brief: the grade and what to work on first; full: every error, or repetition, as well."
        ),
    ] = "full"

    @property
    def side(self) -> str:
        """Whose left and right the performer's are, in the words of `dousa.evaluation.assess`."""
        return "mirrored" if self.mirror else "same"

    def choose_weights(self) -> dict[str, Any]:
        """``weights`` and ``importance`` of `dousa.evaluation.assess`; the file of the weights is read."""
        if self.weights == _EQUAL:
            return {"weights": None, "importance": "equal"}
        from dousa.evaluation import read_weights

        weights = None if self.weights is None else read_weights(self.weights)
        return {"weights": weights, "importance": self.importance}


@dataclass(frozen=True, slots=True)
class ExerciseOptions:
    """An exercise of several repetitions."""

    repetitions: Annotated[
        bool,
        typer.Option(
            "--repetitions",
            help="An exercise: count the repetitions, grade and measure each, and say how they develop.",
        ),
    ] = False
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="With --repetitions: write a row for each.")
    ] = None
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="With --repetitions: draw them (.png, .svg or .pdf)."),
    ] = None


@dataclass(frozen=True, slots=True)
class BeatOptions:
    """The music that is danced to."""

    music: Annotated[
        Path | None,
        typer.Option("--music", metavar="FILE", help="The music: how early or late the accents are to its beats."),
    ] = None
    beats: Annotated[
        Path | None,
        typer.Option(
            "--beats", metavar="FILE", help="Its beats instead: one time in seconds a line, or Audacity labels."
        ),
    ] = None
    music_start: Annotated[
        float | None,
        typer.Option(
            "--music-start",
            metavar="SECONDS",
            help="Where the music begins in the recording of the performance. Default: estimated.",
        ),
    ] = None


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
