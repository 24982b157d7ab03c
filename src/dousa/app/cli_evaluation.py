"""Commands that judge motion: evaluate and experiment-errors."""

from __future__ import annotations

import enum
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app import _options as o
from dousa.app._output import console, print_json, progress_bar, warn
from dousa.errors import OptionError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app._output import ProgressCallback
    from dousa.app.evaluating import Evaluation
    from dousa.evaluation.experiment import FalseAlarms, NamedMotion

__all__ = ["register"]


class Tempo(enum.StrEnum):
    """Whether the performance keeps the reference's tempo."""

    SAME = "same"
    FREE = "free"


class Language(enum.StrEnum):
    """Language of the sentences."""

    EN = "en"
    JA = "ja"


class Which(enum.StrEnum):
    """Which motions an experiment looks at."""

    ALL = "all"
    TUNING = "tuning"
    HELD_OUT = "held-out"


def register(app: typer.Typer) -> None:
    """Hang this module's commands on the application."""
    app.command(rich_help_panel="Evaluation")(evaluate)
    app.command("experiment-errors", rich_help_panel="Evaluation")(experiment_errors)


def evaluate(
    reference: Annotated[
        list[Path],
        typer.Argument(
            metavar="REFERENCE...",
            help="The model: one take, or better five and more; files or folders of BVH, AMC, C3D, TRC, NPZ. The "
            "first is what the performance is held against, all of them say what may vary.",
        ),
    ],
    performance: Annotated[
        Path | None,
        typer.Option(
            "--performance", "-p", metavar="FILE", help="The motion to judge (required).", show_default=False
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Write the report (HTML) and the curves (CSV) there."
        ),
    ] = None,
    furi: Annotated[
        Path | None,
        typer.Option(
            "--furi",
            metavar="FILE",
            help="Cuts of the figures, in frames or seconds of the first REFERENCE. Default: found in it.",
        ),
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="The performer faced the reference and danced its mirror image.")
    ] = False,
    tempo: Annotated[
        Tempo, typer.Option("--tempo", help="same: late is late; free: a slower performance is not late.")
    ] = Tempo.SAME,
    weights: Annotated[
        Path | None,
        typer.Option("--weights", metavar="FILE", help="What matters: lines 'arms = 2', 'left_shank = 0'."),
    ] = None,
    lang: Annotated[Language, typer.Option("--lang", help="Language of table and report.")] = Language.EN,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    json: o.Json = False,
) -> None:
    """What differs between a performance and its model, where, and by how much.

    Tells four errors apart: another motion of the whole body, another motion
    of a limb, motion not danced to the full, and wrong timing. With one
    REFERENCE take the grade is not calibrated, and says so.

    Example: dousa evaluate teacher_*.bvh --performance pupil.bvh -o report
    """
    from dousa.app.evaluating import check_folder, evaluate_files, find_references
    from dousa.library import ReadOptions

    if performance is None:
        raise OptionError("--performance FILE is missing: which motion is to be judged?")
    if output is not None:
        check_folder(output)
    if not performance.exists():
        raise OptionError(f"{performance}: no such file; check the name given with --performance")
    files = find_references(reference)
    options = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    with progress_bar() as progress:
        done = evaluate_files(
            files,
            performance,
            options=options,
            furi_file=furi,
            side="mirrored" if mirror else "same",
            tempo=tempo.value,
            weights=_load_weights(weights),
            language=lang.value,
            progress=progress,
        )
        page = None
        if output is not None:
            from dousa.app.report import write_report

            progress(len(files) + 1, len(files) + 2, "writing the report")
            page = write_report(done.assessment, output, language=lang.value)
    _warn(done)
    if json:
        print_json(_describe(done, page))
    else:
        from dousa.app._evaluation_tables import print_assessment

        print_assessment(console(), done.assessment, lang.value)
        if page is not None:
            console().print(f"report: {page}", markup=False, soft_wrap=True)


def _load_weights(path: Path | None) -> dict[str, float] | None:
    if path is None:
        return None
    from dousa.evaluation import read_weights

    weights: dict[str, float] = read_weights(path)
    return weights


def _describe(done: Evaluation, page: Path | None) -> dict[str, Any]:
    return {
        **done.assessment.to_json(),
        "references": [str(path) for path in done.references],
        "performance": str(done.performance),
        "report": None if page is None else str(page),
    }


def _warn(done: Evaluation) -> None:
    """What a person should know, on standard error."""
    import os

    for text, count in Counter(text for _, text in done.notes).items():
        where = next(path for path, note in done.notes if note == text)
        more = f" (and {count - 1} more {'file' if count == 2 else 'files'})" if count > 1 else ""
        warn(f"{where}{more}: {text}")
    same = {os.path.realpath(path) for path in done.references}
    if len(same) > 1 and os.path.realpath(done.performance) in same:
        warn(f"{done.performance} is one of the references too, so the limits know it already")
    for text in done.assessment.warnings:
        warn(text)


