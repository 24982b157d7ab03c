"""Forests for parts of bodies: learned from the clips of the library, described as if all lacked the same joints.

Such a forest is learned when a body without these joints is first asked about, or with the training where clips of the
library lack them (``learning``). It is kept in the library with what it says of the clips, grows by clips that are
added, and is learned anew when others, their categories or the parameters change.

What a forest for a part of bodies learns from the clips of a library.
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

from dousa.errors import DousaError, LibraryDamagedError, LibraryError
from dousa.library.search.search import PartProgress
from dousa.library.store import schema
from dousa.library.store.checksums import PART_FORESTS, seal_rows
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import ClipFeatures, Description, describe_stored, find_feature_set, lacks
from dousa.library.store.forests import (
    StoredForest,
    TreeAnswers,
    count_votes,
    describe_copies,
    find_leaves,
    fit_forest,
    hold_back,
    learn_unknown,
    make_keys,
)
from dousa.library.store.schema import pack, stack
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import is_comparable, name_parts
from dousa.retrieval.forest.calibration import Assessor

if TYPE_CHECKING:
    from dousa.arrays import FloatArray
    from dousa.retrieval.features.feature_sets import FeatureSet

STEPS = 4
"""Of learning such a forest, as progress is told."""

_LEARNED_BY = "copies"  # what is learned otherwise than by an earlier dousa is learned anew


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """What a forest says of clips: leaves (n_trees,) and poses of each, by number."""

    leaves: dict[int, NDArray[np.int32]]
    poses: dict[int, NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Material:
    """The clips that have a part.

    Parameters
    ----------
    rows : of the table of clips, by number.
    first_later : number from which on clips came after the training of the library.
    taught_by : of the forest, what decides what is learned from clips: name of the features, parameters.
    """

    rows: list[Any]
    first_later: int
    taught_by: tuple[Any, ...]

    @property
    def ids(self) -> list[int]:
        """Numbers of the clips."""
        return [row.id for row in self.rows]

    @cached_property
    def by_path(self) -> list[Any]:
        """The clips in the order of their paths."""
        return sorted(self.rows, key=lambda row: str(row.path))

    @cached_property
    def taught(self) -> list[Any]:
        """The clips that have a category."""
        return [row for row in self.rows if row.category is not None]

    @cached_property
    def first(self) -> list[Any]:
        """Those of them with which a forest is trained: of the library's training, if these have two categories."""
        there = [row for row in self.taught if row.id < self.first_later]
        return there if count_categories(there) > 1 else self.taught

    @cached_property
    def learned_from(self) -> str:
        """Stands for what a forest learns from them."""
        return self.stand_for(self.ids)

    def stand_for(self, ids: Collection[int]) -> str:
        """Stands for what a forest learns from some of them."""
        among = set(ids)
        taught = [(row.id, row.category, row.performer) for row in self.taught if row.id in among]
        parts: list[Any] = [*self.taught_by, taught, _LEARNED_BY]
        n_first = sum(row.id in among for row in self.first)
        if n_first < len(taught):
            parts.append(n_first)
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def count_categories(rows: Sequence[Any]) -> int:
    """Different categories of clips."""
    return len({row.category for row in rows if row.category is not None})


def read_material(connection: sa.Connection, main: StoredForest, kind: FeatureSet) -> Material:
    """The clips that have what some features look at."""
    clips = schema.clips.c
    columns = clips.id, clips.path, clips.category, clips.performer, clips.height, clips.absent, clips.content_hash
    rows = connection.execute(sa.select(*columns).where(clips.kind == schema.CLIP).order_by(clips.id))
    there = [row for row in rows if not lacks(kind.name, row.absent)]
    parameters = {name: value for name, value in main.forest.get_params().items() if name != "n_jobs"}
    return Material(there, main.first_later, (kind.name, parameters))


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Learning a forest for a part of bodies.

    Parameters
    ----------
    connection : to the library.
    main : the forest of the library: its parameters are taken.
    kind : features that look at the part.
    material : the clips.
    n_jobs, progress : as in ``PartForests.load``.
    """

    connection: sa.Connection
    main: StoredForest
    kind: FeatureSet
    material: Material
    n_jobs: int | None = None
    progress: PartProgress | None = None
    _described: dict[int, Description] = field(default_factory=dict)

    def learn(self, stored: StoredForest | None, answers: Answers) -> tuple[StoredForest, bool]:
        """The forest as it has learned from all clips, and what it says of them.

        Parameters
        ----------
        stored : a forest that knows some of the clips; None before there is one.
        answers : what it says of these, to which that of the others is added.

        Returns
        -------
        The forest, and whether it or its answers have changed.
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
        self._tell(STEPS, Message("library_training.done"))
        return stored, True

    def _tell(self, done: int, message: Message) -> None:
        if self.progress is not None:
            self.progress(done, STEPS, message)

    def _describe(self, ids: Sequence[int]) -> None:
        def tell(done: int, total: int) -> None:
            self._tell(0, Message("library_training.describing_clips_done", done=done, total=total))

        self._described.update(describe_stored(self.connection, ids, self.kind.name, self.n_jobs, tell))

    def _read(self, ids: Sequence[int]) -> FloatArray:
        """Features as those of a training: float32, of which precision they are: the same loops are compiled."""
        lacking = sorted({number for number in ids if number not in self._described})
        if lacking:
            self._described.update(describe_stored(self.connection, lacking, self.kind.name, self.n_jobs))
        return np.stack([self._described[number].features.astype(np.float32) for number in ids])

    def _ask(self, stored: StoredForest, answers: Answers, ids: Sequence[int]) -> None:
        """Add what a forest says of clips, whose poses are kept where they are known."""
        if not ids:
            return
        answers.leaves.update(zip(ids, find_leaves(stored, self._read(ids)), strict=True))
        lacking = [number for number in ids if number not in answers.poses]
        answers.poses.update((number, self._described[number].poses) for number in lacking)

    def _train(self) -> StoredForest:
        """A forest with the parameters of the library's, over clips of its training, and their disturbed copies."""
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
        """The forest as it has learned from clips that were added; answers of those that it moves are changed."""
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
        assessor = stored.assessor
        if assessor is not None:
            assessor = Assessor(growth.forest, assessor.calibration.with_clips(features, labels))
        categories = tuple(str(name) for name in growth.forest.classes_)
        grown = replace(stored, forest=growth.forest, categories=categories, assessor=assessor)
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
            material = read_material(connection, main, kind)
            if count_categories(material.rows) < 2:
                return None
            known = self._kept.get(kind.name)
            if known is not None and (known.learned_from, known.ids) == (
                material.learned_from,
                tuple(row.id for row in material.by_path),
            ):
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
        """The forest and its answers as the library keeps them, if all that it has learned from is as it was."""
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
            raise LibraryDamagedError("library_forest.part_damaged", library=where, problem=error) from error
        categories = tuple(str(name) for name in forest.classes_)
        assessor = None if calibration is None else Assessor(forest, calibration)
        stored = replace(main, forest=forest, categories=categories, feature_set=kind.name, assessor=assessor)
        leaves = stack([row.leaves], "<i4", (n_clips, len(forest.trees_.roots)), "leaves")[0]
        poses = stack([row.poses], "<f4", (n_clips, POSE_CELLS, POSE_COLUMNS), "poses")[0]
        return stored, Answers(dict(zip(ids, leaves, strict=True)), dict(zip(ids, poses, strict=True)))

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


def _index(stored: StoredForest, material: Material, answers: Answers) -> PartIndex:
    rows = material.by_path
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
