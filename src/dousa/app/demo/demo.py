"""The demonstration's first act: a library of synthetic motions is made, trained, searched and measured."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.demo.takes import say, show_take, write_dance_figure
from dousa.app.output import ProgressCallback, make_folder, progress_bar
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import SearchResult

LIBRARY = "demo.dousa"

_EXAMPLE = "kick_left"
_TEMPLATE_RATE = 15.0  # Hz; half of the usual rate, a quarter of the waiting
_PERFORMER_RULE = r"name:^(performer\d+)_"
_WHO = "a performer the library has never seen"


def write_library(
    folder: str | os.PathLike[str],
    n_performers: int = 10,
    takes: int = 1,
    seed: int = 0,
    categories: Sequence[str] | None = None,
    progress: ProgressCallback | None = None,
) -> list[Path]:
    """Write a library of synthetic motions as ``folder/category/performer_take.bvh``.

    Parameters
    ----------
    folder : made if missing; files of the same name are replaced.
    n_performers, takes, seed : as in `dousa.motion.synthetic.performers.make_library`.
    categories : all by default.
    progress : called with (files done, files, path).

    Returns
    -------
    Paths of the files, by category, performer and take.

    Raises
    ------
    OptionError : an unknown category, a number out of range.
    MotionWriteError : the folder cannot be written.
    """
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.performers import CATEGORIES, make_library

    chosen = CATEGORIES if categories is None else tuple(categories)
    total = len(chosen) * n_performers * takes
    paths: list[Path] = []
    for category, performer, take, motion in make_library(n_performers, takes, seed, chosen):
        path = Path(folder) / category / f"{performer.name}_{take + 1}.bvh"
        make_folder(path.parent)
        write_motion(motion, path)
        paths.append(path)
        if progress is not None:
            progress(len(paths), total, Message("demo.making_motions"))
    return paths


def run_demo(
    console: Console,
    output: Path,
    *,
    seed: int = 0,
    n_jobs: int | None = None,
    n_performers: int = 10,
    categories: Sequence[str] | None = None,
) -> None:
    """Make a library, train it, search it for a motion it has not seen, and measure how good it is.

    Can be run again into the same folder.

    Parameters
    ----------
    console : where the results are printed.
    output : folder for ``demo.dousa``, ``search.png``, ``take.bvh`` with ``timeline.png``, ``experiment.png`` and the
        synthetic motions.
    seed : of the performers, the take and the forest.
    n_jobs : workers; every core by default.
    n_performers, categories : size of the library.

    Raises
    ------
    DousaError : a folder that cannot be written.
    """
    make_folder(output)
    queries, strange = _write_motions(console, output, seed, n_performers, categories)
    example = next((path for path, category in queries.items() if category == _EXAMPLE), min(queries))
    started = time.perf_counter()
    library = output / LIBRARY
    _build(console, library, output / "motions", seed, n_jobs)
    _search(console, library, queries, example, output / "search.png")
    show_take(console, library, queries, example, strange, output, seed=seed, n_jobs=n_jobs)
    _measure(console, output, seed, n_jobs)
    console.print(f"Done in {time.perf_counter() - started:.0f} s. Now try your own query:")
    say(console, f"  dousa search {library} {example}")


def _write_motions(
    console: Console, output: Path, seed: int, n_performers: int, categories: Sequence[str] | None
) -> tuple[dict[Path, str], Path]:
    """Write the library's motions, and by one more performer queries with their categories and a figure of a dance."""
    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.performers import draw_performer, make_motion

    started = time.perf_counter()
    with progress_bar() as progress:
        written = write_library(output / "motions", n_performers, 1, seed, categories, progress)
    stranger = draw_performer(1000 * seed + n_performers, f"performer{n_performers:02d}")
    queries = {}
    for category in dict.fromkeys(path.parent.name for path in written):
        path = output / "queries" / category / f"{stranger.name}_1.bvh"
        make_folder(path.parent)
        write_motion(make_motion(category, stranger), path)
        queries[path] = category
    say(
        console,
        f"Made {len(written)} motions as BVH files in {output / 'motions'}: {len(queries)} categories by "
        f"{n_performers} performers, in {time.perf_counter() - started:.1f} s",
    )
    strange = output / "queries" / "dance" / f"{stranger.name}_1.bvh"
    make_folder(strange.parent)
    write_dance_figure(stranger, strange, seed)
    return queries, strange


