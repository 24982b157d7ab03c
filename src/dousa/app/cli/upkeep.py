"""Commands that look after a library: check, compact."""

from __future__ import annotations

from typing import Annotated

import typer

from dousa.app import tables
from dousa.app.cli.library import open_library, open_to_learn
from dousa.app.cli.options import shared as o
from dousa.app.output import console, print_json, progress_bar, say
from dousa.messages import Message


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    for command in (check, compact):
        app.command(rich_help_panel="Library")(command)


def check(
    library: o.LibraryPath,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Put right what can be: computed again, read again from the original files."),
    ] = False,
    json: o.Json = False,
) -> None:
    """Check that everything in a library is as it was written, by checksums; exit code 2 if something is damaged.

    A library of an older dousa has no checksums yet and gets them.

    Example: dousa check moves.dousa --repair
    """
    with (open_library if repair else open_to_learn)(library) as opened, progress_bar() as progress:
        report = opened.check(repair=repair, progress=progress)
    if json:
        print_json(report.to_json())
    else:
        tables.print_check(console(), report)
    if not report.is_sound:
        raise typer.Exit(2)


def compact(library: o.LibraryPath, wait: o.Wait = 60.0, json: o.Json = False) -> None:
    """Make the file of a library smaller after clips were removed. They cannot be brought back by dousa undo then.

    Needs as much free space as what is left in the library.

    Example: dousa compact moves.dousa
    """
    with open_library(library, wait=wait) as opened:
        report = opened.compact()
    if json:
        print_json(report.to_json())
        return
    if report.forgotten:
        say(Message("library_compact.forgotten", megabytes=report.forgotten / 1e6))
    if report.before:
        say(Message("library_compact.done", before=report.before / 1e6, after=report.after / 1e6))
