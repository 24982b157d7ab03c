"""The command line: ``dousa --help`` lists the commands, ``dousa COMMAND --help`` shows an example of each.

Commands live in one module per group and import what they need when they run, so that help is there at once.
Errors that a person can put right are one line on standard error and exit code 2.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

import dousa
from dousa.app.cli import estimation, evaluation, experiments, files, library, studio, takes, upkeep
from dousa.app.cli.usage import (
    Command,
    Group,
    Language,
    UsageError,
    choose_language,
    describe_usage,
    to_typer_command,
)
from dousa.app.output import fail, survive_narrow_encodings
from dousa.errors import DousaError, OptionError
from dousa.messages import Message
from dousa.workers.current import use_cluster

FAILED, INTERRUPTED = 2, 130


class Application(typer.Typer):
    """Commands may take request classes, and their usage errors are messages."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:
        add = super().command(name, cls=Command, **settings)
        return lambda command: add(to_typer_command(command))


app = Application(
    name="dousa",
    cls=Group,
    help="Capture, retrieve and evaluate human motion (動作).",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

PANELS: dict[str, tuple[Callable[..., None], ...]] = {
    "Files": (files.info, files.convert, files.plot),
    "Library": (
        *(library.add, library.train, library.search, library.classify, library.export, library.remove),
        *(library.relabel, library.list_clips, upkeep.tag, upkeep.undo, upkeep.check, upkeep.compact, upkeep.review),
        *(takes.find, takes.label),
    ),
    "Estimation": (
        *(estimation.estimate, estimation.render, estimation.sync, estimation.calibrate, estimation.keypoints),
    ),
    "Evaluation": (evaluation.evaluate, evaluation.progress, files.count),
    "Studio": (studio.studio,),
    "Trials": (experiments.experiment, experiments.demo, experiments.warm),
}
"""The commands in the order of the help."""

for panel, commands in PANELS.items():
    for command in commands:
        app.command("list" if command is library.list_clips else None, rich_help_panel=panel)(command)


def _check_jobs(jobs: int | None) -> int | None:
    if jobs == 0:
        raise OptionError("usage.jobs")
    return jobs


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dousa {dousa.__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop."),
    ] = False,
    lang: Language = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", min=-1, callback=_check_jobs, help="Workers; default: all cores."),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="ADDRESS",
            help="Let the workers of a Dask scheduler, such as tcp://HOST:8786, read, describe and grow trees: add, "
            "train, experiment.",
        ),
    ] = None,
) -> None:
    if context.invoked_subcommand is None:
        raise OptionError("usage.missing_command")
    context.obj = jobs
    context.with_resource(use_cluster(cluster))


def main() -> None:
    """Run the command line of dousa."""
    run_application(app)


def run_application(application: typer.Typer) -> None:
    """Run an application; the exit code is 0, 2 after an error that can be put right, 130 after Ctrl-C."""
    # Loading numba and SQLAlchemy makes very many objects that all stay; to look through them for cycles again
    # and again would take a tenth of the time of a search.
    gc.set_threshold(100_000)
    survive_narrow_encodings()
    try:
        choose_language(sys.argv[1:])
        code = application(standalone_mode=False)
    except UsageError as error:
        described = describe_usage(error)
        if described is not None:
            fail(described)
        code = FAILED
    except DousaError as error:
        fail(error)
        code = FAILED
    except OSError as error:
        # Files are looked after where they are read and written; what is left is mostly the output itself.
        fail(
            Message("cli.answer_not_written", reason=error)
            if error.filename is None
            else Message("cli.file_problem", path=error.filename, reason=error)
        )
        code = FAILED
    except MemoryError:
        fail(Message("cli.out_of_memory"))
        code = FAILED
    except KeyboardInterrupt:
        code = INTERRUPTED
    except SystemError as error:
        # Ctrl-C while a compiled loop runs is noticed when it returns, and reaches us as the first cause of this.
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        if not isinstance(cause, KeyboardInterrupt):
            raise
        code = INTERRUPTED
    if code == INTERRUPTED:  # Typer turns Ctrl-C into this exit code and says nothing
        fail(Message("cli.interrupted"))
    if code:
        sys.exit(code)


if __name__ == "__main__":
    main()
