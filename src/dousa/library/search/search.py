"""Search and classification with the forest of a library, which stays in memory with the index.

Clips that share the same joints with a query form a group with one forest. To compare groups, the share of the body
that was not compared counts as the median distance, so legs alone are not nearer than a whole body with the same
motion.
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import InvalidMotionError, LibraryError, OptionError
from dousa.formats.motion_files import ReadOptions, Skipped, find_motion_files, is_unicode
from dousa.library.results import Classification, Hit, SearchResult, Verdict
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.search.part_forests import PartForests
from dousa.library.search.ranking import Asked, PoseReader, RankedRows, ask_forest, choose_best, number_hits, rank_rows
from dousa.library.search.renewal import load_index
from dousa.library.store import schema
from dousa.library.store.engine import Database
from dousa.library.store.features import (
    StoredMotion,
    describe_clip,
    find_feature_set,
    lacks,
    load_features,
    load_motions,
    load_poses,
)
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
from dousa.messages import Message, Progress
from dousa.retrieval.features.posed_motion import count_placed, is_comparable
from dousa.retrieval.forest.evidence import weigh


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Clips (``chosen`` (N,) of ``index``) that share the same joints with a query, and the forest for these joints."""

    stored: StoredForest
    index: LeafIndex
    chosen: BoolArray
    read_poses: PoseReader


def group_clips(
    database: Database,
    parts: PartForests,
    main: StoredForest,
    index: LeafIndex,
    absent: Sequence[str],
    progress: Progress | None,
) -> tuple[list[Group], int]:
    """Group the clips by the joints that they share with a body, and count those that share too few.

    Parameters
    ----------
    main, index : forest of the library, and the clips that have all joints of this.
    absent : joints that the body lacks.
    progress : called while forests for parts are learned.
    """
    whole = find_feature_set(find_feature_set(main.feature_set).base)
    members: dict[tuple[str, ...], list[int]] = defaultdict(list)
    members[find_feature_set(main.feature_set).without(absent).hidden] += index.list_ids()
    for clip_id, lacking in index.partial.items():
        members[whole.without([*absent, *lacking.split()]).hidden].append(clip_id)
    groups, n_left_out = [], 0
    for hidden, ids in members.items():
        if not ids:
            continue
        if hidden == main.hidden:
            groups.append(Group(main, index, index.living, partial(_read_poses, database, main)))
            continue
        part = parts.load(main, hidden, progress=progress) if is_comparable(hidden) else None
        if part is None:
            n_left_out += len(ids)
            continue
        groups.append(Group(part.stored, part.index, part.index.choose(None, ids), part.read_poses))
    return groups, n_left_out


def _read_poses(database: Database, main: StoredForest, ids: Sequence[int]) -> NDArray[np.float32]:
    with database.reading() as connection:
        return load_poses(connection, ids, main.feature_set)


def rank_groups(
    groups: Sequence[Group],
    ask: Callable[[Group], Sequence[Asked]],
    k: int,
    by: str,
    category: str | None = None,
    among: Collection[int] | None = None,
) -> tuple[tuple[Hit, ...], int | None]:
    """Find the k clips that are most like a motion, or like its mirror image, with comparable distances.

    OptionError for an unknown ranking.

    Parameters
    ----------
    ask : returns the motion, and its mirror image if wanted, as the forest of a group sees them.
    by : one of ``dousa.retrieval.ranking.ranking.RANKINGS``.
    category, among : search only clips of this category, or of these numbers; None for all.

    Returns
    -------
    The clips, and the number of all that are similar; None if likeness was not learned, or there are several groups.
    """
    ranked: list[list[tuple[Group, RankedRows]]] = []
    for group in groups:
        chosen = group.chosen & group.index.choose(category, among)
        count = k if len(groups) == 1 else int(chosen.sum())  # several groups need the median of all distances
        rows = (rank_rows(group.index, one, count, by, chosen, group.read_poses) for one in ask(group))
        ranked.append([(group, found) for found in rows])
    hits = [hit for side in zip(*ranked, strict=True) for hit in _make_comparable(side, k)]
    if len(ranked) != 1:
        return choose_best(hits, k), None
    similar = [found.similar for _, found in ranked[0] if found.similar is not None]
    n_alike = len(np.unique(np.concatenate(similar))) if len(similar) == len(ranked[0]) else None
    return number_hits(hits) if len(ranked[0]) == 1 else choose_best(hits, k), n_alike


