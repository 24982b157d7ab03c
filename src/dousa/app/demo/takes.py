"""Uncut recordings in the demonstration's first act: clips joined into a take, labelled, and searched inside."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.output import progress_bar
from dousa.errors import DousaError

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.experiments.metrics import TrueSegment
    from dousa.library import FindResult, LabelledTake, Library
    from dousa.motion.synthetic.performers import Performer
    from dousa.retrieval import LabelledClip

TAKE, TIMELINE = "take.bvh", "timeline.png"

_LEAST_CLIPS, _N_CLIPS = 3, 9
_FIGURE = "point"  # of the synthetic dance; its circles are arm circles with bent knees, and its kicks are kicks


def say(console: Console, text: str) -> None:
    """Print a line as it is."""
    console.print(text, markup=False, soft_wrap=True)


@dataclass(frozen=True, slots=True)
class Take:
    """A recording and its true segments, whose category is None where the library has none for them."""

    path: Path
    truth: tuple[TrueSegment, ...]


def write_dance_figure(performer: Performer, path: Path, seed: int = 0) -> None:
    """Write one figure of the synthetic dance, which is none of the synthetic categories.

    Raises
    ------
    MotionWriteError : the file cannot be written.
    """
    import dataclasses

    from dousa.formats.registry import write_motion
    from dousa.motion.synthetic.dance import make_dance

    dance = make_dance(performer, seed)
    figure = next(figure for figure in dance.figures if figure.name == _FIGURE)
    frames = slice(figure.start, figure.end)
    rotations, translations = dance.motion.rotations[frames], dance.motion.translations[frames]
    write_motion(dataclasses.replace(dance.motion, rotations=rotations, translations=translations), path)


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
    import numpy as np

    from dousa.experiments.metrics import TrueSegment
    from dousa.formats.registry import write_motion
    from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories, fit_motion
    from dousa.retrieval.takes.made_takes import join_clips

    joined = join_clips(clips, np.random.default_rng(seed))
    parents = np.array(CANONICAL_PARENTS)
    write_motion(fit_motion(Trajectories(CANONICAL_JOINTS, joined.positions, joined.frame_rate, parents)), path)
    rate = joined.frame_rate
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
    from dousa.library import Library

    clips = _choose_clips(queries, example, strange, seed)
    if len(clips) < _LEAST_CLIPS:
        say(console, "No uncut take is shown: it is made of three or more clips of a performer held out")
        return
    with Library.open(library_path) as library:
        take = write_take(clips, tuple(library.categories()), output / TAKE, seed)
        library.add(take.path, kind="take", n_jobs=n_jobs)
        say(
            console,
            f"\nJoined {len(clips)} motions of the same performer into an uncut take of {take.truth[-1].stop:.0f} s, "
            f"and added it: {take.path}",
        )
        _label(console, library, take, output / TIMELINE, n_jobs)
        _find(console, library, take, queries[example])
    say(console, f"Picture of the timeline: {output / TIMELINE}")


def _choose_clips(queries: Mapping[Path, str], example: Path, strange: Path | None, seed: int) -> list[LabelledClip]:
    """The example and some other queries in a random order, of many categories, what is strange in the middle."""
    import numpy as np

    generator = np.random.default_rng(seed)
    others = sorted(path for path in queries if path != example)
    others = [others[k] for k in generator.permutation(len(others))]
    # One of each category before a second of any; what is sorted keeps its order otherwise.
    seen = Counter([queries[example]])
    turns = {}
    for path in others:
        turns[path] = seen[queries[path]]
        seen[queries[path]] += 1
    chosen = [example, *sorted(others, key=lambda path: turns[path])[: _N_CLIPS - 1]]
    ordered = [chosen[k] for k in generator.permutation(len(chosen))]
    if strange is not None:
        ordered.insert((len(ordered) + 1) // 2, strange)
    return read_clips(ordered, queries)


def read_clips(paths: Sequence[Path], categories: Mapping[Path, str]) -> list[LabelledClip]:
    """Read motion files as clips; files that cannot be used are left out."""
    from dousa.formats.motion_files import ReadOptions, read_canonical
    from dousa.retrieval import LabelledClip

    clips = []
    for path in paths:
        with suppress(DousaError):
            motion = read_canonical(str(path), ReadOptions())[0]
            labels = categories.get(path, ""), None
            clips.append(LabelledClip(str(path), *labels, motion.positions, motion.frame_rate, motion.height))
    return clips


def _label(console: Console, library: Library, take: Take, picture: Path, n_jobs: int | None) -> None:
    from dousa.app.pictures.timeline import draw_timeline
    from dousa.experiments.metrics import compare_timeline

    started = time.perf_counter()
    with progress_bar() as progress:
        answer = library.label(take.path, n_jobs=n_jobs, progress=progress)
    seconds = time.perf_counter() - started
    counts = compare_timeline(answer.timeline.segments, take.truth, answer.timeline.duration)
    strangers = [piece for piece in take.truth if piece.category is None]
    unknown = "".join(f"; {_describe_unknown(answer, piece)}" for piece in strangers)
    say(
        console,
        f"Labelled it (with learning how, {seconds:.1f} s): {counts.matched} of {counts.true} motions found, "
        f"{counts.right_frames / counts.n_frames:.0%} of the frames right{unknown}",
    )
    if answer.clip_id is not None:
        draw_timeline(answer.to_json(), picture, library.trajectories(answer.clip_id), take.path.name)


def _describe_unknown(answer: LabelledTake, piece: TrueSegment) -> str:
    """How much of a segment without a category is labelled as unknown."""
    from dousa.evaluation.words import format_time

    unknown = [segment for segment in answer.timeline.segments if segment.category is None]
    overlaps = (min(segment.stop, piece.stop) - max(segment.start, piece.start) for segment in unknown)
    share = sum(max(overlap, 0.0) for overlap in overlaps) / (piece.stop - piece.start)
    when = f"{format_time(piece.start)}-{format_time(piece.stop)}"
    return f"what the library has no category for ({when}) is unknown at {share:.0%} of its time"


def _find(console: Console, library: Library, take: Take, category: str) -> None:
    models = [clip.path for clip in library.clips() if clip.category == category]
    if models:
        answer = library.find(models[0], take.path, k=5)
        say(console, _describe_place(answer, take, category))


def _describe_place(answer: FindResult, take: Take, category: str) -> str:
    from dousa.evaluation.words import format_time
    from dousa.retrieval.takes.find import overlap

    query = os.path.join(category, os.path.basename(answer.query))
    pieces = [piece for piece in take.truth if piece.category == category]
    truth = ", ".join(f"{format_time(piece.start)}-{format_time(piece.stop)}" for piece in pieces)
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
        if not any(overlap((place.start, place.end), (piece.start, piece.stop)) > 0 for piece in pieces)
    ]
    return f"{text}; elsewhere {max(elsewhere):.2f} at most" if elsewhere else text
