"""Commands for motion libraries: add, train, search, classify, list, remove, relabel."""

from __future__ import annotations

import functools
import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app.cli.usage import Json, LibraryPath
from dousa.app.output import console, print_answer, print_json, progress_bar, say, say_written, warn
from dousa.app.requests.library import (
    Character,
    ClassifyRequest,
    LabelRules,
    Labels,
    Like,
    SearchRequest,
    TaggedLabels,
    TakeLabels,
    Text,
    TrainRequest,
)
from dousa.app.requests.reading import PartReading, Reading
from dousa.app.targets import check_targets
from dousa.errors import LibraryError, OptionError
from dousa.extras import require
from dousa.messages import Message
from dousa.workers.current import current_cluster

if TYPE_CHECKING:
    from dousa.formats.motion_files import ReadOptions
    from dousa.library import Library


def open_library(library: str, *, create: bool = False) -> Library:
    """Open a library to change it, once other programs have written what they write."""
    from dousa.library import Library

    return Library.open(library, create=create, timeout=60.0)


def open_to_read(library: str) -> Library:
    """Open a library to read it."""
    from dousa.library import Library

    return Library.open(library, read_only=True)


def open_to_learn(library: str) -> Library:
    """Open a library to read it, and to keep what it learns for bodies that lack joints if it can be written."""
    from dousa.library import Library

    try:
        return Library.open(library)
    except LibraryError:
        return open_to_read(library)


def clip_or_path(text: str) -> int | str:
    """The number of a clip, unless a file is called so."""
    is_number = text.isascii() and text.isdigit() and len(text) < 1000  # Python reads no more than some 4,000
    return int(text) if is_number and not os.path.exists(text) else text


def choose_saved(library: Library, name: str) -> list[int | str]:
    """The clips of a saved search or selection; LibraryError where nothing fits it now."""
    found: list[int | str] = [*library.searches.find(name)]
    if not found:
        raise LibraryError("library_searches.empty", library=library.name, name=name)
    return found


def choose_clips(
    library: Library, clips: Sequence[int | str], select: str | None, where: TaggedLabels
) -> tuple[list[int | str], dict[str, Any]]:
    """The clips that are named, saved, described by words or like a motion (empty for all), and the labels that they
    must have."""
    labels: dict[str, Any] = asdict(where)
    text, like = labels.pop("text"), labels.pop("like")
    chosen = [*clips, *(choose_saved(library, select) if select is not None else [])]
    if text is not None:
        found = _keep_named(library, [hit.clip_id for hit in library.search_text(text, None).results], chosen)
        if not found:
            raise LibraryError("library_clips.none_of_text", library=library.name, text=text)
        chosen = found
    if like is not None:
        asked = chosen or any(value is not None for value in labels.values())
        among = [clip.id for clip in library.clips(chosen, **labels)] if asked else None
        chosen = _find_like(library, like, among)
        if not chosen:
            raise LibraryError("library_clips.none_like", library=library.name, query=like)
    return chosen, labels


def _keep_named(library: Library, found: list[int], named: list[int | str]) -> list[int | str]:
    among = {clip.id for clip in library.clips(named)} if named else set(found)
    return [number for number in found if number in among]


def _find_like(library: Library, query: str, among: list[int] | None) -> list[int | str]:
    """The clips that mean the same as a motion; the most similar ones where the library has not learned that."""
    wanted = clip_or_path(query)
    found = library.search(wanted, among=among)
    if (count := found.alike_count or 0) > len(found.results):
        found = library.search(wanted, count, among=among)
    return [hit.clip_id for hit in found.results if hit.alike is not False]


def print_changed(key: str, changed: Sequence[str], code: str, *, json: bool) -> None:
    """Print the clips that a command has changed, under a key of JSON or below a message."""
    from dousa.app.tables.lines import print_some

    if json:
        print_json({key: changed})
    else:
        print_some(console(), Message(code, n=len(changed)), list(changed))


Select = Annotated[
    str | None,
    typer.Option("--select", metavar="NAME", help="Only clips of a saved search or selection (see dousa tag --list)."),
]
Clips = Annotated[
    list[str] | None,
    typer.Argument(metavar="[CLIP...]", help="Files, folders or clip numbers (see dousa list)."),
]


