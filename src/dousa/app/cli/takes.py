"""Commands for uncut recordings: find, label."""

from __future__ import annotations

import io
import json as json_module
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dousa.app.cli.library import clip_or_path, open_library, open_to_learn, open_to_read
from dousa.app.cli.usage import Json, LibraryPath
from dousa.app.output import print_answer, progress_bar, say_written, warn, warn_skipped
from dousa.app.requests.library import LabelRequest
from dousa.app.requests.reading import Reading
from dousa.app.targets import check_table, check_targets
from dousa.errors import InvalidMotionError, OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.formats.motion_files import ReadOptions
    from dousa.library import LabelledTake, Library
    from dousa.retrieval.takes.live import LiveAnswer, LiveFrame, LiveLabeller

_STANDARD_INPUT = "-"

TakeOrFrames = Annotated[
    str,
    typer.Argument(
        metavar="TAKE",
        help="A recording: a file, the number of a take, or - for frames as JSON lines on standard input.",
    ),
]


def find(
    context: typer.Context,
    library: LibraryPath,
    query: Annotated[
        str, typer.Argument(metavar="QUERY", help="A motion file, or the number of a clip (see dousa list).")
    ],
    takes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[TAKE...]",
            help="Recordings to search: files, folders or numbers.",
            show_default="all takes of the library",
        ),
    ] = None,
    k: Annotated[int, typer.Option("-k", min=1, help="Number of hits.")] = 10,
    mirror: Annotated[bool, typer.Option("--mirror", help="Also search for the mirror image of the motion.")] = False,
    *,
    reading: Reading,
    json: Json = False,
) -> None:
    """Find where a motion occurs in uncut recordings, at half to twice its tempo.

    The surest places come first: how likely they show the same motion. Below 50 % they no longer do. The score is 1 for
    the very same motion and near 0 for another; how likely a score makes it depends on the recordings.

    Example: dousa find moves.dousa kick.bvh
    """
    from dousa.app.tables.search import print_places

    with open_to_learn(library) as opened, progress_bar() as progress:
        answer = opened.find(
            clip_or_path(query),
            None if not takes else [clip_or_path(take) for take in takes],
            k,
            mirror=mirror,
            options=reading.load(),
            n_jobs=context.obj,
            progress=progress,
        )
    print_answer(answer, partial(print_places, mirrored=mirror), json=json)
    warn_skipped(answer.skipped)
    if answer.skipped and not answer.n_takes:
        raise typer.Exit(2)


def label(
    context: typer.Context,
    library: LibraryPath,
    take: TakeOrFrames,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="Write the timeline as a table; with .eaf for ELAN.")
    ] = None,
    picture: Annotated[Path | None, typer.Option("--picture", help="Draw the timeline: .png, .svg or .pdf.")] = None,
    given: Annotated[
        bool, typer.Option("--given", help="The labels that a take was given, instead of recognising any.")
    ] = False,
    *,
    request: LabelRequest,
    reading: Reading,
    json: Json = False,
) -> None:
    """Label an uncut recording from beginning to end, including unknown segments.

    With - frames come as JSON lines, {"time": s, "joints": {"left_hand": \\[x, y, z], ...}} in m with Y up, and answers
    go as JSON lines, five a second. The first time after dousa train, what takes are labelled with is learned.

    Example: dousa label moves.dousa recordings/session.bvh --picture session.png

    Example: dousa label moves.dousa recordings/session.bvh --given --csv session.eaf
    """
    from dousa.app.tables.search import print_timeline

    if take == _STANDARD_INPUT:
        if csv or picture or given or reading.read:
            raise OptionError("takes_cli.live_options")
        _label_live(library, request.threshold, context.obj)
        return
    if given and (picture or request.threshold is not None or reading.read):
        raise OptionError("takes_cli.given_options")
    options = reading.load()
    if picture:
        require("matplotlib", "pictures")
    inputs = (take, library, *reading.files)
    check_table("--csv", csv, inputs)
    check_targets({"--picture": picture}, inputs)
    if given:
        _show_given(library, take, csv, json=json)
        return
    with open_library(library) as opened:
        with progress_bar() as progress:
            answer = opened.label(
                clip_or_path(take), threshold=request.threshold, options=options, n_jobs=context.obj, progress=progress
            )
        print_answer(answer, print_timeline, json=json)
        # Last, so that an answer is not lost where a file cannot be written.
        if csv:
            _write_labels(answer, csv)
        if picture:
            _draw(opened, answer, picture, options)
        say_written(csv, picture, json=json)


