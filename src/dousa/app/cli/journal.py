"""Commands for what people do to a library bit by bit: undo, tag."""

from __future__ import annotations

from typing import Annotated

import typer

from dousa.app import tables
from dousa.app.cli.library import choose_saved, clip_or_path, open_library, open_to_read
from dousa.app.cli.options import shared as o
from dousa.app.output import console, print_json, say, warn
from dousa.errors import OptionError
from dousa.messages import Message


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    for command in (tag, undo):
        app.command(rich_help_panel="Library")(command)


def undo(
    library: o.LibraryPath,
    number: Annotated[
        int | None,
        typer.Argument(metavar="[NUMBER]", help="A change (see --list).", show_default="the last one"),
    ] = None,
    redo: Annotated[bool, typer.Option("--redo", help="Do again what was undone.")] = False,
    show: Annotated[bool, typer.Option("--list", help="List the changes, and change nothing.")] = False,
    jobs: o.Jobs = None,
    wait: o.Wait = 60.0,
    json: o.Json = False,
) -> None:
    """Undo the last change of a library: labels, tags, removed and added clips, labels of takes.

    Works after a restart too, and one change after the other. Removed clips are kept until dousa compact, and at most
    1 GB of them. A change whose clips were changed since is left alone. What a forest has learned stays.

    Example: dousa undo moves.dousa
    """
    if show:
        if redo or number is not None:
            raise OptionError("journal.list_alone")
        with open_to_read(library) as opened:
            entries = opened.journal()
        if json:
            print_json([entry.to_json() for entry in entries])
        else:
            tables.print_journal(console(), entries)
        return
    with open_library(library, wait=wait) as opened:
        entry = (opened.redo if redo else opened.undo)(number, n_jobs=jobs)
        trained = opened.stats().trained_at is not None
    if json:
        print_json(entry.to_json())
        return
    say(Message("journal.redone" if redo else "journal.undone", what=entry.what))
    if trained and not redo and entry.kind in ("add", "label", "name"):
        warn(Message("journal.still_learned"))


def tag(
    library: o.LibraryPath,
    clips: Annotated[
        list[str] | None,
        typer.Argument(metavar="[CLIP...] [+TAG...] [-TAG...]", help="Clips, and tags to give (+) and take away (-)."),
    ] = None,
    add: Annotated[list[str] | None, typer.Option("--add", metavar="TAG", help="The same as +TAG.")] = None,
    take: Annotated[list[str] | None, typer.Option("--take", metavar="TAG", help="The same as -TAG.")] = None,
    select: o.Select = None,
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="Only clips of this performer.")] = None,
    where_tag: Annotated[str | None, typer.Option("--tag", help="Only clips with this tag.")] = None,
    show: Annotated[bool, typer.Option("--list", help="List the tags, and what is saved for --select.")] = False,
    wait: o.Wait = 60.0,
    json: o.Json = False,
) -> None:
    """Give tags to clips or takes, and take tags away; a clip can have several. 'favourite' is a star in the studio.

    Example: dousa tag moves.dousa 12 13 +fight -draft
    """
    if show:
        with open_to_read(library) as opened:
            counts, searches = opened.tags(), opened.searches.all()
        if json:
            print_json({"tags": counts, "searches": [search.to_json() for search in searches]})
        else:
            tables.print_tags(console(), counts, searches)
        return
    with open_library(library, wait=wait) as opened:
        chosen: list[int | str] = [clip_or_path(clip) for clip in clips or []]
        if select is not None:
            chosen += choose_saved(opened, select)
        filters = {"where_category": category, "where_performer": performer, "where_tag": where_tag}
        changed = opened.tag(chosen, add=add or (), remove=take or (), **filters)
    if json:
        print_json({"tagged": changed})
    else:
        tables.print_some(console(), Message("library_tags.tagged", n=len(changed)), list(changed))