def _make_comparable(ranked: Sequence[tuple[Group, RankedRows]], k: int) -> Iterator[Hit]:
    """Yield the first k clips of every group, with distances that are comparable between groups."""
    placed = [count_placed(group.stored.hidden) for group, _ in ranked]
    most = max(placed)
    typical = _find_median(ranked[placed.index(most)][1].distances)
    for (group, found), n_placed in zip(ranked, placed, strict=True):
        for hit in found.hits(k):
            yield replace(_blend(hit, n_placed / most, typical), hidden=group.stored.hidden)


def _find_median(distances: FloatArray) -> float:
    known = distances[~np.isnan(distances)]
    return float(np.median(known)) if len(known) else 0.0


def _blend(hit: Hit, share: float, typical: float) -> Hit:
    if hit.rank_distance is None or share == 1.0:
        return hit
    return replace(hit, rank_distance=share * hit.rank_distance + (1.0 - share) * typical)


def check_threshold(threshold: float | None) -> None:
    """Raise OptionError for a probability outside 0 to 1."""
    if threshold is not None and not 0 <= threshold <= 1:
        raise OptionError("library_search.threshold", threshold=threshold)


def judge(stored: StoredForest, answers: TreeAnswers, features: FloatArray, threshold: float | None) -> list[Verdict]:
    """Predict the categories of N motions.

    ``answers``, ``features`` : tree answers, and the features (N, frames, columns) that they are about.
    ``threshold`` : probability of being right below which a motion is unknown; None for the calibrated one, 0 for
    never.
    """
    shares = answers.shares()
    if stored.assessor is None or not len(shares):
        odds = weigh(shares, None, 1.0)
        return [_name(stored, own, int(row.argmax()), float(row.max())) for own, row in zip(shares, odds, strict=True)]
    seen = stored.assessor.assess(answers.leaves, features)
    unknown = seen.unknown if threshold is None else seen.confidence < threshold
    verdicts = []
    for row, strange in enumerate(unknown):
        verdict = _name(stored, shares[row], int(seen.guess[row]), float(seen.odds[row]))
        verdicts.append(
            replace(
                verdict,
                category=None if strange else verdict.guess,
                known=float(seen.known[row]),
                confidence=float(seen.confidence[row]),
                perhaps=bool(strange and seen.possible[row]),
            )
        )
    return verdicts


def _name(stored: StoredForest, shares: FloatArray, guess: int, odds: float) -> Verdict:
    """Return the verdict on a motion without knowing how far it can be trusted."""
    order = np.argsort(-shares, kind="stable")  # equals keep their order
    histogram = {stored.categories[index]: float(shares[index]) for index in order}
    return Verdict(stored.categories[guess], stored.categories[guess], None, None, histogram, odds=odds)


def list_sides(stored: StoredForest, motion: StoredMotion, mirror: bool | None) -> list[StoredMotion]:
    """List what is asked about: the motion, and its mirror image if wanted, or if there is evidence to choose by."""
    chooses = stored.assessor is not None and find_feature_set(stored.feature_set).has_banks
    return [motion, motion.mirror()] if mirror or (mirror is None and chooses) else [motion]


def _ask(
    stored: StoredForest, motion: StoredMotion | None, mirror: bool | None
) -> tuple[list[StoredMotion], list[Asked]]:
    """List the sides of a motion, and what a forest says of each; nothing of no motion."""
    sides = [] if motion is None else list_sides(stored, motion, mirror)
    return sides, [ask_forest(stored, one, mirrored=number > 0) for number, one in enumerate(sides)]


def choose_side(verdicts: Sequence[Verdict], mirror: bool | None) -> tuple[slice, tuple[Message, ...]]:
    """Choose which of the sides of ``list_sides`` are answered about, and what is said of that: one if not asked."""
    if mirror is not None or len(verdicts) < 2:
        return slice(None), ()
    mirrored = verdicts[1].fits_better_than(verdicts[0])
    return (slice(1, 2), (Message("verdict.taken_mirrored"),)) if mirrored else (slice(0, 1), ())