def _write_labels(answer: LabelledTake, path: Path) -> None:
    """The timeline as a table, or as a document of ELAN, which has no place for how sure it is."""
    from dousa.formats.annotations.elan import write_eaf
    from dousa.motion.annotation import Stretch
    from dousa.retrieval.takes.label import write_timeline_csv

    if path.suffix.lower() == ".eaf":
        segments = answer.timeline.segments
        write_eaf([Stretch(segment.start, segment.stop, segment.category) for segment in segments], path)
    else:
        write_timeline_csv(answer.timeline, path)


def _show_given(library: str, take: str, path: Path | None, *, json: bool) -> None:
    """Print the labels that a take was given, and write them into a file that can be read again."""
    from dousa.app.tables.search import print_given
    from dousa.formats.annotations.elan import write_eaf
    from dousa.formats.annotations.tables import write_labels_csv

    with open_to_read(library) as opened:
        takes = [clip.id for clip in opened.clips([clip_or_path(take)]) if clip.kind == "take"]
        given = opened.annotations.read(takes)
    known = [annotation for annotation in given if annotation.is_complete or annotation.segments]
    if len(known) != 1:
        raise OptionError("takes_cli.none_given" if not known else "takes_cli.several_given", take=take, n=len(known))
    print_answer(known[0], print_given, json=json)
    if path is not None:
        (write_eaf if path.suffix.lower() == ".eaf" else write_labels_csv)(known[0].rows, path)
        say_written(path, json=json)


def _draw(library: Library, answer: LabelledTake, picture: Path, options: ReadOptions) -> None:
    from dousa.app.pictures.timeline import draw_timeline
    from dousa.formats.motion_files import read_canonical

    if answer.clip_id is not None:
        motion = library.trajectories(answer.clip_id)
    else:
        motion = read_canonical(answer.take, options, whole=False)[0].to_trajectories()
    draw_timeline(answer.timeline, picture, motion, Path(answer.take).name)


def _label_live(library: str, threshold: float | None, jobs: int | None) -> None:
    """Answer frames on standard input as they come, by lines of JSON."""
    with open_library(library) as opened:
        # Before the first frame: what takes are labelled with may still have to be learned.
        with progress_bar() as progress:
            labeller = opened.live(threshold=threshold, n_jobs=jobs, progress=progress)
        _answer_frames(labeller)


def _answer_frames(labeller: LiveLabeller) -> None:
    from dousa.retrieval.takes.live import LiveFrameParser, read_live_frames

    parser = LiveFrameParser()
    try:
        for frame in read_live_frames(_read_lines(), parser):
            if labeller.height is None:
                labeller.height = parser.height
            answer = _push(labeller, frame, parser.line)
            if answer is not None:
                _say(answer)
    except (InvalidMotionError, KeyboardInterrupt):
        # The usual end of a live session: what was seen so far is still answered.
        with suppress(InvalidMotionError):
            _finish(labeller)
        raise
    if not _finish(labeller):
        warn(Message("takes_cli.no_frames"))


def _push(labeller: LiveLabeller, frame: LiveFrame, line: int) -> LiveAnswer | None:
    try:
        return labeller.push(frame.positions, frame.time)
    except InvalidMotionError as error:
        raise InvalidMotionError("takes_cli.line", number=line, problem=error) from error


def _finish(labeller: LiveLabeller) -> bool:
    last = labeller.finish()
    if last is not None:
        _say(last)
    return last is not None


def _read_lines() -> Iterator[str]:
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(encoding="utf-8", errors="backslashreplace")
    yield from sys.stdin or ()


def _say(answer: LiveAnswer) -> None:
    sys.stdout.write(json_module.dumps(answer.to_json(), ensure_ascii=False, allow_nan=False) + "\n")
    sys.stdout.flush()
