"""Asking the forest of a library: searching and classifying, with the forest and the leaves kept warm."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryError, NotTrainedError
from dousa.library import schema
from dousa.library._describing import StoredMotion, describe_clip, load_motions, round_positions
from dousa.library._engine import reading
from dousa.library._explaining import Explaining
from dousa.library._features import load_features, load_poses
from dousa.library._forests import StoredForest, ask_trees, load_forest
from dousa.library._judging import Unknown, judge
from dousa.library._queries import name_query, read_query
from dousa.library._revision import read_revision
from dousa.library.answers import Classification, SearchResult, Verdict
from dousa.library.ingest import (
    ClipRecord,
    ReadOptions,
    ReadTask,
    find_motion_files,
    is_unicode,
    look_at,
    read_clips,
)
from dousa.library.reports import Skipped
from dousa.library.search import Asked, SearchIndex, load_index, search_index

__all__ = ["ClassifyOptions", "Querying", "SearchOptions"]

_MOST_POSES = 16_384  # kept in memory; some 4 kB each


@dataclass(frozen=True, slots=True)
class SearchOptions:
    """How a library is searched.

    Parameters
    ----------
    k : results at most.
    ranking : what clips are ordered by.
    same_category : only clips of the category that most trees take the query for.
    mirror : the mirror image of the query is searched for too.
    explain : say why.
    unknown : when a motion is called unknown.
    """

    k: int
    ranking: str
    same_category: bool
    mirror: bool
    explain: bool
    unknown: Unknown


@dataclass(frozen=True, slots=True)
class ClassifyOptions:
    """How files are classified.

    Parameters
    ----------
    mirror : say what the mirror image is taken for too.
    explain : say why.
    unknown : when a motion is called unknown.
    n_jobs : files read at a time.
    """

    mirror: bool
    explain: bool
    unknown: Unknown
    n_jobs: int | None


class Querying:
    """The side of a library that answers about whole motions.

    What was read stays in memory until the revision of the library changes.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    """

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self._engine = engine
        self._where = where
        self._index: SearchIndex | None = None
        self._poses: dict[int, NDArray[np.float32]] = {}
        self.forest: StoredForest | None = None

    def search(self, query: Any, wanted: SearchOptions, options: ReadOptions) -> SearchResult:
        """The clips nearest to a file, a clip or a motion."""
        with reading(self._engine, self._where) as connection:
            stored = self.load(connection)
            index = self._load_index(connection, stored)
            clip_id = self._find_clip(connection, index, query, options)
            name = index.paths[index.rows[query]] if isinstance(query, int) else name_query(query)
            if clip_id is None:
                motion = round_positions(read_query(query, options))
                asked = [_ask(stored, motion)]
            else:
                if wanted.mirror or wanted.explain:
                    (motion,) = load_motions(connection, [clip_id])
                features = load_features(connection, stored.feature_set, [clip_id]).features
                poses = self._read_poses(connection, [clip_id])[0]
                asked = [Asked(index.answers_of(clip_id), features, poses)]
            if wanted.mirror:
                asked.append(_ask(stored, motion.mirror(), mirrored=True))
            verdicts = [judge(stored, one.answers, one.features, wanted.unknown)[0] for one in asked]
            category = verdicts[0].guess if wanted.same_category else None
            hits = search_index(
                index,
                asked,
                wanted.k,
                wanted.ranking,
                category,
                lambda ids: self._read_poses(connection, ids),
            )
            if wanted.explain:
                explaining = Explaining(stored)
                verdicts = explaining.verdicts(verdicts, motion)
                hits = explaining.hits(hits, motion, load_motions(connection, [hit.clip_id for hit in hits]))
        return SearchResult(name, verdicts[0], hits, wanted.ranking, verdicts[1] if wanted.mirror else None)

    def classify(
        self, paths: Sequence[str | os.PathLike[str]], wanted: ClassifyOptions, options: ReadOptions
    ) -> list[Classification]:
        """What the forest takes files for."""
        with reading(self._engine, self._where) as connection:
            stored = self.load(connection)
        files, missing = find_motion_files(paths)
        tasks = [ReadTask(str(file.path), options, feature_set=stored.feature_set) for file in files]
        explaining = Explaining(stored) if wanted.explain else None
        answers: list[Classification] = []
        for item in (*missing, *read_clips(tasks, wanted.n_jobs)):
            if isinstance(item, ClipRecord):
                verdicts = _classify(stored, item, wanted)
                if explaining is not None:
                    verdicts = explaining.verdicts(verdicts, item.to_motion())
                answers.append(Classification(item.path, verdicts[0], verdicts[1] if wanted.mirror else None))
            elif isinstance(item, Skipped):
                answers.append(Classification(item.path, None, problem=item.reason))
        return answers

    def load(self, connection: sa.Connection) -> StoredForest:
        """The forest, as it is now.

        Raises
        ------
        NotTrainedError : there is none.
        """
        stored = load_forest(connection, self._where, self.forest)
        if stored is None:
            raise NotTrainedError(f"{self._where}: there is no forest yet; run: dousa train {self._where}")
        self.forest = stored
        return stored

    def path_of(self, connection: sa.Connection, number: int) -> str:
        """The file of a clip or take; LibraryError if there is none of this number."""
        query = sa.select(schema.clips.c.path).where(schema.clips.c.id == number)
        path = connection.execute(query).scalar_one_or_none() if schema.is_id(number) else None
        if path is None:
            raise LibraryError(f"{self._where}: no clip or take {number}; see: dousa list")
        return str(path)

    def _load_index(self, connection: sa.Connection, stored: StoredForest) -> SearchIndex:
        revision = read_revision(connection)
        if self._index is None or self._index.revision != revision:
            self._index = load_index(connection, revision, stored)
            self._poses = {}
        return self._index

    def _read_poses(self, connection: sa.Connection, ids: Sequence[int]) -> NDArray[np.float32]:
        """(N, cells, columns) pose sequences of clips; those that were read stay, as others ask for them too."""
        kept = self._poses  # the same in all that follows: another thread may begin anew
        missing = [clip_id for clip_id in ids if clip_id not in kept]
        if len(kept) + len(missing) > _MOST_POSES:
            kept, missing = {}, list(ids)
            self._poses = kept
        if missing:
            kept.update(zip(missing, load_poses(connection, missing), strict=True))
        return np.stack([kept[clip_id] for clip_id in ids]) if len(ids) else load_poses(connection, ids)

    def _find_clip(
        self, connection: sa.Connection, index: SearchIndex, query: Any, options: ReadOptions
    ) -> int | None:
        """The clip that the query is, if it has not changed since it was stored."""
        if isinstance(query, int):
            if query not in index.rows:
                path = self.path_of(connection, query)
                raise LibraryError(
                    f"{self._where}: {query} is the take {path}; look into takes with: dousa find, dousa label"
                )
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


def _ask(stored: StoredForest, motion: StoredMotion, mirrored: bool = False) -> Asked:
    """What the trees say of a motion that is not stored."""
    described = describe_clip(motion, stored.feature_set)
    features = described.features[None]
    return Asked(ask_trees(stored, features), features, described.poses, mirrored)


def _classify(stored: StoredForest, record: ClipRecord, wanted: ClassifyOptions) -> list[Verdict]:
    """The verdict on a file, and on its mirror image if that is wanted."""
    described = [record.description or describe_clip(record.to_motion(), stored.feature_set)]
    if wanted.mirror:
        described.append(describe_clip(record.to_motion().mirror(), stored.feature_set))
    features = np.stack([one.features for one in described])
    return judge(stored, ask_trees(stored, features), features, wanted.unknown)
