"""Forests for bodies that lack joints, learned from the clips of a library as if all lacked the same ones.

A forest is learned when it is first needed, or with the training. The library keeps it with its answers about the
clips. It grows by added clips, and is learned again when other clips, their categories or the parameters change.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryDamagedError
from dousa.library.search.leaf_index import IndexedRows, LeafIndex, make_index
from dousa.library.search.parts import guess_categories, make_part
from dousa.library.store import schema
from dousa.library.store.checksums import PART_FORESTS
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import ClipFeatures, Description, describe_stored, find_feature_set, lacks
from dousa.library.store.forests import (
    StoredForest,
    describe_copies,
    find_leaves,
    fit_forest,
    hold_back,
    learn_unknown,
    make_keys,
)
from dousa.library.store.rows import delete_rows, insert_rows
from dousa.library.store.schema import pack, stack
from dousa.messages import Message, Progress
from dousa.retrieval.features.posed_motion import is_comparable, name_parts

if TYPE_CHECKING:
    from dousa.arrays import FloatArray
    from dousa.retrieval.features.feature_sets import FeatureSet

_LEARNED_BY = "copies"  # the way of learning: a forest learned in another way is learned again


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """Leaves (n_trees,) and poses of clips, by clip number."""

    leaves: dict[int, NDArray[np.int32]]
    poses: dict[int, NDArray[np.float32]]


@dataclass(frozen=True)
class Material:
    """The clips from which a forest for a part of the body learns.

    Parameters
    ----------
    rows : rows of the table of clips, by number.
    first_later : number of the first clip that was added after the training.
    taught_by : name of the features and parameters of the forest.
    """

    rows: list[Any]
    first_later: int
    taught_by: tuple[Any, ...]

    @property
    def ids(self) -> list[int]:
        """The numbers of the clips."""
        return [row.id for row in self.rows]

    @cached_property
    def taught(self) -> list[Any]:
        """The clips that have a category."""
        return [row for row in self.rows if row.category is not None]

    @cached_property
    def first(self) -> list[Any]:
        """The clips to train with: those of the library's training if they have two categories, else all."""
        there = [row for row in self.taught if row.id < self.first_later]
        return there if count_categories(there) > 1 else self.taught

    @cached_property
    def learned_from(self) -> str:
        """The hash of all that a forest learns from."""
        return self.stand_for(self.ids)

    def stand_for(self, ids: Collection[int]) -> str:
        """Hash what a forest learns from some of the clips."""
        among = set(ids)
        taught = [(row.id, row.category, row.performer) for row in self.taught if row.id in among]
        parts: list[Any] = [*self.taught_by, taught, _LEARNED_BY]
        n_first = sum(row.id in among for row in self.first)
        if n_first < len(taught):
            parts.append(n_first)
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def count_categories(rows: Sequence[Any]) -> int:
    """Count the different categories of clips."""
    return len({row.category for row in rows if row.category is not None})


