"""One command of ours as a program: options, errors and exit codes as those of ``dousa``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from dousa.app.cli.main import Application, run_application

Jobs = Annotated[int | None, typer.Option("--jobs", min=-1, help="Workers; default: all cores.")]


def run_command(command: Callable[..., None]) -> None:
    """Run a function of Typer parameters and groups of options on the words of the command line."""
    application = Application(pretty_exceptions_enable=False, rich_markup_mode="rich")
    application.command()(command)
    run_application(application)
