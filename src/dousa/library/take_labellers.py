"""Labellers of takes: learned with the forest from clips and annotated takes, and kept with it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError, LibraryError, MotionFileError
from dousa.formats.motion_files import ReadOptions
from dousa.library.annotations.store import load_annotated_takes
from dousa.library.results import LabelledTake
from dousa.library.search.part_forests import PartForests
from dousa.library.store import schema
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import StoredMotion, find_feature_set, lacks, load_motions
from dousa.library.store.forests import ForestCache, StoredForest
from dousa.library.store.ingest import Query
from dousa.library.store.rows import fetch_in
from dousa.library.takes.takes import Takes, check_single
from dousa.messages import Count, Message, Progress
from dousa.motion.canonical.joints import find_absent
from dousa.retrieval.features.posed_motion import hide_joints

if TYPE_CHECKING:
    from dousa.retrieval import LabelledClip
    from dousa.retrieval.features.posed_motion import AnnotatedTake, PosedMotion
    from dousa.retrieval.forest.stretches import StretchJudge
    from dousa.retrieval.takes.label import TakeLabeller
    from dousa.retrieval.takes.live import LiveLabeller


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """A labeller, its forest, the number of clips learned since its training, and its examples."""

    stored: StoredForest
    labeller: TakeLabeller
    n_learned: int
    examples: frozenset[int]


class Labellers:
    """Labels takes; a labeller is learned if there is none for the present forest."""

    def __init__(self, database: Database, forests: ForestCache, takes: Takes, parts: PartForests) -> None:
        self._database = database
        self._forests = forests
        self._takes = takes
        self._parts = parts
        self._of_parts: dict[str, tuple[StoredForest, TakeLabeller]] = {}
        self._last: _Kept | None = None
        self._examples: dict[int, StoredMotion] = {}
        self._taught: tuple[tuple[tuple[int, str], ...], TakeLabeller] | None = None

    def label(
        self,
        take: Query,
        threshold: float | None,
        examples: Sequence[int],
        options: ReadOptions,
        n_jobs: int | None,
        progress: Progress | None,
    ) -> LabelledTake:
        """Label a take; as ``Library.label``."""
        from dousa.retrieval.takes.label import label_take

        check_single(take)
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
            path, clip_id, motion, doubts = self._takes.read_single(connection, take, options)
        part, note = self._parts.choose(stored, motion.absent, progress)
        if part is None:
            raise MotionFileError(path, note if note is not None else Message("partial.incomparable", parts=()))
        whole = part is stored
        labeller = self.get(stored, n_jobs, progress, examples) if whole else self._get_part(part, n_jobs, progress)
        seen = _complete(motion, part.feature_set)
        judge = self._find_judge(part, examples if whole else ())
        timeline = label_take(labeller, seen, judge=judge, threshold=threshold, n_jobs=choose_jobs(n_jobs))
        return LabelledTake(path, clip_id, timeline, doubts if note is None else (*doubts, note))

    def _find_judge(self, stored: StoredForest, examples: Sequence[int] = ()) -> StretchJudge | None:
        """Return the judge of segments as clips; it spares the categories of examples."""
        from dousa.retrieval.forest.stretches import StretchJudge

        if stored.assessor is None:
            return None
        judge = StretchJudge(stored.assessor, find_feature_set(stored.feature_set))
        if not examples:
            return judge
        with self._database.reading() as connection:
            return judge.sparing(frozenset(name for _, name in _read_labels(connection, examples)))

    def _get_part(self, part: StoredForest, n_jobs: int | None, progress: Progress | None) -> TakeLabeller:
        """Return the labeller for takes of bodies that lack joints; it does not learn from examples."""
        known = self._of_parts.get(part.feature_set)
        if known is None or known[0] is not part:
            row = schema.part_forests, self._parts.find_row(part)
            labeller = self._read(*row) or self._learn_and_keep(part, *row, n_jobs, progress)
            known = self._of_parts[part.feature_set] = part, labeller
        return known[1]

    def live(
        self, height: float | None, threshold: float | None, n_jobs: int | None, progress: Progress | None
    ) -> LiveLabeller:
        """Return a labeller of single frames; as ``Library.live``."""
        from dousa.retrieval.takes.live import LiveLabeller

        stored = self._load()
        labeller = self.get(stored, n_jobs, progress)
        return LiveLabeller(labeller, height=height, threshold=threshold, judge=self._find_judge(stored))

    def _load(self) -> StoredForest:
        with self._database.reading() as connection:
            return self._forests.load(connection)

    def get(
        self, stored: StoredForest, n_jobs: int | None, progress: Progress | None, examples: Sequence[int] = ()
    ) -> TakeLabeller:
        """Return the labeller of a forest, taught by examples: clips, of which unlabelled ones are left out.

        It is kept in the library if that can be written.
        """
        base = self._get_base(stored, n_jobs, progress, frozenset(examples))
        if not examples:
            return base
        with self._database.reading() as connection:
            labels = _read_labels(connection, examples)
            if self._taught is not None and self._taught[0] == labels:
                return self._taught[1]
            taught = self._teach(connection, base, labels)
        self._taught = (labels, taught)
        return taught

    def _get_base(
        self, stored: StoredForest, n_jobs: int | None, progress: Progress | None, examples: frozenset[int]
    ) -> TakeLabeller:
        """Return the labeller without examples."""
        if self._last is None or self._last.stored.learned != stored.learned:
            with self._database.reading() as connection:
                n_learned = int(connection.execute(sa.select(schema.forests.c.n_learned)).scalar_one())
            row = schema.forests, [schema.forests.c.learned == stored.learned]
            labeller = self._read(*row) or self._carry(n_learned, examples)
            labeller = labeller or self._learn_and_keep(stored, *row, n_jobs, progress)
            self._last = _Kept(stored, labeller, n_learned, examples)
            self._examples, self._taught = {}, None
        elif examples - self._last.examples:
            self._last = replace(self._last, examples=self._last.examples | examples)
        return self._last.labeller

    def _carry(self, n_learned: int, examples: frozenset[int]) -> TakeLabeller | None:
        """Return the last labeller, if the forest has since learned only examples, which are taught anyway."""
        last = self._last
        if last is None or not 0 < n_learned - last.n_learned <= len(examples - last.examples):
            return None
        return last.labeller

    def _teach(
        self, connection: sa.Connection, base: TakeLabeller, labels: tuple[tuple[int, str], ...]
    ) -> TakeLabeller:
        from dousa.retrieval.takes.labeller_training import Example, teach_labeller

        new = [number for number, _ in labels if number not in self._examples]
        self._examples.update(zip(new, load_motions(connection, new), strict=True))
        kind = self._last.stored.feature_set if self._last is not None else ""
        return teach_labeller(base, [Example(_complete(self._examples[number], kind), name) for number, name in labels])

    def _read(self, table: sa.Table, where: Sequence[sa.ColumnElement[bool]]) -> TakeLabeller | None:
        """Read the labeller in the row of a forest; None if there is none."""
        with self._database.reading() as connection:
            data = connection.execute(sa.select(table.c.labeller).where(*where)).scalar_one_or_none()
        return None if data is None else self._unpack(data)

    def _learn_and_keep(
        self,
        stored: StoredForest,
        table: sa.Table,
        where: Sequence[sa.ColumnElement[bool]],
        n_jobs: int | None,
        progress: Progress | None,
    ) -> TakeLabeller:
        """Learn a labeller and write it into the row of its forest, unless the library has another one by now."""
        labeller = self._learn(stored, n_jobs, progress)
        here = sa.update(table).where(*where).values(labeller=labeller.to_bytes())
        self._database.keep(lambda connection: connection.execute(here))
        return labeller

    def _unpack(self, data: bytes) -> TakeLabeller:
        from dousa.retrieval.takes.label import TakeLabeller

        try:
            return TakeLabeller.from_bytes(data)
        except DousaError as error:
            raise LibraryDamagedError("library_forest.damaged", library=self._database.where, problem=error) from error

    def _learn(self, stored: StoredForest, n_jobs: int | None, progress: Progress | None) -> TakeLabeller:
        def report(done: int, total: int) -> None:
            if progress is not None:
                progress(done, total, Message("library_training.labeller"))

        with self._database.reading() as connection:
            labeller = learn_labeller(connection, stored, n_jobs, report)
        if labeller is None:
            raise LibraryError("library_training.clips_gone", library=self._database.where)
        return labeller


def learn_labeller(
    connection: sa.Connection, stored: StoredForest, n_jobs: int | None = None, progress: Count | None = None
) -> TakeLabeller | None:
    """Learn a labeller from a library; None if it holds nothing of these categories.

    The forest has the features and categories; segments of annotated takes may have other categories.
    """
    from dousa.retrieval.takes.labeller_training import train_labeller

    clips, takes = _read_clips(connection, stored), list(_read_takes(connection, stored))
    if not clips and not any(stretch.category is not None for take in takes for stretch in take.stretches):
        return None
    return train_labeller(clips, takes, n_jobs=choose_jobs(n_jobs), progress=progress)


def _read_takes(connection: sa.Connection, stored: StoredForest) -> Iterator[AnnotatedTake]:
    for take in load_annotated_takes(connection):
        if not lacks(stored.feature_set, " ".join(find_absent(take.positions))):
            seen = _complete(take, stored.feature_set)
            yield replace(take, positions=seen.positions, height=seen.height)


def _complete(motion: PosedMotion, feature_set: str) -> PosedMotion:
    """Hide the joints that the features ignore, and fill their places."""
    kind = find_feature_set(feature_set)
    return kind.complete(hide_joints(motion, kind.hidden))


def _read_clips(
    connection: sa.Connection, stored: StoredForest, *, most: int = 1500, at_once: int = 100
) -> list[LabelledClip]:
    """Read clips of the forest's categories that are not segments of takes.

    ``most`` : clips at most, more than a labeller samples moments from; of more every n-th of each category is read.
    ``at_once`` : clips that are in memory at their own frame rate.
    """
    from dousa.retrieval import LabelledClip, guess_performers
    from dousa.retrieval.features.channels import CHANNEL_RATE, sample_positions

    clips, parts = schema.clips.c, schema.segments.c
    query = sa.select(clips.id, clips.path, clips.category, clips.performer, clips.height, clips.absent)
    query = query.join(schema.segments, parts.clip_id == clips.id, isouter=True)
    query = query.where(clips.kind == schema.CLIP, parts.clip_id.is_(None))
    known = set(stored.categories)
    rows = [row for row in connection.execute(query) if row.category in known]
    rows = [row for row in rows if not lacks(stored.feature_set, row.absent)]
    rows.sort(key=lambda row: (row.category, row.id))
    if len(rows) > most:
        rows = [rows[place] for place in np.unique(np.linspace(0, len(rows) - 1, most).astype(int))]
    people = guess_performers([row.height for row in rows])
    chosen = []
    for first in range(0, len(rows), at_once):
        some = slice(first, first + at_once)
        motions = load_motions(connection, [row.id for row in rows[some]])
        for row, who, motion in zip(rows[some], people[some], motions, strict=True):
            # The labeller needs no higher rate, and many clips are in memory.
            seen = _complete(motion, stored.feature_set)
            sampled = sample_positions(seen.positions, seen.frame_rate)
            name = row.performer or who
            chosen.append(LabelledClip(row.path, row.category, name, sampled, CHANNEL_RATE, seen.height))
    return chosen


def _read_labels(connection: sa.Connection, numbers: Sequence[int]) -> tuple[tuple[int, str], ...]:
    clips = schema.clips.c
    query = sa.select(clips.id, clips.category).where(clips.category.is_not(None))
    there = sorted({number for number in numbers if schema.is_id(number)})
    found = fetch_in(connection, query, clips.id, there)
    return tuple(sorted((int(row.id), str(row.category)) for row in found))