def read_material(connection: sa.Connection, main: StoredForest, kind: FeatureSet) -> Material:
    """Read the clips that have all joints of a feature set."""
    clips = schema.clips.c
    columns = clips.id, clips.path, clips.category, clips.performer, clips.height, clips.absent, clips.content_hash
    rows = connection.execute(sa.select(*columns).where(clips.kind == schema.CLIP).order_by(clips.id))
    there = [row for row in rows if not lacks(kind.name, row.absent)]
    parameters = {name: value for name, value in main.forest.get_params().items() if name != "n_jobs"}
    return Material(there, main.first_later, (kind.name, parameters))


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Learns a forest for a part of the body, with the parameters of the library's forest ``main``."""

    connection: sa.Connection
    main: StoredForest
    kind: FeatureSet
    material: Material
    n_jobs: int | None = None
    progress: Progress | None = None
    _described: dict[int, Description] = field(default_factory=dict)

    def learn(self, stored: StoredForest | None, answers: Answers) -> tuple[StoredForest, bool]:
        """Learn from all clips; return the forest, and whether it or its answers have changed.

        ``stored`` : a forest that has learned from some of the clips; None for a new one.
        ``answers`` : its answers about these; those about the other clips are added.
        """
        missing = [number for number in self.material.ids if number not in answers.leaves]
        if not missing and stored is not None:
            return stored, False
        self._describe(missing)
        if stored is None:
            stored = self._train()
            self._ask(stored, answers, [row.id for row in self.material.first])
        new = [row for row in self.material.taught if row.id not in answers.leaves]
        if new:
            stored = self._grow(stored, answers, new)
        self._ask(stored, answers, [number for number in missing if number not in answers.leaves])
        self._tell(4, Message("library_training.done"))
        return stored, True

    def _tell(self, done: int, message: Message) -> None:
        if self.progress is not None:
            self.progress(done, 4, message)  # the steps of ``learn``

    def _describe(self, ids: Sequence[int]) -> None:
        def tell(done: int, total: int) -> None:
            self._tell(0, Message("library_training.describing_clips_done", done=done, total=total))

        self._described.update(describe_stored(self.connection, ids, self.kind.name, self.n_jobs, tell))

    def _read(self, ids: Sequence[int]) -> FloatArray:
        """Read features as float32, as a training does, so that the same compiled loops are used."""
        lacking = sorted({number for number in ids if number not in self._described})
        if lacking:
            self._described.update(describe_stored(self.connection, lacking, self.kind.name, self.n_jobs))
        return np.stack([self._described[number].features.astype(np.float32) for number in ids])

    def _ask(self, stored: StoredForest, answers: Answers, ids: Sequence[int]) -> None:
        """Add the leaves of clips, and the poses that are missing."""
        if not ids:
            return
        answers.leaves.update(zip(ids, find_leaves(stored, self._read(ids)), strict=True))
        lacking = [number for number in ids if number not in answers.poses]
        answers.poses.update((number, self._described[number].poses) for number in lacking)

    def _train(self) -> StoredForest:
        """Train a forest with the first clips and their disturbed copies."""
        from dousa.retrieval import MotionForest

        rows = self.material.first
        clips = ClipFeatures(
            ids=[row.id for row in rows],
            features=self._read([row.id for row in rows]),
            categories=[row.category for row in rows],
            performers=[row.performer for row in rows],
            heights=[row.height for row in rows],
            computed={},
        )
        labelled = range(len(rows))
        copies = describe_copies(self.connection, clips, labelled, self.kind, self.n_jobs)
        forest = MotionForest().set_params(**{**self.main.forest.get_params(), "n_jobs": choose_jobs(self.n_jobs)})
        self._tell(1, Message("library_training.growing_trees"))
        fit_forest(forest, clips, labelled, self.kind, copies)
        self._tell(2, Message("library_training.calibrating"))
        assessor = learn_unknown(forest, hold_back(clips, labelled), self.kind, copies)
        self._tell(3, Message("library_training.writing"))
        categories = tuple(str(name) for name in forest.classes_)
        return replace(self.main, forest=forest, categories=categories, feature_set=self.kind.name, assessor=assessor)

    def _grow(self, stored: StoredForest, answers: Answers, new: Sequence[Any]) -> StoredForest:
        """Grow the forest by added clips, and update the answers of clips that move to other leaves."""
        from dousa.retrieval.forest.growth import StandingClips, grow_forest

        self._tell(1, Message("library_training.growing_trees"))
        standing = [row for row in self.material.taught if row.id in answers.leaves]
        ids = np.array([row.id for row in standing])
        trained = {row.id for row in self.material.first}
        there = StandingClips(
            np.array([row.category for row in standing], np.str_),
            np.stack([answers.leaves[number] for number in ids.tolist()]),
            lambda places: self._read(ids[places].tolist()),
            make_keys(row.content_hash for row in standing),
            np.array([number not in trained for number in ids.tolist()]),
        )
        own = [row.id for row in new]
        labels, features = np.array([row.category for row in new], np.str_), self._read(own)
        growth = grow_forest(
            stored.forest,
            there,
            features,
            labels,
            keys=make_keys(row.content_hash for row in new),
            feature_set=self.kind,
        )
        grown = stored.grown(growth.forest, features, labels)
        moved = zip(ids[growth.moved].tolist(), growth.moved_leaves.astype(np.int32), strict=True)
        # Clips without a category stand in leaves that have grown, too.
        others = set(answers.leaves) & {row.id for row in self.material.rows if row.category is None}
        again = [number for number in sorted(others) if growth.changed[answers.leaves[number]].any()]
        answers.leaves.update(moved)
        answers.leaves.update(zip(own, growth.leaves.astype(np.int32), strict=True))
        answers.poses.update((number, self._described[number].poses) for number in own)
        self._ask(grown, answers, again)
        return grown


@dataclass(frozen=True, slots=True, eq=False)
class PartIndex:
    """A forest for a part of the body, and its answers about the N clips that have this part.

    ``material`` : what it has learned from.
    ``poses`` : (N, cells, columns) pose sequences.
    """

    stored: StoredForest
    material: Material
    index: LeafIndex
    poses: NDArray[np.float32]

    def read_poses(self, ids: Sequence[int]) -> NDArray[np.float32]:
        """Return the pose sequences of clips."""
        return self.poses[np.searchsorted(self.material.ids, ids)]


