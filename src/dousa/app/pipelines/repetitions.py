"""From motion files to the repetitions of an exercise: the command without its options."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.pipelines.evaluate import read_take
from dousa.errors import InvalidMotionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.evaluation import RepetitionsAssessment
    from dousa.formats.motion_files import ReadOptions
    from dousa.motion import CanonicalMotion


@dataclass(frozen=True, slots=True, eq=False)
class ExerciseEvaluation:
    """The repetitions found in a performance, and the files that they are about.

    Parameters
    ----------
    assessment : the answer.
    motion : the performance.
    references, performance : files.
    notes : (file, warning) what reading the files said.
    """

    assessment: RepetitionsAssessment
    motion: CanonicalMotion
    references: tuple[Path, ...]
    performance: Path
    notes: tuple[tuple[Path, Message], ...]


def evaluate_repetitions(
    references: Sequence[Path],
    performance: Path,
    *,
    options: ReadOptions,
    side: str = "same",
    tempo: str = "free",
    weights: Mapping[str, float] | None = None,
    importance: str = "learned",
    progress: ProgressCallback | None = None,
) -> ExerciseEvaluation:
    """Read the files, split the performance into repetitions, and assess each.

    Parameters
    ----------
    references, performance : files, see `dousa.app.pipelines.evaluate.find_references`.
    options : what is said about all of them.
    side, tempo, weights, importance : as in `dousa.evaluation.assess_repetitions`.
    progress : called with (steps done, steps, what is being done).

    Raises
    ------
    DousaError : a file or motion that cannot be used; the message says which.
    """
    from dousa.evaluation import ABOUT_REFERENCES, assess_repetitions

    steps = len(references) + 2
    report = progress or (lambda done, total, what: None)
    notes: list[tuple[Path, Message]] = []
    takes = []
    for number, path in enumerate((*references, performance)):
        report(number, steps, Message("progress.reading"))
        takes.append(read_take(path, options, notes))
    report(steps - 1, steps, Message("progress.comparing"))
    try:
        assessment = assess_repetitions(
            takes[:-1], takes[-1], side=side, tempo=tempo, weights=weights, importance=importance
        )
    except InvalidMotionError as error:
        about_references = error.code in (*ABOUT_REFERENCES, "exercises.still_reference")
        shortest = min(range(len(references)), key=lambda number: takes[number].duration)
        where = references[shortest] if about_references else performance
        raise InvalidMotionError("cli.file_problem", path=os.fspath(where), reason=error.located) from error
    return ExerciseEvaluation(assessment, takes[-1], tuple(references), performance, tuple(notes))