def add(
    context: typer.Context,
    library: LibraryPath,
    paths: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Motion files, or folders of them.")],
    takes: Annotated[
        bool,
        typer.Option("--takes", help="These are uncut recordings: to search with dousa find, to label, to learn from."),
    ] = False,
    *,
    take_labels: TakeLabels,
    rules: LabelRules,
    reading: PartReading,
    json: Json = False,
) -> None:
    """Add motion files to a library, which is created if necessary. Files already in it are skipped.

    The category of a file is its folder below PATH, such as 'squat' or 'walk/active', or what --category-from says;
    takes have none. If the library is trained, the forest learns from the new clips at once; dousa train makes a new
    one. Can be interrupted and run again.

    Labels of takes are tables of start_s, end_s and category (NAME.labels.csv), or of ELAN, Praat or BORIS; each
    segment becomes a clip. Run again when they have changed.

    Example: dousa add moves.dousa recordings/ --performer-from 'name:HDM_(..)_'

    Example: dousa add moves.dousa sessions/ --takes --labels beside
    """
    from dousa.app.tables.library import print_add

    if takes and rules.category_from != "folder":
        raise OptionError("library_cli.takes_without_category")
    options = reading.load()
    _check_before_making(library, paths, rules, options)
    if take_labels.labels is not None and takes:
        _check_labels(paths, take_labels.labels, take_labels.tier)
    with _leave_no_empty(library), _open_to_add(library, paths) as opened, progress_bar() as progress:
        report = opened.add(
            paths,
            kind="take" if takes else "clip",
            **asdict(rules),
            labels_from=take_labels.labels,
            tier=take_labels.tier,
            options=options,
            n_jobs=context.obj,
            progress=lambda done, total, path: progress(done, total, Message("library_cli.adding")),
        )
    print_answer(report, print_add, json=json)
    used = (report.added, report.replaced, report.moved, report.unchanged, report.duplicates)
    if report.skipped and not any(used):
        raise typer.Exit(2)


def _check_before_making(library: str, paths: list[Path], rules: LabelRules, options: ReadOptions) -> None:
    """Find mistakes in the words of a command before it leaves an empty library behind."""
    from dousa.library import parse_label_rule
    from dousa.motion.canonical.reference_frame import parse_unit, parse_up

    if options.unit is not None:
        parse_unit(options.unit)
    if options.up is not None:
        parse_up(options.up)
    parse_label_rule(rules.category_from, "category")
    parse_label_rule(rules.performer_from, "performer")
    if not any(os.path.lexists(path) for path in paths):
        raise OptionError("library_cli.no_such_path", path=paths[0])
    if "://" not in library and not os.path.exists(library):
        from dousa.formats.motion_files import find_motion_files
        from dousa.formats.registry import SUFFIXES

        if find_motion_files(paths) == ([], []):
            raise OptionError("library_cli.no_motion", path=paths[0], known=SUFFIXES)


def _open_to_add(library: str, paths: list[Path]) -> Library:
    """Open or make the library that files go into; where workers do not see the files, none is made."""
    workers = current_cluster()
    if workers is not None:
        from dousa.formats.motion_files import find_motion_files

        workers.check_paths([file.path for file in find_motion_files(paths)[0]])
    return open_library(library, create=True)


@contextmanager
def _leave_no_empty(library: str) -> Iterator[None]:
    """A new library goes again where nothing came into it, as of damaged files alone."""
    is_new = "://" not in library and not os.path.exists(library)
    try:
        yield
    finally:
        if is_new and os.path.exists(library):
            with open_to_read(library) as opened:
                is_empty = not opened.clips()
            if is_empty:
                os.remove(library)


def _check_labels(paths: list[Path], rule: str, tier: str | None) -> None:
    """Find mistakes in tables of labels before an empty library is left behind."""
    from dousa.formats.motion_files import find_motion_files
    from dousa.library.annotations.matching import find_labels

    find_labels(find_motion_files(paths)[0], rule, tier)


def train(context: typer.Context, library: LibraryPath, *, request: TrainRequest, json: Json = False) -> None:
    """Train a forest on the categories of a library; votes of clips and features of takes are stored.

    Example: dousa train moves.dousa
    """
    with open_library(library) as opened, progress_bar() as progress:
        report = opened.train(**asdict(request), n_jobs=context.obj or -1, progress=progress)
    if json:
        print_json(report.to_json())
        return
    learned = {"trees": report.n_trees, "clips": report.n_clips, "seconds": report.seconds}
    say(Message("library_cli.trained", categories=len(report.categories), **learned))
    calibration = report.calibration
    if calibration is None:
        warn(Message("library_cli.no_calibration"))
    elif len(report.single) == len(report.categories):  # no clip could be held back
        say(Message("library_cli.calibrated_by_others"))
    else:
        shares = {"known": calibration.false_alarms, "others": 1 - calibration.misses}
        say(Message("library_cli.calibrated", **shares))
    if report.hidden:
        from dousa.retrieval.features.posed_motion import name_parts

        say(Message("library_cli.hidden", parts=name_parts(report.hidden)))
    if report.n_partial:
        say(Message("library_cli.partial", n=report.n_partial))
    if report.n_unlabelled:
        warn(Message("library_cli.unlabelled", n=report.n_unlabelled))
    if report.single:
        warn(Message("library_cli.single_clips", categories=report.single))
    if report.doubt:
        warn(report.doubt)


