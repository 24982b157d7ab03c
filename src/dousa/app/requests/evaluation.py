"""What an evaluation can be asked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from dousa.errors import OptionError

Tempo = Literal["same", "free"]
Mirrored = Literal["auto", "yes", "no"]


def choose_tempo(tempo: Tempo | None, *, repetitions: bool) -> Tempo:
    """The tempo, by default free for repetitions and else the same."""
    return tempo or ("free" if repetitions else "same")


@dataclass(frozen=True, slots=True)
class EvaluationRequest:
    """How a performance is held against a reference."""

    furi: Annotated[
        Path | None,
        typer.Option(
            "--furi",
            metavar="FILE",
            help="Boundaries of the figures, in frames or seconds of the first REFERENCE. Default: detected.",
        ),
    ] = None
    mirror: Annotated[
        Mirrored,
        typer.Option(
            "--mirror",
            help="Whether the performer faced the reference and did its mirror image: yes, no, or auto, which "
            "finds out.",
        ),
    ] = "auto"
    tempo: Annotated[
        Tempo | None,
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
            help="Weights in the grade: lines such as 'arms = 2', 'left_shank = 0'.",
        ),
    ] = None
    repetitions: Annotated[
        bool,
        typer.Option(
            "--repetitions",
            help="An exercise: count the repetitions, grade and measure each, and say how they develop.",
        ),
    ] = False
    music: Annotated[
        Path | None,
        typer.Option(
            "--music",
            metavar="FILE",
            help="The music: how early or late the accents are to its beats. Or its beats (.txt): one time in seconds "
            "a line, or Audacity labels.",
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

    def check(self) -> None:
        """Check that the options go together, before the long work.

        Raises
        ------
        OptionError : options that contradict each other.
        """
        for option, value in (("--furi", self.furi), ("--music", self.music)):
            if self.repetitions and value is not None:
                raise OptionError("exercises.not_with", option=option)
        if self.music_start is not None and self.music is None:
            raise OptionError("beats.start_with")

    def choose_judging(self) -> dict[str, Any]:
        """``side``, ``tempo`` and ``weights`` of `dousa.evaluation.assess`; the weights are read."""
        judging: dict[str, Any] = {"side": {"auto": "auto", "yes": "mirrored", "no": "same"}[self.mirror]}
        judging["tempo"] = choose_tempo(self.tempo, repetitions=self.repetitions)
        from dousa.evaluation import read_weights

        weights = None if self.weights is None else read_weights(self.weights)
        return {**judging, "weights": weights}
