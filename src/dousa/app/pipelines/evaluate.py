"""From motion files to an assessment, of a dance or of the repetitions of an exercise, and to a pupil over time."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from dousa.errors import InvalidMotionError, OptionError
from dousa.formats.motion_files import ReadOptions, find_motion_files, read_canonical
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.evaluation import Assessment, Beats, BeatTiming, Progress, RepetitionsAssessment
    from dousa.motion import CanonicalMotion


_Assessment = TypeVar("_Assessment")


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation(Generic[_Assessment]):
    """An assessment and the files that it is about.

    Parameters
    ----------
    assessment : the answer.
    references : files of the reference takes, the first is the model.
    performance : the file judged.
    notes : (file, warning) of reading the files.
    motion : what that file holds.
    """

    assessment: _Assessment
    references: tuple[Path, ...]
    performance: Path
    notes: tuple[tuple[Path, Message], ...]
    motion: CanonicalMotion


def find_references(paths: Sequence[Path]) -> list[Path]:
    """The files given, folders replaced by the motion files below them; each once, in this order.

    Raises
    ------
    OptionError : a path that does not exist, a folder without motion files.
    """
    found: list[Path] = []
    for path in paths:
        files, missing = find_motion_files([path])
        if missing:
            raise OptionError("cli.file_problem", path=missing[0].path, reason=missing[0].reason)
        if not files:
            raise OptionError("evaluate.no_motion_files", path=path)
        single = path if not path.is_dir() else None
        found.extend(single or file.path for file in files)
    by_place: dict[str, Path] = {}
    for path in found:
        by_place.setdefault(os.path.realpath(path), path)
    return list(by_place.values())


def evaluate_files(
    references: Sequence[Path],
    performance: Path,
    *,
    options: ReadOptions,
    furi_file: Path | None = None,
    progress: ProgressCallback | None = None,
    **judging: Any,
) -> Evaluation[Assessment]:
    """Read the takes of the reference and the performance, and assess.

    Parameters
    ----------
    references : files, see `find_references`.
    performance : file.
    options : how they are read.
    furi_file : cuts of the figures, in frames of the first reference; by default they are found.
    progress : called with (steps done, steps, what is being done).
    judging : ``side``, ``tempo`` and ``weights`` of `dousa.evaluation.assess`.

    Raises
    ------
    DousaError : a file, furi file or motion that cannot be used; the message says which.
    """
    takes, notes = _read_takes((*references, performance), options, progress)
    from dousa.evaluation import assess, read_furi

    furi = None if furi_file is None else read_furi(furi_file, takes[0].frame_rate, takes[0].n_frames)
    names = [path.name for path in (*references, performance)]
    with _compare(references, performance, takes, progress):
        assessment = assess(takes[:-1], takes[-1], furi=furi, names=names, **judging)
    return Evaluation(assessment, tuple(references), performance, notes, takes[-1])


def evaluate_repetitions(
    references: Sequence[Path],
    performance: Path,
    *,
    options: ReadOptions,
    progress: ProgressCallback | None = None,
    **judging: Any,
) -> Evaluation[RepetitionsAssessment]:
    """Read the files, split the performance into repetitions, and assess each by `dousa.evaluation.assess_repetitions`.

    Parameters and errors are those of `evaluate_files`.
    """
    takes, notes = _read_takes((*references, performance), options, progress)
    from dousa.evaluation import assess_repetitions

    with _compare(references, performance, takes, progress):
        assessment = assess_repetitions(takes[:-1], takes[-1], **judging)
    return Evaluation(assessment, tuple(references), performance, notes, takes[-1])


def _read_takes(
    paths: Sequence[Path], options: ReadOptions, progress: ProgressCallback | None
) -> tuple[list[CanonicalMotion], tuple[tuple[Path, Message], ...]]:
    """Read the files; also (file, warning) of each."""
    takes: list[CanonicalMotion] = []
    notes: list[tuple[Path, Message]] = []
    for number, path in enumerate(paths):
        if progress is not None:
            progress(number, len(paths) + 1, Message("progress.reading"))
        if path.is_dir():
            raise OptionError("evaluate.performance_is_folder", path=path)
        motion, _ = read_canonical(os.fspath(path), options, whole=False)
        takes.append(motion)
        notes.extend((path, warning) for warning in motion.warnings)
    return takes, tuple(notes)


@contextmanager
def _compare(
    references: Sequence[Path],
    performance: Path,
    takes: Sequence[CanonicalMotion],
    progress: ProgressCallback | None,
) -> Iterator[None]:
    if progress is not None:
        progress(len(takes), len(takes) + 1, Message("progress.comparing"))
    try:
        yield
    except InvalidMotionError as error:
        where = (*references, performance)[find_blamed(error, takes[:-1])]
        raise InvalidMotionError("cli.file_problem", path=where, reason=error.located) from error


def find_blamed(error: InvalidMotionError, references: Sequence[CanonicalMotion]) -> int:
    """The place of the motion that an error is about: the shortest of the references, or -1, the performance."""
    from dousa.evaluation import ABOUT_REFERENCES

    if error.code not in (*ABOUT_REFERENCES, "exercises.still_reference"):
        return -1
    return min(range(len(references)), key=lambda number: references[number].duration)


def check_folder(folder: Path) -> None:
    """Check that a folder can be made or written, before the long work.

    Raises
    ------
    OptionError : it cannot.
    """
    place = Path(os.path.abspath(folder))
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise OptionError("evaluate.folder_below_file", folder=folder, place=place)
    if not os.access(place, os.W_OK | os.X_OK):
        raise OptionError("evaluate.folder_not_writable", folder=folder, place=place)


_BEAT_TABLES = (".txt", ".csv", ".tsv")


def load_beats(path: Path | None) -> Beats | None:
    """The beats of a sound file, or of a text file of their times; None if there is neither."""
    from dousa.evaluation import find_beats, read_beats

    if path is None:
        return None
    return read_beats(path) if path.suffix.lower() in _BEAT_TABLES else find_beats(path)


def time_accents(done: Evaluation[Assessment], beats: Beats, start_s: float | None) -> BeatTiming:
    """Compare the accents of a performance with the beats.

    Raises
    ------
    DousaError : as `dousa.evaluation.assess_timing`, with the name of the file.
    """
    from dousa.evaluation import assess_timing

    try:
        return assess_timing(done.motion, beats, music_start_s=start_s)
    except InvalidMotionError as error:
        raise InvalidMotionError("cli.file_problem", path=done.performance, reason=error.located) from error


def compare_answers(paths: Sequence[Path]) -> tuple[Progress, bool]:
    """Compare evaluations.

    Parameters
    ----------
    paths : files that ``dousa evaluate --json`` wrote, the oldest first.

    Returns
    -------
    progress : the comparison.
    same_reference : whether all have the same reference.

    Raises
    ------
    OptionError : a file that cannot be read or is something else; fewer than two files.
    """
    from dousa.evaluation import compare_attempts, read_attempt

    answers = [_read(path) for path in paths]
    attempts = [
        read_attempt(answer, _name(answer, path)) if isinstance(answer, Mapping) else read_attempt({}, str(path))
        for path, answer in zip(paths, answers, strict=True)
    ]
    models = {json.dumps(answer.get("references")) for answer in answers}
    return compare_attempts(attempts), len(models) == 1


def _read(path: Path) -> Any:
    try:
        if path.stat().st_size > 100_000_000:
            raise OptionError("progress.too_large", path=path)
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise OptionError("progress.unreadable", path=path, reason=error) from error


def _name(answer: Mapping[str, Any], path: Path) -> str:
    """Of the performance; of the file where that is not known."""
    performance = answer.get("performance")
    return Path(performance).name if isinstance(performance, str) else path.name
