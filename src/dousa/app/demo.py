"""The demonstration in three acts, on synthetic motions: a library, a dance judged, a performer seen by cameras only.

Each act can be run again into the same folder and raises a `DousaError` where it cannot write.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.output import ProgressCallback, make_folder, progress_bar, warn
from dousa.app.pictures.charts import draw_experiment_figure
from dousa.app.pictures.sheets import draw_search_result
from dousa.app.pictures.timeline import draw_timeline
from dousa.app.pipelines.estimate import estimate_files
from dousa.app.pipelines.evaluate import evaluate_files
from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.app.pipelines.render import ring_around
from dousa.app.report.page import write_report
from dousa.app.requests.estimation import EstimationRequest, Outputs
from dousa.app.tables.evaluation import print_assessment
from dousa.app.tables.lines import print_tables
from dousa.app.tables.search import describe_verdict, print_search
from dousa.errors import DousaError
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import fit_poses
from dousa.estimation.body.skeleton_body import body_from_motion
from dousa.estimation.raster.rendering import Spoiling, render, spoil
from dousa.estimation.silhouettes.mask_npz import read_true_joints, write_silhouettes
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.words import KINDS, describe_segments, format_time
from dousa.experiments import run_experiment
from dousa.experiments.metrics import TrueSegment, compare_timeline
from dousa.formats.motion_files import ReadOptions, read_canonical
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.messages import Message
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories, canonicalise, fit_motion
from dousa.motion.synthetic import Performer, draw_performer, make_dance, make_library, make_mistakes, make_motion
from dousa.motion.synthetic.performers import CATEGORIES
from dousa.retrieval import LabelledClip
from dousa.retrieval.takes.find import overlap
from dousa.retrieval.takes.made_takes import join_clips

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.app.pipelines.estimate import Estimation
    from dousa.evaluation import ErrorEvent
    from dousa.library import FindResult, LabelledTake
    from dousa.motion.synthetic import Mistake

LIBRARY = "demo.dousa"
_PERFORMER_RULE = r"name:^(performer\d+)_"
_KICK = "kick_left"
_WHO = "a performer the library has never seen"


def say(console: Console, text: str) -> None:
    console.print(text, markup=False, soft_wrap=True)


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
    chosen = CATEGORIES if categories is None else tuple(categories)
    paths: list[Path] = []
    for category, performer, take, motion in make_library(n_performers, takes, seed, chosen):
        path = Path(folder) / category / f"{performer.name}_{take + 1}.bvh"
        make_folder(path.parent)
        write_motion(motion, path)
        paths.append(path)
        if progress is not None:
            progress(len(paths), len(chosen) * n_performers * takes, Message("demo.making_motions"))
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
    """Make a library, train it, search it for a motion it has not seen, look into a take, and measure it.

    Parameters
    ----------
    console : where the results are printed.
    output : folder for ``demo.dousa``, ``search.png``, ``take.bvh`` with ``timeline.png``, ``experiment.png`` and the
        synthetic motions.
    seed : of the performers, the take and the forest.
    n_jobs : workers; every core by default.
    n_performers, categories : size of the library.
    """
    make_folder(output)
    queries, strange = _write_motions(console, output, seed, n_performers, categories)
    example = next((path for path, category in queries.items() if category == _KICK), min(queries))
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
    started = time.perf_counter()
    with progress_bar() as progress:
        written = write_library(output / "motions", n_performers, 1, seed, categories, progress)
    stranger = draw_performer(1000 * seed + n_performers, f"performer{n_performers:02d}")
    names = dict.fromkeys(path.parent.name for path in written)
    queries = {output / "queries" / name / f"{stranger.name}_1.bvh": name for name in names}
    strange = output / "queries" / "dance" / f"{stranger.name}_1.bvh"
    for path in (*queries, strange):
        make_folder(path.parent)
    for path, category in queries.items():
        write_motion(make_motion(category, stranger), path)
    write_dance_figure(stranger, strange, seed)
    say(
        console,
        f"Made {len(written)} motions as BVH files in {output / 'motions'}: {len(queries)} categories by "
        f"{n_performers} performers, in {time.perf_counter() - started:.1f} s",
    )
    return queries, strange


def _build(console: Console, path: Path, motions: Path, seed: int, n_jobs: int | None) -> None:
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
    truth = queries[example]
    with Library.open(path, read_only=True) as library:
        result = library.search(example, 8, explain=True)
        draw_search_result(library, example, result, picture, truth=truth)
        answers = library.classify(list(queries), n_jobs=None)
    say(console, f"\nQuery: {example} ({_WHO})")
    say(console, f"In truth {truth}; the forest says {describe_verdict(result.verdict)}")
    for reason in result.verdict.explanation.reasons[:1] if result.verdict.explanation else ():
        say(console, f"Why: {reason.text}; without that {reason.vote_without:.0%} of the trees would say so")
    print_search(console, result)
    matches = sum(hit.category == truth for hit in result.results)
    console.print(f"{matches} of these {len(result.results)} match, as they are {truth} too.")
    right = sum(answer.category == truth for answer, truth in zip(answers, queries.values(), strict=True))
    console.print(f"Of all {len(answers)} queries ({_WHO}) {right} get the right category.")
    say(console, f"Picture of query and results: {picture}")


def _measure(console: Console, output: Path, seed: int, n_jobs: int | None, template_rate: float = 15.0) -> None:
    """Run the paper's experiment; templates at half of the usual rate (Hz) take a quarter of the time."""
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
            sampling_rate=template_rate,
            n_jobs=n_jobs or -1,
            progress=progress,
        )
    console.print(f"\nThe experiment of the paper on these motions (motion templates at {template_rate:g} Hz):")
    print_tables(console, result.to_tables())
    draw_experiment_figure(result.to_json(), output / "experiment.png")
    say(console, f"Picture of the table: {output / 'experiment.png'}")


