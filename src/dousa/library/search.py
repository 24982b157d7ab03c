"""Asking the forest of a library: searching and classifying, with the forest and the leaves kept warm."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from operator import itemgetter

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import LibraryError, OptionError
from dousa.formats.motion_files import ReadOptions, Skipped, find_motion_files, is_unicode
from dousa.library import schema
from dousa.library.engine import Database, read_revision
from dousa.library.features import (
    StoredMotion,
    describe_clip,
    lacks,
    load_features,
    load_motions,
    load_poses,
    round_positions,
)
from dousa.library.forests import ForestCache, StoredForest, TreeAnswers, ask_trees, count_votes
from dousa.library.ingest import ClipRecord, Query, ReadTask, is_as_stored, name_query, read_clips, read_query
from dousa.library.results import MIRROR_DISTANCE, Classification, Hit, SearchResult, Verdict
from dousa.library.schema import stack
from dousa.library.seals.checksums import LABELS, LEAVES
from dousa.library.selection import find_row
from dousa.library.text.meanings import find_meanings
from dousa.messages import Message
from dousa.retrieval.forest.likeness import Likeness, merge_votes
from dousa.retrieval.ranking.ranking import DEFAULT_RANKING, RankedClips, RankingQuery, rank_clips

PoseReader = Callable[[Sequence[int]], NDArray[np.float32]]
"""Gives (n, cells, columns), the pose sequences of clips of n numbers."""

PartProgress = Callable[[int, int, Message], None]
"""Called with (steps done, steps, message about the next step)."""

_MOST_POSES = 16_384  # kept in memory; some 4 kB each


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A motion that is searched for.

    Parameters
    ----------
    answers, features : what the trees say of it, and what they say it of; one row each.
    poses : its pose sequence.
    mirrored : whether it is the mirror image of the query.
    chances : (N,) of ``find_alike``, of the clips of an index, where they are known.
    """

    answers: TreeAnswers
    features: FloatArray
    poses: NDArray[np.float32]
    mirrored: bool = False
    chances: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SearchIndex:
    """What a search needs of all clips, in the order of their paths.

    Parameters
    ----------
    revision : of the library when it was read.
    ids, paths : of the clips.
    labels : category of each clip; the forest's, where nobody gave it one.
    answers : what the trees say of the clips.
    rows : place of each clip number in the above.
    partial : by number, the joints that clips lack which the forest asks about: they are not among the above.
    likeness : tells which clips are alike; None where that was not learned, as the next two.
    meanings : (C,) number of what each category means; categories of one meaning have the same.
    told : (N, M) share of the trees that vote for each meaning.
    lengths : (N,) Euclidean lengths of these.
    """

    revision: int
    ids: tuple[int, ...]
    paths: tuple[str, ...]
    labels: tuple[str, ...]
    answers: TreeAnswers
    rows: dict[int, int]
    partial: dict[int, str] = field(default_factory=dict)
    likeness: Likeness | None = None
    meanings: NDArray[np.intp] | None = None
    told: FloatArray | None = None
    lengths: FloatArray | None = None

    def answers_of(self, clip_id: int) -> TreeAnswers:
        """What the trees say of one clip."""
        row = self.rows[clip_id]
        return self.answers[row : row + 1]


