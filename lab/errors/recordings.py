"""Motion files below some paths, as the takes of the experiment."""

from __future__ import annotations

import os
from collections.abc import Sequence

from dousa.app.output import ProgressCallback
from dousa.app.pipelines.experiment_clips import read_each, read_file, show_first
from dousa.errors import OptionError
from dousa.formats.motion_files import FoundFile, ReadOptions, Skipped, find_motion_files
from dousa.library.label_rules import LabelRule
from lab.errors.experiment import NamedMotion


def read_takes(
    paths: Sequence[str | os.PathLike[str]],
    group_of: LabelRule,
    *,
    options: ReadOptions,
    n_jobs: int | None = None,
    progress: ProgressCallback | None = None,
) -> tuple[list[tuple[NamedMotion, str | None]], list[Skipped]]:
    """Read all motion files below some paths for an experiment.

    Parameters
    ----------
    paths : files and folders.
    group_of : tells which files are takes of one thing.
    options : what is said about the files.
    n_jobs : files at a time; None for every core.
    progress : called with (done, total, "reading").

    Returns
    -------
    takes : motions and their groups, in the order of the files.
    skipped : the other files, and why.

    Raises
    ------
    OptionError : no motion could be read.
    """
    files, skipped = find_motion_files(paths)
    takes: list[tuple[NamedMotion, str | None]] = []
    answers = read_each(_read_take, [(file, options) for file in files], n_jobs, progress)
    for file, answer in zip(files, answers, strict=True):
        if isinstance(answer, Skipped):
            skipped.append(answer)
        else:
            takes.append((answer, group_of(file.root, file.path)))
    if not takes and not skipped:
        raise OptionError("evaluate.nothing_found", paths=paths)
    if not takes:
        raise OptionError("evaluate.nothing_readable", paths=paths, **show_first(skipped))
    return takes, skipped


def _read_take(file: FoundFile, options: ReadOptions) -> NamedMotion | Skipped:
    motion = read_file(file, options)
    return motion if isinstance(motion, Skipped) else NamedMotion(str(file.path), motion)