@dataclass(frozen=True, slots=True)
class Take:
    """A recording and its true segments, whose category is None where the library has none for them."""

    path: Path
    truth: tuple[TrueSegment, ...]


def write_dance_figure(performer: Performer, path: Path, seed: int = 0, figure: str = "point") -> None:
    """Write one figure of the synthetic dance that is none of the synthetic categories, as its kicks are.

    Raises
    ------
    MotionWriteError : the file cannot be written.
    """
    dance = make_dance(performer, seed)
    chosen = next(one for one in dance.figures if one.name == figure)
    frames = slice(chosen.start, chosen.end)
    rotations, translations = dance.motion.rotations[frames], dance.motion.translations[frames]
    write_motion(replace(dance.motion, rotations=rotations, translations=translations), path)


def write_take(clips: Sequence[LabelledClip], known: Sequence[str], path: Path, seed: int = 0) -> Take:
    """Join clips of one performer into a take and write it.

    Parameters
    ----------
    clips : in the order in which they are played.
    known : categories that the library has.
    path : of the take.
    seed : of the lengths of the blends between clips.

    Raises
    ------
    TrainingError : no clips.
    MotionWriteError : the file cannot be written.
    """
    joined = join_clips(clips, np.random.default_rng(seed))
    rate, parents = joined.frame_rate, np.array(CANONICAL_PARENTS)
    write_motion(fit_motion(Trajectories(CANONICAL_JOINTS, joined.positions, rate, parents)), path)
    truth = tuple(
        TrueSegment(piece.start / rate, piece.stop / rate, piece.category if piece.category in known else None)
        for piece in joined.pieces
    )
    return Take(path, truth)


def show_take(
    console: Console,
    library_path: Path,
    queries: Mapping[Path, str],
    example: Path,
    strange: Path | None,
    output: Path,
    *,
    seed: int = 0,
    n_jobs: int | None = None,
) -> None:
    """Join some queries into a take, add it to the library, label it, and find a motion in it.

    Parameters
    ----------
    library_path : trained, without the queries.
    queries : files of one performer with their true categories. With less than three there is no take.
    example : the one of them whose category is looked for.
    strange : file of another motion by the same performer, of none of the categories.
    output : folder for ``take.bvh`` and ``timeline.png``.
    seed : of the choice and order of the clips.
    """
    clips, picture = choose_clips(queries, example, strange, seed), output / "timeline.png"
    if len(clips) < 3:
        say(console, "No uncut take is shown: it is made of three or more clips of a performer held out")
        return
    with Library.open(library_path) as library:
        take = write_take(clips, tuple(library.categories()), output / "take.bvh", seed)
        library.add(take.path, kind="take", n_jobs=n_jobs)
        say(
            console,
            f"\nJoined {len(clips)} motions of the same performer into an uncut take of {take.truth[-1].stop:.0f} s, "
            f"and added it: {take.path}",
        )
        started = time.perf_counter()
        with progress_bar() as progress:
            answer = library.label(take.path, n_jobs=n_jobs, progress=progress)
        say(console, _describe_labels(answer, take, time.perf_counter() - started))
        if answer.clip_id is not None:
            draw_timeline(answer.to_json(), picture, library.trajectories(answer.clip_id), take.path.name)
        category = queries[example]
        models = [clip.path for clip in library.clips() if clip.category == category]
        if models:
            say(console, _describe_place(library.find(models[0], take.path, k=5), take, category))
    say(console, f"Picture of the timeline: {picture}")