def load_index(connection: sa.Connection, revision: int, stored: StoredForest) -> SearchIndex:
    """Read what the trees say of all clips, at a revision of the library.

    Raises
    ------
    LibraryDamagedError : leaves that are not as many as the trees, or that the forest does not have.
    """
    clips, table = schema.clips.c, schema.clip_leaves.c
    own = len(LABELS.columns)
    query = sa.select(*LABELS.columns, *LEAVES.columns)
    query = query.join(schema.clip_leaves, table.clip_id == clips.id)
    parts = sa.select(clips.id, clips.absent).where(clips.kind == schema.CLIP, clips.absent != "")
    # Sorted here: databases differ in how they order text.
    rows = sorted(connection.execute(query).all(), key=itemgetter(1))
    columns = list(zip(*rows, strict=True)) if rows else [()] * (own + len(LEAVES.columns))
    LABELS.check_all(connection, columns[:own])
    LEAVES.check_all(connection, columns[own:])
    ids, paths, given, _, _, _, _, _, predicted, leaves, directions, _ = columns
    answers = count_votes(stored, stack(leaves, "<i4", (len(stored.forest.trees_.roots),), "leaves"))
    if stored.likeness is not None and None not in directions:
        width = stored.likeness.space.axes.shape[1]
        answers = replace(answers, directions=stack(directions, "<f4", (width,), "directions"))
    named = find_meanings(stored.categories)
    meanings = np.unique([named[name] for name in stored.categories], return_inverse=True)[1]
    told = merge_votes(answers.shares(), meanings)
    return SearchIndex(
        revision=revision,
        ids=ids,
        paths=paths,
        labels=tuple(b if a is None else a for a, b in zip(given, predicted, strict=True)),
        answers=answers,
        rows={clip_id: row for row, clip_id in enumerate(ids)},
        partial={row.id: row.absent for row in connection.execute(parts) if lacks(stored.feature_set, row.absent)},
        likeness=stored.likeness,
        meanings=meanings,
        told=told,
        lengths=np.linalg.norm(told, axis=1),
    )


def find_alike(index: SearchIndex, asked: Asked) -> FloatArray | None:
    """Probabilities (N,) that the clips mean the same as a motion; None where that was not learned."""
    directions, own = index.answers.directions, asked.answers.directions
    if index.likeness is None or index.meanings is None or index.told is None or directions is None or own is None:
        return None
    told = merge_votes(asked.answers.shares(), index.meanings)[0]
    return index.likeness.judge(told, own[0], index.told, directions, index.lengths)


def _with_chances(index: SearchIndex, asked: Asked) -> Asked:
    return replace(asked, chances=find_alike(index, asked))


def count_alike(
    index: SearchIndex, asked: Sequence[Asked], category: str | None, among: Iterable[int] | None
) -> int | None:
    """How many clips are alike to a motion or its mirror image; None where that was not learned."""
    chances = [find_alike(index, one) if one.chances is None else one.chances for one in asked]
    if index.likeness is None or any(chance is None for chance in chances):
        return None
    alike = np.any([chance >= index.likeness.threshold for chance in chances if chance is not None], axis=0)
    places = _find_places(index, category, among)
    return int((alike if places is None else alike[places]).sum())


def _find_places(index: SearchIndex, category: str | None, among: Iterable[int] | None) -> NDArray[np.intp] | None:
    """Places of the clips that are looked at; None for all."""
    if category is None and among is None:
        return None
    wanted = set(index.ids if among is None else among)
    chosen = [category in (None, label) and own in wanted for label, own in zip(index.labels, index.ids, strict=True)]
    return np.flatnonzero(np.array(chosen, dtype=np.bool_))


def search_index(
    index: SearchIndex,
    asked: Sequence[Asked],
    k: int,
    by: str,
    category: str | None,
    read_poses: PoseReader,
    among: Collection[int] | None = None,
) -> tuple[Hit, ...]:
    """The k clips that are most like a motion, or like its mirror image.

    Parameters
    ----------
    index : the clips.
    asked : the motion, and its mirror image if that is searched for too.
    k : how many.
    by : one of ``dousa.retrieval.ranking.ranking.RANKINGS``.
    category : only clips of this category; of all if None.
    read_poses : gives (n, cells, columns), the pose sequences of clips of these numbers; asked once for each motion.
    among : only clips of these numbers; of all if None.

    Raises
    ------
    OptionError : an unknown ranking.
    """
    places = _find_places(index, category, among)
    first = [rank_places(index, one, k, by, places, read_poses)[0] for one in asked]
    if len(first) == 1:
        return tuple(_number(first[0]))
    return choose_best((hit for hits in first for hit in hits), k)


