"""What takes are labelled with: learned from the clips when a take is first labelled, and kept with the forest."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError, LibraryError
from dousa.library import schema
from dousa.library._describing import find_feature_set, load_motions
from dousa.library._engine import reading, writing
from dousa.library._features import load_features
from dousa.library._forests import StoredForest
from dousa.library._jobs import choose_jobs

if TYPE_CHECKING:
    from dousa.retrieval import LabelledClip
    from dousa.retrieval.labelling import TakeLabeller

__all__ = ["LabellerShelf", "LearnProgress"]

LearnProgress = Callable[[int, int, str], None]
"""Called with (steps done, steps, what comes now)."""

_MOST_CLIPS = 1500  # that a labeller learns from: it learns how actions follow one another, not what they are


class LabellerShelf:
    """The labeller of a library; learned where there is none for the present forest.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    """

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self._engine = engine
        self._where = where
        self._learned: int | None = None
        self._labeller: TakeLabeller | None = None

    def get(self, stored: StoredForest, n_jobs: int | None, progress: LearnProgress | None) -> TakeLabeller:
        """The labeller of a forest.

        Where the library can be written the labeller is kept in it; else the next program learns it again.

        Raises
        ------
        LibraryError : all the clips that taught the forest are gone.
        """
        if self._labeller is None or self._learned != stored.learned:
            labeller = self._read(stored)
            if labeller is None:
                labeller = self._learn(stored, n_jobs, progress)
                self._keep(stored, labeller)
            self._labeller, self._learned = labeller, stored.learned
        return self._labeller

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
