"""Looking into takes: where is something like this, and what happens when."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from dousa.errors import MotionFileError
from dousa.library._describing import StoredMotion, find_feature_set, load_motions, round_positions
from dousa.library._engine import reading
from dousa.library._forests import StoredForest
from dousa.library._labelling import LabellerShelf, LearnProgress
from dousa.library._queries import name_query, read_query
from dousa.library._querying import Querying
from dousa.library._taking import Describing, ReadTake, TakeShelf, check_single
from dousa.library.ingest import ReadOptions
from dousa.library.reports import Skipped
from dousa.library.take_answers import FindResult, LabelledTake, Place

if TYPE_CHECKING:
    from dousa.retrieval.finding import Found
    from dousa.retrieval.labelling import TakeLabeller
    from dousa.retrieval.streaming import LiveLabeller

__all__ = ["Finding"]

_CLEARLY = 0.02  # a mirror image must fit better by this much of the score: many motions are their own
_SAME_PLACE = 0.3  # intersection over union of two answers that are the same place


class Finding:
    """The side of a library that looks into takes.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    querying : keeps its forest warm.
    """

    def __init__(self, engine: sa.Engine, where: str, querying: Querying) -> None:
        self._engine = engine
        self._where = where
        self._querying = querying
        self._shelf = TakeShelf(where)
        self._labellers = LabellerShelf(engine, where)

    def find(
        self,
        query: Any,
        takes: Sequence[Any] | None,
        k: int,
        mirror: bool,
        options: ReadOptions,
        n_jobs: int | None,
    ) -> FindResult:
        """The places of takes that are most like a motion."""
        with reading(self._engine, self._where) as connection:
            stored = self._querying.load(connection)
            name, motion = self._read(connection, query, options)
            skipped: list[Skipped] = []
            if takes is None:
                chosen = self._shelf.all_takes(connection, stored)
            else:
                describing = Describing(stored, stored.grid, options, n_jobs)
                chosen, skipped = self._shelf.chosen(connection, describing, takes)
        found = [(place, False) for place in _find(stored, motion, chosen, k)]
        if mirror:
            found += [(place, True) for place in _find(stored, motion.mirror(), chosen, k)]
        return FindResult(
            query=name,
            duration=motion.duration,
            n_takes=len(chosen),
            seconds=sum(take.windows.duration for take in chosen),
            results=tuple(_rank(found, chosen, k)),
            skipped=tuple(skipped),
        )

    def label(
        self,
        take: Any,
        threshold: float | None,
        options: ReadOptions,
        n_jobs: int | None,
        progress: LearnProgress | None,
        examples: Sequence[int] = (),
    ) -> LabelledTake:
        """What happens in a take."""
        from dousa.retrieval.labelling import label_take

        check_single(take)
        stored, labeller = self._labeller(n_jobs, progress, examples)
        with reading(self._engine, self._where) as connection:
            describing = Describing(stored, labeller.grid, options, n_jobs)
            chosen, skipped = self._shelf.chosen(connection, describing, [take])
        if not chosen:
            raise MotionFileError(os.fspath(take), skipped[0].reason)
        timeline = label_take(labeller, chosen[0].windows, threshold=threshold)
        return LabelledTake(chosen[0].path, chosen[0].clip_id, timeline)

    def live(
        self,
        height: float | None,
        threshold: float | None,
        n_jobs: int | None,
        progress: LearnProgress | None,
    ) -> LiveLabeller:
        """Labels frames as they come."""
        from dousa.retrieval.streaming import LiveLabeller

        stored, labeller = self._labeller(n_jobs, progress)
        kind = find_feature_set(stored.feature_set)
        return LiveLabeller(stored.forest, kind, labeller, height=height, threshold=threshold)

    def _labeller(
        self, n_jobs: int | None, progress: LearnProgress | None, examples: Sequence[int] = ()
    ) -> tuple[StoredForest, TakeLabeller]:
        with reading(self._engine, self._where) as connection:
            stored = self._querying.load(connection)
        return stored, self._labellers.get(stored, n_jobs, progress, examples)

    def _read(self, connection: sa.Connection, query: Any, options: ReadOptions) -> tuple[str, StoredMotion]:
        """The name and the motion of a query."""
        if not isinstance(query, int):
            return name_query(query), round_positions(read_query(query, options))
        path = self._querying.path_of(connection, query)
        (motion,) = load_motions(connection, [query])
        return path, motion


def _find(stored: StoredForest, motion: StoredMotion, takes: Sequence[ReadTake], k: int) -> list[Found]:
    from dousa.retrieval.finding import describe_query, find_in_takes

    query = describe_query(stored.forest, find_feature_set(stored.feature_set), motion)
    # Named by their place in the list: two files may have one name, and numbers are compared fast.
    return find_in_takes(query, [(str(row), take.windows) for row, take in enumerate(takes)], limit=k)


def _rank(found: list[tuple[Found, bool]], takes: Sequence[ReadTake], k: int) -> list[Place]:
    """Places of the query and of its mirror image, best first, each once."""
    from dousa.retrieval.finding import overlap

    found.sort(key=lambda one: (one[1] * _CLEARLY - one[0].score, int(one[0].take), one[0].start))
    kept: list[tuple[Found, bool]] = []
    for one, mirrored in found:
        same = (
            other.take == one.take
            and overlap((one.start, one.stop), (other.start, other.stop)) >= _SAME_PLACE
            for other, _ in kept
        )
        if not any(same):
            kept.append((one, mirrored))
    places = []
    for rank, (one, mirrored) in enumerate(kept[:k], 1):
        take = takes[int(one.take)]
        places.append(
            Place(
                take=take.path,
                clip_id=take.clip_id,
                start=one.start,
                end=one.stop,
                score=one.score,
                distance=one.distance,
                shared_leaves=one.shared_leaves,
                tempo=one.tempo,
                mirrored=mirrored,
                rank=rank,
            )
        )
    return places
