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
from dousa.app.cli import estimation as cli_estimation
from dousa.app.cli import evaluation as cli_evaluation
from dousa.app.cli import experiments as cli_trials
from dousa.app.cli import files as cli_files
from dousa.app.cli import films as cli_films
from dousa.app.cli import journal as cli_journal
from dousa.app.cli import keypoints as cli_keypoints
from dousa.app.cli import library as cli_library
from dousa.app.cli import studio as cli_studio
from dousa.app.cli import takes as cli_takes
from dousa.app.cli import upkeep as cli_upkeep
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

FAILED, INTERRUPTED = 2, 130


class _Application(typer.Typer):
    """Every command may have groups of options and has ``--lang``, and its mistakes are described by us."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[..., Any]:
        add = super().command(name, cls=Command, **settings)
        return lambda command: add(to_typer_command(command))


app = _Application(
    name="dousa",
    cls=Group,
    help="Capture, retrieve and evaluate human motion (動作).",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

for group in (
    cli_files, cli_library, cli_journal, cli_upkeep, cli_takes, cli_estimation, cli_films, cli_keypoints,
    cli_evaluation, cli_studio, cli_trials,
):  # fmt: skip
    group.register(app)


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
) -> None:
    if context.invoked_subcommand is None:
        raise OptionError("usage.missing_command")


def main() -> None:
    """Run the command line; the exit code is 0, 2 after an error that can be put right, 130 after Ctrl-C."""
    # Loading numba and SQLAlchemy makes very many objects that all stay; to look through them for cycles again
    # and again would take a tenth of the time of a search.
    gc.set_threshold(100_000)
    survive_narrow_encodings()
    try:
        choose_language(sys.argv[1:])
        code = app(standalone_mode=False)
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
