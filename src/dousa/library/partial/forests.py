"""Forests for parts of bodies: learned from the clips of the library, described as if all lacked the same joints.

Such a forest is learned when a body without these joints is first asked about, or with the training where clips of the
library lack them (``learning``). It is kept in the library with what it says of the clips, grows by clips that are
added, and is learned anew when others, their categories or the parameters change.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryDamagedError, LibraryError
from dousa.library import schema
from dousa.library.engine import Database
from dousa.library.features import find_feature_set
from dousa.library.forests import StoredForest, TreeAnswers, count_votes
from dousa.library.partial.learning import Answers, Lesson, Material, count_categories, read_material
from dousa.library.schema import pack, stack
from dousa.library.seals.checksums import PART_FORESTS, seal_rows
from dousa.library.search import PartProgress
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import is_comparable, name_parts

if TYPE_CHECKING:
    from dousa.retrieval.features.feature_sets import FeatureSet


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
