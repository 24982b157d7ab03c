"""The command line: ``dousa --help`` lists the commands, ``dousa COMMAND --help`` shows an example of each.

Commands live in one module per group and import what they need when they run, so that help is there at once.
Errors that a person can put right are one line on standard error and exit code 2.
"""

from __future__ import annotations

import gc
import sys
from typing import Annotated, NoReturn

import typer

import dousa
from dousa.app import (
    cli_estimation,
    cli_estimation_trials,
    cli_evaluation,
    cli_files,
    cli_library,
    cli_studio,
    cli_takes,
    cli_trials,
)
from dousa.app._output import fail, survive_narrow_encodings
from dousa.errors import DousaError

__all__ = ["app", "main"]

INTERRUPTED = 130

app = typer.Typer(
    name="dousa",
    help="Capture, find and judge human motion (動作).",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for group in (
    cli_files, cli_library, cli_takes, cli_estimation, cli_estimation_trials, cli_evaluation, cli_studio,
    cli_trials,
):  # fmt: skip
    group.register(app)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dousa {dousa.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop."),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; the exit code is 0, 2 after an error that can be put right, 130 after Ctrl-C."""
    # Loading numba and SQLAlchemy makes very many objects that all stay; to look through them for cycles again
    # and again would take a tenth of the time of a search.
    gc.set_threshold(100_000)
    survive_narrow_encodings()
    try:
        app()
    except DousaError as error:
        fail(str(error))
        sys.exit(2)
    except OSError as error:
        # Files are looked after where they are read and written; what is left is mostly the output itself.
        fail(f"{error.filename or 'the answer cannot be written'}: {error.strerror or error}")
        sys.exit(2)
    except MemoryError:
        fail("the motions do not fit into the memory of this machine; give fewer or shorter ones")
        sys.exit(2)
    except (KeyboardInterrupt, SystemExit) as stop:
        # Typer turns Ctrl-C into this exit code and says nothing.
        if isinstance(stop, SystemExit) and stop.code != INTERRUPTED:
            raise
        _stop_interrupted()
    except SystemError as error:
        # Ctrl-C while a compiled loop runs is noticed when it returns, and reaches us as the first cause of this.
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        if not isinstance(cause, KeyboardInterrupt):
            raise
        _stop_interrupted()


def _stop_interrupted() -> NoReturn:
    fail("interrupted; what was finished is kept, run the same command again to go on")
    sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
