"""Commands for motion libraries: add, train, search, classify, list, remove, relabel."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from dousa.app import tables
from dousa.app.cli.options import shared as o
from dousa.app.output import console, print_json, progress_bar, say, warn
from dousa.app.targets import check_targets
from dousa.errors import LibraryError, LibraryVersionError, MotionFileError, OptionError
from dousa.extras import require
from dousa.messages import Message
from dousa.workers.current import use_cluster

if TYPE_CHECKING:
    from dousa.formats.motion_files import ReadOptions
    from dousa.library import Library
    from dousa.workers import Cluster

Query = Annotated[str, typer.Argument(metavar="QUERY", help="A motion file, or the number of a clip (see dousa list).")]
Mirror = Annotated[bool, typer.Option("--mirror", help="Also search for the mirror image of the motion.")]
Explain = Annotated[bool, typer.Option("--explain", help="Explain the answer in words, with times.")]

Threshold = Annotated[
    float | None,
    typer.Option(
        "--threshold",
        min=0,
        max=1,
        help="Confidence below which a motion is called unknown; 0: never.",
        show_default="0.5",
    ),
]


def open_library(library: str, *, create: bool = False, wait: float = 5.0) -> Library:
    """A library that can be changed."""
    from dousa.library import Library

    return Library.open(library, create=create, timeout=wait)


def open_to_read(library: str) -> Library:
    """A library that will only be asked; one that an older dousa made is brought up to date first."""
    from dousa.library import Library

    try:
        return Library.open(library, read_only=True)
    except LibraryVersionError:
        Library.open(library).close()
        return Library.open(library, read_only=True)


def open_to_learn(library: str) -> Library:
    """A library that will be asked, and keeps what it learns for bodies that lack joints, if it can be written."""
    try:
        return open_library(library)
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


RankingName = Literal["fused", "histogram", "leaves", "pose"]
"""What clips are ordered by."""

Clips = Annotated[
    list[str] | None,
    typer.Argument(metavar="[CLIP...]", help="Files, folders or clip numbers (see dousa list)."),
]


def register(app: typer.Typer) -> None:
    """Register this module's commands with the application."""
    for command in (add, train, search, classify, export, remove, relabel):
        app.command(rich_help_panel="Library")(command)
    app.command("list", rich_help_panel="Library")(list_clips)