class PartForests:
    """The forests for parts of bodies, in memory and in the library."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._kept: dict[str, PartIndex] = {}

    def choose(
        self, main: StoredForest, absent: Collection[str], progress: Progress | None = None
    ) -> tuple[StoredForest | None, Message | None]:
        """Choose the forest for a body, with a note on the joints that it ignores; or None, with the reason.

        Parameters
        ----------
        main : the forest of the library; returned without a note if the body has all of its joints.
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

    def prepare(self, main: StoredForest, n_jobs: int | None = None, progress: Progress | None = None) -> None:
        """Learn the forest that most clips with absent joints need, in about a quarter of the time of a training."""
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
        self, main: StoredForest, hidden: Sequence[str], n_jobs: int | None = None, progress: Progress | None = None
    ) -> PartIndex | None:
        """Load or learn the forest for bodies without some joints; None if its clips have fewer than two categories.

        LibraryDamagedError if the stored forest or the clips are damaged.

        Parameters
        ----------
        main : the forest of the library, whose features and parameters are used.
        hidden : canonical joints to ignore.
        n_jobs : clips described at a time.
        progress : called while the forest is learned.
        """
        kind = find_feature_set(find_feature_set(main.feature_set).base).without(hidden)
        with self._database.reading() as connection:
            material = read_material(connection, main, kind)
            if count_categories(material.rows) < 2:
                return None
            known = self._kept.get(kind.name)
            if known is not None and known.material == material:
                return known
            stored, answers = self._read(connection, main, kind, material)
            lesson = Lesson(connection, main, kind, material, n_jobs, progress)
            stored, changed = lesson.learn(stored, answers)
        if changed:
            self._keep(stored, material, answers)
        self._kept[kind.name] = _index(stored, material, answers)
        return self._kept[kind.name]

    def _read(
        self, connection: sa.Connection, main: StoredForest, kind: FeatureSet, material: Material
    ) -> tuple[StoredForest | None, Answers]:
        """Read the forest and its answers from the library; None if there is none or its clips have changed."""
        from dousa.retrieval import MotionForest
        from dousa.retrieval.forest.calibration import Assessor, Calibration
        from dousa.retrieval.ranking.ranking import POSE_CELLS, POSE_COLUMNS

        table = schema.part_forests.c
        row = connection.execute(sa.select(schema.part_forests).where(table.feature_set == kind.name)).one_or_none()
        if row is None:
            return None, Answers({}, {})
        PART_FORESTS.check(connection, row)
        n_clips = len(row.clip_ids) // 4
        ids = stack([row.clip_ids], "<i4", (n_clips,), "part")[0].tolist()
        if row.learned_from != material.stand_for(ids):
            return None, Answers({}, {})
        try:
            forest = MotionForest.from_bytes(row.forest)
            calibration = None if row.calibration is None else Calibration.from_bytes(row.calibration)
        except DousaError as error:
            where = self._database.where
            raise LibraryDamagedError("library_forest.damaged", library=where, problem=error) from error
        categories = tuple(str(name) for name in forest.classes_)
        assessor = None if calibration is None else Assessor(forest, calibration)
        stored = replace(main, forest=forest, categories=categories, feature_set=kind.name, assessor=assessor)
        leaves = stack([row.leaves], "<i4", (n_clips, len(forest.trees_.roots)), "leaves")[0]
        poses = stack([row.poses], "<f4", (n_clips, POSE_CELLS, POSE_COLUMNS), "poses")[0]
        return stored, Answers(dict(zip(ids, leaves, strict=True)), dict(zip(ids, poses, strict=True)))

    def find_row(self, part: StoredForest) -> list[sa.ColumnElement[bool]]:
        """Return what the row of a loaded forest fulfils; no row does where another was loaded since."""
        table, known = schema.part_forests.c, self._kept[part.feature_set]
        if known.stored is not part:
            return [sa.false()]
        return [table.feature_set == part.feature_set, table.learned_from == known.material.learned_from]

    def _keep(self, stored: StoredForest, material: Material, answers: Answers) -> None:
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

        def write(connection: sa.Connection) -> None:
            same = table.c.feature_set == stored.feature_set, table.c.learned_from == material.learned_from
            row["labeller"] = connection.execute(sa.select(table.c.labeller).where(*same)).scalar_one_or_none()
            delete_rows(connection, table, [stored.feature_set])
            insert_rows(connection, table, [row])

        self._database.keep(write)


def _index(stored: StoredForest, material: Material, answers: Answers) -> PartIndex:
    rows, names = material.rows, tuple(sorted({row.category for row in material.taught}))
    given = np.array([-1 if row.category is None else names.index(row.category) for row in rows])
    leaves = np.stack([answers.leaves[row.id] for row in rows])
    paths = [str(row.path).encode() for row in rows]
    part = make_part(np.array(material.ids), given, names, paths, leaves, stored.forest.trees_.n_leaves)
    index = make_index(-1, stored, IndexedRows(np.zeros((0, 4), np.int64), {}), (part,))
    index = replace(index, parts=(guess_categories(part, index.votes[0], stored.categories),))
    return PartIndex(stored, material, index, np.stack([answers.poses[row.id] for row in rows]))
