"""How well errors in a performance are detected: errors of known class, time and size are put into real motions.

python -m lab.errors RECORDINGS [--repeats N] [--which held-out] [--takes-from RULE] [--json]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import ProgressCallback, console, print_json, progress_bar, warn, warn_skipped
from dousa.app.requests.reading import Reading
from dousa.errors import OptionError
from dousa.messages import Message
from lab.command_line import Jobs, run_command
from lab.errors.experiment import NamedMotion
from lab.errors.results import ErrorExperimentResult, SecondTakes

Which = Literal["all", "tuning", "held-out"]
"""Which motions the experiment uses."""

_SHOWN_PROBLEMS = 3


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


def experiment_errors(
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Correct motions: files, or folders of them.")],
    *,
    injection_options: InjectionOptions,
    takes_options: TakesOptions,
    reading: Reading,
    jobs: Jobs = None,
    json: Json = False,
) -> None:
    """Measure error detection: inject errors of known class, time and size into motions and detect them.

    A made-up performer of another build dances each motion with errors in it;
    the evaluation gets the motion and the performance and nothing else.

    Example: python -m lab.errors recordings/ --repeats 3 --which held-out

    Example: python -m lab.errors hdm05/ --repeats 0 --takes-from 'name:HDM_(.+)_[0-9]+_120'
    """
    from dousa.app.tables.lines import print_tables
    from dousa.library import parse_label_rule
    from lab.errors.recordings import read_takes

    if injection_options.repeats == 0 and takes_options.takes_from is None:
        raise OptionError("evaluation_cli.nothing_to_do")
    rule = parse_label_rule(takes_options.takes_from, "takes")
    options = reading.load()
    trials = second_takes = None
    with progress_bar() as progress:
        takes, skipped = read_takes(path, rule, options=options, n_jobs=jobs, progress=progress)
        if injection_options.repeats:
            trials = _inject_errors([motion for motion, _ in takes], injection_options, jobs, progress)
        if takes_options.takes_from is not None:
            n, seed = takes_options.references, injection_options.seed
            second_takes = _compare_takes(takes, injection_options.which, n, seed, jobs, progress)
    if json:
        seconds = {"second_takes": second_takes} if second_takes else {}
        print_json({**(trials.to_json() if trials else {}), **seconds, "skipped": skipped})
    else:
        for result in (trials, second_takes):
            print_tables(console(), result.to_tables() if result else ())
        problems = trials.problems if trials else ()
        for problem in problems[:_SHOWN_PROBLEMS]:
            warn(problem)
        if len(problems) > _SHOWN_PROBLEMS:
            warn(Message("answers.more_trials_failed", n=len(problems) - _SHOWN_PROBLEMS))
    warn_skipped(skipped)


def _inject_errors(
    motions: Sequence[NamedMotion], options: InjectionOptions, jobs: int | None, progress: ProgressCallback
) -> ErrorExperimentResult:
    from lab.errors.experiment import run_error_experiment

    return run_error_experiment(
        motions,
        repeats=options.repeats,
        seed=options.seed,
        noise_deg=options.noise,
        timing_ms=options.timing,
        which=options.which,
        n_jobs=jobs or -1,
        progress=lambda done, total, _: progress(done, total, Message("evaluation_cli.trials")),
    )


def _compare_takes(
    takes: Sequence[tuple[NamedMotion, str | None]],
    which: str,
    n_references: int,
    seed: int,
    jobs: int | None,
    progress: ProgressCallback,
) -> SecondTakes:
    """False alarms between takes of one group, group by group."""
    from lab.errors.experiment import is_held_out, measure_second_takes

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


if __name__ == "__main__":
    run_command(experiment_errors)