def add(
    library: o.LibraryPath,
    paths: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Motion files, or folders of them.")],
    takes: Annotated[
        bool,
        typer.Option("--takes", help="These are uncut recordings: to search with dousa find, to label, to learn from."),
    ] = False,
    labels: Annotated[
        str | None,
        typer.Option(
            "--labels",
            metavar="RULE",
            help="Where takes have tables of what happens when: beside, folder:FOLDER or csv:FILE.",
        ),
    ] = None,
    tier: Annotated[
        str | None,
        typer.Option("--tier", help="Tier of these tables.", show_default="the first that has labels"),
    ] = None,
    *,
    label_options: o.LabelOptions,
    motion_options: o.MotionOptions,
    jobs: o.Jobs = None,
    cluster: o.Cluster = None,
    wait: o.Wait = 60.0,
    json: o.Json = False,
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
    if takes and label_options.category_from != "folder":
        raise OptionError("library_cli.takes_without_category")
    options = motion_options.load()
    _check_before_making(library, paths, label_options, options)
    if labels is not None and takes:
        _check_labels(paths, labels, tier)
    with (
        _leave_no_empty(library),
        use_cluster(cluster) as workers,
        _open_for_workers(workers, library, paths, wait) as opened,
        progress_bar() as progress,
    ):
        report = opened.add(
            paths,
            kind="take" if takes else "clip",
            **o.list_values(label_options),
            labels_from=labels,
            tier=tier,
            options=options,
            n_jobs=jobs,
            progress=lambda done, total, path: progress(done, total, Message("library_cli.adding")),
        )
    if json:
        print_json(report.to_json())
    else:
        tables.print_add(console(), report)
    used = (report.added, report.replaced, report.moved, report.unchanged, report.duplicates)
    if report.skipped and not any(used):
        raise typer.Exit(2)


def _check_before_making(library: str, paths: list[Path], label_options: o.LabelOptions, options: ReadOptions) -> None:
    """Find mistakes in the words of a command before it leaves an empty library behind."""
    from dousa.library import parse_label_rule
    from dousa.motion.canonical.reference_frame import parse_unit, parse_up

    if options.unit is not None:
        parse_unit(options.unit)
    if options.up is not None:
        parse_up(options.up)
    parse_label_rule(label_options.category_from, "category")
    parse_label_rule(label_options.performer_from, "performer")
    if not any(os.path.lexists(path) for path in paths):
        raise OptionError("library_cli.no_such_path", path=paths[0])
    if "://" not in library and not os.path.exists(library):
        from dousa.formats.motion_files import find_motion_files
        from dousa.formats.registry import SUFFIXES

        if find_motion_files(paths) == ([], []):
            raise OptionError("library_cli.no_motion", path=paths[0], known=SUFFIXES)


def _open_for_workers(workers: Cluster | None, library: str, paths: list[Path], wait: float) -> Library:
    """The library that files go into; where workers do not see the files, none is made."""
    if workers is not None:
        from dousa.formats.motion_files import find_motion_files

        workers.check_paths([file.path for file in find_motion_files(paths)[0]])
    return open_library(library, create=True, wait=wait)


@contextmanager
def _leave_no_empty(library: str) -> Iterator[None]:
    """A new library goes again where a table of labels does not fit its take: nothing has been written into it."""
    is_new = "://" not in library and not os.path.exists(library)
    try:
        yield
    except MotionFileError:
        if is_new and os.path.exists(library):
            with open_to_read(library) as opened:
                is_empty = not opened.clips()
            if is_empty:
                os.remove(library)
        raise


def _check_labels(paths: list[Path], rule: str, tier: str | None) -> None:
    """Find mistakes in tables of labels before an empty library is left behind."""
    from dousa.formats.motion_files import find_motion_files
    from dousa.library.annotations.places import find_labels

    find_labels(find_motion_files(paths)[0], rule, tier)


def train(
    library: o.LibraryPath,
    features: Annotated[
        o.FeatureSetName | None,
        typer.Option(
            "--features",
            help="Features of the trees: the 56 pose features of the paper, or also speeds, spreads and trends.",
            show_default="extended",
        ),
    ] = None,
    trees: Annotated[int, typer.Option("--trees", min=1, help="Number of trees.")] = 100,
    trials: Annotated[
        int | None,
        typer.Option(
            "--trials",
            min=1,
            help="Tests drawn at a node; default: 12 of 3,080 (paper), the square root (extended).",
        ),
    ] = None,
    max_entropy: Annotated[
        float, typer.Option("--max-entropy", min=0, help="Bits; nodes at or below are leaves.")
    ] = 0.0,
    bootstrap: Annotated[bool, typer.Option("--bootstrap", help="Each tree draws its clips with replacement.")] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same forest.")] = 0,
    jobs: o.Jobs = None,
    cluster: o.Cluster = None,
    wait: o.Wait = 60.0,
    json: o.Json = False,
) -> None:
    """Train a forest on the categories of a library; clips get their histograms, takes their features.

    Example: dousa train moves.dousa
    """
    with use_cluster(cluster), open_library(library, wait=wait) as opened, progress_bar() as progress:
        report = opened.train(
            feature_set=features.value if features else None,
            n_trees=trees,
            n_trials=trials,
            max_entropy=max_entropy,
            bootstrap=bootstrap,
            random_state=seed,
            n_jobs=jobs or -1,
            progress=progress,
        )
    if json:
        print_json(report.to_json())
        return
    learned = {"trees": report.n_trees, "clips": report.n_clips, "seconds": report.seconds}
    say(Message("library_cli.trained", categories=len(report.categories), **learned))
    calibration = report.calibration
    if calibration is None:
        warn(Message("library_cli.no_calibration"))
    else:
        shares = {"known": calibration.false_alarms, "others": 1 - calibration.misses}
        say(Message("library_cli.calibrated", **shares))
    if report.hidden:
        from dousa.retrieval.features.partial_bodies import name_parts

        say(Message("library_cli.hidden", parts=name_parts(report.hidden)))
    if report.n_partial:
        say(Message("library_cli.partial", n=report.n_partial))
    if report.n_unlabelled:
        warn(Message("library_cli.unlabelled", n=report.n_unlabelled))
    if report.single:
        warn(Message("library_cli.single_clips", categories=report.single))


def search(
    library: o.LibraryPath,
    query: Annotated[
        str | None,
        typer.Argument(metavar="[QUERY]", help="A motion file, or the number of a clip (see dousa list)."),
    ] = None,
    text: Annotated[
        str | None,
        typer.Option("--text", "-t", help="Words, English or Japanese: what is done, or with QUERY only such clips."),
    ] = None,
    k: Annotated[int, typer.Option("-k", "--limit", min=1, help="How many results.")] = 10,
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="Only clips of this performer.")] = None,
    rank: Annotated[
        RankingName,
        typer.Option("--rank", help="Rank by votes, leaves, poses, or all three."),
    ] = "fused",
    mirror: Mirror = False,
    explain: Explain = False,
    threshold: Threshold = None,
    same_category: Annotated[
        bool, typer.Option("--same-category", help="Only clips of the category predicted for the query.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Draw query and results: .png, .svg or .pdf.")
    ] = None,
    *,
    motion_options: o.MotionOptions,
    json: o.Json = False,
) -> None:
    """Find the clips most similar to a motion, and classify it; or with --text those that words describe.

    Clips are put in order by the distance of the forest's votes, by the share of trees that lead query and clip to the
    same leaf, and by the distance of their poses aligned in time. Words are looked for in categories, in names and in
    what the motions do ("both hands above the head"): by meaning, misspelt or not.

    Example: dousa search moves.dousa kick.bvh -k 5
    """
    if query is None:
        if any((mirror, explain, same_category, picture, threshold is not None, rank != "fused")):
            raise OptionError("text_search.needs_query")
        _search_text(library, text, k, category, performer, json)
        return
    if picture:
        require("matplotlib", "pictures")
    check_targets({"--picture": picture}, (query, library, *motion_options.files))
    with open_to_learn(library) as opened:
        wanted = clip_or_path(query)
        options = motion_options.load()
        among = _choose_among(opened, text, category, performer)
        with progress_bar() as progress:
            result = opened.search(
                wanted,
                k,
                ranking=rank,
                same_category=same_category,
                mirror=mirror,
                explain=explain,
                threshold=threshold,
                among=among,
                options=options,
                progress=progress,
            )
        if picture:
            from dousa.app.pictures.sheets import draw_search_result

            draw_search_result(opened, wanted, result, picture, options)
    if json:
        print_json(result.to_json())
    else:
        tables.print_search(console(), result)


