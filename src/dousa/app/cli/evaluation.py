"""Commands that evaluate motion: evaluate, progress and experiment-errors."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from dousa.app.cli import options as o
from dousa.app.output import console, print_json, progress_bar, warn, warn_skipped
from dousa.errors import OptionError
from dousa.messages import Message, get_language

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app.output import ProgressCallback
    from dousa.app.pipelines.evaluate import Evaluation
    from dousa.experiments.error_results import SecondTakes
    from dousa.experiments.errors import NamedMotion

_SHOWN_PROBLEMS = 3
_EQUAL = Path("equal")  # as --weights


Which = Literal["all", "tuning", "held-out"]
"""Which motions an experiment uses."""


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    app.command(rich_help_panel="Evaluation")(evaluate)
    app.command(rich_help_panel="Evaluation")(progress)
    app.command("experiment-errors", rich_help_panel="Evaluation")(experiment_errors)


def evaluate(
    reference: Annotated[
        list[Path],
        typer.Argument(
            metavar="REFERENCE...",
            help="Reference: one take, or better five or more; files or folders of BVH, AMC, C3D, TRC, NPZ. The "
            "first is what the performance is held against, all of them say what may vary.",
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
    furi: Annotated[
        Path | None,
        typer.Option(
            "--furi",
            metavar="FILE",
            help="Boundaries of the figures, in frames or seconds of the first REFERENCE. Default: detected.",
        ),
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="The performer faced the reference and danced its mirror image.")
    ] = False,
    tempo: Annotated[
        Literal["same", "free"] | None,
        typer.Option(
            "--tempo",
            help="same: lateness counts; free: being slower throughout does not. Default: same; with --repetitions "
            "free.",
            show_default=False,
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(
            "--weights",
            metavar="FILE",
            help="Weights: lines such as 'arms = 2', 'left_shank = 0', multiplied with what matters in the reference. "
            "'equal' instead of a file: as --importance equal.",
        ),
    ] = None,
    importance: Annotated[
        Literal["learned", "equal"],
        typer.Option(
            "--importance",
            help="learned: in the grade segments count as they matter in the reference; equal: all alike.",
        ),
    ] = "learned",
    detail: Annotated[
        Literal["brief", "full"],
        typer.Option(
            "--detail", help="brief: the grade and what to work on first; full: every error, or repetition, as well."
        ),
    ] = "full",
    repetitions: Annotated[
        bool,
        typer.Option(
            "--repetitions",
            help="An exercise: count the repetitions, grade and measure each, and say how they develop.",
        ),
    ] = False,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="With --repetitions: write a row for each.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE", help="With --repetitions: draw them (.png, .svg or .pdf)."),
    ] = None,
    music: Annotated[
        Path | None,
        typer.Option("--music", metavar="FILE", help="The music: how early or late the accents are to its beats."),
    ] = None,
    beats: Annotated[
        Path | None,
        typer.Option(
            "--beats", metavar="FILE", help="Its beats instead: one time in seconds a line, or Audacity labels."
        ),
    ] = None,
    music_start: Annotated[
        float | None,
        typer.Option(
            "--music-start",
            metavar="SECONDS",
            help="Where the music begins in the recording of the performance. Default: estimated.",
        ),
    ] = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    json: o.Json = False,
) -> None:
    """Show what differs between a performance and its reference, where, and by how much.

    Tells four errors apart: another motion of the whole body, another motion
    of a limb, motion not danced to the full, and wrong timing. With one
    REFERENCE take the grade is not calibrated, and says so.

    Example: dousa evaluate teacher_*.bvh --performance pupil.bvh -o report

    Example: dousa evaluate squat.trc --performance squats.trc --repetitions --csv squats.csv
    """
    from dousa.app.cli.exercises import ExerciseOptions, check_exercise_options, evaluate_exercise
    from dousa.app.pipelines.beats import check_beat_options, load_beats, time_accents
    from dousa.app.pipelines.evaluate import check_folder, evaluate_files, find_references
    from dousa.formats.motion_files import ReadOptions

    if performance is None:
        raise OptionError("evaluation_cli.no_performance")
    check_exercise_options(repetitions, csv, picture, {"--output": output, "--furi": furi})
    check_beat_options(music, beats, music_start, repetitions)
    if output is not None:
        check_folder(output)
    if not performance.exists():
        raise OptionError("evaluation_cli.performance_not_found", path=performance)
    files, language = find_references(reference), get_language()
    options = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    side = "mirrored" if mirror else "same"
    if weights == _EQUAL:
        importance = "equal"
    if repetitions:
        wanted = ExerciseOptions(side, tempo or "free", _load_weights(weights), importance)
        evaluate_exercise(files, performance, options, wanted, detail=detail, csv=csv, picture=picture, json=json)
        return
    known = load_beats(music, beats)
    with progress_bar() as progress:
        done = evaluate_files(
            files,
            performance,
            options=options,
            furi_file=furi,
            side=side,
            tempo=tempo or "same",
            weights=_load_weights(weights),
            importance=importance,
            progress=progress,
        )
        timing = None if known is None else time_accents(done, known, music_start)
        page = None
        if output is not None:
            from dousa.app.report import write_report

            progress(len(files) + 1, len(files) + 2, Message("evaluation_cli.writing_report"))
            page = write_report(done.assessment, output, language=language)
    _warn(done)
    if json:
        print_json(_describe(done, page, detail) | ({} if timing is None else {"beats": timing.to_json()}))
    else:
        from dousa.app.tables.answers import print_assessment

        print_assessment(console(), done.assessment, detail)
        for message in () if timing is None else timing.messages:
            console().print(str(message), markup=False, soft_wrap=True)
        if page is not None:
            console().print(str(Message("evaluation_cli.report", path=page)), markup=False, soft_wrap=True)


def progress(
    answers: Annotated[
        list[Path],
        typer.Argument(metavar="ANSWER...", help="Answers of dousa evaluate --json, the oldest first; two or more."),
    ],
    picture: Annotated[Path | None, typer.Option("--picture", help="Draw the curves: .png, .svg or .pdf.")] = None,
    json: o.Json = False,
) -> None:
    """Show a pupil over time: the grade and the errors of several evaluations, what improved, and what still fails.

    Example: dousa progress monday.json friday.json --picture pupil.png
    """
    from dousa.app.pipelines.progress import compare_answers

    found, alike = compare_answers(answers)
    if not alike:
        warn(Message("evaluation_cli.other_reference"))
    if json:
        print_json(found.to_json())
    else:
        from dousa.app.tables.progress import print_progress

        print_progress(console(), found)
    if picture is not None:
        from dousa.app.pictures.progress import draw_progress

        draw_progress(found, picture)


def _load_weights(path: Path | None) -> dict[str, float] | None:
    if path is None or path == _EQUAL:
        return None
    from dousa.evaluation import read_weights

    weights: dict[str, float] = read_weights(path)
    return weights


def _describe(done: Evaluation, page: Path | None, detail: str) -> dict[str, Any]:
    from dousa.evaluation import advise, describe_advice

    return {
        **done.assessment.to_json(),
        "advice": describe_advice(advise(done.assessment, detail)),
        "references": [str(path) for path in done.references],
        "performance": str(done.performance),
        "report": None if page is None else str(page),
    }


def _warn(done: Evaluation) -> None:
    """What a person should know, on standard error."""
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


def experiment_errors(
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Correct motions: files, or folders of them.")],
    repeats: Annotated[
        int,
        typer.Option(
            "--repeats", min=0, help="Number of repeats, with different errors; 0: no errors (see --takes-from)."
        ),
    ] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0,
    noise: Annotated[
        float,
        typer.Option(
            "--noise", min=0.0, max=90.0, metavar="DEG", help="Fluctuation of the simulated performer's pose."
        ),
    ] = 3.0,
    timing: Annotated[
        float,
        typer.Option(
            "--timing", min=0.0, max=5000.0, metavar="MS", help="Fluctuation of the simulated performer's timing."
        ),
    ] = 20.0,
    which: Annotated[
        Which,
        typer.Option("--which", help="held-out: the 30 % of the files, by name, that nothing was tuned on."),
    ] = "all",
    takes_from: Annotated[
        str | None,
        typer.Option(
            "--takes-from",
            metavar="RULE",
            help="Which files are takes of the same motion by one person (folder, name:REGEX, path:REGEX, csv:FILE): "
            "counts the false alarms between them.",
        ),
    ] = None,
    references: Annotated[
        int, typer.Option("--references", min=1, help="Reference takes for each take of --takes-from.")
    ] = 5,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """Measure error detection: inject errors of known class, time and size into motions and detect them.

    A made-up performer of another build dances each motion with errors in it;
    the evaluation gets the motion and the performance and nothing else.

    Example: dousa experiment-errors recordings/ --repeats 3 --which held-out

    Example: dousa experiment-errors hdm05/ --repeats 0 --takes-from 'name:HDM_(.+)_[0-9]+_120'
    """
    from dousa.app.pipelines.evaluate import read_takes
    from dousa.formats.motion_files import ReadOptions
    from dousa.library import parse_label_rule

    if repeats == 0 and takes_from is None:
        raise OptionError("evaluation_cli.nothing_to_do")
    rule = parse_label_rule(takes_from, "takes")
    options = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    trials = second_takes = None
    with progress_bar() as progress:
        takes, skipped = read_takes(path, rule, options=options, n_jobs=jobs, progress=progress)
        if repeats:
            from dousa.experiments import run_error_experiment

            trials = run_error_experiment(
                [motion for motion, _ in takes],
                repeats=repeats,
                seed=seed,
                noise_deg=noise,
                timing_ms=timing,
                which=which,
                n_jobs=jobs or -1,
                progress=lambda done, total, _: progress(done, total, Message("evaluation_cli.trials")),
            )
        if takes_from is not None:
            second_takes = _compare_takes(takes, which, references, seed, jobs, progress)
    if json:
        seconds = {"second_takes": second_takes} if second_takes else {}
        print_json({**(trials.to_json() if trials else {}), **seconds, "skipped": skipped})
    else:
        from dousa.app.tables.answers import print_tables

        for result in (trials, second_takes):
            print_tables(console(), result.to_tables() if result else ())
        problems = trials.problems if trials else ()
        for problem in problems[:_SHOWN_PROBLEMS]:
            warn(problem)
        if len(problems) > _SHOWN_PROBLEMS:
            warn(Message("answers.more_trials_failed", n=len(problems) - _SHOWN_PROBLEMS))
    warn_skipped(skipped)


def _compare_takes(
    takes: Sequence[tuple[NamedMotion, str | None]],
    which: str,
    n_references: int,
    seed: int,
    jobs: int | None,
    progress: ProgressCallback,
) -> SecondTakes:
    """False alarms between takes of one group, group by group."""
    from dousa.experiments import is_held_out, measure_second_takes

    groups: dict[str, list[NamedMotion]] = {}
    for motion, group in takes:
        if group is not None and (which == "all" or is_held_out(motion.name) == (which == "held-out")):
            groups.setdefault(group, []).append(motion)
    if not any(len(motions) > 1 for motions in groups.values()):
        raise OptionError("evaluation_cli.no_groups", n=len(groups))
    return measure_second_takes(
        groups,
        n_references=n_references,
        seed=seed,
        n_jobs=jobs or -1,
        progress=lambda done, total, _: progress(done, total, Message("evaluation_cli.second_takes")),
    )
