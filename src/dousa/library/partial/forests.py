"""Forests for parts of bodies: learned from the clips of the library, described as if all lacked the same joints.

Such a forest is learned when a body without these joints is first asked about, or with the training where clips of the
library lack them. It is kept in the library with what it says of the clips, and learned anew when they, their
categories or the parameters change.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryDamagedError, LibraryError
from dousa.library import schema
from dousa.library.engine import Database, choose_jobs
from dousa.library.features import ClipFeatures, Description, describe_stored, find_feature_set, lacks
from dousa.library.forests import (
    StoredForest,
    TreeAnswers,
    count_votes,
    describe_copies,
    find_leaves,
    fit_forest,
    hold_back,
    learn_unknown,
)
from dousa.library.schema import pack, stack
from dousa.library.seals.checksums import PART_FORESTS, seal_rows
from dousa.library.search import PartProgress
from dousa.messages import Message
from dousa.retrieval.features.partial_bodies import is_comparable, name_parts

if TYPE_CHECKING:
    from dousa.arrays import FloatArray
    from dousa.retrieval.features.feature_sets import FeatureSet
    from dousa.retrieval.forest.calibration import Copies

_STEPS = 4

_LEARNED_BY = "copies"  # what is learned otherwise than by an earlier dousa is learned anew


@dataclass(frozen=True, slots=True, eq=False)
class PartIndex:
    """A forest for a part of the body, and what it says of the clips that have this part.

    Parameters
    ----------
    stored : the forest.
    learned_from : stands for what it has learned.
    ids, paths : of N clips, in the order of their paths.
    labels : category of each; the forest's, where nobody gave it one.
    answers : what the trees say of the clips.
    poses : (N, cells, columns) their pose sequences.
    """

    stored: StoredForest
    learned_from: str
    ids: tuple[int, ...]
    paths: tuple[str, ...]
    labels: tuple[str, ...]
    answers: TreeAnswers
    poses: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class _Answers:
    """What a forest says of clips: leaves (n_trees,) and poses of each, by number."""

    leaves: dict[int, NDArray[np.int32]]
    poses: dict[int, NDArray[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class _Material:
    """The clips that have a part, by number, and what stands for what a forest learns from them."""

    rows: list[Any]
    learned_from: str

    @property
    def ids(self) -> list[int]:
        return [row.id for row in self.rows]


class PartForests:
    """The forests for parts of bodies, in memory and in the library."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._kept: dict[str, PartIndex] = {}

    def choose(
        self, main: StoredForest, absent: Collection[str], progress: PartProgress | None = None
    ) -> tuple[StoredForest | None, Message | None]:
        """The forest that is asked about a body, and a note of what it leaves out; or None, and why there is none.

        Parameters
        ----------
        main : the forest of the library; it is asked, and nothing noted, about a body that lacks nothing of it.
        absent : canonical joints that the body lacks.
        progress : as in ``load``.
        """
        whole = find_feature_set(main.feature_set)
        kind = whole.without(absent)
        if kind is whole:
            return main, None
        if not is_comparable(kind.hidden):
            return None, Message("partial.incomparable", parts=name_parts(kind.hidden))
        part = self.load(main, kind.hidden, progress=progress)
        if part is None:
            return None, Message("partial.no_clips", parts=name_parts(kind.hidden))
        code = "partial.query_and_library" if main.hidden else "partial.query"
        return part.stored, Message(code, parts=name_parts(kind.hidden))

    def prepare(self, main: StoredForest, n_jobs: int | None = None, progress: PartProgress | None = None) -> None:
        """Learn the forest by which most of the clips that lack joints are compared with whole ones.

        One only, as it takes a quarter of the time of a training.

        Parameters
        ----------
        main : the forest of the library.
        n_jobs, progress : as in ``load``.
        """
        clips, whole = schema.clips.c, find_feature_set(main.feature_set)
        counted = sa.select(clips.absent, sa.func.count().label("n")).where(clips.kind == schema.CLIP)
        with self._database.reading() as connection:
            rows = connection.execute(counted.where(clips.absent != "").group_by(clips.absent)).all()
        counts: Counter[tuple[str, ...]] = Counter()
        for row in rows:
            kind = whole.without(row.absent.split())
            if kind is not whole and is_comparable(kind.hidden):
                counts[kind.hidden] += row.n
        if counts:
            most = min(counts, key=lambda hidden: (-counts[hidden], hidden))
            self.load(main, most, n_jobs, progress)

    def load(
        self,
        main: StoredForest,
        hidden: Sequence[str],
        n_jobs: int | None = None,
        progress: PartProgress | None = None,
    ) -> PartIndex | None:
        """The forest for bodies without some joints; None where fewer than two categories could teach it.

        Parameters
        ----------
        main : the forest of the library: its features and parameters are taken.
        hidden : canonical joints that are not looked at.
        n_jobs : clips described at a time.
        progress : called while it is learned.

        Raises
        ------
        LibraryDamagedError : what is stored of it, or of the clips, is damaged.
        """
        kind = find_feature_set(find_feature_set(main.feature_set).base).without(hidden)
        with self._database.reading() as connection:
            material = _read_material(connection, main, kind)
            if len({row.category for row in material.rows if row.category is not None}) < 2:
                return None
            known = self._kept.get(kind.name)
            if known is not None and (known.learned_from, known.ids) == (
                material.learned_from,
                tuple(row.id for row in _by_path(material.rows)),
            ):
                return known
            stored, answers = self._read(connection, main, kind, material)
            missing = [clip_id for clip_id in material.ids if clip_id not in answers.leaves]
            described = _describe(connection, missing, kind, n_jobs, progress)
            if stored is None:
                clips = _gather_taught(material, described)
                copies = describe_copies(connection, clips, range(len(clips.ids)), kind, n_jobs)
                stored = _train(main, kind, clips, copies, n_jobs, progress)
        if missing:
            features = _stack([described[clip_id] for clip_id in missing])
            answers.leaves.update(zip(missing, find_leaves(stored, features), strict=True))
            answers.poses.update((clip_id, described[clip_id].poses) for clip_id in missing)
            self._keep(stored, material, answers)
        if progress is not None:
            progress(_STEPS, _STEPS, Message("library_training.done"))
        self._kept[kind.name] = _index(stored, material, answers)
        return self._kept[kind.name]

    def _read(
        self, connection: sa.Connection, main: StoredForest, kind: FeatureSet, material: _Material
    ) -> tuple[StoredForest | None, _Answers]:
        """The forest and its answers as the library keeps them, if it has learned from the clips as they are."""
        from dousa.retrieval import MotionForest
        from dousa.retrieval.features.pose_sequences import POSE_CELLS, POSE_COLUMNS
        from dousa.retrieval.forest.calibration import Assessor, Calibration

        table = schema.part_forests.c
        query = sa.select(schema.part_forests).where(table.feature_set == kind.name)
        row = connection.execute(query.where(table.learned_from == material.learned_from)).one_or_none()
        if row is None:
            return None, _Answers({}, {})
        PART_FORESTS.check(connection, row)
        try:
            forest = MotionForest.from_bytes(row.forest)
            calibration = None if row.calibration is None else Calibration.from_bytes(row.calibration)
        except DousaError as error:
            where = self._database.where
            raise LibraryDamagedError("library_forest.part_damaged", library=where, problem=error) from error
        categories = tuple(str(name) for name in forest.classes_)
        assessor = None if calibration is None else Assessor(forest, calibration)
        stored = replace(main, forest=forest, categories=categories, feature_set=kind.name, assessor=assessor)
        n_clips = len(row.clip_ids) // 4
        ids = stack([row.clip_ids], "<i4", (n_clips,), "part")[0].tolist()
        leaves = stack([row.leaves], "<i4", (n_clips, len(forest.trees_.roots)), "leaves")[0]
        poses = stack([row.poses], "<f4", (n_clips, POSE_CELLS, POSE_COLUMNS), "poses")[0]
        return stored, _Answers(dict(zip(ids, leaves, strict=True)), dict(zip(ids, poses, strict=True)))

    def read_labeller(self, part: StoredForest) -> bytes | None:
        """What takes are labelled with by a forest that was loaded last, where the library has it."""
        table, known = schema.part_forests.c, self._kept[part.feature_set]
        query = sa.select(table.labeller).where(table.feature_set == part.feature_set)
        with self._database.reading() as connection:
            data = connection.execute(query.where(table.learned_from == known.learned_from)).scalar_one_or_none()
        return None if known.stored is not part or data is None else bytes(data)

    def keep_labeller(self, part: StoredForest, labeller: bytes) -> None:
        """Write what takes are labelled with, unless the library has another forest by now or cannot be written."""
        table, known = schema.part_forests, self._kept[part.feature_set]
        if known.stored is not part:
            return
        try:
            with self._database.writing() as connection:
                here = sa.update(table).where(table.c.feature_set == part.feature_set)
                here = here.where(table.c.learned_from == known.learned_from)
                connection.execute(here.values(labeller=labeller))
        except LibraryDamagedError:
            raise
        except LibraryError:
            return

    def _keep(self, stored: StoredForest, material: _Material, answers: _Answers) -> None:
        """Write a forest and its answers, unless the library cannot be written."""
        table, ids = schema.part_forests, material.ids
        row: dict[str, Any] = {
            "feature_set": stored.feature_set,
            "learned_from": material.learned_from,
            "forest": stored.forest.to_bytes(),
            "calibration": None if stored.assessor is None else stored.assessor.calibration.to_bytes(),
            "clip_ids": pack(ids, "<i4"),
            "leaves": pack(np.stack([answers.leaves[clip_id] for clip_id in ids]), "<i4"),
            "poses": pack(np.stack([answers.poses[clip_id] for clip_id in ids]), "<f4"),
        }
        try:
            with self._database.writing() as connection:
                same = table.c.feature_set == stored.feature_set, table.c.learned_from == material.learned_from
                row["labeller"] = connection.execute(sa.select(table.c.labeller).where(*same)).scalar_one_or_none()
                connection.execute(sa.delete(table).where(table.c.feature_set == stored.feature_set))
                connection.execute(sa.insert(table), seal_rows(table, [row]))
        except LibraryDamagedError:
            raise
        except LibraryError:
            return  # the next program learns it again