def _search_text(
    library: str, text: str | None, k: int, category: str | None, performer: str | None, json: bool
) -> None:
    if text is None:
        raise OptionError("text_search.nothing_asked")
    with open_to_read(library) as opened:
        answer = opened.search_text(text, k, category=category, performer=performer)
    if json:
        print_json(answer.to_json())
    else:
        tables.print_text_search(console(), answer)


def _choose_among(library: Library, text: str | None, category: str | None, performer: str | None) -> list[int] | None:
    """The clips that filters leave for a search with a motion; None for all."""
    if text is not None:
        found = library.search_text(text, None, category=category, performer=performer, kind="clip")
        if found.n_searched and not found.results:
            warn(Message("text_search.nothing", text=text, all=found.n_searched))
        return [hit.clip_id for hit in found.results]
    if category is None and performer is None:
        return None
    return [clip.id for clip in library.clips(category=category, performer=performer)]


def classify(
    library: o.LibraryPath,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Motion files, or folders of them.")],
    mirror: Mirror = False,
    explain: Explain = False,
    threshold: Threshold = None,
    *,
    motion_options: o.MotionOptions,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """Classify each file, or call it unknown, without adding it.

    Example: dousa classify moves.dousa new/*.bvh
    """
    with open_to_learn(library) as opened, progress_bar() as progress:
        options = motion_options.load()
        answers = opened.classify(
            files,
            mirror=mirror,
            explain=explain,
            threshold=threshold,
            options=options,
            n_jobs=jobs,
            progress=progress,
        )
    if json:
        print_json([answer.to_json() for answer in answers])
    else:
        tables.print_classes(console(), answers)
    problems = [answer for answer in answers if answer.problem is not None]
    for answer in problems:
        warn(Message("cli.file_problem", path=answer.path, reason=answer.problem))
    if problems:
        raise typer.Exit(2)


def list_clips(
    library: o.LibraryPath,
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="Only clips of this performer.")] = None,
    tag: Annotated[str | None, typer.Option("--tag", help="Only clips with this tag.")] = None,
    select: o.Select = None,
    clips: Annotated[bool, typer.Option("--clips", help="List every clip and take, not only the categories.")] = False,
    save: Annotated[
        str | None, typer.Option("--save", metavar="NAME", help="Keep this search under a name, for --select.")
    ] = None,
    json: o.Json = False,
) -> None:
    """List what is in a library: its categories, or with --clips (or a category, performer or tag) every clip and take.

    Example: dousa list moves.dousa --category walk
    """
    asked = {"category": category, "performer": performer, "tag": tag}
    asked = {name: label for name, label in asked.items() if label is not None}
    if save is not None:
        if select is not None or not asked:
            raise OptionError("library_searches.nothing_to_save")
        with open_library(library) as opened:
            opened.searches.save(save, asked)
    with open_to_read(library) as opened:
        stats = opened.stats()
        saved = None if select is None else choose_saved(opened, select)
        wanted = bool(asked) or clips or json or saved is not None
        rows = opened.clips(saved, category=category, performer=performer, tag=tag) if wanted else []
    if json:
        print_json({**stats.to_json(), "clips": [clip.to_json() for clip in rows]})
    elif rows:
        tables.print_clips(console(), [clip.to_json() for clip in rows])
    else:
        tables.print_stats(console(), library, stats.to_json())


