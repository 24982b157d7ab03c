"""Training: one forest over all labelled clips, leaves for every clip, and windows for every take."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import TrainingError
from dousa.kernels import load_compiler
from dousa.library.learning.lesson import choose_trained, save_examples
from dousa.library.results import TrainReport
from dousa.library.search.renewal import make_side_file
from dousa.library.search.text_store import find_meanings, keep_all_relations, keep_relations_of
from dousa.library.store import schema
from dousa.library.store.engine import Database, next_clip_id, next_revision, note_changed_clips, read_revision
from dousa.library.store.features import ClipFeatures, keep_features, lacks, load_features, save_descriptions
from dousa.library.store.forests import (
    MOST_COPIES,
    StoredForest,
    TreeAnswers,
    ask_trees,
    describe_copies,
    fit_forest,
    fit_grid,
    hold_back,
    keep_unlearned,
    learn_unknown,
    replace_forest,
    save_answers,
)
from dousa.library.takes.windows import describe_takes, make_window_files, refresh_windows, save_windows
from dousa.messages import Message, Progress
from dousa.retrieval import MotionForest
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.posed_motion import is_comparable
from dousa.retrieval.forest.calibration import Calibration, guess_performers
from dousa.retrieval.forest.likeness import LikenessLearner
from dousa.retrieval.takes.label import TakeLabeller
from dousa.workers.threads import limit_blas

LearnLabeller = Callable[[sa.Connection, StoredForest, int | None], TakeLabeller | None]
"""Called with a connection, the forest, and the number of threads."""


class _Tell:
    """Reports the six steps of a training."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress or (lambda done, total, what: None)

    def __call__(self, done: int, message: Message) -> None:
        self._progress(done, 6, message)

    def of_clips(self, done: int, total: int) -> None:
        """Report described clips."""
        self(0, Message("library_training.describing_clips_done", done=done, total=total))

    def of_takes(self, done: int, total: int) -> None:
        """Report described takes."""
        self(4, Message("library_training.describing_takes_done", done=done, total=total))

    def of_files(self, done: int, total: int, what: Message) -> None:
        """Report takes in files."""
        self(5, Message("library_training.keeping_takes_done", done=done, total=total))