def _read_material(connection: sa.Connection, main: StoredForest, kind: FeatureSet) -> _Material:
    clips = schema.clips.c
    query = sa.select(clips.id, clips.path, clips.category, clips.performer, clips.height, clips.absent)
    rows = connection.execute(query.where(clips.kind == schema.CLIP).order_by(clips.id))
    there = [row for row in rows if not lacks(kind.name, row.absent)]
    parameters = {name: value for name, value in main.forest.get_params().items() if name != "n_jobs"}
    taught = [(row.id, row.category, row.performer) for row in there if row.category is not None]
    digest = hashlib.sha256(json.dumps([kind.name, parameters, taught, _LEARNED_BY]).encode())
    return _Material(there, digest.hexdigest())


def _by_path(rows: Sequence[Any]) -> list[Any]:
    return sorted(rows, key=lambda row: str(row.path))


def _describe(
    connection: sa.Connection,
    ids: Sequence[int],
    kind: FeatureSet,
    n_jobs: int | None,
    progress: PartProgress | None,
) -> dict[int, Description]:
    def tell(done: int, total: int) -> None:
        if progress is not None:
            progress(0, _STEPS, Message("library_training.describing_clips_done", done=done, total=total))

    return describe_stored(connection, ids, kind.name, n_jobs, tell)