def _build(console: Console, path: Path, motions: Path, seed: int, n_jobs: int | None) -> None:
    from dousa.library import Library

    with Library.open(path, create=True) as library, progress_bar() as progress:
        root = os.path.join(os.path.abspath(motions), "")
        stale = [clip.id for clip in library.clips() if not clip.path.startswith(root)]
        if stale:
            library.remove(stale)
        added = library.add(
            motions,
            performer_from=_PERFORMER_RULE,
            n_jobs=n_jobs,
            progress=lambda done, total, _: progress(done, total, Message("library_cli.adding")),
        )
        size = f"{len(added.added) + len(added.replaced)} files, {added.bytes / 1e6:.1f} MB"
        known = f"; {len(added.unchanged)} were there already" if added.unchanged else ""
        say(console, f"Added to {path}: {size} in {added.seconds:.1f} s{known}")
        trained = library.train(random_state=seed, n_jobs=n_jobs, progress=progress)
    console.print(
        f"Trained {trained.n_trees} trees on {trained.n_clips} clips of {len(trained.categories)} categories "
        f"in {trained.seconds:.1f} s"
    )


def _search(console: Console, path: Path, queries: dict[Path, str], example: Path, picture: Path) -> None:
    from dousa.app.pictures.sheets import draw_search_result
    from dousa.library import Library

    with Library.open(path, read_only=True) as library:
        result = library.search(example, 8, explain=True)
        draw_search_result(library, example, result, picture, truth=queries[example])
        _print_result(console, example, queries[example], result)
        answers = library.classify(list(queries), n_jobs=None)
    right = sum(answer.category == truth for answer, truth in zip(answers, queries.values(), strict=True))
    console.print(f"Of all {len(answers)} queries ({_WHO}) {right} get the right category.")
    say(console, f"Picture of query and results: {picture}")


def _print_result(console: Console, example: Path, truth: str, result: SearchResult) -> None:
    from rich.markup import escape
    from rich.table import Table

    from dousa.app.tables.search import describe_verdict

    say(console, f"\nQuery: {example} ({_WHO})")
    console.print(f"In truth {truth}; the forest says {describe_verdict(result.verdict)}", markup=False)
    for reason in result.verdict.explanation.reasons[:1] if result.verdict.explanation else ():
        say(console, f"Why: {reason.text}; without that {reason.vote_without:.0%} of the trees would say so")
    table = Table(box=None)
    for name in ("rank", "distance", "same leaf", "category", "", "file"):
        right = name in ("rank", "distance", "same leaf")
        table.add_column(name, justify="right" if right else "left", overflow="fold" if name == "file" else "ellipsis")
    for hit in result.results:
        verdict = "[green]match[/]" if hit.category == truth else "[red]differs[/]"
        name = os.path.join(os.path.basename(os.path.dirname(hit.path)), os.path.basename(hit.path))
        numbers = (str(hit.rank), f"{hit.distance:.3f}", f"{hit.leaf_share:.0%}")
        table.add_row(*numbers, escape(hit.category), verdict, escape(name))
    console.print(table)


def _measure(console: Console, output: Path, seed: int, n_jobs: int | None) -> None:
    from dousa.app.pictures.charts import draw_experiment_figure
    from dousa.app.pipelines.experiment_clips import read_labelled_clips
    from dousa.app.tables.lines import print_tables
    from dousa.experiments import run_experiment
    from dousa.formats.motion_files import ReadOptions

    with progress_bar() as progress:
        clips, _ = read_labelled_clips(
            [output / "motions"],
            category_from="folder",
            performer_from=_PERFORMER_RULE,
            options=ReadOptions(),
            n_jobs=n_jobs,
            progress=progress,
        )
        result = run_experiment(
            clips,
            split="leave-performer-out",
            random_state=seed,
            sampling_rate=_TEMPLATE_RATE,
            n_jobs=n_jobs or -1,
            progress=progress,
        )
    console.print(f"\nThe experiment of the paper on these motions (motion templates at {_TEMPLATE_RATE:g} Hz):")
    print_tables(console, result.to_tables())
    draw_experiment_figure(result.to_json(), output / "experiment.png")
    say(console, f"Picture of the table: {output / 'experiment.png'}")
