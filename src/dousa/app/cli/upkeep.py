"""Commands that look after a library, and over it: check, compact, review, map."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app import tables
from dousa.app.cli.library import open_library, open_to_learn, open_to_read
from dousa.app.cli.options import shared as o
from dousa.app.output import console, print_json, progress_bar, say
from dousa.app.targets import CLIP_MAP, check_targets
from dousa.errors import LibraryDamagedError, OptionError
from dousa.files.disk import atomic_write
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.library import ClipInfo, ClipMap


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    for command in (check, compact, review):
        app.command(rich_help_panel="Library")(command)
    app.command("map", rich_help_panel="Library")(map_clips)


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
    try:
        with (open_library if repair else open_to_learn)(library) as opened, progress_bar() as progress:
            report = opened.check(repair=repair, progress=progress)
    except LibraryDamagedError as error:
        if error.code == "library_file.cut_short":  # which says that this command can tell more
            raise LibraryDamagedError("library_file.nothing_left", library=library) from error
        raise
    if json:
        print_json(report.to_json())
    else:
        tables.print_check(console(), report)
    if not report.is_sound:
        raise typer.Exit(2)


def compact(
    library: o.LibraryPath,
    fragments: Annotated[
        bool,
        typer.Option("--fragments", help="Move positions and features out of the file, into a folder beside it."),
    ] = False,
    fragments_at: Annotated[
        str | None,
        typer.Option(metavar="FOLDER|URL", help="The same of a library on a server: s3://bucket/folder or a folder."),
    ] = None,
    wait: o.Wait = 60.0,
    json: o.Json = False,
) -> None:
    """Make the file of a library smaller after clips were removed. They cannot be brought back by dousa undo then.

    Needs as much free space as what is left in the library.

    Example: dousa compact moves.dousa
    """
    place = fragments_at if fragments_at is not None else ("" if fragments else None)
    with open_library(library, wait=wait) as opened, progress_bar() as progress:
        report = opened.compact(fragments=place, progress=progress)
    if json:
        print_json(report.to_json())
        return
    for message in report.to_messages():
        say(message)


def review(
    library: o.LibraryPath,
    duplicates: Annotated[
        bool, typer.Option("--duplicates", help="Clips that are nearly the same, instead of wrong labels.")
    ] = False,
    k: Annotated[int, typer.Option("-k", "--limit", min=1, help="How many to list.")] = 20,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """List clips whose label is likely wrong: those that they resemble have another one. Nothing is changed.

    Every clip is judged by trees that have not seen it. Clips with the tag 'checked' are taken to be right:
    dousa tag moves.dousa +checked -- 12. In the studio: Library, Check labels.

    Example: dousa review moves.dousa
    """
    with open_to_read(library) as opened:
        if duplicates:
            groups = opened.find_near_duplicates()
            if json:
                print_json([group.to_json() for group in groups])
            else:
                tables.print_duplicates(console(), groups, k)
            return
        with progress_bar() as progress:
            report = opened.review_labels(n_jobs=jobs or -1, progress=progress)
    if json:
        print_json(report.to_json())
    else:
        tables.print_label_review(console(), report, k)


_TABLES, _PICTURES = (".csv",), (".png", ".svg", ".pdf")


def map_clips(
    library: o.LibraryPath,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Table (.csv) or picture (.png, .svg, .pdf) to write.")
    ] = None,
    json: o.Json = False,
) -> None:
    """Lay out all clips on a map: those lie together whose poses are alike, whatever they are called.

    Only what is near means something. In the studio: Library, Map, to choose clips with a lasso.

    Example: dousa map moves.dousa -o map.png
    """
    if output is None and not json:
        raise OptionError("library_map.no_output")
    if output is not None and output.suffix.lower() not in (*_TABLES, *_PICTURES):
        raise OptionError("library_map.suffix", path=output, found=output.suffix)
    check_targets({"--output": output}, (library,), CLIP_MAP)
    with open_to_read(library) as opened:
        with progress_bar() as progress:
            found = opened.map(progress=progress)
        if not len(found.clip_ids):
            raise OptionError("library_map.none", library=library)
        clips = opened.clips(found.clip_ids.tolist())
    by_number = {clip.id: clip for clip in clips}
    clips = [by_number[number] for number in found.clip_ids.tolist()]
    rows = [_describe_place(clip, *point) for clip, point in zip(clips, found.points.tolist(), strict=True)]
    if output is not None:
        _write_map(output, found, rows, clips)
    if json:
        print_json({"clips": rows, "n_laid_out": found.n_laid_out, "left_out": list(found.left_out)})
        return
    say(Message("library_map.line", output=output, n=len(rows)))
    if found.left_out:
        say(Message("library_map.left_out", n=len(found.left_out)))


def _describe_place(clip: ClipInfo, x: float, y: float) -> dict[str, Any]:
    """A clip on the map, as plain values."""
    labels = {"category": clip.category, "performer": clip.performer}
    return {"clip_id": clip.id, "path": clip.path, **labels, "x": round(x, 4), "y": round(y, 4)}


def _write_map(output: Path, found: ClipMap, rows: list[dict[str, Any]], clips: list[ClipInfo]) -> None:
    if output.suffix.lower() in _PICTURES:
        from dousa.app.pictures.clip_map import draw_clip_map

        draw_clip_map(found, [clip.category for clip in clips], output)
        return
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with atomic_write(output) as file:
        file.write(text.getvalue().encode("utf-8", "surrogateescape"))