def choose_best(hits: Iterable[Hit], k: int) -> tuple[Hit, ...]:
    """The nearest k clips among the hits of several searches, each clip once."""
    best: dict[int, Hit] = {}
    for hit in sorted(hits, key=_mirrored_last):
        best.setdefault(hit.clip_id, hit)
    return tuple(_number(list(best.values())[:k]))


def rank_places(
    index: SearchIndex,
    asked: Asked,
    k: int,
    by: str,
    places: NDArray[np.intp] | None,
    read_poses: PoseReader,
) -> tuple[list[Hit], FloatArray]:
    """The first k clips for one motion, among those at some places of the index, and how far each of these is."""
    votes, leaves = index.answers.votes, index.answers.leaves
    directions, own = index.answers.directions, asked.answers.directions
    rows = np.arange(len(index.ids)) if places is None else places
    clips = RankedClips(
        votes if places is None else votes[places],
        leaves if places is None else leaves[places],
        lambda chosen: read_poses([index.ids[row] for row in rows[chosen]]),
        # Rounded, so that a clip is no distance from itself.
        None if directions is None or own is None else np.round(directions[rows] @ own[0], 6),
    )
    ranking = rank_clips(by, RankingQuery(asked.answers.votes[0], asked.answers.leaves[0], asked.poses), clips)
    order, chances = ranking.order, find_alike(index, asked) if asked.chances is None else asked.chances
    alike = None if chances is None or index.likeness is None else chances[rows] >= index.likeness.threshold
    if alike is not None and by == DEFAULT_RANKING:
        order = order[np.argsort(~alike[order], kind="stable")]
    hits = []
    for place in order[:k]:
        row = int(rows[place])
        hits.append(
            Hit(
                path=index.paths[row],
                category=index.labels[row],
                distance=float(ranking.histogram[place]),
                rank=0,
                clip_id=index.ids[row],
                leaf_share=1.0 - float(ranking.leaves[place]),
                pose_distance=_number_or_none(ranking.pose[place]),
                rank_distance=_number_or_none(ranking.distances[place]),
                mirrored=asked.mirrored,
                alike=None if alike is None else bool(alike[place]),
                probability=None if chances is None else round(float(chances[row]), 4),
            )
        )
    return hits, ranking.distances


def _number_or_none(value: np.float64) -> float | None:
    return None if np.isnan(value) else float(value)


def _mirrored_last(hit: Hit) -> tuple[tuple[bool, bool], float]:
    """By the distance, where mirrored clips must be clearly nearer; clips whose poses were not compared come last."""
    far = hit.rank_distance is None, hit.alike is False
    distance = hit.distance if hit.rank_distance is None else hit.rank_distance
    return far, distance / MIRROR_DISTANCE if hit.mirrored else distance


def _number(hits: Sequence[Hit]) -> list[Hit]:
    return [replace(hit, rank=rank) for rank, hit in enumerate(hits, start=1)]


def check_threshold(threshold: float | None) -> None:
    """OptionError for a probability outside 0 to 1."""
    if threshold is not None and not 0 <= threshold <= 1:
        raise OptionError("library_search.threshold", threshold=threshold)


def judge(stored: StoredForest, answers: TreeAnswers, features: FloatArray, threshold: float | None) -> list[Verdict]:
    """What the forest predicts for motions.

    Parameters
    ----------
    stored : the forest.
    answers, features : what its trees say of N motions, and (N, frames, columns) what they said it of.
    threshold : probability of being right below which a guess is withheld, and the motion called unknown; None for
        that of the forest's calibration, 0 for never.
    """
    guesses = answers.predicted()
    histograms = [_order_histogram(stored.categories, own) for own in answers.shares()]
    pairs = list(zip(guesses, histograms, strict=True))
    if stored.assessor is None or not guesses:
        return [Verdict(guess, guess, None, None, histogram) for guess, histogram in pairs]
    seen = stored.assessor.assess(answers.leaves, features)
    limit = stored.assessor.calibration.threshold if threshold is None else threshold
    return [
        Verdict(guess if confidence >= limit else None, guess, float(known), float(confidence), histogram)
        for (guess, histogram), known, confidence in zip(pairs, seen.known, seen.confidence, strict=True)
    ]