class Explaining:
    """Explains the answers of one forest."""

    def __init__(self, stored: StoredForest) -> None:
        from dousa.retrieval.explain.explanation import Explainer

        self._feature_set = stored.feature_set
        self._explainer = Explainer(stored.forest)

    def verdicts(self, verdicts: Sequence[Verdict], motions: Sequence[StoredMotion]) -> list[Verdict]:
        """Add reasons to the verdicts on motions."""
        explained = []
        for verdict, own in zip(verdicts, motions, strict=True):
            features = describe_clip(own, self._feature_set).features
            reasons = self._explainer.explain(features, own.duration, verdict.guess)
            explained.append(replace(verdict, explanation=reasons))
        return explained

    def hit(self, hit: Hit, motion: StoredMotion, other: StoredMotion) -> Hit:
        """Add the reasons why a clip is like the query or its mirror image."""
        own = motion.mirror() if hit.mirrored else motion
        first, second = (describe_clip(one, self._feature_set).features for one in (own, other))
        return replace(hit, likeness=self._explainer.explain_pair(first, second, (own.duration, other.duration)))


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options of a search, as in ``Library.search``."""

    k: int
    ranking: str
    same_category: bool = False
    mirror: bool | None = None
    explain: bool = False
    threshold: float | None = None
    among: frozenset[int] | None = None


class Searcher:
    """Searches and classifies motions, also of bodies that lack joints.

    The index stays in memory until the revision of the library changes.
    """

    def __init__(self, database: Database, forests: ForestCache, parts: PartForests) -> None:
        self._database, self._forests, self._parts = database, forests, parts
        self._index: LeafIndex | None = None
        self._poses: dict[int, NDArray[np.float32]] = {}

    def search(
        self, query: Query, wanted: Wanted, options: ReadOptions, progress: Progress | None = None
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
                name = name_query(query)
                doubts = (*doubts, *note_long(motion.duration, lambda: _read_usual(connection)))
            else:
                name, doubts = self._name(connection, index, query), read_doubts(connection, clip_id)
                if wanted.mirror or wanted.explain or index.partial:
                    (motion,) = load_motions(connection, [clip_id])
                wanted = replace(wanted, mirror=bool(wanted.mirror))
            whole = motion is None or not lacks(stored.feature_set, " ".join(motion.absent))
            if whole and not index.partial:
                read_poses = partial(self._read_poses, connection, stored.feature_set)
                groups = [Group(stored, index, index.living, read_poses)]
                sides, asked = _ask(stored, motion, wanted.mirror)
                if clip_id is not None:
                    features = load_features(connection, stored.feature_set, [clip_id]).features
                    asked = [Asked(index.answers_of(clip_id), features, read_poses([clip_id])[0]), *asked[1:]]
                found = self._answer(connection, name, (stored, groups), (sides, asked), wanted)
                hits = tuple(replace(hit, hidden=()) for hit in found.results)  # no body lacks what the forest uses
                return replace(found, results=hits, notes=(*doubts, *found.notes))
        assert motion is not None
        part, note = self._parts.choose(stored, motion.absent, progress)
        if part is None:
            assert note is not None
            raise InvalidMotionError(note)
        query_seen = _ask(part, motion, wanted.mirror)
        groups, n_left_out = group_clips(self._database, self._parts, stored, index, motion.absent, progress)
        with self._database.reading() as connection:
            found = self._answer(connection, name, (part, groups), query_seen, wanted)
        notes = [*doubts, *([] if note is None else [note]), *found.notes]
        others = sum(hit.hidden != part.hidden for hit in found.results)
        notes += [Message("partial.some_hits", n=others)] if others else []
        notes += [Message("partial.left_out", n=n_left_out)] if n_left_out else []
        return replace(found, notes=tuple(notes), alike_count=None)

    def _answer(
        self,
        connection: sa.Connection,
        name: str,
        among: tuple[StoredForest, Sequence[Group]],
        query: tuple[Sequence[StoredMotion], Sequence[Asked]],
        wanted: Wanted,
    ) -> SearchResult:
        """Judge a query, and find what is most like it.

        ``among`` : the forest that judges it, and the clips by the joints that they share with it.
        ``query`` : the motion and perhaps its mirror image, as of ``list_sides`` (none of a stored clip whose numbers
        suffice), and what that forest says of each.
        """
        stored, groups = among
        sides, asked = query
        verdicts = [judge(stored, one.answers, one.features, wanted.threshold)[0] for one in asked]
        chosen, notes = choose_side(verdicts, wanted.mirror)
        verdicts, own, motions = verdicts[chosen], asked[chosen], sides[chosen]
        category = verdicts[0].guess if wanted.same_category else None

        def ask(group: Group) -> Sequence[Asked]:
            if group.stored is stored:
                return own
            return [ask_forest(group.stored, side, one.mirrored) for side, one in zip(motions, own, strict=True)]

        hits, n_alike = rank_groups(groups, ask, wanted.k, wanted.ranking, category, wanted.among)
        if wanted.explain:
            explaining = {group.stored.hidden: Explaining(group.stored) for group in groups}
            verdicts = explaining.setdefault(stored.hidden, Explaining(stored)).verdicts(verdicts, motions)
            found = load_motions(connection, [hit.clip_id for hit in hits])
            both = zip(hits, found, strict=True)
            hits = tuple(explaining[hit.hidden].hit(hit, sides[0], other) for hit, other in both)
        mirrored = verdicts[1] if wanted.mirror else None
        return SearchResult(name, verdicts[0], hits, wanted.ranking, mirrored, notes, n_alike)

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
        mirror: bool | None,
        explain: bool,
        threshold: float | None,
        options: ReadOptions,
        n_jobs: int | None,
        progress: Progress | None = None,
    ) -> list[Classification]:
        """Predict the categories of files, as ``Library.classify`` does."""
        check_threshold(threshold)
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
        files, missing = find_motion_files(paths)
        tasks = [ReadTask(str(file.path), options, feature_set=stored.feature_set) for file in files]
        explaining = {stored.feature_set: Explaining(stored)} if explain else None
        choose = lru_cache(maxsize=None)(lambda absent: self._parts.choose(stored, absent, progress))
        answers: list[Classification] = []

        @lru_cache
        def read_usual() -> float:
            with self._database.reading() as connection:
                return _read_usual(connection)

        for item in (*missing, *read_clips(tasks, n_jobs)):
            if isinstance(item, ClipRecord):
                asked, note = choose(item.motion.absent)
                if asked is None:
                    answers.append(Classification(item.path, None, problem=note))
                    continue
                known = item.description if asked is stored else None
                sides = list_sides(asked, item.motion, mirror)
                described = [known or describe_clip(item.motion, asked.feature_set)]
                described += [describe_clip(one, asked.feature_set) for one in sides[1:]]
                features = np.stack([one.features for one in described])
                verdicts = judge(asked, ask_trees(asked, features), features, threshold)
                chosen, said = choose_side(verdicts, mirror)
                verdicts = verdicts[chosen]
                if explaining is not None:
                    own = explaining.setdefault(asked.feature_set, Explaining(asked))
                    verdicts = own.verdicts(verdicts, sides[chosen])
                notes = [*list_doubts(item), *note_long(item.motion.duration, read_usual), *said]
                notes += [] if note is None else [note]
                mirrored = verdicts[1] if mirror else None
                answers.append(Classification(item.path, verdicts[0], mirrored, None, tuple(notes)))
            elif isinstance(item, Skipped):
                answers.append(Classification(item.path, None, problem=item.reason))
        return answers

    def _load_index(self, connection: sa.Connection, stored: StoredForest) -> LeafIndex:
        known, database = self._index, self._database
        index = load_index(connection, database.where, stored, known, may_write=not database.is_read_only)
        if index is not known:
            self._index, self._poses = index, {}
        return index

    def _read_poses(
        self, connection: sa.Connection, feature_set: str, ids: Sequence[int], *, most: int = 16_384
    ) -> NDArray[np.float32]:
        """Return (N, cells, columns) pose sequences of clips, and keep ``most`` of them, 4 kB each, for later."""
        kept = self._poses  # a local name, as another thread may replace it
        missing = [clip_id for clip_id in ids if clip_id not in kept]
        if len(kept) + len(missing) > most:
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


def note_long(
    seconds: float, read_usual: Callable[[], float], *, least: float = 10.0, factor: float = 2.0
) -> tuple[Message, ...]:
    """Return a note for a motion that is much longer than the clips of the library, so probably an uncut recording.

    It lasts ``least`` s at least, and ``factor`` times what ``read_usual`` returns, which is asked only then; larger
    numbers give fewer notes.
    """
    if seconds < least or seconds < factor * (longest := read_usual()):
        return ()
    return (Message("library_search.like_a_take", seconds=seconds, longest=longest),)


def _read_usual(connection: sa.Connection, share: float = 0.99) -> float:
    """Read the s that this share of the clips last at most; infinity for no clips."""
    table = schema.clips.c
    durations = connection.execute(sa.select(table.duration).where(table.kind == schema.CLIP)).scalars().all()
    return float(np.quantile(durations, share)) if durations else math.inf
