"""From folders of motion files to the labelled clips, or the takes, of an experiment."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from dousa.errors import DousaError, OptionError, TrainingError
from dousa.formats.motion_files import (
    FoundFile,
    ReadOptions,
    Skipped,
    describe_problem,
    find_motion_files,
    read_canonical,
)
from dousa.library import choose_jobs, parse_label_rule
from dousa.messages import Message
from dousa.workers.current import current_cluster
from dousa.workers.threads import yield_answers

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.motion import CanonicalMotion
    from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip

_Read = TypeVar("_Read")

FileNote = Callable[[str, Message], None]
"""Called with a file and what came up when it was read."""


def read_labelled_clips(
    paths: Sequence[str | os.PathLike[str]],
    *,
    category_from: str,
    performer_from: str | None,
    options: ReadOptions,
    n_jobs: int | None = None,
    progress: ProgressCallback | None = None,
    note: FileNote | None = None,
) -> tuple[list[LabelledClip], list[Skipped]]:
    """Read all motion files below some paths, with their category and performer.

    Parameters
    ----------
    paths : files and folders.
    category_from, performer_from : rules as in `dousa.library.label_rules`.
    options : how the files are read.
    n_jobs : files at a time; None for every core.
    progress : called with (done, total, file).
    note : called with doubts about the files that are used.

    Returns
    -------
    clips : those that could be read and have a category.
    skipped : the other files, and why.

    Raises
    ------
    OptionError : a rule that cannot be understood.
    TrainingError : no clip could be read.
    """
    rules = parse_label_rule(category_from, "category"), parse_label_rule(performer_from, "performer")
    files, skipped = find_motion_files(paths)
    tasks = [(file, options, *(rule(file.root, file.path) for rule in rules)) for file in files]
    clips: list[LabelledClip] = []
    for answer in read_each(_read_clip, tasks, n_jobs, progress):
        if isinstance(answer, Skipped):
            skipped.append(answer)
        else:
            clip, doubts = answer
            clips.append(clip)
            _note(note, clip.name, doubts)
    _check_any(clips, skipped, paths)
    return clips, skipped


def _check_any(found: Sequence[object], skipped: Sequence[Skipped], paths: Sequence[str | os.PathLike[str]]) -> None:
    if not found and not skipped:
        raise TrainingError("experiments_cli.nothing_found", paths=paths)
    if not found:
        raise TrainingError("experiments_cli.nothing_readable", paths=paths, **show_first(skipped))


def read_annotated_takes(
    paths: Sequence[str | os.PathLike[str]],
    labels_from: str,
    tier: str | None = None,
    *,
    performer_from: str | None,
    options: ReadOptions,
    n_jobs: int | None = None,
    progress: ProgressCallback | None = None,
    note: FileNote | None = None,
) -> tuple[list[AnnotatedTake], list[Skipped]]:
    """Read all takes below some paths that have labels, in the order of the files, and as `read_labelled_clips`.

    Parameters
    ----------
    labels_from, tier : where their labels are, as in `dousa.library.annotations.matching`.
    note : called with doubts about the files that are used, and about their labels.

    Raises
    ------
    OptionError : a rule that cannot be understood.
    MotionFileError : labels that cannot be read, or do not fit their take.
    TrainingError : no take could be read.
    """
    from dousa.formats.annotations.label_file import to_annotation
    from dousa.library.annotations.matching import TakeLength, check_fit, find_labels, fit
    from dousa.motion.annotation import lay_out
    from dousa.retrieval.features.posed_motion import AnnotatedTake

    performer_of = parse_label_rule(performer_from, "performer")
    files, skipped = find_motion_files(paths)
    labels = find_labels(files, labels_from, tier)
    skipped += [
        Skipped(str(file.path), Message("annotations.no_table")) for file in files if str(file.path) not in labels
    ]
    files = [file for file in files if str(file.path) in labels]
    takes = []
    answers = read_each(read_file, [(file, options) for file in files], n_jobs, progress)
    for file, motion in zip(files, answers, strict=True):
        if isinstance(motion, Skipped):
            skipped.append(motion)
            continue
        table = labels[str(file.path)]
        annotation, doubts = to_annotation(table.file, table.tiers, tier, motion.frame_rate)
        if annotation.is_blank:
            skipped.append(Skipped(str(file.path), Message("annotations.blank", table=annotation.source)))
            continue
        length = TakeLength(str(file.path), motion.duration, motion.frame_rate, motion.n_frames)
        check_fit(length, annotation)
        _note(note, str(file.path), [*motion.warnings, *table.notes, *doubts, *fit(length, annotation.segments)[1]])
        stretches = lay_out(annotation.segments, annotation.unclear, motion.duration)
        performer = performer_of(file.root, file.path)
        known = str(file.path), performer, motion.positions, motion.frame_rate, motion.height
        takes.append(AnnotatedTake(*known, stretches))
    _check_any(takes, skipped, paths)
    return takes, skipped


def refuse_clips_in_both(clips: Sequence[LabelledClip], tested: Sequence[LabelledClip]) -> None:
    """Raise an OptionError where a file is both for training and for testing."""
    both = sorted({os.path.realpath(clip.name) for clip in clips} & {os.path.realpath(c.name) for c in tested})
    if both:
        raise OptionError("experiments_cli.train_and_test", n=len(both), total=len(tested), first=both[0])


def read_each(
    read: Callable[..., _Read | Skipped],
    tasks: Sequence[tuple[Any, ...]],
    n_jobs: int | None,
    progress: ProgressCallback | None,
) -> Iterator[_Read | Skipped]:
    """Read files in parallel, and yield the answers in their order."""

    def work(task: tuple[Any, ...]) -> _Read | Skipped:
        return read(*task)

    cluster = current_cluster()
    if cluster is not None:
        cluster.check_paths([task[0].path for task in tasks])
        sizes = [os.path.getsize(task[0].path) if os.path.isfile(task[0].path) else 0 for task in tasks]
        answers = cluster.map(work, tasks, sizes=sizes)
    else:
        answers = yield_answers(work, tasks, choose_jobs(n_jobs))
    for done, answer in enumerate(answers, 1):
        if progress is not None:
            progress(done, len(tasks), Message("progress.reading"))
        yield answer


def _read_clip(
    file: FoundFile, options: ReadOptions, category: str | None, performer: str | None
) -> tuple[LabelledClip, tuple[Message, ...]] | Skipped:
    from dousa.retrieval.features.posed_motion import LabelledClip

    if category is None:
        return Skipped(str(file.path), Message("motion_files.no_category"))
    motion = read_file(file, options)
    if isinstance(motion, Skipped):
        return motion
    clip = LabelledClip(str(file.path), category, performer, motion.positions, motion.frame_rate, motion.height)
    return clip, motion.warnings


def read_file(file: FoundFile, options: ReadOptions) -> CanonicalMotion | Skipped:
    path = str(file.path)
    try:
        return read_canonical(path, options)[0]
    except DousaError as error:
        return Skipped(path, describe_problem(path, error))


def _note(note: FileNote | None, path: str, doubts: Iterable[Message]) -> None:
    if note is not None:
        for doubt in doubts:
            note(path, doubt)


def show_first(skipped: Sequence[Skipped]) -> dict[str, Any]:
    """Values of a message that says how many files were skipped, and why the first was."""
    return {"n": len(skipped), "first": skipped[0].path, "reason": skipped[0].reason}
