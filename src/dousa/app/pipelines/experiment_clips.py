"""From folders of motion files to the labelled clips of an experiment."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.retrieval.features.posed_motion import LabelledClip


def read_labelled_clips(
    paths: Sequence[str | os.PathLike[str]],
    *,
    category_from: str,
    performer_from: str | None,
    options: ReadOptions,
    n_jobs: int | None = None,
    progress: ProgressCallback | None = None,
) -> tuple[list[LabelledClip], list[Skipped]]:
    """Read all motion files below some paths, with their category and performer.

    Parameters
    ----------
    paths : files and folders.
    category_from, performer_from : rules as in `dousa.library.labels`.
    options : what is said about the files.
    n_jobs : files at a time; None for every core.
    progress : called with (done, total, file).

    Returns
    -------
    clips : those that could be read and have a category.
    skipped : the other files, and why.

    Raises
    ------
    OptionError : a rule that cannot be understood.
    TrainingError : no clip could be read.
    """
    import joblib

    rules = parse_label_rule(category_from, "category"), parse_label_rule(performer_from, "performer")
    files, skipped = find_motion_files(paths)
    labels = [tuple(rule(file.root, file.path) for rule in rules) for file in files]
    parallel = joblib.Parallel(n_jobs=choose_jobs(n_jobs), prefer="threads", return_as="generator")
    clips: list[LabelledClip] = []
    answers = parallel(
        joblib.delayed(_read_clip)(file, category, performer, options)
        for file, (category, performer) in zip(files, labels, strict=True)
    )
    for done, answer in enumerate(answers, 1):
        (skipped if isinstance(answer, Skipped) else clips).append(answer)
        if progress is not None:
            progress(done, len(files), Message("progress.reading"))
    if not clips:
        if not skipped:
            raise TrainingError("experiments_cli.nothing_found", paths=paths)
        raise TrainingError(
            "experiments_cli.nothing_readable",
            paths=paths,
            n=len(skipped),
            first=skipped[0].path,
            reason=skipped[0].reason,
        )
    return clips, skipped


def refuse_clips_in_both(clips: Sequence[LabelledClip], tested: Sequence[LabelledClip]) -> None:
    """OptionError where a file trains and tests: a system that knows the answer by heart is not tested."""
    both = sorted({os.path.realpath(clip.name) for clip in clips} & {os.path.realpath(c.name) for c in tested})
    if both:
        raise OptionError("experiments_cli.train_and_test", n=len(both), total=len(tested), first=both[0])


def _read_clip(
    file: FoundFile, category: str | None, performer: str | None, options: ReadOptions
) -> LabelledClip | Skipped:
    from dousa.retrieval.features.posed_motion import LabelledClip

    path = str(file.path)
    if category is None:
        return Skipped(path, Message("motion_files.no_category"))
    try:
        motion, _ = read_canonical(path, options)
    except DousaError as error:
        return Skipped(path, describe_problem(path, error))
    return LabelledClip(path, category, performer, motion.positions, motion.frame_rate, motion.height)
