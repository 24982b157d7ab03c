"""Commands that look after a library: check, backup, restore, compact, review, undo, tag."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from dousa.app.cli.library import (
    Select,
    choose_clips,
    clip_or_path,
    open_library,
    open_to_learn,
    open_to_read,
    print_changed,
)
from dousa.app.cli.usage import Json, LibraryPath, split_tags
from dousa.app.output import console, print_answer, print_json, progress_bar, say, warn
from dousa.app.requests.library import TaggedLabels
from dousa.errors import LibraryDamagedError, OptionError
from dousa.messages import Message


def check(
    library: LibraryPath,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Put right what can be: computed again, read again from the original files."),
    ] = False,
    json: Json = False,
) -> None:
    """Check that everything in a library is as it was written, by checksums; exit code 2 if something is damaged.

    Example: dousa check moves.dousa --repair
    """
    from dousa.app.tables.library import print_messages

    try:
        with (open_library if repair else open_to_learn)(library) as opened, progress_bar() as progress:
            report = opened.check(repair=repair, progress=progress)
    except LibraryDamagedError as error:
        if error.code == "library_file.cut_short":  # which says that this command can tell more
            raise LibraryDamagedError("library_file.nothing_left", library=library) from error
        raise
    print_answer(report, print_messages, json=json)
    if not report.is_sound:
        raise typer.Exit(2)


def backup(
    library: LibraryPath,
    to: Annotated[str, typer.Argument(metavar="TO", help="The new file.")],
    json: Json = False,
) -> None:
    """Copy a library to a new file and compare the copy with its checksums. Other programs may write meanwhile.

    The copy is a library, also that of a database server; where fragments lie beside it, they belong to it.

    Example: dousa backup moves.dousa backups/monday.dousa
    """
    from dousa.app.tables.library import print_messages

    with open_to_read(library) as opened, progress_bar() as progress:
        report = opened.backup(to, progress=progress)
    print_answer(report, print_messages, json=json)


def restore(
    backup: Annotated[str, typer.Argument(metavar="BACKUP", help="A file of dousa backup, or any library file.")],
    library: LibraryPath,
    json: Json = False,
) -> None:
    """Put a backup in the place of a library. The library that is there is kept in a folder beside it.

    No other program may have it open. A database server needs an empty database.

    Example: dousa restore backups/monday.dousa moves.dousa
    """
    from dousa.app.tables.library import print_messages
    from dousa.library import Library

    with progress_bar() as progress:
        report = Library.restore(backup, library, progress=progress)
    print_answer(report, print_messages, json=json)


def compact(
    library: LibraryPath,
    fragments: Annotated[
        str | None,
        typer.Option(
            "--fragments",
            metavar="beside|FOLDER|URL",
            help="Move positions and features out of the file, into a folder beside it; those of a library on a server "
            "to s3://bucket/folder or a folder.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Make the file of a library smaller after clips were removed. They cannot be brought back by dousa undo then.

    Needs as much free space as what is left in the library.

    Example: dousa compact moves.dousa
    """
    from dousa.app.tables.library import print_messages

    place = "" if fragments == "beside" else fragments
    with open_library(library) as opened, progress_bar() as progress:
        report = opened.compact(fragments=place, progress=progress)
    print_answer(report, print_messages, json=json)


def review(
    context: typer.Context,
    library: LibraryPath,
    duplicates: Annotated[
        bool, typer.Option("--duplicates", help="Clips that are nearly the same, instead of wrong labels.")
    ] = False,
    k: Annotated[int, typer.Option("-k", "--limit", min=1, help="How many to list.")] = 20,
    json: Json = False,
) -> None:
    """List clips whose label is likely wrong: clips that they resemble have another one. Nothing is changed.

    Every clip is judged by trees that have not seen it. Clips with the tag 'checked' are taken to be right:
    dousa tag moves.dousa +checked -- 12. In the studio: Library, Check labels.

    Example: dousa review moves.dousa
    """
    from dousa.app.tables.library import print_duplicates, print_label_review

    with open_to_read(library) as opened:
        if duplicates:
            groups = opened.find_near_duplicates()
            print_answer(groups, partial(print_duplicates, most=k), json=json)
            return
        with progress_bar() as progress:
            report = opened.review_labels(n_jobs=context.obj or -1, progress=progress)
    print_answer(report, partial(print_label_review, most=k), json=json)


def undo(
    context: typer.Context,
    library: LibraryPath,
    number: Annotated[
        int | None,
        typer.Argument(metavar="[NUMBER]", help="A change (see --list).", show_default="your last one"),
    ] = None,
    redo: Annotated[bool, typer.Option("--redo", help="Do again what was undone.")] = False,
    show: Annotated[bool, typer.Option("--list", help="List the changes, and change nothing.")] = False,
    json: Json = False,
) -> None:
    """Undo your last change of a library: labels, tags, removed and added clips, labels of takes.

    A change that another user made, or another machine, is undone by its number only. Works after a restart too, and
    one change after the other. Removed clips are kept until dousa compact, and at most 1 GB of them. A change whose
    clips were changed since is left alone. What a forest has learned stays.

    Example: dousa undo moves.dousa
    """
    from dousa.app.tables.library import print_journal

    if show:
        if redo or number is not None:
            raise OptionError("journal.list_alone")
        with open_to_read(library) as opened:
            print_answer(opened.journal(), print_journal, json=json)
        return
    with open_library(library) as opened:
        entry = (opened.redo if redo else opened.undo)(number, n_jobs=context.obj)
        trained = opened.stats().trained_at is not None
    if json:
        print_json(entry.to_json())
        return
    say(Message("journal.redone" if redo else "journal.undone", what=entry.what))
    if trained and not redo and entry.kind in ("add", "label", "name"):
        warn(Message("journal.still_learned"))


def tag(
    library: LibraryPath,
    clips: Annotated[
        list[str] | None,
        typer.Argument(metavar="[CLIP...] [+TAG...] [-TAG...]", help="Clips, and tags to give (+) and take away (-)."),
    ] = None,
    select: Select = None,
    *,
    where: TaggedLabels,
    show: Annotated[bool, typer.Option("--list", help="List the tags, and what is saved for --select.")] = False,
    json: Json = False,
) -> None:
    """Give tags to clips or takes, and take tags away; a clip can have several. 'favourite' is a star in the studio.

    Example: dousa tag moves.dousa 12 13 +fight -draft
    """
    from dousa.app.tables.library import print_tags

    if show:
        with open_to_read(library) as opened:
            counts, searches = opened.tags(), opened.searches.all()
        if json:
            print_json({"tags": counts, "searches": [search.to_json() for search in searches]})
        else:
            print_tags(console(), counts, searches)
        return
    with open_library(library) as opened:
        named, given, taken = split_tags(clips or ())
        chosen, labels = choose_clips(opened, [clip_or_path(clip) for clip in named], select, where)
        filters = {f"where_{name}": label for name, label in labels.items()}
        changed = opened.tag(chosen, add=given, remove=taken, **filters)
    print_changed("tagged", changed, "library_tags.tagged", json=json)
