"""Search and classification with the forest of a library, which stays in memory with the index."""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import LibraryError, OptionError
from dousa.formats.motion_files import ReadOptions, Skipped, find_motion_files, is_unicode
from dousa.library.results import MIRROR_DISTANCE, Classification, Hit, SearchResult, Verdict
from dousa.library.search.leaf_index import IndexQuery, LeafIndex
from dousa.library.search.ranking import PoseReader, Ranked, rank_index
from dousa.library.search.renewal import load_index
from dousa.library.store import schema
from dousa.library.store.engine import Database
from dousa.library.store.features import StoredMotion, describe_clip, lacks, load_features, load_motions, load_poses
from dousa.library.store.forests import ForestCache, StoredForest, TreeAnswers, ask_trees
from dousa.library.store.ingest import (
    ClipRecord,
    Query,
    ReadTask,
    is_as_stored,
    list_doubts,
    name_query,
    read_clips,
    read_rounded,
)
from dousa.library.store.selection import find_row, read_doubts
from dousa.messages import Message

PartProgress = Callable[[int, int, Message], None]
"""Called with (steps done, steps, message about the next step)."""

# A recording of at least 10 s, and twice as long as 99 % of the clips, is taken for uncut.
_LEAST_TAKE, _TAKE_FACTOR, _NEARLY_ALL = 10.0, 2.0, 0.99
_MOST_POSES = 16_384  # in memory; some 4 kB each


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A motion to search for.

    Parameters
    ----------
    answers, features : tree answers, and the features that they are about; one row each.
    poses : pose sequence.
    mirrored : whether it is the mirror image of the query.
    """

    answers: TreeAnswers
    features: FloatArray
    poses: NDArray[np.float32]
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class Found:
    """The first clips, and the number of all clips like the query; None if likeness was not learned."""

    hits: tuple[Hit, ...]
    n_alike: int | None


def search_index(
    index: LeafIndex,
    asked: Sequence[Asked],
    k: int,
    by: str,
    category: str | None,
    read_poses: PoseReader,
    among: Collection[int] | None = None,
) -> Found:
    """Find the k clips that are most like a motion, or like its mirror image.

    Parameters
    ----------
    asked : the motion, and its mirror image if wanted.
    by : one of ``dousa.retrieval.ranking.ranking.RANKINGS``.
    category : search only this category; None for all.
    read_poses : called at most once for each motion.
    among : search only clips of these numbers; None for all.

    Raises
    ------
    OptionError : an unknown ranking.
    """
    chosen = index.choose(category, among)
    ranked = [rank_index(index, _as_query(one), k, by, chosen, read_poses) for one in asked]
    hits = [_make_hits(index, found, one.mirrored) for one, found in zip(asked, ranked, strict=True)]
    alike = [found.all_alike for found in ranked if found.all_alike is not None]
    return Found(
        tuple(number_hits(hits[0])) if len(hits) == 1 else choose_best((hit for some in hits for hit in some), k),
        len(np.unique(np.concatenate(alike))) if alike and len(alike) == len(ranked) else None,
    )


def _as_query(asked: Asked) -> IndexQuery:
    answers = asked.answers
    direction = None if answers.directions is None else answers.directions[0]
    return IndexQuery(answers.votes[0], answers.leaves[0], asked.poses, direction)


def _make_hits(index: LeafIndex, found: Ranked, mirrored: bool) -> list[Hit]:
    return [
        Hit(
            path=index.path(row).decode(),
            category=index.label(row),
            distance=float(found.histograms[place]),
            rank=0,
            clip_id=index.clip_id(row),
            leaf_share=1.0 - float(found.leaves[place]),
            pose_distance=number_or_none(found.poses[place]),
            rank_distance=number_or_none(found.distances[place]),
            mirrored=mirrored,
            alike=None if found.alike is None else bool(found.alike[place]),
            probability=None if found.chances is None else round(float(found.chances[place]), 4),
        )
        for place, row in enumerate(found.rows.tolist())
    ]


def number_or_none(value: np.float64) -> float | None:
    """Return a distance, or None for NaN."""
    return None if np.isnan(value) else float(value)


def choose_best(hits: Iterable[Hit], k: int) -> tuple[Hit, ...]:
    """Return the nearest k clips among the hits of several searches, each clip once."""
    best: dict[int, Hit] = {}
    for hit in sorted(hits, key=_mirrored_last):
        best.setdefault(hit.clip_id, hit)
    return tuple(number_hits(list(best.values())[:k]))


def _mirrored_last(hit: Hit) -> tuple[tuple[bool, bool], float]:
    """Sort by distance with a handicap for mirrored clips; unlike clips come later, those without poses last."""
    far = hit.rank_distance is None, hit.alike is False
    distance = hit.distance if hit.rank_distance is None else hit.rank_distance
    return far, distance / MIRROR_DISTANCE if hit.mirrored else distance


def number_hits(hits: Sequence[Hit]) -> list[Hit]:
    return [replace(hit, rank=rank) for rank, hit in enumerate(hits, start=1)]


def check_threshold(threshold: float | None) -> None:
    """Raise OptionError for a probability outside 0 to 1."""
    if threshold is not None and not 0 <= threshold <= 1:
        raise OptionError("library_search.threshold", threshold=threshold)


def judge(stored: StoredForest, answers: TreeAnswers, features: FloatArray, threshold: float | None) -> list[Verdict]:
    """Predict the categories of N motions.

    Parameters
    ----------
    answers, features : tree answers, and the features (N, frames, columns) that they are about.
    threshold : probability of being right below which a motion is unknown; None for the calibrated one, 0 for never.
    """
    guesses = answers.predicted()
    histograms = [_order_histogram(stored.categories, own) for own in answers.shares()]
    pairs = list(zip(guesses, histograms, strict=True))
    if stored.assessor is None or not guesses:
        return [Verdict(guess, guess, None, None, histogram) for guess, histogram in pairs]
    seen = stored.assessor.assess(answers.leaves, features)
    unknown = seen.unknown if threshold is None else seen.confidence < threshold
    return [
        Verdict(
            None if strange else guess,
            guess,
            float(known),
            float(confidence),
            histogram,
            perhaps=bool(strange and possible),
        )
        for (guess, histogram), known, confidence, strange, possible in zip(
            pairs, seen.known, seen.confidence, unknown, seen.possible, strict=True
        )
    ]


def _order_histogram(categories: Sequence[str], shares: FloatArray) -> dict[str, float]:
    """Return the share of each category, the largest first; equals keep their order."""
    order = np.argsort(-shares, kind="stable")
    return {categories[index]: float(shares[index]) for index in order}


class Explaining:
    """Explains the answers of one forest."""

    def __init__(self, stored: StoredForest) -> None:
        from dousa.retrieval.explain.explanation import Explainer

        self._feature_set = stored.feature_set
        self._explainer = Explainer(stored.forest)

    def verdicts(self, verdicts: Sequence[Verdict], motion: StoredMotion) -> list[Verdict]:
        """Add reasons to the verdict on a motion, and to that on its mirror image if there are two."""
        explained = []
        for verdict, own in zip(verdicts, (motion, motion.mirror()), strict=False):
            features = describe_clip(own, self._feature_set).features
            reasons = self._explainer.explain(features, own.duration, verdict.guess)
            explained.append(replace(verdict, explanation=reasons))
        return explained

    def hits(self, hits: Sequence[Hit], motion: StoredMotion, found: Iterable[StoredMotion]) -> tuple[Hit, ...]:
        """Add the reasons why hits are like the query or its mirror image."""
        explained = []
        for hit, other in zip(hits, found, strict=True):
            own = motion.mirror() if hit.mirrored else motion
            likeness = self._explainer.explain_pair(
                describe_clip(own, self._feature_set).features,
                describe_clip(other, self._feature_set).features,
                (own.duration, other.duration),
            )
            explained.append(replace(hit, likeness=likeness))
        return tuple(explained)


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options of a search, as in ``Library.search``."""

    k: int
    ranking: str
    same_category: bool = False
    mirror: bool = False
    explain: bool = False
    threshold: float | None = None
    among: frozenset[int] | None = None


