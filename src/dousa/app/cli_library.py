"""Commands about a motion library: add, train, search, classify, list, remove, relabel."""

from __future__ import annotations

import enum
import os
from pathlib import Path
from typing import Annotated

import typer

from dousa.app import _options as o
from dousa.app._libraries import Explain, Mirror, Query, Threshold, clip_or_path, open_library, open_to_read
from dousa.app._output import console, print_json, progress_bar, warn
from dousa.errors import OptionError

__all__ = ["register"]

Clips = Annotated[
    list[str] | None,
    typer.Argument(metavar="[CLIP...]", help="Files, folders or numbers of clips (see dousa list)."),
]


class RankingName(enum.StrEnum):
    """What clips are ordered by."""

    FUSED = "fused"
    HISTOGRAM = "histogram"
    LEAVES = "leaves"
    POSE = "pose"


def register(app: typer.Typer) -> None:
    """Hang this module's commands on the application."""
    for command in (add, train, search, classify, remove, relabel):
        app.command(rich_help_panel="Library")(command)
    app.command("list", rich_help_panel="Library")(list_clips)


def add(
    library: o.LibraryPath,
    paths: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Motion files, or folders of them.")],
    takes: Annotated[
        bool,
        typer.Option(
            "--takes", help="These are uncut recordings: to look into with dousa find, not to learn from."
        ),
    ] = False,
    category_from: o.CategoryFrom = "folder",
    performer_from: o.PerformerFrom = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """Add motion files to a library; it is made if there is none. Files already there are left as they are.

    The category of a file is its folder below PATH, such as 'squat' or 'walk/active', or what --category-from says;
    takes have none. If the library is trained, the forest learns from the new clips at once; dousa train makes a new
    one. Can be interrupted and run again.

    Example: dousa add moves.dousa recordings/ --performer-from 'name:HDM_(..)_'
    """
    if takes and category_from != "folder":
        raise OptionError("takes have no category, as much happens in them: leave --category-from out")
    named_joints = o.load_joint_map(joint_map)
    _check_before_making(paths, category_from, performer_from, unit, up)
    with open_library(library, create=True) as opened, progress_bar() as progress:
        report = opened.add(
            paths,
            kind="take" if takes else "clip",
            category_from=category_from,
            performer_from=performer_from,
            joint_map=named_joints,
            unit=unit,
            up=up,
            skeleton=skeleton,
            n_jobs=jobs,
            progress=lambda done, total, path: progress(done, total, "adding"),
        )
    if json:
        print_json(report.to_json())
    else:
        from dousa.app import _tables

        _tables.print_add(console(), report)
    used = (report.added, report.replaced, report.moved, report.unchanged, report.duplicates)
    if report.skipped and not any(used):
        raise typer.Exit(2)


def _check_before_making(
    paths: list[Path], category_from: str, performer_from: str | None, unit: str | None, up: str | None
) -> None:
    """Find mistakes in the words of a command before it leaves an empty library behind."""
    from dousa.library import parse_label_rule
    from dousa.motion.reference_frame import parse_unit, parse_up

    if unit is not None:
        parse_unit(unit)
    if up is not None:
        parse_up(up)

    parse_label_rule(category_from, "category")
    parse_label_rule(performer_from, "performer")
    if not any(os.path.lexists(path) for path in paths):
        raise OptionError(f"{paths[0]}: no such file or folder; check the name")


def train(
    library: o.LibraryPath,
    features: Annotated[
        o.FeatureSetName | None,
        typer.Option(
            "--features",
            help="What the trees look at: the 56 pose features of the paper, or also speeds, spreads and trends.",
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
    bootstrap: Annotated[
        bool, typer.Option("--bootstrap", help="Each tree draws its clips with replacement.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same forest.")] = 0,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """Learn the categories of a library; every clip gets its histogram, every take is described.

    Example: dousa train moves.dousa
    """
    with open_library(library) as opened, progress_bar() as progress:
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
    console().print(
        f"{report.n_trees} trees learned {len(report.categories)} categories from {report.n_clips} clips "
        f"in {report.seconds:.1f} s"
    )
    calibration = report.calibration
    if calibration is None:
        warn("too few categories or clips to learn what is unknown: every motion gets a category")
    else:
        console().print(
            f"of motions like these {calibration.false_alarms:.0%} are called unknown, of others "
            f"{1 - calibration.misses:.0%} (categories and performers held back)"
        )
    if report.n_unlabelled:
        warn(f"{report.n_unlabelled} clips without a category taught nothing; they can be found all the same")
    if report.single:
        warn(f"categories with one clip only are hardly learned: {', '.join(report.single)}")


def search(
    library: o.LibraryPath,
    query: Query,
    k: Annotated[int, typer.Option("-k", min=1, help="How many results.")] = 10,
    rank: Annotated[
        RankingName,
        typer.Option("--rank", help="What the order goes by: votes, leaves, poses, or all three."),
    ] = RankingName.FUSED,
    mirror: Mirror = False,
    explain: Explain = False,
    threshold: Threshold = None,
    same_category: Annotated[
        bool, typer.Option("--same-category", help="Only clips of the category that the query is taken for.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Draw query and results: .png, .svg or .pdf.")
    ] = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    json: o.Json = False,
) -> None:
    """Find the motions most like a motion, and say what it is.

    Clips are put in order by the distance of the forest's votes, by the share of trees that lead query and clip to the
    same leaf, and by the distance of their poses aligned in time.

    Example: dousa search moves.dousa kick.bvh -k 5
    """
    with open_to_read(library) as opened:
        wanted = clip_or_path(query)
        reading = {"joint_map": o.load_joint_map(joint_map), "unit": unit, "up": up, "skeleton": skeleton}
        result = opened.search(
            wanted,
            k,
            ranking=rank.value,
            same_category=same_category,
            mirror=mirror,
            explain=explain,
            threshold=threshold,
            **reading,
        )
        if picture:
            from dousa.app.pictures import draw_search_result

            draw_search_result(opened, wanted, result, picture, reading)
    if json:
        print_json(result.to_json())
    else:
        from dousa.app import _tables

        _tables.print_search(console(), result)


def classify(
    library: o.LibraryPath,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Motion files, or folders of them.")],
    mirror: Mirror = False,
    explain: Explain = False,
    threshold: Threshold = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    jobs: o.Jobs = None,
    json: o.Json = False,
) -> None:
    """Say which category each file belongs to, or that it belongs to none, without adding it.

    Example: dousa classify moves.dousa new/*.bvh
    """
    with open_to_read(library) as opened:
        reading = {"joint_map": o.load_joint_map(joint_map), "unit": unit, "up": up, "skeleton": skeleton}
        answers = opened.classify(
            files, mirror=mirror, explain=explain, threshold=threshold, **reading, n_jobs=jobs
        )
    if json:
        print_json([answer.to_json() for answer in answers])
    else:
        from dousa.app import _tables

        _tables.print_classes(console(), answers)
    problems = [answer for answer in answers if answer.problem is not None]
    for answer in problems:
        warn(f"{answer.path}: {answer.problem}")
    if problems:
        raise typer.Exit(2)


def list_clips(
    library: o.LibraryPath,
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[
        str | None, typer.Option("--performer", help="Only clips of this performer.")
    ] = None,
    clips: Annotated[
        bool, typer.Option("--clips", help="List every clip and take, not only the categories.")
    ] = False,
    json: o.Json = False,
) -> None:
    """What is in a library: its categories, or with --clips (or a category or performer) every clip and take.

    Example: dousa list moves.dousa --category walk
    """
    with open_to_read(library) as opened:
        stats = opened.stats()
        chosen = category is not None or performer is not None
        rows = opened.clips(category=category, performer=performer) if chosen or clips or json else []
    if json:
        print_json({**stats.to_json(), "clips": [clip.to_json() for clip in rows]})
    elif rows:
        from dousa.app import _tables

        _tables.print_clips(console(), [clip.to_json() for clip in rows])
    else:
        from dousa.app import _tables

        _tables.print_stats(console(), library, stats.to_json())


def _selection(clips: list[str] | None) -> list[int | str]:
    return [clip_or_path(clip) for clip in clips or []]


def remove(
    library: o.LibraryPath,
    clips: Clips = None,
    category: Annotated[str | None, typer.Option("--category", help="Only clips of this category.")] = None,
    performer: Annotated[
        str | None, typer.Option("--performer", help="Only clips of this performer.")
    ] = None,
    json: o.Json = False,
) -> None:
    """Take clips or takes out of a library; the files themselves are left alone.

    Example: dousa remove moves.dousa recordings/broken.bvh
    """
    with open_library(library) as opened:
        removed = opened.remove(_selection(clips), category=category, performer=performer)
    if json:
        print_json({"removed": removed})
    else:
        from dousa.app import _tables

        _tables.print_some(console(), f"{len(removed)} removed", list(removed))


def relabel(
    library: o.LibraryPath,
    clips: Clips = None,
    category: Annotated[str | None, typer.Option("--category", help="The new category; '' for none.")] = None,
    performer: Annotated[
        str | None, typer.Option("--performer", help="The new performer; '' for none.")
    ] = None,
    where_category: Annotated[
        str | None, typer.Option("--where-category", help="Only clips of this category.")
    ] = None,
    where_performer: Annotated[
        str | None, typer.Option("--where-performer", help="Only clips of this performer.")
    ] = None,
    json: o.Json = False,
) -> None:
    """Give clips or takes another category or performer; the forest learns of it with the next dousa train.

    Example: dousa relabel moves.dousa 12 13 --category kick
    """
    from dousa.library import UNCHANGED

    if category is None and performer is None:
        raise OptionError("nothing to change: give --category or --performer")
    with open_library(library) as opened:
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
        from dousa.app import _tables

        _tables.print_some(console(), f"{len(changed)} relabelled", list(changed))
