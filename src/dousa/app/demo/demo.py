"""The demonstration: a library of motions is made, trained, searched and measured before your eyes.

What it shows of uncut recordings is in `demo_takes`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.demo.takes import show_take, write_dance_figure
from dousa.app.output import ProgressCallback, make_folder, progress_bar
from dousa.errors import TrainingError
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import Library, SearchResult

_N_PERFORMERS = 10
_N_RESULTS = 8
_EXAMPLE = "kick_left"
_TEMPLATE_RATE = 15.0  # Hz; half of the usual rate, a quarter of the waiting
_PERFORMER_RULE = r"name:^(performer\d+)_"


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
    data: Path | None,
    output: Path,
    *,
    seed: int = 0,
    n_jobs: int | None = None,
    category_from: str = "folder",
    performer_from: str | None = None,
    n_performers: int = _N_PERFORMERS,
    categories: Sequence[str] | None = None,
) -> None:
    """Make a library, train it, ask it for a motion it has not seen, and measure how good it is.

    Can be run again into the same folder.

    Parameters
    ----------
    console : where to tell about it.
    data : folder of motion files to do it with; synthetic motions by default.
    output : folder for ``demo.dousa``, ``search.png``, ``take.bvh`` with ``timeline.png``, ``experiment.png`` and the
        synthetic motions.
    seed : of the synthetic performers, the choice of the query and the forest.
    n_jobs : workers; every core by default.
    category_from, performer_from : rules for the labels of ``data``, see `dousa.library.labels`.
    n_performers, categories : size of the synthetic library.

    Raises
    ------
    DousaError : what can be put right by the person who reads it.
    """
    make_folder(output)
    if data is None:
        plan = _plan_synthetic(console, output, seed, n_performers, categories)
    else:
        plan = _plan_data(data, seed, category_from, performer_from)
    started = time.perf_counter()
    library_path = output / "demo.dousa"
    _build(console, library_path, plan, seed, n_jobs)
    _ask(console, library_path, plan, output / "search.png")
    show_take(console, library_path, plan.queries, plan.example, plan.strange, output, seed=seed, n_jobs=n_jobs)
    _measure(console, plan, output / "experiment.png", seed, n_jobs)
    console.print(f"Done in {time.perf_counter() - started:.0f} s. Now try your own query:")
    console.print(f"  dousa search {library_path} {plan.example}", markup=False, soft_wrap=True)


@dataclass(frozen=True, slots=True)
class _Plan:
    """What the library is made of, and what it is asked.

    Parameters
    ----------
    folder : motions of the library.
    queries : files that the library must not know, with their true categories.
    example : the query whose answer is shown.
    who : what the queries have in common, in words.
    strange : file of something that is of no category, by the same performer.
    category_from, performer_from : rules for the labels.
    """

    folder: Path
    queries: dict[Path, str]
    example: Path
    who: str
    strange: Path | None
    category_from: str
    performer_from: str | None


def _plan_synthetic(
    console: Console, output: Path, seed: int, n_performers: int, categories: Sequence[str] | None
) -> _Plan:
    """Write the motions; one more performer than the library has plays the queries."""
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
    console.print(
        f"Made {len(written)} motions as BVH files in {output / 'motions'}: {len(queries)} categories by "
        f"{n_performers} performers, in {time.perf_counter() - started:.1f} s",
        markup=False,
        soft_wrap=True,
    )
    example = next((path for path, category in queries.items() if category == _EXAMPLE), min(queries))
    strange = output / "queries" / "dance" / f"{stranger.name}_1.bvh"
    make_folder(strange.parent)
    write_dance_figure(stranger, strange, seed)
    who = "a performer the library has never seen"
    return _Plan(output / "motions", queries, example, who, strange, "folder", _PERFORMER_RULE)


def _plan_data(data: Path, seed: int, category_from: str, performer_from: str | None) -> _Plan:
    """Hold out all clips of one performer, or one clip if nobody says who performs."""
    import numpy as np

    from dousa.formats.motion_files import find_motion_files
    from dousa.library import parse_label_rule

    files, _ = find_motion_files([data])
    category = parse_label_rule(category_from, "category")
    performer = parse_label_rule(performer_from, "performer")
    labels = {Path(file.path): category(Path(file.root), Path(file.path)) for file in files}
    known = {path: label for path, label in labels.items() if label is not None}
    counts = {label: sum(other == label for other in known.values()) for label in known.values()}
    several = sorted(path for path, label in known.items() if counts[label] > 1)
    if len(counts) < 2 or not several:
        raise TrainingError("demo.too_few_categories", path=data, n_files=len(files), n_categories=len(counts))
    example = several[int(np.random.default_rng(seed).integers(len(several)))]
    people = {Path(file.path): performer(Path(file.root), Path(file.path)) for file in files}
    held = [path for path in known if path == example or people[path] == people[example] is not None]
    if len(held) == len(known):
        held = [example]
    who = "one clip held out" if len(held) == 1 else f"all clips of performer {people[example]}, held out"
    return _Plan(data, {path: known[path] for path in held}, example, who, None, category_from, performer_from)


def _build(console: Console, path: Path, plan: _Plan, seed: int, n_jobs: int | None) -> None:
    """Add the motions, take out what must not be known, train."""
    from dousa.library import Library

    with Library.open(path, create=True) as library, progress_bar() as progress:
        _forget_others(library, plan.folder)
        added = library.add(
            plan.folder,
            category_from=plan.category_from,
            performer_from=plan.performer_from,
            n_jobs=n_jobs,
            progress=lambda done, total, _: progress(done, total, Message("library_cli.adding")),
        )
        _forget_queries(library, plan)
        size = f"{len(added.added) + len(added.replaced)} files, {added.bytes / 1e6:.1f} MB"
        known = f"; {len(added.unchanged)} were there already" if added.unchanged else ""
        console.print(f"Added to {path}: {size} in {added.seconds:.1f} s{known}", markup=False, soft_wrap=True)
        for item in added.skipped[:3]:
            console.print(f"  left out {item.path}: {item.reason}", markup=False, soft_wrap=True)
        if len(added.skipped) > 3:
            console.print(f"  left out {len(added.skipped) - 3} more files")
        trained = library.train(random_state=seed, n_jobs=n_jobs, progress=progress)
    console.print(
        f"Trained {trained.n_trees} trees on {trained.n_clips} clips of {len(trained.categories)} categories "
        f"in {trained.seconds:.1f} s"
    )


def _forget_others(library: Library, folder: Path) -> None:
    """Remove clips of an earlier run that was about other motions."""
    root = os.path.join(os.path.abspath(folder), "")
    stale = [clip.id for clip in library.clips() if not clip.path.startswith(root)]
    if stale:
        library.remove(stale)


def _forget_queries(library: Library, plan: _Plan) -> None:
    """Remove what the library must not know."""
    queries = {os.path.abspath(query) for query in plan.queries}
    known = [clip.id for clip in library.clips() if clip.path in queries]
    if known:
        library.remove(known)


def _ask(console: Console, path: Path, plan: _Plan, picture: Path) -> None:
    """Show one query's answer in full, then how many of all queries are understood."""
    from dousa.app.pictures.sheets import draw_search_result
    from dousa.library import Library

    truth = plan.queries[plan.example]
    with Library.open(path, read_only=True) as library:
        result = library.search(plan.example, _N_RESULTS, explain=True)
        draw_search_result(library, plan.example, result, picture, truth=truth)
        _print_answer(console, plan, result)
        if len(plan.queries) > 1:
            answers = library.classify(list(plan.queries), n_jobs=None)
            truths = [plan.queries[query] for query in plan.queries]
            right = sum(answer.category == truth for answer, truth in zip(answers, truths, strict=True))
            console.print(f"Of all {len(answers)} queries ({plan.who}) {right} get the right category.")
    console.print(f"Picture of query and results: {picture}", markup=False, soft_wrap=True)


