"""What takes are labelled with: learned from the clips when a take is first labelled, and kept with the forest."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryDamagedError, LibraryError
from dousa.library import schema
from dousa.library._arrays import stack
from dousa.library._describing import find_feature_set, load_motions
from dousa.library._engine import reading, writing
from dousa.library._features import load_features
from dousa.library._forests import StoredForest
from dousa.library._jobs import choose_jobs
from dousa.library._take_windows import describe_windows
from dousa.library.selection import portions

if TYPE_CHECKING:
    from dousa.retrieval import LabelledClip
    from dousa.retrieval.labelling import TakeLabeller
    from dousa.retrieval.takes import TakeWindows

__all__ = ["LabellerShelf", "LearnProgress"]

LearnProgress = Callable[[int, int, str], None]
"""Called with (steps done, steps, what comes now)."""

_MOST_HELD = 400  # clips of other categories of which the same must be said after an example
_MOST_CLIPS = 1500  # that a labeller learns from: it learns how actions follow one another, not what they are


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """A labeller, its forest, how many clips that had learned since its training, and the examples known then."""

    stored: StoredForest
    labeller: TakeLabeller
    n_learned: int
    examples: frozenset[int]


class LabellerShelf:
    """The labeller of a library; learned where there is none for the present forest.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    """

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self._engine = engine
        self._where = where
        self._last: _Kept | None = None
        self._examples: dict[int, TakeWindows] = {}
        self._taught: tuple[tuple[tuple[int, str], ...], TakeLabeller] | None = None

    def get(
        self,
        stored: StoredForest,
        n_jobs: int | None,
        progress: LearnProgress | None,
        examples: Sequence[int] = (),
    ) -> TakeLabeller:
        """The labeller of a forest.

        Where the library can be written the labeller is kept in it; else the next program learns it again.

        Parameters
        ----------
        stored : the forest.
        n_jobs, progress : of the learning.
        examples : numbers of clips that it is taught besides; those that are gone or have no category are left out.

        Raises
        ------
        LibraryError : all the clips that taught the forest are gone.
        """
        base = self._get_base(stored, n_jobs, progress, frozenset(examples))
        if not examples:
            return base
        with reading(self._engine, self._where) as connection:
            labels = _read_labels(connection, examples)
            if self._taught is not None and self._taught[0] == labels:
                return self._taught[1]
            taught = self._teach(connection, stored, base, labels, n_jobs)
        self._taught = (labels, taught)
        return taught

    def _get_base(
        self,
        stored: StoredForest,
        n_jobs: int | None,
        progress: LearnProgress | None,
        examples: frozenset[int],
    ) -> TakeLabeller:
        """The labeller that no example has taught."""
        if self._last is None or self._last.stored.learned != stored.learned:
            with reading(self._engine, self._where) as connection:
                n_learned = int(connection.execute(sa.select(schema.forests.c.n_learned)).scalar_one())
            labeller = self._read(stored)
            if labeller is None:
                labeller = self._carry(stored, n_learned, examples)
            if labeller is None:
                labeller = self._learn(stored, n_jobs, progress)
                self._keep(stored, labeller)
            self._last = _Kept(stored, labeller, n_learned, examples)
            self._examples, self._taught = {}, None
        elif examples - self._last.examples:
            self._last = replace(self._last, examples=self._last.examples | examples)
        return self._last.labeller

    def _carry(self, stored: StoredForest, n_learned: int, examples: frozenset[int]) -> TakeLabeller | None:
        """The last labeller, if all that the forest has learned since are examples: those are taught anyway."""
        from dousa.retrieval.labeller_teaching import carry_labeller

        last = self._last
        if last is None or not 0 < n_learned - last.n_learned <= len(examples - last.examples):
            return None
        return carry_labeller(last.labeller, last.stored.forest.trees_, stored.forest.trees_)

    def _teach(
        self,
        connection: sa.Connection,
        stored: StoredForest,
        base: TakeLabeller,
        labels: tuple[tuple[int, str], ...],
        n_jobs: int | None,
    ) -> TakeLabeller:
        from dousa.retrieval.labeller_teaching import Example, teach_labeller

        new = [number for number, _ in labels if number not in self._examples]
        for number, motion in zip(new, load_motions(connection, new), strict=True):
            self._examples[number] = describe_windows(stored, motion, n_jobs, base.grid)
        held = _read_held(connection, stored, {name for _, name in labels})
        return teach_labeller(base, [Example(self._examples[number], name) for number, name in labels], held)

    def _read(self, stored: StoredForest) -> TakeLabeller | None:
        from dousa.retrieval.labelling import TakeLabeller

        table = schema.forests.c
        query = sa.select(table.labeller).where(table.learned == stored.learned)
        with reading(self._engine, self._where) as connection:
            data = connection.execute(query).scalar_one_or_none()
        if data is None:
            return None
        try:
            return TakeLabeller.from_bytes(data)
        except DousaError as error:
            raise LibraryDamagedError(f"{self._where}: {error}") from error

    def _learn(
        self, stored: StoredForest, n_jobs: int | None, progress: LearnProgress | None
    ) -> TakeLabeller:
        from dousa.retrieval.labeller_training import train_labeller

        def report(done: int, total: int) -> None:
            if progress is not None:
                progress(done, total, "learning to label takes")

        with reading(self._engine, self._where) as connection:
            clips, ids = _read_clips(connection, stored)
            if not clips:
                raise LibraryError(
                    f"{self._where}: the clips that taught the forest are gone; add clips and run: dousa train"
                )
            features = load_features(connection, stored.feature_set, ids, n_jobs).features
        return train_labeller(
            stored.forest,
            find_feature_set(stored.feature_set),
            clips,
            features=features,
            n_jobs=choose_jobs(n_jobs),
            progress=report,
        )

    def _keep(self, stored: StoredForest, labeller: TakeLabeller) -> None:
        """Write the labeller, unless the library has another forest by now or cannot be written."""
        try:
            with writing(self._engine, self._where) as connection:
                table = schema.forests
                here = sa.update(table).where(table.c.learned == stored.learned)
                connection.execute(here.values(labeller=labeller.to_bytes()))
        except LibraryDamagedError:
            raise
        except LibraryError:
            return


def _read_clips(connection: sa.Connection, stored: StoredForest) -> tuple[list[LabelledClip], list[int]]:
    """Clips of the categories that the forest knows, not more than are needed, and their numbers."""
    from dousa.retrieval import LabelledClip

    clips = schema.clips.c
    query = sa.select(clips.id, clips.path, clips.category, clips.performer).where(clips.kind == schema.CLIP)
    rows = [row for row in connection.execute(query) if row.category in set(stored.categories)]
    # Every n-th clip of every category.
    rows.sort(key=lambda row: (row.category, row.id))
    chosen = (
        [rows[place] for place in np.unique(np.linspace(0, len(rows) - 1, _MOST_CLIPS).astype(int))]
        if rows
        else []
    )
    ids = [row.id for row in chosen]
    return [
        LabelledClip(
            row.path, row.category, row.performer, motion.positions, motion.frame_rate, motion.height
        )
        for row, motion in zip(chosen, load_motions(connection, ids), strict=True)
    ], ids


def _read_labels(connection: sa.Connection, numbers: Sequence[int]) -> tuple[tuple[int, str], ...]:
    """Numbers and categories of those clips that are there and have one, by number."""
    clips = schema.clips.c
    found = [
        (int(row.id), str(row.category))
        for some in portions(sorted({number for number in numbers if schema.is_id(number)}))
        for row in connection.execute(
            sa.select(clips.id, clips.category).where(clips.id.in_(some), clips.category.is_not(None))
        )
    ]
    return tuple(sorted(found))


def _read_held(connection: sa.Connection, stored: StoredForest, taught: Collection[str]) -> NDArray[np.int32]:
    """(H, n_trees) leaves of clips of categories that are not taught: every n-th of every category."""
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(clips.id, clips.category).join(schema.clip_leaves, table.clip_id == clips.id)
    rows = [
        row for row in connection.execute(query) if row.category is not None and row.category not in taught
    ]
    rows.sort(key=lambda row: (row.category, row.id))
    step = max(len(rows) / _MOST_HELD, 1.0)
    ids = [int(rows[int(place)].id) for place in np.arange(0, len(rows), step)]
    leaves = [
        row.leaves
        for some in portions(ids)
        for row in connection.execute(sa.select(table.leaves).where(table.clip_id.in_(some)))
    ]
    return stack(leaves, "<i4", (len(stored.forest.trees_.roots),), "leaves")