def experiment_errors(
    path: Annotated[
        list[Path], typer.Argument(metavar="PATH...", help="Motions done right: files, or folders of them.")
    ],
    repeats: Annotated[
        int,
        typer.Option(
            "--repeats", min=0, help="How often, with other errors; 0 leaves them out (see --takes-from)."
        ),
    ] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0,
    noise: Annotated[
        float,
        typer.Option(
            "--noise", min=0.0, max=90.0, metavar="DEG", help="How much the simulated performer wavers."
        ),
    ] = 3.0,
    timing: Annotated[
        float,
        typer.Option(
            "--timing", min=0.0, max=5000.0, metavar="MS", help="How far off the beat the performer drifts."
        ),
    ] = 20.0,
    which: Annotated[
        Which,
        typer.Option(
            "--which", help="held-out: the 30 % of the files, told by name, that nothing was tuned on."
        ),
    ] = Which.ALL,
    takes_from: Annotated[
        str | None,
        typer.Option(
            "--takes-from",
            metavar="RULE",
            help="Which files are takes of one thing by one person (folder, name:REGEX, path:REGEX, csv:FILE): counts "
            "the false alarms between them.",
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
    """How well are errors found? Puts errors of known class, time and size into motions and looks for them.

    A made-up performer of another build dances each motion with errors in it;
    the evaluation gets the motion and the performance and nothing else.

    Example: dousa experiment-errors recordings/ --repeats 3 --which held-out

    Example: dousa experiment-errors hdm05/ --repeats 0 --takes-from 'name:HDM_(.+)_[0-9]+_120'
    """
    from dousa.app.evaluating import read_takes
    from dousa.library import ReadOptions, parse_label_rule

    if repeats == 0 and takes_from is None:
        raise OptionError("--repeats 0 leaves nothing to do; give 1 or more, or --takes-from")
    rule = parse_label_rule(takes_from, "takes")
    options = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    answer: dict[str, Any] = {}
    with progress_bar() as progress:
        takes, skipped = read_takes(path, rule, options=options, n_jobs=jobs, progress=progress)
        if repeats:
            from dousa.evaluation import run_error_experiment

            result = run_error_experiment(
                [motion for motion, _ in takes],
                repeats=repeats,
                seed=seed,
                noise_deg=noise,
                timing_ms=timing,
                which=which.value,
                n_jobs=jobs or -1,
                progress=lambda done, total, _: progress(done, total, "trials"),
            )
            answer = result.to_json()
        if takes_from is not None:
            answer["second_takes"] = _count_false_alarms(takes, which.value, references, seed, jobs, progress)
    answer["skipped"] = [{"path": item.path, "reason": item.reason} for item in skipped]
    if json:
        print_json(answer)
    else:
        from dousa.app._evaluation_tables import print_error_experiment

        print_error_experiment(console(), answer)
    for item in skipped[:5]:
        warn(f"left out {item.path}: {item.reason}")
    if len(skipped) > 5:
        warn(f"left out {len(skipped) - 5} more files")


def _count_false_alarms(
    takes: Sequence[tuple[NamedMotion, str | None]],
    which: str,
    n_references: int,
    seed: int,
    jobs: int | None,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """False alarms between takes of one group, group by group."""
    from dousa.evaluation import is_held_out, measure_false_alarms

    groups: dict[str, list[NamedMotion]] = {}
    for motion, group in takes:
        if group is not None and (which == "all" or is_held_out(motion.name) == (which == "held-out")):
            groups.setdefault(group, []).append(motion)
    several = {group: motions for group, motions in sorted(groups.items()) if len(motions) > 1}
    if not several:
        raise OptionError(
            f"--takes-from: expected two takes or more of something, got {len(groups)} groups of one; "
            "is the rule right?"
        )
    found: dict[str, FalseAlarms] = {}
    for number, (group, motions) in enumerate(several.items()):
        progress(number, len(several), "second takes")
        found[group] = measure_false_alarms(motions, n_references=n_references, seed=seed, n_jobs=jobs or -1)
    minutes = sum(alarms.minutes for alarms in found.values())
    events = sum(len(alarms.events) for alarms in found.values())
    return {
        "n_references": n_references,
        "n_groups": len(several),
        "n_alone": len(groups) - len(several),
        "n_takes": sum(alarms.n_takes for alarms in found.values()),
        "n_with_fewer_references": sum(
            len(motions) for motions in several.values() if len(motions) <= n_references
        ),
        "minutes": minutes,
        "per_minute": events / minutes if minutes > 0 else None,
        "groups": {group: alarms.to_json() for group, alarms in found.items()},
    }
