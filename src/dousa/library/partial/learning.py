"""What a forest for a part of bodies learns from the clips of a library.

As that of whole bodies it is trained with the clips of the library's training, and grows by those that were added
later: the same clips give the same forest, whenever it is first asked for and however many came at a time. Features of
such parts are not kept: what growing reads of clips that it knows is described anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.library import schema
from dousa.library.engine import choose_jobs
from dousa.library.features import ClipFeatures, Description, describe_stored, lacks
from dousa.library.forests import (
    StoredForest,
    describe_copies,
    find_leaves,
    fit_forest,
    hold_back,
    learn_unknown,
    make_keys,
)
from dousa.messages import Message
from dousa.retrieval.forest.calibration import Assessor

if TYPE_CHECKING:
    from dousa.arrays import FloatArray
    from dousa.library.search import PartProgress
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