@limit_blas()
def train_forest(
    database: Database,
    forest: MotionForest,
    kind: FeatureSet,
    learn_labeller: LearnLabeller,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> tuple[StoredForest, TrainReport]:
    """Fit a forest to the clips of a library and store it with its answers, in one transaction.

    Windows of very many takes are written afterwards, take by take. TrainingError for fewer than two categories.

    Parameters
    ----------
    forest : unfitted forest.
    kind : features of the forest, computed where they are not stored.
    learn_labeller : learns the labeller of takes.
    n_jobs : clips and takes described at a time.
    progress : called with (steps done, steps, message about the next step).
    """
    start = time.perf_counter()
    load_compiler()
    tell = _Tell(progress)
    tell(0, Message("library_training.describing_clips"))
    database.check_writable()  # before the work
    with database.reading() as connection:
        kind, n_partial = _choose_joints(database.where, connection, kind)  # before the work
    keep_features(database, kind.name, n_jobs, tell.of_clips, partial(keep_relations_of, database, n_jobs=n_jobs))
    stored, answers, counts = _learn(database, forest, kind, n_jobs, tell)
    tell(3, Message("library_training.labeller"))
    with database.reading() as connection:
        labeller = learn_labeller(connection, stored, n_jobs)
    tell(4, Message("library_training.describing_takes"))
    with database.reading() as connection:
        windows = describe_takes(connection, stored, n_jobs=n_jobs, progress=tell.of_takes)
    tell(5, Message("library_training.writing"))
    keep_all_relations(database)
    stored = _store(database, stored, replace(answers, windows=windows), labeller)
    del windows
    refresh_windows(database, stored, n_jobs, tell.of_takes)
    make_side_file(database, stored)
    make_window_files(database, stored, n_jobs, tell.of_files)
    tell(6, Message("library_training.done"))
    n_clips, n_labelled = len(answers.clips.ids), sum(counts.values())
    calibration = None if stored.assessor is None else stored.assessor.calibration
    done = TrainReport(
        feature_set=kind.name,
        n_trees=int(forest.get_params()["n_trees"]),
        n_clips=n_labelled,
        n_unlabelled=n_clips - n_labelled,
        categories=counts,
        calibration=calibration,
        single=tuple(name for name, count in counts.items() if count == 1),
        n_partial=n_partial,
        hidden=kind.hidden,
        doubt=_doubt_categories(answers.clips, counts, calibration),
        seconds=time.perf_counter() - start,
    )
    return stored, done


def _doubt_categories(clips: ClipFeatures, counts: dict[str, int], calibration: Calibration | None) -> Message | None:
    """Return why categories, with their numbers of clips, may be recording sessions or people rather than actions."""
    people = zip(clips.categories, clips.performers, guess_performers(clips.heights), strict=True)
    done_by = {(category, performer or guess) for category, performer, guess in people if category is not None}
    several = len({person for _, person in done_by}) > 1 and min(counts.values()) > 1
    some = [*counts][:3]
    if not any(map(str.isalpha, "".join(counts))):
        return Message("library_training.only_numbers", categories=some)
    if several and len(done_by) == len(counts):
        return Message("library_training.one_person_each", categories=some)
    if calibration is not None and max(counts.values()) > 1 and calibration.false_alarms > 0.5:
        return Message("library_training.not_recognised", categories=some)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Answers:
    """Tree answers about all clips at a revision, and windows of takes; without features, to save memory."""

    revision: int
    clips: ClipFeatures
    answers: TreeAnswers
    windows: dict[int, bytes]


def _learn(
    database: Database, forest: MotionForest, kind: FeatureSet, n_jobs: int | None, tell: _Tell
) -> tuple[StoredForest, _Answers, dict[str, int]]:
    """Grow and calibrate the trees; return them, their answers, and the number of clips in each category."""
    with database.reading() as connection:
        seen, following = read_revision(connection), next_clip_id(connection)
        clips = load_features(connection, kind.name, n_jobs=n_jobs, progress=tell.of_clips, spare=MOST_COPIES)
        grid = fit_grid(connection)
        labelled, counts = _check_categories(database.where, clips.categories)
        disturbed = describe_copies(connection, clips, labelled, kind, n_jobs)
    tell(1, Message("library_training.growing_trees"))
    fit_forest(forest, clips, labelled, kind, disturbed)
    tell(2, Message("library_training.calibrating"))
    held = hold_back(clips, labelled)
    means = find_meanings(set(held.categories.tolist()))  # categories of one meaning count as the same
    meanings = np.array([means[label] for label in held.categories.tolist()], dtype=np.str_)
    people = np.array(held.performers, dtype=np.str_)
    learner = LikenessLearner(held.features, held.categories, meanings, people, kind)
    assessor = learn_unknown(forest, held, kind, disturbed, learner.watch)
    likeness = None if assessor is None else learner.finish()
    names = tuple(str(name) for name in forest.classes_)
    stored = StoredForest(forest, names, kind.name, grid, assessor, 0, 0, likeness, following)
    known = replace(clips, features=np.empty((0, *clips.features.shape[1:]), np.float32), room=None)
    return stored, _Answers(seen, known, ask_trees(stored, clips.features), {}), counts


def _store(database: Database, stored: StoredForest, answers: _Answers, labeller: TakeLabeller | None) -> StoredForest:
    """Write the forest, its answers about clips and takes, and the labeller of takes."""
    seen = answers.revision
    n_clips = sum(category is not None for category in answers.clips.categories)

    def ask(connection: sa.Connection, known: _Answers | None) -> _Answers:
        now = read_revision(connection)
        if known is None and now == seen:
            return answers
        if known is not None and known.revision == now:
            return known
        # Another program added or removed clips while the trees grew.
        there = load_features(connection, stored.feature_set)
        described = describe_takes(connection, stored, known=(known or answers).windows)
        return _Answers(now, there, ask_trees(stored, there.features), described)

    def write(connection: sa.Connection, known: _Answers) -> StoredForest:
        revision = next_revision(connection)
        own = replace(stored, revision=revision, learned=revision)
        if known.revision != seen:
            next_revision(connection)
            note_changed_clips(connection)  # the forest has not learned from their changes, so it is not current
        replace_forest(connection, own, n_clips, None if labeller is None else labeller.to_bytes())
        save_descriptions(connection, list(known.clips.computed), list(known.clips.computed.values()))
        connection.execute(sa.delete(schema.clip_leaves))
        save_answers(connection, known.clips.ids, known.answers)
        save_examples(connection, own.revision, _choose_examples(own, known))
        later = zip(known.clips.ids, known.clips.categories, strict=True)
        keep_unlearned(connection, [n for n, category in later if n >= own.first_later and category is not None])
        connection.execute(sa.delete(schema.take_windows))
        save_windows(connection, own, known.windows)
        return own

    return database.write_planned(ask, write)


def _choose_examples(stored: StoredForest, known: _Answers) -> NDArray[np.int32] | None:
    """Choose example clips for each leaf of a large forest."""
    numbers = {name: number for number, name in enumerate(stored.categories)}
    own = np.array([-1 if name is None else numbers.get(name, -1) for name in known.clips.categories], np.int32)
    return choose_trained(stored, np.array(known.clips.ids, np.int64), own, known.answers)


def _choose_joints(
    where: str, connection: sa.Connection, kind: FeatureSet, *, enough: float = 1 / 3
) -> tuple[FeatureSet, int]:
    """Choose the features of a forest, and count the clips that lack joints of these.

    They are those of whole bodies if the share ``enough`` of the labelled clips is whole and has two categories, else
    those of the most frequent set of joints.
    """
    table = schema.clips.c
    rows = connection.execute(sa.select(table.category, table.absent).where(table.kind == schema.CLIP)).all()
    parts = {row.absent: kind.without(row.absent.split()) if row.absent else kind for row in rows}
    labelled = [row for row in rows if row.category is not None]
    counts = Counter(parts[row.absent].name for row in labelled)
    if counts[kind.name] >= enough * len(labelled):
        counts[kind.name] = len(labelled) + 1
    by_name = {part.name: part for part in parts.values() if is_comparable(part.hidden)}
    chosen = kind
    for name, _ in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        taught = {row.category for row in labelled if not lacks(name, row.absent)}
        if name in by_name and len(taught) > 1:
            chosen = by_name[name]
            break
    own = [row.category for row in rows if not lacks(chosen.name, row.absent)]
    _check_categories(where, own)
    return chosen, len(rows) - len(own)


def _check_categories(where: str, categories: Sequence[str | None]) -> tuple[list[int], dict[str, int]]:
    labelled = [index for index, category in enumerate(categories) if category is not None]
    counts = dict(sorted(Counter(name for name in categories if name is not None).items()))
    if len(counts) < 2:
        n_clips = len(categories)
        if not counts:
            raise TrainingError("library_training.no_category", library=where, n_clips=n_clips)
        only = next(iter(counts))
        raise TrainingError("library_training.one_category", library=where, n_clips=n_clips, category=only)
    return labelled, counts