def export(
    library: o.LibraryPath,
    clips: Clips = None,
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for the files, or a ZIP file (.zip).")
    ],
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="Only clips of this performer.")] = None,
    tag: Annotated[str | None, typer.Option("--tag", help="Only clips with this tag.")] = None,
    select: o.Select = None,
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="Format of the files: the suffix of any that is written, such as glb, bvh or c3d; amass; or original.",
        ),
    ] = "original",
    character_options: o.CharacterOptions,
    motion_options: o.MotionOptions,
    json: o.Json = False,
) -> None:
    """Export clips as files, a folder per category, with a manifest.csv of their labels.

    Can be interrupted and run again: what is there and unchanged is kept. Files are read as they were when they were
    added, but for what is said here.

    Example: dousa export moves.dousa --category walk --to glb -o walks/
    """
    options = motion_options.load()
    with open_to_read(library) as opened, progress_bar() as progress:
        chosen = _selection(clips) + (choose_saved(opened, select) if select is not None else [])
        report = opened.export(
            output,
            chosen or None,
            category=category,
            performer=performer,
            tag=tag,
            to=to,
            **o.list_values(character_options),
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
    library: o.LibraryPath,
    clips: Clips = None,
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="Only clips of this performer.")] = None,
    tag: Annotated[str | None, typer.Option("--tag", help="Only clips with this tag.")] = None,
    for_good: Annotated[
        bool, typer.Option("--for-good", help="Keep nothing for dousa undo, such as on a full disk.")
    ] = False,
    wait: o.Wait = 60.0,
    json: o.Json = False,
) -> None:
    """Remove clips or takes from a library; the files themselves are not touched, and dousa undo brings them back.

    Example: dousa remove moves.dousa recordings/broken.bvh
    """
    with open_library(library, wait=wait) as opened:
        removed = opened.remove(_selection(clips), category=category, performer=performer, tag=tag, for_good=for_good)
    if json:
        print_json({"removed": removed})
    else:
        tables.print_some(console(), Message("library_cli.removed", n=len(removed)), list(removed))


def relabel(
    library: o.LibraryPath,
    clips: Clips = None,
    category: Annotated[str | None, typer.Option("--category", help="The new category; '' for none.")] = None,
    performer: Annotated[str | None, typer.Option("--performer", help="The new performer; '' for none.")] = None,
    where_category: Annotated[str | None, typer.Option("--where-category", help="Only clips of this category.")] = None,
    where_performer: Annotated[
        str | None, typer.Option("--where-performer", help="Only clips of this performer.")
    ] = None,
    wait: o.Wait = 60.0,
    json: o.Json = False,
) -> None:
    """Change the category or performer of clips or takes; run dousa train to retrain the forest.

    Example: dousa relabel moves.dousa 12 13 --category kick
    """
    from dousa.library import UNCHANGED

    if category is None and performer is None:
        raise OptionError("library_cli.nothing_to_change")
    with open_library(library, wait=wait) as opened:
        changed = opened.relabel(
            _selection(clips),
            category=UNCHANGED if category is None else category or None,
            performer=UNCHANGED if performer is None else performer or None,
            where_category=where_category,
            where_performer=where_performer,
        )
    if json:
        print_json({"relabelled": changed})
    else:
        tables.print_some(console(), Message("library_cli.relabelled", n=len(changed)), list(changed))
