"""Training: one forest over all labelled clips, leaves for every clip, and windows for every take.

Clips that are added later teach it too: `learn_clips`, by way of `insert_clips`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import TrainingError
from dousa.library import schema
from dousa.library.engine import Database, next_revision, note_changed_clips, read_revision, take_clip_ids
from dousa.library.features import (
    ClipFeatures,
    Description,
    describe_clip,
    find_feature_set,
    lacks,
    load_features,
    pack_positions,
    save_descriptions,
)
from dousa.library.forests import (
    StoredForest,
    ask_trees,
    choose_held_back,
    count_votes,
    find_leaves,
    fit_grid,
    learn_unknown,
    replace_forest,
    save_answers,
    update_forest,
)
from dousa.library.ingest import ClipRecord
from dousa.library.results import TrainReport
from dousa.library.schema import pack, stack
from dousa.library.seals.checksums import LABELS, LEAVES, seal_positions, seal_rows, update_rows
from dousa.library.takes import describe_takes, describe_windows, save_windows
from dousa.library.text.meanings import find_meanings
from dousa.library.text.store import keep_all_relations, keep_relations
from dousa.messages import Message
from dousa.retrieval import MotionForest
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.partial_bodies import is_comparable
from dousa.retrieval.forest.calibration import Assessor
from dousa.retrieval.forest.likeness import LikenessLearner
from dousa.retrieval.takes.label import TakeLabeller

if TYPE_CHECKING:
    from dousa.retrieval.forest.growth import Growth

TrainProgress = Callable[[int, int, Message], None]

_STEPS = 6
_ENOUGH_WHOLE = 1 / 3  # of the clips: then the forest is one of whole bodies

LearnLabeller = Callable[[sa.Connection, StoredForest, int | None], TakeLabeller | None]
"""Called with a connection, the forest, and the number of threads."""


def train_forest(
    database: Database,
    forest: MotionForest,
    kind: FeatureSet,
    learn_labeller: LearnLabeller,
    n_jobs: int | None = None,
    progress: TrainProgress | None = None,
) -> tuple[StoredForest, TrainReport]:
    """Fit a forest to the clips of a library and store it with all that it says, in one transaction.

    Parameters
    ----------
    forest : not yet fitted.
    kind : features that it asks for; those that are not stored are computed.
    learn_labeller : learns what takes are labelled with.
    n_jobs : clips and takes described at a time.
    progress : called with (steps done, steps, message about the next step).

    Raises
    ------
    TrainingError : fewer than two categories.
    """
    start = time.perf_counter()
    report = progress or (lambda done, total, what: None)
    report(0, _STEPS, Message("library_training.describing_clips"))

    def tell_clips(done: int, total: int) -> None:
        report(0, _STEPS, Message("library_training.describing_clips_done", done=done, total=total))

    def tell_takes(done: int, total: int) -> None:
        report(4, _STEPS, Message("library_training.describing_takes_done", done=done, total=total))

    with database.reading() as connection:
        seen = read_revision(connection)
        kind, n_partial = _choose_joints(database.where, connection, kind)  # before the work
        clips = load_features(connection, kind.name, n_jobs=n_jobs, progress=tell_clips)
        grid = fit_grid(connection)
    labelled, counts = _check_categories(database.where, clips.categories)
    report(1, _STEPS, Message("library_training.growing_trees"))
    categories = np.array([clips.categories[row] for row in labelled], dtype=np.str_)
    forest.fit(clips.features[labelled], categories, feature_set=kind)
    report(2, _STEPS, Message("library_training.calibrating"))
    learner = make_likeness_learner(clips, labelled, kind)
    assessor = learn_unknown(forest, clips, labelled, kind, learner.watch)
    likeness = None if assessor is None else learner.finish()
    names = tuple(str(name) for name in forest.classes_)
    stored = StoredForest(forest, names, kind.name, grid, assessor, 0, 0, likeness)
    report(3, _STEPS, Message("library_training.labeller"))
    with database.reading() as connection:
        labeller = learn_labeller(connection, stored, n_jobs)
    report(4, _STEPS, Message("library_training.describing_takes"))
    with database.reading() as connection:
        windows = describe_takes(connection, stored, n_jobs=n_jobs, progress=tell_takes)
    report(5, _STEPS, Message("library_training.writing"))
    keep_all_relations(database)
    stored = _store(database, stored, seen, clips, windows, labeller)
    report(_STEPS, _STEPS, Message("library_training.done"))
    done = TrainReport(
        feature_set=kind.name,
        n_trees=int(forest.get_params()["n_trees"]),
        n_clips=len(labelled),
        n_unlabelled=len(clips.categories) - len(labelled),
        categories=counts,
        calibration=None if assessor is None else assessor.calibration,
        single=tuple(name for name, count in counts.items() if count == 1),
        n_partial=n_partial,
        hidden=kind.hidden,
        seconds=time.perf_counter() - start,
    )
    return stored, done


def make_likeness_learner(clips: ClipFeatures, labelled: Sequence[int], kind: FeatureSet) -> LikenessLearner:
    """What learns, while the calibration holds its rounds, which clips are alike; categories of one meaning are."""
    rows, people = choose_held_back(clips, labelled)
    labels = np.array([clips.categories[row] for row in rows], dtype=np.str_)
    means = find_meanings(set(labels.tolist()))
    meanings = np.array([means[label] for label in labels.tolist()], dtype=np.str_)
    return LikenessLearner(clips.features[rows], labels, meanings, np.array(people, dtype=np.str_), kind)


def _store(
    database: Database,
    stored: StoredForest,
    seen: int,
    clips: ClipFeatures,
    windows: dict[int, bytes],
    labeller: TakeLabeller | None,
) -> StoredForest:
    """Write the forest, what it says of clips and takes, and what takes are labelled with."""
    n_clips = sum(category is not None for category in clips.categories)
    answers = ask_trees(stored, clips.features)
    with database.writing() as connection:
        revision = next_revision(connection)
        stored = stored.with_revision(revision)
        if revision != seen + 1:
            # Another program added or removed clips while the trees grew.
            clips = load_features(connection, stored.feature_set)
            windows = describe_takes(connection, stored, known=windows)
            answers = ask_trees(stored, clips.features)
            next_revision(connection)
            note_changed_clips(connection)  # the forest has not learned from what they did: it is not current
        replace_forest(connection, stored, n_clips, None if labeller is None else labeller.to_bytes())
        save_descriptions(connection, list(clips.computed), list(clips.computed.values()))
        connection.execute(sa.delete(schema.clip_leaves))
        save_answers(connection, clips.ids, answers)
        connection.execute(sa.delete(schema.take_windows))
        save_windows(connection, stored, windows)
    return stored


def _choose_joints(where: str, connection: sa.Connection, kind: FeatureSet) -> tuple[FeatureSet, int]:
    """The features that the forest of a library asks for, without joints that most of its clips lack.

    Those of whole bodies, if whole ones are a third of the clips that have a category, and of two categories; else
    those of the parts that are the most. Returned with the number of clips that have fewer joints.
    """
    table = schema.clips.c
    rows = connection.execute(sa.select(table.category, table.absent).where(table.kind == schema.CLIP)).all()
    parts = {row.absent: kind.without(row.absent.split()) if row.absent else kind for row in rows}
    labelled = [row for row in rows if row.category is not None]
    counts = Counter(parts[row.absent].name for row in labelled)
    if counts[kind.name] >= _ENOUGH_WHOLE * len(labelled):
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


@dataclass(frozen=True, slots=True)
class Learned:
    """What a forest learned from clips that were added.

    Parameters
    ----------
    n_clips : clips that have a category.
    new_categories : those that the forest did not know.
    """

    n_clips: int = 0
    new_categories: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Standing:
    """Clips that stand in the leaves: numbers (N,), categories, predicted categories, leaves (N, n_trees)."""

    ids: list[int]
    categories: list[str | None]
    predicted: list[str]
    leaves: NDArray[np.int32]


def learn_clips(
    connection: sa.Connection,
    stored: StoredForest,
    features: FloatArray,
    categories: Sequence[str | None],
    revision: int,
) -> tuple[StoredForest, Learned]:
    """Teach a forest new clips, whose leaves are not written yet, and write it and the answers that change.

    Parameters
    ----------
    features : (M, frames, columns) of the new clips.
    categories : (M,) theirs; a clip without one teaches nothing.
    revision : of the library in this transaction.

    Returns
    -------
    The forest that has learned, and what; the same forest where there was nothing to learn.
    """
    labelled = [row for row, category in enumerate(categories) if category is not None]
    if not labelled:
        return stored, Learned()
    labels = np.array([categories[row] for row in labelled], dtype=np.str_)
    standing = _read_standing(connection, stored)
    known = set(stored.categories)
    # Clips that were given a category later that the forest does not know stand in no leaf of theirs.
    taught = np.array([row for row, name in enumerate(standing.categories) if name in known], dtype=np.int64)
    growth = _grow(connection, stored, standing, taught, features[labelled], labels)
    assessor = stored.assessor
    if assessor is not None:
        assessor = Assessor(growth.forest, assessor.calibration.with_clips(features[labelled], labels))
    grown = replace(
        stored,
        forest=growth.forest,
        categories=tuple(str(name) for name in growth.forest.classes_),
        assessor=assessor,
        learned=revision,
    )
    update_forest(connection, grown, len(labelled))
    leaves = standing.leaves.copy()
    leaves[taught[growth.moved]] = growth.moved_leaves
    others = np.setdiff1d(np.arange(len(standing.ids)), taught)
    if len(others):
        ids = [standing.ids[row] for row in others]
        leaves[others] = find_leaves(grown, load_features(connection, stored.feature_set, ids).features)
    _update_answers(connection, grown, standing, leaves)
    return grown, Learned(len(labelled), tuple(sorted(set(labels.tolist()) - known)))


def _grow(
    connection: sa.Connection,
    stored: StoredForest,
    standing: _Standing,
    taught: NDArray[np.int64],
    features: FloatArray,
    labels: NDArray[np.str_],
) -> Growth:
    """The forest with new clips, beside those of the standing ones that it knows."""
    from dousa.retrieval.forest.growth import StandingClips, grow_forest

    def read_features(places: NDArray[np.int64]) -> FloatArray:
        ids = [standing.ids[row] for row in taught[places]]
        return load_features(connection, stored.feature_set, ids).features

    categories = np.array([standing.categories[row] for row in taught], dtype=np.str_)
    clips = StandingClips(categories, standing.leaves[taught], read_features)
    kind = find_feature_set(stored.feature_set)
    return grow_forest(stored.forest, clips, features, labels, feature_set=kind)


def _read_standing(connection: sa.Connection, stored: StoredForest) -> _Standing:
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(*LABELS.columns, *LEAVES.columns)
    query = query.join(schema.clip_leaves, table.clip_id == clips.id).order_by(clips.id)
    rows = connection.execute(query).all()
    for row in rows:
        LABELS.check(connection, row)
        LEAVES.check(connection, row)
    leaves = stack([row.leaves for row in rows], "<i4", (len(stored.forest.trees_.roots),), "leaves")
    count_votes(stored, leaves)  # there are such leaves
    predicted = [row.predicted_category for row in rows]
    return _Standing([row.id for row in rows], [row.category for row in rows], predicted, leaves)


def _update_answers(
    connection: sa.Connection, stored: StoredForest, standing: _Standing, leaves: NDArray[np.int32]
) -> None:
    """Write the leaves and the guesses that have changed."""
    predicted = count_votes(stored, leaves).predicted()
    moved = (leaves != standing.leaves).any(axis=1)
    changes = {
        number: {"predicted_category": now, "leaves": pack(leaves[row], "<i4")}
        for row, (number, now, before) in enumerate(zip(standing.ids, predicted, standing.predicted, strict=True))
        if moved[row] or now != before
    }
    update_rows(connection, LEAVES, changes)


def insert_clips(
    connection: sa.Connection,
    fresh: Sequence[ClipRecord],
    stored: StoredForest | None,
    takes: Mapping[tuple[str, int], bytes],
    revision: int,
) -> tuple[StoredForest | None, Learned]:
    """Write new clips, takes and segments, with the labels in their rows, and everything that belongs to them.

    Parameters
    ----------
    takes : windows by path and ``learned`` of the forest that described them; others are described here.

    Returns
    -------
    The forest, after it learned from the clips that have a category; and what it learned.
    """
    numbered = dict(zip(take_clip_ids(connection, len(fresh)), fresh, strict=True))
    now = datetime.now(UTC).isoformat(timespec="seconds")
    rows = [{**record.row, "id": number, "added_at": now} for number, record in numbered.items()]
    connection.execute(sa.insert(schema.clips), seal_rows(schema.clips, rows))
    positions = []
    for number, record in numbered.items():
        if record.place is None:
            data = pack_positions(record.motion)
            positions.append({"clip_id": number, "positions": data, "block_checksums": seal_positions(number, data)})
    if positions:
        connection.execute(sa.insert(schema.clip_trajectories), positions)
    places = [{"clip_id": number, **record.place} for number, record in numbered.items() if record.place is not None]
    if places:
        connection.execute(sa.insert(schema.segments), seal_rows(schema.segments, places))
    keep_relations(connection)
    clips = {number: record for number, record in numbered.items() if record.row["kind"] == schema.CLIP}
    if clips:
        note_changed_clips(connection)
    if stored is None:
        return None, Learned()
    learned = Learned()
    # Bodies that lack joints that it asks about are told apart by forests of their own, when they are needed.
    whole = {n: record for n, record in numbered.items() if not lacks(stored.feature_set, record.row["absent"])}
    answered = {number: record for number, record in clips.items() if number in whole}
    if answered:
        stored, learned = _insert_answers(connection, answered, stored, revision)
    recordings = {number: record for number, record in whole.items() if number not in clips}
    windows = {
        number: takes.get((record.path, stored.learned)) or describe_windows(stored, record.motion).to_bytes()
        for number, record in recordings.items()
    }
    save_windows(connection, stored, windows)
    return stored, learned


def _insert_answers(
    connection: sa.Connection, clips: Mapping[int, ClipRecord], stored: StoredForest, revision: int
) -> tuple[StoredForest, Learned]:
    """What the trees say of new clips, after they learned from those that have a category."""
    numbers = list(clips)
    described = [_describe(stored, record) for record in clips.values()]
    save_descriptions(connection, numbers, described)
    features = np.stack([description.features for description in described])
    labels = [record.row["category"] for record in clips.values()]
    stored, learned = learn_clips(connection, stored, features, labels, revision)
    save_answers(connection, numbers, ask_trees(stored, features))
    return stored, learned


def _describe(stored: StoredForest, record: ClipRecord) -> Description:
    """Features and poses of a clip; computed here only if the forest changed while the file was read."""
    known = record.description
    if known is not None and known.feature_set == stored.feature_set:
        return known
    return describe_clip(record.motion, stored.feature_set)