def _stack(described: Sequence[Description]) -> FloatArray:
    """Features as those of a training: float32, of which precision they are, so that the same loops are compiled."""
    return np.stack([own.features.astype(np.float32) for own in described])


def _gather_taught(material: _Material, described: dict[int, Description]) -> ClipFeatures:
    """The clips that have a category."""
    rows = [row for row in material.rows if row.category is not None]
    return ClipFeatures(
        ids=[row.id for row in rows],
        features=_stack([described[row.id] for row in rows]),
        categories=[row.category for row in rows],
        performers=[row.performer for row in rows],
        heights=[row.height for row in rows],
        computed={},
    )


def _train(
    main: StoredForest,
    kind: FeatureSet,
    clips: ClipFeatures,
    copies: Copies,
    n_jobs: int | None,
    progress: PartProgress | None,
) -> StoredForest:
    """A forest with the parameters of the library's, over clips that have a category, and their disturbed copies."""
    from dousa.retrieval import MotionForest

    report = progress or (lambda done, total, what: None)
    forest = MotionForest().set_params(**{**main.forest.get_params(), "n_jobs": choose_jobs(n_jobs)})
    labelled = range(len(clips.ids))
    report(1, _STEPS, Message("library_training.growing_trees"))
    fit_forest(forest, clips, labelled, kind, copies)
    report(2, _STEPS, Message("library_training.calibrating"))
    assessor = learn_unknown(forest, hold_back(clips, labelled), kind, copies)
    report(3, _STEPS, Message("library_training.writing"))
    categories = tuple(str(name) for name in forest.classes_)
    return replace(main, forest=forest, categories=categories, feature_set=kind.name, assessor=assessor)


def _index(stored: StoredForest, material: _Material, answers: _Answers) -> PartIndex:
    rows = _by_path(material.rows)
    said = count_votes(stored, np.stack([answers.leaves[row.id] for row in rows]))
    guesses = said.predicted()
    return PartIndex(
        stored=stored,
        learned_from=material.learned_from,
        ids=tuple(row.id for row in rows),
        paths=tuple(row.path for row in rows),
        labels=tuple(b if row.category is None else row.category for row, b in zip(rows, guesses, strict=True)),
        answers=said,
        poses=np.stack([answers.poses[row.id] for row in rows]),
    )