def _print_answer(console: Console, plan: _Plan, result: SearchResult) -> None:
    from rich.markup import escape
    from rich.table import Table

    from dousa.app.tables.search import describe_verdict

    truth = plan.queries[plan.example]
    console.print(f"\nQuery: {plan.example} ({plan.who})", markup=False, soft_wrap=True)
    console.print(
        f"In truth {truth}; the forest says {describe_verdict(result.verdict)}",
        markup=False,
    )
    for reason in result.verdict.explanation.reasons[:1] if result.verdict.explanation else ():
        without = f"without that {reason.vote_without:.0%} of the trees would say so"
        console.print(f"Why: {reason.text}; {without}", markup=False, soft_wrap=True)
    table = Table(box=None)
    table.add_column("rank", justify="right")
    table.add_column("distance", justify="right")
    table.add_column("same leaf", justify="right")
    table.add_column("category")
    table.add_column("")
    table.add_column("file", overflow="fold")
    for hit in result.results:
        same = hit.category == truth
        verdict = "[green]match[/]" if same else "[red]differs[/]"
        name = os.path.relpath(hit.path, os.path.abspath(plan.folder))
        numbers = (str(hit.rank), f"{hit.distance:.3f}", f"{hit.leaf_share:.0%}")
        table.add_row(*numbers, escape(hit.category), verdict, escape(name))
    console.print(table)


def _measure(console: Console, plan: _Plan, picture: Path, seed: int, n_jobs: int | None) -> None:
    """The paper's experiment on all motions at hand."""
    from dousa.app.pictures.sheets import draw_experiment_figure
    from dousa.app.pipelines.experiment_clips import read_labelled_clips
    from dousa.app.tables.lines import print_tables
    from dousa.experiments import run_experiment
    from dousa.formats.motion_files import ReadOptions

    with progress_bar() as progress:
        clips, _ = read_labelled_clips(
            [plan.folder],
            category_from=plan.category_from,
            performer_from=plan.performer_from,
            options=ReadOptions(),
            n_jobs=n_jobs,
            progress=progress,
        )
        split = "half" if plan.performer_from is None else "leave-performer-out"
        result = run_experiment(
            clips,
            split=split,
            random_state=seed,
            sampling_rate=_TEMPLATE_RATE,
            n_jobs=n_jobs or -1,
            progress=progress,
        )
    console.print(f"\nThe experiment of the paper on these motions (motion templates at {_TEMPLATE_RATE:g} Hz):")
    print_tables(console, result.to_tables())
    draw_experiment_figure(result.to_json(), picture)
    console.print(f"Picture of the table: {picture}", markup=False, soft_wrap=True)