def _order_histogram(categories: Sequence[str], shares: FloatArray) -> dict[str, float]:
    """Share of each category, the largest first, then by name."""
    order = np.argsort(-shares, kind="stable")
    return {categories[index]: float(shares[index]) for index in order}


class Explaining:
    """Explains what one forest says."""

    def __init__(self, stored: StoredForest) -> None:
        from dousa.retrieval.explain.explanation import Explainer

        self._feature_set = stored.feature_set
        self._explainer = Explainer(stored.forest)

    def verdicts(self, verdicts: Sequence[Verdict], motion: StoredMotion) -> list[Verdict]:
        """The verdict on a motion, and on its mirror image if there are two, with the reasons for their guesses."""
        explained = []
        for verdict, own in zip(verdicts, (motion, motion.mirror()), strict=False):
            features = describe_clip(own, self._feature_set).features
            reasons = self._explainer.explain(features, own.duration, verdict.guess)
            explained.append(replace(verdict, explanation=reasons))
        return explained

    def hits(self, hits: Sequence[Hit], motion: StoredMotion, found: Iterable[StoredMotion]) -> tuple[Hit, ...]:
        """Hits, with the reasons why they are like the query or its mirror image."""
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
    """What a search is to give; as in ``Library.search``."""

    k: int
    ranking: str
    same_category: bool = False
    mirror: bool = False
    explain: bool = False
    threshold: float | None = None
    among: frozenset[int] | None = None