class Searcher(ABC):
    """Searches and classifies whole motions; ``part_search.PartSearcher`` adds bodies that lack joints.

    The index stays in memory until the revision of the library changes.
    """

    def __init__(self, database: Database, forests: ForestCache) -> None:
        self._database = database
        self._forests = forests
        self._index: LeafIndex | None = None
        self._poses: dict[int, NDArray[np.float32]] = {}

    def search(
        self, query: Query, wanted: Wanted, options: ReadOptions, progress: PartProgress | None = None
    ) -> SearchResult:
        """Find the clips nearest to a file, a clip or a motion, as ``Library.search`` does."""
        check_threshold(wanted.threshold)
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
            index = self._load_index(connection, stored)
            clip_id = self._find_clip(connection, index, query, options)
            motion: StoredMotion | None = None
            if clip_id is None:
                assert not isinstance(query, int)
                motion, doubts = read_rounded(query, options)
                name, doubts = name_query(query), (*doubts, *note_long(connection, motion.duration))
            else:
                name, doubts = self._name(connection, index, query), read_doubts(connection, clip_id)
                if wanted.mirror or wanted.explain or index.partial:
                    (motion,) = load_motions(connection, [clip_id])
            whole = motion is None or not lacks(stored.feature_set, " ".join(motion.absent))
            if whole and not index.partial:
                found = self._search_whole(connection, index, stored, (name, clip_id, motion), wanted)
                return replace(found, notes=doubts)
        assert motion is not None
        found = self._search_parts((stored, index), (name, motion), wanted, progress)
        return replace(found, notes=(*doubts, *found.notes))

    @abstractmethod
    def _search_parts(
        self,
        library: tuple[StoredForest, LeafIndex],
        query: tuple[str, StoredMotion],
        wanted: Wanted,
        progress: PartProgress | None,
    ) -> SearchResult:
        """Search where the query or some of the clips lack joints of the library's forest."""

    @abstractmethod
    def _choose_forest(
        self, stored: StoredForest, absent: Sequence[str], progress: PartProgress | None
    ) -> tuple[StoredForest | None, Message | None]:
        """Choose the forest for a body, with a note on the joints that it ignores; or None, with the reason."""

    def _search_whole(
        self,
        connection: sa.Connection,
        index: LeafIndex,
        stored: StoredForest,
        query: tuple[str, int | None, StoredMotion | None],
        wanted: Wanted,
    ) -> SearchResult:
        """Search where all bodies have the joints of the forest."""
        name, clip_id, motion = query
        if clip_id is None:
            assert motion is not None
            asked = [ask_forest(stored, motion)]
        else:
            features = load_features(connection, stored.feature_set, [clip_id]).features
            poses = self._read_poses(connection, stored.feature_set, [clip_id])[0]
            asked = [Asked(index.answers_of(clip_id), features, poses)]
        if wanted.mirror:
            assert motion is not None
            asked.append(ask_forest(stored, motion.mirror(), mirrored=True))
        verdicts = [judge(stored, one.answers, one.features, wanted.threshold)[0] for one in asked]
        category = verdicts[0].guess if wanted.same_category else None
        read_poses = partial(self._read_poses, connection, stored.feature_set)
        found = search_index(index, asked, wanted.k, wanted.ranking, category, read_poses, wanted.among)
        hits = found.hits
        if wanted.explain:
            assert motion is not None
            explaining = Explaining(stored)
            verdicts = explaining.verdicts(verdicts, motion)
            hits = explaining.hits(hits, motion, load_motions(connection, [hit.clip_id for hit in hits]))
        mirrored = verdicts[1] if wanted.mirror else None
        return SearchResult(name, verdicts[0], hits, wanted.ranking, mirrored, alike_count=found.n_alike)

    def _name(self, connection: sa.Connection, index: LeafIndex, query: Query) -> str:
        if not isinstance(query, int):
            return name_query(query)
        row = index.find(query)
        if row is not None:
            return index.path(row).decode()
        return str(find_row(connection, self._database.where, query).path)

    def classify(
        self,
        paths: Sequence[str | os.PathLike[str]],
        *,
        mirror: bool,
        explain: bool,
        threshold: float | None,
        options: ReadOptions,
        n_jobs: int | None,
        progress: PartProgress | None = None,
    ) -> list[Classification]:
        """Predict the categories of files, as ``Library.classify`` does."""
        check_threshold(threshold)
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
        files, missing = find_motion_files(paths)
        tasks = [ReadTask(str(file.path), options, feature_set=stored.feature_set) for file in files]
        explaining = {stored.feature_set: Explaining(stored)} if explain else None
        choose = lru_cache(maxsize=None)(lambda absent: self._choose_forest(stored, absent, progress))
        answers: list[Classification] = []
        for item in (*missing, *read_clips(tasks, n_jobs)):
            if isinstance(item, ClipRecord):
                asked, note = choose(item.motion.absent)
                if asked is None:
                    answers.append(Classification(item.path, None, problem=note))
                    continue
                known = item.description if asked is stored else None
                described = [known or describe_clip(item.motion, asked.feature_set)]
                if mirror:
                    described.append(describe_clip(item.motion.mirror(), asked.feature_set))
                features = np.stack([one.features for one in described])
                verdicts = judge(asked, ask_trees(asked, features), features, threshold)
                if explaining is not None:
                    own = explaining.setdefault(asked.feature_set, Explaining(asked))
                    verdicts = own.verdicts(verdicts, item.motion)
                notes = [*list_doubts(item), *self._note_long(item.motion.duration)]
                notes += [] if note is None else [note]
                mirrored = verdicts[1] if mirror else None
                answers.append(Classification(item.path, verdicts[0], mirrored, None, tuple(notes)))
            elif isinstance(item, Skipped):
                answers.append(Classification(item.path, None, problem=item.reason))
        return answers

    def _note_long(self, seconds: float) -> tuple[Message, ...]:
        if seconds < _LEAST_TAKE:
            return ()
        with self._database.reading() as connection:
            return note_long(connection, seconds)

    def _load_index(self, connection: sa.Connection, stored: StoredForest) -> LeafIndex:
        known, database = self._index, self._database
        index = load_index(connection, database.where, stored, known, may_write=not database.is_read_only)
        if index is not known:
            self._index, self._poses = index, {}
        return index

    def _read_poses(self, connection: sa.Connection, feature_set: str, ids: Sequence[int]) -> NDArray[np.float32]:
        """Return (N, cells, columns) pose sequences of clips, and keep them for later searches."""
        kept = self._poses  # a local name, as another thread may replace it
        missing = [clip_id for clip_id in ids if clip_id not in kept]
        if len(kept) + len(missing) > _MOST_POSES:
            kept, missing = {}, list(ids)
            self._poses = kept
        if missing:
            kept.update(zip(missing, load_poses(connection, missing, feature_set), strict=True))
        return np.stack([kept[clip_id] for clip_id in ids]) if len(ids) else load_poses(connection, ids, feature_set)

    def _find_clip(self, connection: sa.Connection, index: LeafIndex, query: Query, options: ReadOptions) -> int | None:
        """Return the number of the stored clip that the query is, if it has not changed; else None."""
        if isinstance(query, int):
            if index.find(query) is None and query not in index.partial:
                path = find_row(connection, self._database.where, query).path
                raise LibraryError("library_search.is_take", library=self._database.where, number=query, path=path)
            return query
        if not isinstance(query, str | os.PathLike):
            return None
        path = os.path.abspath(query)
        if not is_unicode(path):
            return None  # no database can hold it
        table = schema.clips.c
        columns = sa.select(table.id, table.path, table.fingerprint, table.read_options)
        row = connection.execute(columns.where(table.path == path)).one_or_none()
        known = row is not None and (row.id in index.partial or index.find(row.id) is not None)
        if row is None or not known or not is_as_stored(row, options):
            return None
        return int(row.id)


def note_long(connection: sa.Connection, seconds: float) -> tuple[Message, ...]:
    """Return a note for a motion that is much longer than the clips of the library."""
    if seconds < _LEAST_TAKE:
        return ()
    table = schema.clips.c
    durations = connection.execute(sa.select(table.duration).where(table.kind == schema.CLIP)).scalars().all()
    longest = float(np.quantile(durations, _NEARLY_ALL)) if durations else math.inf
    if seconds < _TAKE_FACTOR * longest:
        return ()
    return (Message("library_search.like_a_take", seconds=seconds, longest=longest),)


def ask_forest(stored: StoredForest, motion: StoredMotion, mirrored: bool = False) -> Asked:
    """Return the tree answers about a motion that is not stored."""
    described = describe_clip(motion, stored.feature_set)
    features = described.features[None]
    return Asked(ask_trees(stored, features), features, described.poses, mirrored)
