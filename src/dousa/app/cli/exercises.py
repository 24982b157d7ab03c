"""``dousa evaluate --repetitions``: what it reads, says and writes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dousa.app import tables
from dousa.app.output import console, print_json, progress_bar, say, warn
from dousa.app.targets import REPETITIONS, check_targets
from dousa.errors import OptionError
from dousa.files.disk import atomic_write
from dousa.messages import Message, get_language

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from dousa.app.cli.options.evaluation import ExerciseOptions, JudgingOptions
    from dousa.evaluation import RepetitionsAssessment
    from dousa.formats.motion_files import ReadOptions


def check_exercise_options(options: ExerciseOptions, others: Mapping[str, Path | str | None]) -> None:
    """Whether the options go together, before the long work.

    Raises
    ------
    OptionError : ``--csv`` or ``--picture`` without ``--repetitions``, or one of the others with it.
    """
    if not options.repetitions and (options.csv is not None or options.picture is not None):
        raise OptionError("exercises.csv_with")
    for option, value in others.items():
        if options.repetitions and value is not None:
            raise OptionError("exercises.not_with", option=option)


def evaluate_exercise(
    references: Sequence[Path],
    performance: Path,
    options: ReadOptions,
    judging: JudgingOptions,
    exercise: ExerciseOptions,
    *,
    output: Path | None,
    json: bool,
) -> None:
    """Assess the repetitions in a file; print a table or JSON, write CSV and picture."""
    from dousa.app.pipelines.evaluate import evaluate_repetitions
    from dousa.app.report import to_repetitions_csv, write_exercise_report

    csv, picture = exercise.csv, exercise.picture
    check_targets({"--csv": csv, "--picture": picture}, (*references, performance, judging.weights), REPETITIONS)
    weights = judging.choose_weights()
    with progress_bar() as progress:
        done = evaluate_repetitions(
            references,
            performance,
            options=options,
            side=judging.side,
            tempo=judging.tempo or "free",
            **weights,
            progress=progress,
        )
    assessment = done.assessment
    if csv is not None:
        with atomic_write(csv) as file:
            file.write(to_repetitions_csv(assessment))
    if picture is not None:
        from dousa.app.pictures.repetitions_sheet import draw_repetitions
        from dousa.evaluation.exercises.summary import choose_angles

        draw_repetitions(assessment, done.motion, picture, choose_angles(assessment))
    page = None
    if output is not None:
        name = performance.name
        page = write_exercise_report(assessment, done.motion, output, language=get_language(), name=name)
    for path, note in dict.fromkeys(done.notes):
        warn(Message("evaluation_cli.note", path=path, note=note))
    for warning in assessment.warnings:
        warn(warning)
    if json:
        files: dict[str, Any] = {
            "references": [str(path) for path in done.references],
            "performance": str(done.performance),
            "csv": None if csv is None else str(csv),
            "picture": None if picture is None else str(picture),
            "report": None if page is None else str(page),
        }
        print_json({**assessment.to_json(), **_describe(assessment), **files})
        return
    tables.print_repetitions(console(), assessment, judging.detail)
    outputs = (("exercise_table.csv", csv), ("exercise_table.picture", picture), ("evaluation_cli.report", page))
    for code, written in outputs:
        if written is not None:
            say(Message(code, path=written))


def _describe(assessment: RepetitionsAssessment) -> dict[str, Any]:
    """What to know first, as sentences and codes."""
    from dousa.evaluation import describe_exercise, describe_trends

    said = (*describe_exercise(assessment), *describe_trends(assessment))
    return {"says": [str(message) for message in said], "says_codes": [message.code for message in said]}