class Searcher(ABC):
    """Answers about whole motions; what was read stays in memory until the revision of the library changes.

    What becomes of bodies that lack joints is left to ``partial.search``.
    """

    def __init__(self, database: Database, forests: ForestCache) -> None:
        self._database = database
        self._forests = forests
        self._index: SearchIndex | None = None
        self._poses: dict[int, NDArray[np.float32]] = {}

    def search(
        self, query: Query, wanted: Wanted, options: ReadOptions, progress: PartProgress | None = None
    ) -> SearchResult:
        """The clips nearest to a file, a clip or a motion; as ``Library.search``."""
        check_threshold(wanted.threshold)
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
            index = self._load_index(connection, stored)
            clip_id = self._find_clip(connection, index, query, options)
            motion: StoredMotion | None = None
            if clip_id is None:
                assert not isinstance(query, int)
                name, motion = name_query(query), round_positions(read_query(query, options))
            else:
                name = self._name(connection, index, query)
                if wanted.mirror or wanted.explain or index.partial:
                    (motion,) = load_motions(connection, [clip_id])
            whole = motion is None or not lacks(stored.feature_set, " ".join(motion.absent))
            if whole and not index.partial:
                return self._search_whole(connection, index, stored, (name, clip_id, motion), wanted)
        assert motion is not None
        return self._search_parts((stored, index), (name, motion), wanted, progress)

    @abstractmethod
    def _search_parts(
        self,
        library: tuple[StoredForest, SearchIndex],
        query: tuple[str, StoredMotion],
        wanted: Wanted,
        progress: PartProgress | None,
    ) -> SearchResult:
        """The answer where the query, or some of the clips, lack joints that the forest of the library asks about."""

    @abstractmethod
    def _choose_forest(
        self, stored: StoredForest, absent: Sequence[str], progress: PartProgress | None
    ) -> tuple[StoredForest | None, Message | None]:
        """The forest that is asked about a body, and what it leaves out; or None, and why there is none."""

    def _search_whole(
        self,
        connection: sa.Connection,
        index: SearchIndex,
        stored: StoredForest,
        query: tuple[str, int | None, StoredMotion | None],
        wanted: Wanted,
    ) -> SearchResult:
        """The answer where all bodies have the joints that the forest asks about."""
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
        asked = [_with_chances(index, one) for one in asked]
        verdicts = [judge(stored, one.answers, one.features, wanted.threshold)[0] for one in asked]
        category = verdicts[0].guess if wanted.same_category else None
        read_poses = partial(self._read_poses, connection, stored.feature_set)
        hits = search_index(index, asked, wanted.k, wanted.ranking, category, read_poses, wanted.among)
        if wanted.explain:
            assert motion is not None
            explaining = Explaining(stored)
            verdicts = explaining.verdicts(verdicts, motion)
            hits = explaining.hits(hits, motion, load_motions(connection, [hit.clip_id for hit in hits]))
        n_alike = count_alike(index, asked, category, wanted.among)
        mirrored = verdicts[1] if wanted.mirror else None
        return SearchResult(name, verdicts[0], hits, wanted.ranking, mirrored, alike_count=n_alike)

    def _name(self, connection: sa.Connection, index: SearchIndex, query: Query) -> str:
        if not isinstance(query, int):
            return name_query(query)
        if query in index.rows:
            return index.paths[index.rows[query]]
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
        """Predict the categories of files; as ``Library.classify``."""
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
                notes = () if note is None else (note,)
                answers.append(Classification(item.path, verdicts[0], verdicts[1] if mirror else None, None, notes))
            elif isinstance(item, Skipped):
                answers.append(Classification(item.path, None, problem=item.reason))
        return answers

    def _load_index(self, connection: sa.Connection, stored: StoredForest) -> SearchIndex:
        revision = read_revision(connection)
        if self._index is None or self._index.revision != revision:
            self._index = load_index(connection, revision, stored)
            self._poses = {}
        return self._index

    def _read_poses(self, connection: sa.Connection, feature_set: str, ids: Sequence[int]) -> NDArray[np.float32]:
        """(N, cells, columns) pose sequences of clips; those that were read stay, as others ask for them too."""
        kept = self._poses  # the same in all that follows: another thread may begin anew
        missing = [clip_id for clip_id in ids if clip_id not in kept]
        if len(kept) + len(missing) > _MOST_POSES:
            kept, missing = {}, list(ids)
            self._poses = kept
        if missing:
            kept.update(zip(missing, load_poses(connection, missing, feature_set), strict=True))
        return np.stack([kept[clip_id] for clip_id in ids]) if len(ids) else load_poses(connection, ids, feature_set)

    def _find_clip(
        self, connection: sa.Connection, index: SearchIndex, query: Query, options: ReadOptions
    ) -> int | None:
        """The clip that the query is, if it has not changed since it was stored."""
        if isinstance(query, int):
            if query not in index.rows and query not in index.partial:
                path = find_row(connection, self._database.where, query).path
                raise LibraryError("library_search.is_take", library=self._database.where, number=query, path=path)
            return query
        if not isinstance(query, str | os.PathLike):
            return None
        path = os.path.abspath(query)
        if not is_unicode(path):
            return None  # no database can hold it, so it is not there
        table = schema.clips.c
        columns = sa.select(table.id, table.path, table.fingerprint, table.read_options)
        row = connection.execute(columns.where(table.path == path)).one_or_none()
        if row is None or not (row.id in index.rows or row.id in index.partial) or not is_as_stored(row, options):
            return None
        return int(row.id)


def ask_forest(stored: StoredForest, motion: StoredMotion, mirrored: bool = False) -> Asked:
    """What the trees say of a motion that is not stored."""
    described = describe_clip(motion, stored.feature_set)
    features = described.features[None]
    return Asked(ask_trees(stored, features), features, described.poses, mirrored)
