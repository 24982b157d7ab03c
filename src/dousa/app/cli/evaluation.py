"""Commands that evaluate motion: evaluate and progress."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import console, print_answer, print_json, progress_bar, say, warn
from dousa.app.requests.evaluation import EvaluationRequest
from dousa.app.requests.reading import Reading
from dousa.app.targets import REPORT, check_targets
from dousa.errors import OptionError
from dousa.messages import Message, get_language

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app.pipelines.evaluate import Evaluation
    from dousa.evaluation import Assessment
    from dousa.formats.motion_files import ReadOptions

_REPORT_FILES, _EXERCISE_FILES = ("report.html", "curves.csv", "events.csv"), ("report.html", "repetitions.csv")


def evaluate(
    reference: Annotated[
        list[Path],
        typer.Argument(
            metavar="REFERENCE...",
            help="Reference: one take, or better five or more; files or folders of BVH, AMC, C3D, TRC, NPZ. The "
            "first is what the performance is held against, all of them show what may vary.",
        ),
    ],
    performance: Annotated[
        Path | None,
        typer.Option(
            "--performance", "-p", metavar="FILE", help="The motion to evaluate (required).", show_default=False
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Write the report (HTML) and the curves (CSV) there."),
    ] = None,
    notes: Annotated[
        str | None,
        typer.Option("--notes", metavar="TEXT", help="Remarks on the performance, for the report."),
    ] = None,
    detail: Annotated[
        Literal["brief", "full"],
        typer.Option(
            "--detail", help="brief: the grade and what to work on first; full: every error, or repetition, as well."
        ),
    ] = "full",
    *,
    request: EvaluationRequest,
    reading: Reading,
    json: Json = False,
) -> None:
    """Show what differs between a performance and its reference, where, and by how much.

    Four kinds of error are distinguished: another motion of the whole body,
    another motion of a limb, motion not carried out to the full, and wrong timing.
    With one REFERENCE take the grade is not calibrated.

    Example: dousa evaluate teacher_*.bvh --performance pupil.bvh -o report

    Example: dousa evaluate squat.trc --performance squats.trc --repetitions -o squats
    """
    from dousa.app.pipelines.evaluate import find_references

    if performance is None:
        raise OptionError("evaluation_cli.no_performance")
    request.check()
    _check_report(output, notes, (*reference, performance), request)
    if not performance.exists():
        raise OptionError("evaluation_cli.performance_not_found", path=performance)
    files = find_references(reference)
    options = reading.load()
    if request.repetitions:
        _evaluate_exercise(files, performance, options, request, detail, output=output, json=json)
    else:
        _evaluate_dance(files, performance, options, request, detail, output=output, notes=notes or "", json=json)


def _check_report(output: Path | None, notes: str | None, motions: Sequence[Path], request: EvaluationRequest) -> None:
    from dousa.app.pipelines.evaluate import check_folder

    if notes is not None and request.repetitions:
        raise OptionError("exercises.not_with", option="--notes")
    if notes is not None and output is None:
        raise OptionError("evaluation_cli.notes_without_output")
    if output is not None:
        check_folder(output)
        for name in _EXERCISE_FILES if request.repetitions else _REPORT_FILES:
            check_targets({"--output": output / name}, (*motions, request.furi, request.weights), REPORT)


def _evaluate_dance(
    references: Sequence[Path],
    performance: Path,
    options: ReadOptions,
    request: EvaluationRequest,
    detail: str,
    *,
    output: Path | None,
    notes: str,
    json: bool,
) -> None:
    from dousa.app.pipelines.evaluate import evaluate_files, load_beats, time_accents
    from dousa.app.tables.evaluation import print_assessment

    beats, judging = load_beats(request.music), request.choose_judging()
    with progress_bar() as progress:
        done = evaluate_files(
            references, performance, options=options, furi_file=request.furi, **judging, progress=progress
        )
        timing = None if beats is None else time_accents(done, beats, request.music_start)
        page = None
        if output is not None:
            from dousa.app.report.page import write_report

            progress(len(references) + 1, len(references) + 2, Message("evaluation_cli.writing_report"))
            page = write_report(done.assessment, output, language=get_language(), timing=timing, notes=notes)
    _warn(done)
    if json:
        print_json(_describe(done, page, detail) | ({} if timing is None else {"beats": timing.to_json()}))
        return
    print_assessment(console(), done.assessment, detail)
    words = [] if timing is None else list(timing.messages)
    if page is not None:
        words.append(Message("evaluation_cli.report", path=page))
    for message in words:
        say(message)


def _evaluate_exercise(
    references: Sequence[Path],
    performance: Path,
    options: ReadOptions,
    request: EvaluationRequest,
    detail: str,
    *,
    output: Path | None,
    json: bool,
) -> None:
    from dousa.app.pipelines.evaluate import evaluate_repetitions
    from dousa.app.report.exercise import write_exercise_report
    from dousa.app.tables.evaluation import print_repetitions
    from dousa.evaluation.exercises.summary import to_answer

    judging = request.choose_judging()
    with progress_bar() as progress:
        done = evaluate_repetitions(references, performance, options=options, **judging, progress=progress)
    assessment = done.assessment
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
            "report": None if page is None else str(page),
        }
        print_json({**to_answer(assessment), **files})
        return
    print_repetitions(console(), assessment, detail)
    if page is not None:
        say(Message("evaluation_cli.report", path=page))


def progress(
    answers: Annotated[
        list[Path],
        typer.Argument(metavar="ANSWER...", help="Answers of dousa evaluate --json, the oldest first; two or more."),
    ],
    picture: Annotated[Path | None, typer.Option("--picture", help="Draw the curves: .png, .svg or .pdf.")] = None,
    json: Json = False,
) -> None:
    """Show a pupil over time: the grade and the errors of several evaluations, what improved, and what still fails.

    Example: dousa progress monday.json friday.json --picture pupil.png
    """
    from dousa.app.pipelines.evaluate import compare_answers
    from dousa.app.tables.evaluation import print_progress

    check_targets({"--picture": picture}, answers)
    found, same_reference = compare_answers(answers)
    if not same_reference:
        warn(Message("evaluation_cli.other_reference"))
    print_answer(found, print_progress, json=json)
    if picture is not None:
        from dousa.app.pictures.charts import draw_progress

        draw_progress(found, picture)


def _describe(done: Evaluation[Assessment], page: Path | None, detail: str) -> dict[str, Any]:
    from dousa.evaluation import advise, describe_advice

    return {
        **done.assessment.to_json(),
        "advice": describe_advice(advise(done.assessment, detail)),
        "references": [str(path) for path in done.references],
        "performance": str(done.performance),
        "report": None if page is None else str(page),
    }


def _warn(done: Evaluation[Assessment]) -> None:
    import os

    for note, count in Counter(note for _, note in done.notes).items():
        where = next(path for path, other in done.notes if other == note)
        code = "evaluation_cli.note" if count == 1 else "evaluation_cli.note_of_several"
        warn(Message(code, path=where, note=note, more=count - 1))
    same = {os.path.realpath(path) for path in done.references}
    if len(same) > 1 and os.path.realpath(done.performance) in same:
        warn(Message("evaluation_cli.performance_is_reference", path=done.performance))
    for warning in done.assessment.warnings:
        warn(warning)
