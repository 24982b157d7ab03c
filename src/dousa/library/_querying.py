"""Asking the forest of a library: searching and classifying, with the forest and the histograms kept warm."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa

from dousa.errors import DousaError, LibraryError, NotTrainedError
from dousa.library import schema
from dousa.library._engine import reading
from dousa.library._forests import (
    FEATURE_SHAPE,
    StoredForest,
    ask_trees,
    load_features_of,
    load_forest,
    load_outline,
)
from dousa.library._revision import read_revision
from dousa.library.ingest import (
    ClipRecord,
    ReadOptions,
    ReadTask,
    find_motion_files,
    is_unicode,
    look_at,
    read_canonical,
    read_clips,
)
from dousa.library.reports import Classification, SearchResult, Skipped
from dousa.library.search import Asked, SearchIndex, load_index, order_histogram, rank_clips

if TYPE_CHECKING:
    from dousa.motion._types import FloatArray

__all__ = ["Querying"]


class Querying:
    """The side of a library that answers.

    What was read stays in memory until the revision of the library changes.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    """

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self._engine = engine
        self._where = where
        self._index: SearchIndex | None = None
        self.forest: StoredForest | None = None

    def search(self, query: Any, k: int, same_category: bool, options: ReadOptions) -> SearchResult:
        """The clips nearest to a file, a clip or a motion."""
        with reading(self._engine, self._where) as connection:
            index = self._load_index(connection)
            clip_id = self._find_clip(connection, index, query, options)
            if clip_id is None:
                self.forest = self._load_forest(connection)
                features = _compute_features(query, options)
                asked = Asked(_name(query), ask_trees(self.forest, features[None]), features)
            else:
                name = index.paths[index.rows[clip_id]] if isinstance(query, int) else _name(query)
                features = load_features_of(connection, [clip_id])[0]
                asked = Asked(name, index.answers_of(clip_id), features)
            return rank_clips(index, asked, k, same_category, lambda ids: load_features_of(connection, ids))

    def classify(
        self, paths: Sequence[str | os.PathLike[str]], options: ReadOptions, n_jobs: int | None
    ) -> list[Classification]:
        """What the forest takes files for."""
        with reading(self._engine, self._where) as connection:
            self.forest = stored = self._load_forest(connection)
        files, missing = find_motion_files(paths)
        answers = list(read_clips([ReadTask(str(file.path), options) for file in files], n_jobs))
        read = [answer for answer in answers if isinstance(answer, ClipRecord)]
        features = np.stack([record.features for record in read]) if read else np.zeros((0, *FEATURE_SHAPE))
        own = ask_trees(stored, features)
        rows = zip(read, own.predicted(), own.shares(), strict=True)
        good = {
            record.path: Classification(record.path, category, order_histogram(stored.categories, shares))
            for record, category, shares in rows
        }
        bad = [*missing, *(answer for answer in answers if isinstance(answer, Skipped))]
        good.update({item.path: Classification(item.path, None, {}, item.reason) for item in bad})
        return [good[path] for path in (*(item.path for item in missing), *(item.path for item in answers))]

    def _not_trained(self) -> NotTrainedError:
        return NotTrainedError(f"{self._where}: there is no forest yet; run: dousa train {self._where}")

    def _load_forest(self, connection: sa.Connection) -> StoredForest:
        stored = load_forest(connection, self._where, self.forest)
        if stored is None:
            raise self._not_trained()
        return stored

    def _load_index(self, connection: sa.Connection) -> SearchIndex:
        revision = read_revision(connection)
        if self._index is None or self._index.revision != revision:
            outline = load_outline(connection)
            if outline is None:
                raise self._not_trained()
            self._index = load_index(connection, revision, *outline)
        return self._index

    def _find_clip(
        self, connection: sa.Connection, index: SearchIndex, query: Any, options: ReadOptions
    ) -> int | None:
        """The clip that the query is, if its histogram is stored and still true."""
        if isinstance(query, int):
            if query not in index.rows:
                raise LibraryError(f"{self._where}: no clip {query}; see: dousa list")
            return query
        if not isinstance(query, str | os.PathLike):
            return None
        path = os.path.abspath(query)
        if not is_unicode(path):
            return None  # no database can hold it, so it is not there
        table = schema.clips.c
        columns = sa.select(table.id, table.fingerprint, table.read_options)
        row = connection.execute(columns.where(table.path == path)).one_or_none()
        if row is None or row.read_options != options.describe() or row.id not in index.rows:
            return None
        try:
            return int(row.id) if look_at(path, options).fingerprint == row.fingerprint else None
        except (DousaError, OSError):
            return None  # reading the file says what is wrong


def _compute_features(query: Any, options: ReadOptions) -> FloatArray:
    """(10, 56) of a file or a motion."""
    from dousa.motion import CanonicalMotion, Motion, canonicalise, compute_trajectories
    from dousa.retrieval import compute_clip_features

    if isinstance(query, str | os.PathLike):
        motion, _ = read_canonical(os.fspath(query), options)
    elif isinstance(query, CanonicalMotion):
        motion = query
    else:
        trajectories = compute_trajectories(query) if isinstance(query, Motion) else query
        motion = canonicalise(trajectories, options.joint_map)
    return compute_clip_features(motion)


def _name(query: Any) -> str:
    """What the answer calls the query: its path, where it has one."""
    if isinstance(query, str | os.PathLike):
        return os.fspath(query)
    return getattr(getattr(query, "provenance", None), "path", "motion")