def search(
    library: LibraryPath,
    query: Annotated[
        str | None,
        typer.Argument(metavar="[QUERY]", help="A motion file, or the number of a clip (see dousa list)."),
    ] = None,
    text: Annotated[
        str | None,
        typer.Option("--text", "-t", help="Words, English or Japanese: what is done, or with QUERY only such clips."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Draw query and results: .png, .svg or .pdf.")
    ] = None,
    detail: Annotated[bool, typer.Option("--detail", help="Also print what the likeness is made of.")] = False,
    *,
    request: SearchRequest,
    where: Labels,
    reading: Reading,
    json: Json = False,
) -> None:
    """Find the clips most similar to a motion, and classify it; or with --text those that words describe.

    Clips are put in order by the distance of the forest's votes, by the share of its trees that see no difference, and
    by the distance of their poses aligned in time. Words are looked for in categories, in names and in
    what the motions do ("both hands above the head"): by meaning, misspelt or not.

    Example: dousa search moves.dousa kick.bvh -k 5
    """
    from dousa.app.tables.search import print_search

    if query is None:
        if picture or request != SearchRequest(k=request.k):
            raise OptionError("text_search.needs_query")
        _search_text(library, text, request.k, where, json)
        return
    if picture:
        require("matplotlib", "pictures")
    check_targets({"--picture": picture}, (query, library, *reading.files))
    with open_to_learn(library) as opened:
        wanted = clip_or_path(query)
        options = reading.load()
        among = _choose_among(opened, text, where)
        with progress_bar() as progress:
            result = opened.search(wanted, **asdict(request), among=among, options=options, progress=progress)
        if picture:
            from dousa.app.pictures.sheets import draw_search_result

            draw_search_result(opened, wanted, result, picture, options)
    print_answer(result, functools.partial(print_search, detail=detail), json=json)
    say_written(picture, json=json)
    if not json and any(hit.alike is not False for hit in result.results):
        _tell_export(library, {"--like": query, "--text": text}, where)


def _search_text(library: str, text: str | None, k: int, where: Labels, json: bool) -> None:
    from dousa.app.tables.search import print_text_search

    if text is None:
        raise OptionError("text_search.nothing_asked")
    with open_to_read(library) as opened:
        answer = opened.search_text(text, k, **asdict(where))
    print_answer(answer, print_text_search, json=json)
    if answer.results and not json:
        _tell_export(library, {"--text": text}, where)


def _tell_export(library: str, asked: Mapping[str, str | None], where: Labels) -> None:
    """Say how to take along what was found."""
    given = {**asked, "--category": where.category, "--performer": where.performer}
    words = [word for option, value in given.items() if value is not None for word in (option, value)]
    say(Message("answers.take_along", command=shlex.join(["dousa", "export", library, *words, "-o", "found/"])))


def _choose_among(library: Library, text: str | None, where: Labels) -> list[int] | None:
    """The clips that filters leave for a search with a motion; None for all."""
    if text is not None:
        found = library.search_text(text, None, **asdict(where), kind="clip")
        if found.n_searched and not found.results:
            warn(Message("text_search.nothing", text=text, all=found.n_searched))
        return [hit.clip_id for hit in found.results]
    if where == Labels():
        return None
    return [clip.id for clip in library.clips(**asdict(where))]


def classify(
    context: typer.Context,
    library: LibraryPath,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Motion files, or folders of them.")],
    *,
    request: ClassifyRequest,
    reading: Reading,
    json: Json = False,
) -> None:
    """Classify each file, or call it unknown, without adding it.

    Example: dousa classify moves.dousa new/*.bvh
    """
    from dousa.app.tables.search import print_classes

    with open_to_learn(library) as opened, progress_bar() as progress:
        options = reading.load()
        answers = opened.classify(files, **asdict(request), options=options, n_jobs=context.obj, progress=progress)
    print_answer(answers, print_classes, json=json)
    problems = [answer for answer in answers if answer.problem is not None]
    for answer in problems:
        warn(Message("cli.file_problem", path=answer.path, reason=answer.problem))
    if problems:
        raise typer.Exit(2)


def list_clips(
    library: LibraryPath,
    *,
    where: TaggedLabels,
    select: Select = None,
    clips: Annotated[bool, typer.Option("--clips", help="List every clip and take, not only the categories.")] = False,
    save: Annotated[
        str | None, typer.Option("--save", metavar="NAME", help="Keep this search under a name, for --select.")
    ] = None,
    json: Json = False,
) -> None:
    """List what is in a library: its categories, or with --clips (or a filter) every clip and take.

    Example: dousa list moves.dousa --category walk
    """
    from dousa.app.tables.library import print_clips, print_stats

    asked = {name: label for name, label in asdict(where).items() if label is not None}
    if save is not None:
        if select is not None or not asked:
            raise OptionError("library_searches.nothing_to_save")
        with open_library(library) as opened:
            chosen, labels = choose_clips(opened, (), None, where)
            found = {"clips": [clip.id for clip in opened.clips(chosen, **labels)]}  # a motion is no filter to repeat
            opened.searches.save(save, asked if where.like is None else found)
    with open_to_read(library) as opened:
        stats = opened.stats()
        wanted = bool(asked) or clips or json or select is not None
        chosen, labels = choose_clips(opened, (), select, where)
        rows = opened.clips(chosen or None, **labels) if wanted else []
    if json:
        print_json({**stats.to_json(), "clips": [clip.to_json() for clip in rows]})
    elif rows:
        print_clips(console(), [clip.to_json() for clip in rows])
    else:
        print_stats(console(), library, stats.to_json())


def export(
    library: LibraryPath,
    clips: Clips = None,
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for the files, or a ZIP file (.zip).")
    ],
    where: TaggedLabels,
    select: Select = None,
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="Format of the files: the suffix of any that is written, such as glb, bvh or c3d; amass; or original.",
        ),
    ] = "original",
    character: Character,
    reading: Reading,
    json: Json = False,
) -> None:
    """Export clips as files, a folder per category, with a manifest.csv of their labels.

    Can be interrupted and run again: what is there and unchanged is kept. Files are read as they were when they were
    added, but for --read.

    Example: dousa export moves.dousa --like kick.bvh --to glb -o kicks/
    """
    options = reading.load()
    with open_to_read(library) as opened, progress_bar() as progress:
        chosen, labels = choose_clips(opened, _selection(clips), select, where)
        report = opened.export(
            output,
            chosen or None,
            **labels,
            to=to,
            **asdict(character),
            options=options,
            progress=lambda done, total, path: progress(done, total, Message("export.exporting")),
        )
    if json:
        print_json(report.to_json())
    else:
        for skipped in report.skipped:
            warn(Message("text.in_file", path=skipped.path, problem=skipped.reason))
        counts = {"written": len(report.written), "kept": len(report.kept), "skipped": len(report.skipped)}
        say(Message("export.done", folder=output, **counts))
    if report.skipped and not (report.written or report.kept):
        raise typer.Exit(2)