def choose_clips(
    queries: Mapping[Path, str], example: Path, strange: Path | None, seed: int, most: int = 9
) -> list[LabelledClip]:
    """Read the example and other queries, of many categories, in a random order, what is strange in the middle."""
    generator = np.random.default_rng(seed)
    others = sorted(path for path in queries if path != example)
    others = [others[k] for k in generator.permutation(len(others))]
    seen, turns = Counter([queries[example]]), {}
    for path in others:  # one of each category before a second of any
        turns[path] = seen[queries[path]]
        seen[queries[path]] += 1
    chosen = [example, *sorted(others, key=lambda path: turns[path])[: most - 1]]
    ordered = [chosen[k] for k in generator.permutation(len(chosen))]
    if strange is not None:
        ordered.insert((len(ordered) + 1) // 2, strange)
    clips = []
    for path in ordered:
        with suppress(DousaError):  # a file that cannot be used is left out
            motion = read_canonical(str(path), ReadOptions())[0]
            labels = queries.get(path, ""), None
            clips.append(LabelledClip(str(path), *labels, motion.positions, motion.frame_rate, motion.height))
    return clips


def _describe_labels(answer: LabelledTake, take: Take, seconds: float) -> str:
    segments = answer.timeline.segments
    counts = compare_timeline(segments, take.truth, answer.timeline.duration)
    text = (
        f"Labelled it (with learning how, {seconds:.1f} s): {counts.matched} of {counts.true} motions found, "
        f"{counts.right_frames / counts.n_frames:.0%} of the frames right"
    )
    unknown = [segment for segment in segments if segment.category is None]
    for piece in take.truth:
        if piece.category is None:
            shared = (min(one.stop, piece.stop) - max(one.start, piece.start) for one in unknown)
            share = sum(max(seconds, 0.0) for seconds in shared) / (piece.stop - piece.start)
            when = f"{format_time(piece.start)}-{format_time(piece.stop)}"
            text += f"; what the library has no category for ({when}) is unknown at {share:.0%} of its time"
    return text


def _describe_place(answer: FindResult, take: Take, category: str) -> str:
    query = os.path.join(category, os.path.basename(answer.query))
    pieces = [(piece.start, piece.stop) for piece in take.truth if piece.category == category]
    truth = ", ".join(f"{format_time(start)}-{format_time(stop)}" for start, stop in pieces)
    if not answer.results:
        return f"Nothing like {query} was found in it (in truth {category} at {truth})"
    best = answer.results[0]
    text = (
        f"Most like {query} in it: {format_time(best.start)}-{format_time(best.end)}, score {best.score:.2f} "
        f"(in truth {category} at {truth})"
    )
    # A motion of two kicks is found twice: what counts is the best place where there is none.
    elsewhere = [
        place.score
        for place in answer.results
        if not any(overlap((place.start, place.end), piece) > 0 for piece in pieces)
    ]
    return f"{text}; elsewhere {max(elsewhere):.2f} at most" if elsewhere else text


def write_dance(output: Path, seed: int = 0) -> tuple[Path, Path, tuple[Mistake, ...]]:
    """Write the reference dance and the pupil's as BVH files.

    Parameters
    ----------
    output : folder, must exist.
    seed : of the dancers, their takes and the mistakes.

    Returns
    -------
    reference, pupil : the files.
    mistakes : what was done wrong on purpose, in order of time.

    Raises
    ------
    MotionWriteError : the files cannot be written.
    OptionError : a negative seed.
    """
    reference = make_dance(Performer(name="teacher", seed=1000 * seed), seed)
    # Another body and posture, but someone who has learned the dance: the mistakes are put in afterwards.
    pupil = replace(draw_performer(1000 * seed + 41, "pupil"), amplitude=1.0, noise=1.0, left_handed=False)
    performed, mistakes = make_mistakes(make_dance(pupil, seed + 1), seed)
    paths = output / "dance_reference.bvh", output / "dance_pupil.bvh"
    write_motion(reference.motion, paths[0])
    write_motion(performed, paths[1])
    return *paths, mistakes


def run_dance_demo(console: Console, output: Path, *, seed: int = 0) -> None:
    """Make a dance and a pupil's performance of it, evaluate the files, and compare with the truth.

    The folder gets both BVH files and the folder ``report``.
    """
    make_folder(output)
    started = time.perf_counter()
    reference, pupil, mistakes = write_dance(output, seed)
    say(
        console,
        f"\nA dance of six figures: {reference}, and a pupil of another build who makes {len(mistakes)} mistakes on "
        f"purpose: {pupil}",
    )
    folder = output / "report"
    with progress_bar() as progress:
        done = evaluate_files([reference], pupil, options=ReadOptions(), progress=progress)
        page = write_report(done.assessment, folder)
    print_assessment(console, done.assessment)
    for text in done.assessment.warnings:
        warn(str(text))
    _print_comparison(console, mistakes, done.assessment.events)
    console.print(f"Evaluated in {time.perf_counter() - started:.0f} s. The same again:")
    say(console, f"  dousa evaluate {reference} --performance {pupil} -o {folder}")
    say(console, f"Open the report in a browser: {page}")


def match_mistakes(
    mistakes: Sequence[Mistake], events: Sequence[ErrorEvent], least: float = 0.1
) -> list[ErrorEvent | None]:
    """Return for each mistake the event that overlaps it most, of its kind if there is one, else None.

    ``least`` is the intersection over union from which an event has to do with a mistake.
    """

    def compare(mistake: Mistake, event: ErrorEvent) -> tuple[bool, float]:
        shared = min(mistake.end_s, event.end_s) - max(mistake.start_s, event.start_s)
        parts = not mistake.segments or bool(set(mistake.segments) & set(event.segments))
        share = shared / (max(mistake.end_s, event.end_s) - min(mistake.start_s, event.start_s)) if parts else 0.0
        return event.kind == mistake.kind and share >= least, share

    best = [max(events, key=lambda event: compare(mistake, event), default=None) for mistake in mistakes]
    return [
        event if event is not None and compare(mistake, event)[1] >= least else None
        for mistake, event in zip(mistakes, best, strict=True)
    ]


def _print_comparison(console: Console, mistakes: Sequence[Mistake], events: Sequence[ErrorEvent]) -> None:
    from rich.table import Table

    pairs = list(zip(mistakes, match_mistakes(mistakes, events), strict=True))
    columns = ("time", "injected", "where and how much", "found", "start off by")
    table = Table(
        *columns, box=None, title="What was done wrong on purpose, and what of it was found", title_justify="left"
    )
    for mistake, event in pairs:
        when = f"{format_time(mistake.start_s)}-{format_time(mistake.end_s)}"
        where = (describe_segments(mistake.segments) if mistake.segments else "whole body") + _describe_size(mistake)
        verdict, onset = "[red]no[/]", ""
        if event is not None:
            verdict = "[green]yes[/]" if event.kind == mistake.kind else f"[yellow]as {KINDS[event.kind]}[/]"
            verdict += _describe_size(event)
            onset = f"{1000 * (event.start_s - mistake.start_s):+.0f} ms"
        table.add_row(when, str(KINDS[mistake.kind]), where, verdict, onset)
    console.print(table)
    right = sum(event is not None and event.kind == mistake.kind for mistake, event in pairs)
    others = sum(not any(event is other for _, other in pairs) for event in events)
    plural = "event" if others == 1 else "events"
    console.print(f"{right} of {len(mistakes)} found and named right; {others} other {plural} reported.")


def _describe_size(what: Mistake | ErrorEvent) -> str:
    if what.lag_ms is not None:
        return f", {abs(what.lag_ms):.0f} ms {'late' if what.lag_ms > 0 else 'early'}"
    return "" if what.shortfall_deg is None else f", {what.shortfall_deg:.0f} deg short"


def run_estimation_demo(console: Console, output: Path, *, seed: int = 0) -> None:
    """Render a performer, estimate the motion from the silhouettes, find it in the library and evaluate it.

    The performer has another build than the model that the tracker is given, and the silhouettes are spoiled. The
    ``demo.dousa`` of the first act is searched if it is there.
    """
    make_folder(output)
    started = time.perf_counter()
    performed, seen, estimated, overlay, sheet = (
        output / name for name in ("performed.bvh", "seen.npz", "estimated.bvh", "estimated.mp4", "estimated.png")
    )
    stature = write_performance(performed, seen, seed)
    say(
        console,
        f"\nA performer seen by four cameras only: {seen}, with bones and girths 5 to 7 % off those of the model, and "
        "spoiled silhouettes",
    )
    outputs = Outputs(motion=estimated, overlay=overlay, sheet=sheet)
    with progress_bar() as progress:
        done = estimate_files(EstimationRequest((seen,), outputs=outputs, stature=stature), progress, warn)
    for text in done.warnings:
        warn(text)
    _print_accuracy(console, done, seen)
    say(console, f"Look at it: {overlay} and {sheet}")
    if (output / LIBRARY).exists():
        _search_estimate(console, output / LIBRARY, estimated)
    _evaluate_estimate(console, performed, estimated, output, seed)
    console.print(f"Seen, estimated, found and judged in {time.perf_counter() - started:.0f} s. The same again:")
    say(console, f"  dousa estimate {seen} --stature {stature:.2f} -o {estimated} -o {overlay}")


def write_performance(performed: Path, seen: Path, seed: int = 0) -> float:
    """Write what a synthetic performer does, and what cameras see of it.

    Parameters
    ----------
    performed : BVH file to write.
    seen : npz of silhouettes to write.
    seed : of performer and noise.

    Returns
    -------
    The performer's stature in m, the only thing that the tracker gets to know.
    """
    performer = replace(draw_performer(1000 * seed + 61, "performer"), arms=1.06, legs=0.95)
    motion = make_motion(_KICK, performer)
    write_motion(motion, performed)
    canonical = canonicalise(motion)
    body = body_from_motion(canonical)
    body = replace(body, spheres=body.spheres * np.array([1.0, 1.0, 1.0, 1.07]))  # wider than the model's
    poses, _ = fit_poses(body, canonical.positions)
    names, points = point_names(body), compute_points(body, poses)
    cameras = ring_around(points, 4, (320, 240))
    # Holes and specks take long to make, and change less than these.
    amounts = Spoiling(ragged=1.0, shadow=0.4, jitter=0.5)
    masks = [
        spoil(view, np.random.default_rng([seed, number]), amounts)
        for number, view in enumerate(render(body, poses, cameras))
    ]
    truth = (CANONICAL_JOINTS, points[:, [names.index(name) for name in CANONICAL_JOINTS]])
    write_silhouettes(seen, masks, cameras, motion.frame_rate, stature=performer.stature, truth=truth)
    return performer.stature


def _print_accuracy(console: Console, done: Estimation, seen: Path) -> None:
    """Print how far off the joints are, which is known here and in no real recording."""
    found, true_joints = done.estimate, read_true_joints(seen)
    assert true_joints is not None
    names, truth = true_joints
    estimated = dict(zip(found.points.names, np.moveaxis(found.points.positions, 1, 0), strict=True))
    off = [estimated[name] - truth[:, place] for place, name in enumerate(names) if name in estimated]
    error = np.nanmean(np.linalg.norm(off, axis=-1))
    held = np.linalg.norm(truth - truth[:1], axis=-1).mean() * 1000.0
    say(
        console,
        f"Estimated {found.n_frames} frames at {found.frames_per_second:.0f} frames/s, the start found by itself: "
        f"overlap {np.nanmean(found.iou):.2f}, mean joint error {1000 * error:.0f} mm (holding the true "
        f"first pose: {held:.0f} mm), {int(found.lost.sum())} frames lost",
    )


def _search_estimate(console: Console, library_path: Path, estimated: Path) -> None:
    with Library.open(library_path, read_only=True) as library:
        result = library.search(estimated, 5)
    right = sum(hit.category == _KICK for hit in result.results)
    say(
        console,
        f"In the library: in truth {_KICK}, the forest says {describe_verdict(result.verdict)}; "
        f"{right} of the {len(result.results)} nearest clips are {_KICK}",
    )


def _evaluate_estimate(console: Console, performed: Path, estimated: Path, output: Path, seed: int) -> None:
    teacher = Performer(name="teacher", seed=1000 * seed)
    takes = [output / f"teacher_{take + 1}.bvh" for take in range(5)]
    for take, path in enumerate(takes):
        write_motion(make_motion(_KICK, teacher, take), path)
    with progress_bar() as progress:
        seen, true = (
            evaluate_files(takes, path, options=ReadOptions(), tempo="free", progress=progress).assessment
            for path in (estimated, performed)
        )
        page = write_report(seen, output / "report_estimated")
    kinds = [", ".join(dict.fromkeys(event.kind for event in found.events)) or "no error" for found in (seen, true)]
    say(
        console,
        f"Held against {len(takes)} takes of a teacher: grade {round_grade(seen.score):.0f} ({kinds[0]}); "
        f"the motion as it really was: {round_grade(true.score):.0f} ({kinds[1]})",
    )
    say(console, f"Open the report in a browser: {page}")
