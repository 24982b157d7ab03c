"""The command line: ``dousa --help`` lists the commands, ``dousa COMMAND --help`` shows an example of each.

Commands live in one module per group, which is imported when one of them is asked for, and import what they need when
they run, so that answers and help are there at once.
Errors that a person can put right are one line on standard error and exit code 2.
"""

from __future__ import annotations

import atexit
import gc
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated, Any

import typer

import dousa
from dousa.app.cli.usage import (
    Command,
    Group,
    Language,
    UsageError,
    choose_language,
    describe_usage,
    find_command,
    to_typer_command,
)
from dousa.app.output import fail, survive_narrow_encodings
from dousa.app.stops import hear_stops
from dousa.errors import DousaError, OptionError, is_interrupt
from dousa.messages import Message
from dousa.workers.current import use_cluster

FAILED, INTERRUPTED, TERMINATED = 2, 130, 143


class Application(typer.Typer):
    """Commands may take request classes, and their usage errors are messages."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:
        add = super().command(name, cls=Command, **settings)
        return lambda command: add(to_typer_command(command, NEEDED.get(name or "", "").split()))


COMMANDS: dict[str, dict[str, str]] = {
    "Find motions": {"library": "add train search classify", "takes": "find label"},
    "Estimate motion from video": {"estimation": "estimate"},
    "Evaluate a performance": {"evaluation": "evaluate"},
    "All of it": {"files": "info convert", "studio": "studio", "experiments": "demo"},
    "More for libraries": {
        "library": "list_clips export remove relabel",
        "upkeep": "tag undo review check backup restore compact",
    },
    "More for video": {"estimation": "keypoints sync calibrate render"},
    "More for performances": {"evaluation": "progress", "files": "count plot", "experiments": "experiment warm"},
}
"""The functions of the commands by panel of the help, those of the main jobs first, and by module."""

NEEDED = {
    "add": "takes category_from performer_from",
    "convert": "onto frame_rate overwrite",
    "estimate": "output cameras backgrounds stature everybody angles",
    "evaluate": "performance output repetitions mirror tempo",
    "experiment": "split performer_from category_from takes",
    "export": "output to category text onto",
    "label": "csv picture",
    "render": "output cameras ring stature",
    "search": "k text category picture explain",
}
"""The options that one needs first; the others of these commands stand in the help under More."""


def make_application(words: Sequence[str] = ()) -> Application:
    """Make the application: with the one command that ``words`` of the command line ask for, else with all."""
    application = Application(
        name="dousa",
        cls=Group,
        help="Capture, retrieve and evaluate human motion (動作).",
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    application.callback(invoke_without_command=True)(_root)
    listed = [
        (function.removesuffix("_clips"), panel, module, function)
        for panel, modules in COMMANDS.items()
        for module, functions in modules.items()
        for function in functions.split()
    ]
    asked = find_command(words)
    for name, panel, module, function in [one for one in listed if one[0] == asked] or listed:
        run = getattr(import_module(f"dousa.app.cli.{module}"), function)
        application.command(name, rich_help_panel=panel)(run)
    return application


def _check_jobs(jobs: int | None) -> int | None:
    if jobs == 0:
        raise OptionError("usage.jobs")
    return jobs


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dousa {dousa.__version__}")
        raise typer.Exit


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
    # What is left at the end is not looked through for cycles, which takes a quarter of the time of a search.
    atexit.register(gc.freeze)
    # Warnings of libraries are for programmers: what a user should know is a message, and infinite results are errors.
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"  # of workers too
        logging.lastResort = None  # what libraries log about a connection that Ctrl-C closed
    run_application(make_application(sys.argv[1:]))


def run_application(application: typer.Typer) -> None:
    """Run an application; the exit code is 0, 2 after an error that can be put right, 130 after Ctrl-C.

    SIGTERM, as of ``docker stop`` or of a machine that is shut down, stops like Ctrl-C, with the exit code 143.
    """
    # Loading SQLAlchemy and numba makes very many objects that all stay; to look through them for cycles again
    # and again would take a tenth of the time of a search.
    gc.set_threshold(300_000)
    survive_narrow_encodings()
    with hear_stops() as came:
        code = _run(application)
    if code == INTERRUPTED:  # Typer turns Ctrl-C into this exit code and says nothing
        fail(Message("cli.interrupted"))
    if signal.SIGTERM in came:
        code = TERMINATED
    if code:
        sys.exit(code)


def _run(application: typer.Typer) -> int | None:
    try:
        choose_language(sys.argv[1:])
        code: int | None = application(standalone_mode=False)
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
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        code = INTERRUPTED
    return code


if __name__ == "__main__":
    main()