def _selection(clips: list[str] | None) -> list[int | str]:
    return [clip_or_path(clip) for clip in clips or []]


def remove(
    library: LibraryPath,
    clips: Clips = None,
    *,
    where: TaggedLabels,
    for_good: Annotated[
        bool, typer.Option("--for-good", help="Keep nothing for dousa undo, such as on a full disk.")
    ] = False,
    json: Json = False,
) -> None:
    """Remove clips or takes from a library; the files themselves are not touched, and dousa undo brings them back.

    Example: dousa remove moves.dousa recordings/broken.bvh
    """
    with open_library(library) as opened:
        chosen, labels = choose_clips(opened, _selection(clips), None, where)
        removed = opened.remove(chosen, **labels, for_good=for_good)
    print_changed("removed", removed, "library_cli.removed", json=json)


def relabel(
    library: LibraryPath,
    clips: Clips = None,
    category: Annotated[str | None, typer.Option("--category", help="The new category; '' for none.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="The new performer; '' for none.")] = None,
    where_category: Annotated[
        str | None, typer.Option("--where-category", help="Only clips of this category: walk, hdm05/, kick*.")
    ] = None,
    where_performer: Annotated[
        str | None, typer.Option("--where-performer", help="Only clips of this performer.")
    ] = None,
    text: Text = None,
    like: Like = None,
    json: Json = False,
) -> None:
    """Change the category or performer of clips or takes; run dousa train to retrain the forest.

    Example: dousa relabel moves.dousa 12 13 --category kick
    """
    from dousa.library import UNCHANGED

    if category is None and performer is None:
        raise OptionError("library_cli.nothing_to_change")
    with open_library(library) as opened:
        chosen, _ = choose_clips(opened, _selection(clips), None, TaggedLabels(text=text, like=like))
        changed = opened.relabel(
            chosen,
            category=UNCHANGED if category is None else category or None,
            performer=UNCHANGED if performer is None else performer or None,
            where_category=where_category,
            where_performer=where_performer,
        )
    print_changed("relabelled", changed, "library_cli.relabelled", json=json)
