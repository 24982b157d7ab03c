"""What takes are labelled with: learned from the clips when a take is first labelled, and kept with the forest."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryDamagedError, LibraryError, MotionFileError
from dousa.formats.motion_files import ReadOptions
from dousa.library import schema
from dousa.library.engine import Database, choose_jobs
from dousa.library.features import StoredMotion, find_feature_set, lacks, load_features, load_motions
from dousa.library.forests import ForestCache, StoredForest
from dousa.library.ingest import Query
from dousa.library.partial.forests import PartForests
from dousa.library.results import LabelledTake
from dousa.library.schema import stack
from dousa.library.selection import fetch_in
from dousa.library.takes import Describing, Takes, check_single, describe_windows
from dousa.messages import Message
from dousa.retrieval.features.partial_bodies import hide_joints

if TYPE_CHECKING:
    from dousa.retrieval import LabelledClip
    from dousa.retrieval.features.posed_motion import PosedMotion
    from dousa.retrieval.takes.label import TakeLabeller
    from dousa.retrieval.takes.live import LiveLabeller
    from dousa.retrieval.takes.windows import TakeWindows, WindowGrid

LearnProgress = Callable[[int, int, Message], None]
"""Called with (steps done, steps, message about the next step)."""

_MOST_HELD = 400  # clips of other categories of which the same must be said after an example
_MOST_CLIPS = 1500  # that a labeller learns from: it learns how actions follow one another, not what they are


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """A labeller, its forest, how many clips that had learned since its training, and the examples known then."""

    stored: StoredForest
    labeller: TakeLabeller
    n_learned: int
    examples: frozenset[int]


class Labellers:
    """Labels takes; what it labels with is learned where there is none for the present forest."""

    def __init__(self, database: Database, forests: ForestCache, takes: Takes, parts: PartForests) -> None:
        self._database = database
        self._forests = forests
        self._takes = takes
        self._parts = parts
        self._of_parts: dict[str, tuple[StoredForest, TakeLabeller]] = {}
        self._last: _Kept | None = None
        self._examples: dict[int, TakeWindows] = {}
        self._taught: tuple[tuple[tuple[int, str], ...], TakeLabeller] | None = None

    def label(
        self,
        take: Query,
        threshold: float | None,
        examples: Sequence[int],
        options: ReadOptions,
        n_jobs: int | None,
        progress: LearnProgress | None,
    ) -> LabelledTake:
        """What happens in a take; as ``Library.label``."""
        from dousa.retrieval.takes.label import label_take

        check_single(take)
        stored = self._load()
        labeller = self.get(stored, n_jobs, progress, examples)
        notes: list[Message] = []

        def choose(
            absent: Sequence[str],
        ) -> tuple[tuple[StoredForest, WindowGrid] | None, Message | None]:
            nonlocal labeller
            part, note = self._parts.choose(stored, absent, progress)
            if part is None:
                return None, note
            if part is not stored:
                labeller = self._get_part(part, n_jobs, progress)
            notes.extend([] if note is None else [note])
            return (part, labeller.grid), note

        with self._database.reading() as connection:
            describing = Describing(stored, choose, options, n_jobs)
            chosen, skipped = self._takes.chosen(connection, describing, [take])
        if not chosen:
            raise MotionFileError(str(take), skipped[0].reason)
        timeline = label_take(labeller, chosen[0].windows, threshold=threshold)
        return LabelledTake(chosen[0].path, chosen[0].clip_id, timeline, tuple(notes))

    def _get_part(self, part: StoredForest, n_jobs: int | None, progress: LearnProgress | None) -> TakeLabeller:
        """What takes of bodies that lack joints are labelled with; it stays in memory, and examples do not teach it."""
        known = self._of_parts.get(part.feature_set)
        if known is None or known[0] is not part:
            known = part, self._learn(part, n_jobs, progress)
            self._of_parts[part.feature_set] = known
        return known[1]

    def live(
        self,
        height: float | None,
        threshold: float | None,
        n_jobs: int | None,
        progress: LearnProgress | None,
    ) -> LiveLabeller:
        """Labels frames as they come; as ``Library.live``."""
        from dousa.retrieval.takes.live import LiveLabeller

        stored = self._load()
        labeller = self.get(stored, n_jobs, progress)
        kind = find_feature_set(stored.feature_set)
        return LiveLabeller(stored.forest, kind, labeller, height=height, threshold=threshold)

    def _load(self) -> StoredForest:
        with self._database.reading() as connection:
            return self._forests.load(connection)

    def get(
        self,
        stored: StoredForest,
        n_jobs: int | None,
        progress: LearnProgress | None,
        examples: Sequence[int] = (),
    ) -> TakeLabeller:
        """The labeller of a forest, taught by examples: clips of which those without a category are left out.

        Where the library can be written the labeller is kept in it; else the next program learns it again.
        """
        base = self._get_base(stored, n_jobs, progress, frozenset(examples))
        if not examples:
            return base
        with self._database.reading() as connection:
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
            with self._database.reading() as connection:
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
        from dousa.retrieval.takes.labeller_training import carry_labeller

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
        from dousa.retrieval.takes.labeller_training import Example, teach_labeller

        new = [number for number, _ in labels if number not in self._examples]
        for number, motion in zip(new, load_motions(connection, new), strict=True):
            self._examples[number] = describe_windows(stored, motion, n_jobs, base.grid)
        held = _read_held(connection, stored, {name for _, name in labels})
        return teach_labeller(base, [Example(self._examples[number], name) for number, name in labels], held)

    def _read(self, stored: StoredForest) -> TakeLabeller | None:
        from dousa.retrieval.takes.label import TakeLabeller

        table = schema.forests.c
        query = sa.select(table.labeller).where(table.learned == stored.learned)
        with self._database.reading() as connection:
            data = connection.execute(query).scalar_one_or_none()
        if data is None:
            return None
        try:
            return TakeLabeller.from_bytes(data)
        except DousaError as error:
            raise LibraryDamagedError(
                "library_forest.part_damaged", library=self._database.where, problem=error
            ) from error

    def _learn(self, stored: StoredForest, n_jobs: int | None, progress: LearnProgress | None) -> TakeLabeller:
        from dousa.retrieval.takes.labeller_training import train_labeller

        def report(done: int, total: int) -> None:
            if progress is not None:
                progress(done, total, Message("library_training.labeller"))

        with self._database.reading() as connection:
            clips, ids = _read_clips(connection, stored)
            if not clips:
                raise LibraryError("library_training.clips_gone", library=self._database.where)
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
            with self._database.writing() as connection:
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
    columns = (clips.id, clips.path, clips.category, clips.performer, clips.absent)
    query = sa.select(*columns).where(clips.kind == schema.CLIP)
    rows = [
        row
        for row in connection.execute(query)
        if row.category in set(stored.categories) and not lacks(stored.feature_set, row.absent)
    ]
    # Every n-th clip of every category.
    rows.sort(key=lambda row: (row.category, row.id))
    chosen = (
        [rows[place] for place in np.unique(np.linspace(0, len(rows) - 1, _MOST_CLIPS).astype(int))] if rows else []
    )
    ids = [row.id for row in chosen]
    return [
        LabelledClip(row.path, row.category, row.performer, motion.positions, motion.frame_rate, motion.height)
        for row, motion in zip(chosen, _complete(load_motions(connection, ids), stored), strict=True)
    ], ids


def _complete(motions: Iterable[StoredMotion], stored: StoredForest) -> Iterator[PosedMotion]:
    """Motions that can be joined to takes: hidden joints get places, though nobody looks at them."""
    kind = find_feature_set(stored.feature_set)
    for motion in motions:
        yield kind.complete(hide_joints(motion, kind.hidden))


def _read_labels(connection: sa.Connection, numbers: Sequence[int]) -> tuple[tuple[int, str], ...]:
    """Numbers and categories of those clips that are there and have one, by number."""
    clips = schema.clips.c
    query = sa.select(clips.id, clips.category).where(clips.category.is_not(None))
    there = sorted({number for number in numbers if schema.is_id(number)})
    found = fetch_in(connection, query, clips.id, there)
    return tuple(sorted((int(row.id), str(row.category)) for row in found))


def _read_held(connection: sa.Connection, stored: StoredForest, taught: Collection[str]) -> NDArray[np.int32]:
    """(H, n_trees) leaves of clips of categories that are not taught: every n-th of every category."""
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(clips.id, clips.category).join(schema.clip_leaves, table.clip_id == clips.id)
    rows = [row for row in connection.execute(query) if row.category is not None and row.category not in taught]
    rows.sort(key=lambda row: (row.category, row.id))
    step = max(len(rows) / _MOST_HELD, 1.0)
    ids = [int(rows[int(place)].id) for place in np.arange(0, len(rows), step)]
    leaves = [row.leaves for row in fetch_in(connection, sa.select(table.leaves), table.clip_id, ids)]
    return stack(leaves, "<i4", (len(stored.forest.trees_.roots),), "leaves")
