"""Search in takes: those of the library with stored windows, and others that are described when needed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import InvalidMotionError, LibraryError, MotionFileError
from dousa.formats.motion_files import ReadOptions, Skipped, find_motion_files, is_unicode
from dousa.library.results import MIRROR_SCORE, FindResult, Place
from dousa.library.search.part_forests import PartForests
from dousa.library.search.text_store import find_meanings
from dousa.library.store import schema
from dousa.library.store.engine import Database
from dousa.library.store.features import StoredMotion, describe_clip, find_feature_set, load_motions
from dousa.library.store.forests import ForestCache, StoredForest, ask_trees
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
from dousa.library.store.rows import fetch_in
from dousa.library.store.selection import find_row, read_doubts
from dousa.library.takes.windows import MOST_KEPT, WindowKeeper, describe_windows, read_windows, replace_windows
from dousa.messages import Message, Progress
from dousa.retrieval.features.posed_motion import count_placed, hide_joints
from dousa.retrieval.forest.likeness import merge_votes

if TYPE_CHECKING:
    from dousa.library.takes.scanning import TakesOnDisk
    from dousa.retrieval.takes.find import CutStretch, Found
    from dousa.retrieval.takes.windows import TakeWindows


@dataclass(frozen=True, slots=True, eq=False)
class ReadTake:
    """A take with its windows.

    Parameters
    ----------
    clip_id : number in the library; None for a file outside it.
    read : returns the windows; not all takes fit in memory.
    stored : forest of the windows: the library's, or one for the joints shared by take and query.
    motion : of a take outside the library.
    notes : notes on reading its file, if it was read now.
    """

    path: str
    clip_id: int | None
    read: Callable[[], TakeWindows]
    stored: StoredForest
    motion: StoredMotion | None = None
    notes: tuple[Message, ...] = ()


def find_places(
    motions: Sequence[StoredMotion],
    takes: Sequence[ReadTake],
    k: int,
    on_disk: tuple[StoredForest, TakesOnDisk] | None = None,
) -> tuple[list[tuple[Found, bool]], float]:
    """Find the best places for a query and, if given, its mirror image; also return the seconds of all takes.

    Takes that share the same joints with the query are searched together, those ``on_disk`` without reading all.
    """
    from dousa.retrieval.takes.find import TakeSearch, describe_query

    groups: dict[int, tuple[StoredForest, list[int]]] = {}
    for row, take in enumerate(takes):
        groups.setdefault(id(take.stored), (take.stored, []))[1].append(row)
    most = max((count_placed(stored.hidden) for stored, _ in groups.values()), default=1)
    found: list[tuple[Found, bool]] = []
    seconds = {}
    for stored, rows in groups.values():
        kind = find_feature_set(stored.feature_set)
        queries = [describe_query(stored.forest, kind, hide_joints(motion, kind.hidden)) for motion in motions]
        searches = [TakeSearch(query, k) for query in queries]
        far = on_disk[1] if on_disk is not None and on_disk[0] is stored else None
        wanted: dict[int, int] = {}
        for place, row in enumerate(rows):
            number = takes[row].clip_id
            if far is not None and number is not None and number in far:
                wanted[number] = place
                seconds[row] = far.duration(number)
                for search in searches:
                    search.include(str(row))
                continue
            windows = takes[row].read()
            seconds[row] = windows.duration
            for search in searches:
                search.look(str(row), windows)  # the row, as two files may have one name
        if far is not None:
            far.search(searches, wanted)
        # The score counts only for the share of the joints that is compared.
        share = count_placed(kind.hidden) / most
        for mirrored, search in enumerate(searches):
            places = search.finish(partial(_look_again, takes, rows, far))
            found += [(one if share == 1.0 else replace(one, score=one.score * share), mirrored > 0) for one in places]
    return found, sum(seconds[row] for row in range(len(takes)))


def _look_again(
    takes: Sequence[ReadTake], rows: Sequence[int], far: TakesOnDisk | None, place: int
) -> TakeWindows | CutStretch:
    """Return the windows of the take at one of the rows, or its cutter if it is on disk."""
    take = takes[rows[place]]
    if far is not None and take.clip_id is not None and take.clip_id in far:
        return far.cutter(take.clip_id)
    return take.read()


def rank_places(
    found: list[tuple[Found, bool]], takes: Sequence[ReadTake], k: int, *, shared: float = 0.3
) -> list[Place]:
    """Rank places of the query and of its mirror image, the best first, each once.

    Places whose intersection over union is ``shared`` are one place; less leaves out more of them.
    """
    from dousa.retrieval.takes.find import overlap

    found.sort(key=lambda one: (one[1] * MIRROR_SCORE - one[0].score, int(one[0].take), one[0].start))
    kept: list[tuple[Found, bool]] = []
    for one, mirrored in found:
        same = (
            other.take == one.take and overlap((one.start, one.stop), (other.start, other.stop)) >= shared
            for other, _ in kept
        )
        if not any(same):
            kept.append((one, mirrored))
    places = []
    for rank, (one, mirrored) in enumerate(kept[:k], 1):
        take, measures = takes[int(one.take)], (one.score, one.distance, one.shared_leaves, one.tempo)
        places.append(Place(take.path, take.clip_id, one.start, one.stop, *measures, mirrored, rank))
    return places


def judge_places(
    connection: sa.Connection,
    stored: StoredForest,
    query: StoredMotion,
    takes: Sequence[ReadTake],
    places: list[Place],
    *,
    threshold: float = 0.5,
) -> list[Place]:
    """Rank places by the probability that they show the same as the query, each judged as a clip.

    They probably show it from the threshold on; a higher one calls fewer of them similar.
    """
    from dousa.retrieval.takes.find import judge_place

    if stored.likeness is None or not places or any(take.stored is not stored for take in takes):
        return places  # likeness is learned for the library's forest only
    by_path = {(take.path, take.clip_id): take for take in takes}
    known = {take.clip_id: take.motion for take in takes if take.motion is not None}
    wanted = sorted({place.clip_id for place in places if place.clip_id is not None})
    known |= dict(zip(wanted, load_motions(connection, wanted), strict=True))
    named = find_meanings(stored.categories)
    meanings = np.unique([named[name] for name in stored.categories], return_inverse=True)[1]
    asked = [_describe_alike(stored, motion, meanings) for motion in (query, query.mirror())]
    judged: list[tuple[float, Place]] = []
    for place in places:
        whole = by_path[place.take, place.clip_id].motion or known[place.clip_id]
        first = min(round(place.start * whole.frame_rate), whole.n_frames - 1)
        last = max(round(place.end * whole.frame_rate), first + 1)
        part = StoredMotion(whole.positions[first:last], whole.frame_rate, whole.height)
        shares, means, direction = _describe_alike(stored, part, meanings)
        own = asked[place.mirrored]
        likeness = float(stored.likeness.judge(*own[1:], means[None], direction[None])[0])
        chance = judge_place(likeness, place.score, float(shares[own[0].argmax()]))
        judged.append((chance, replace(place, alike=chance >= threshold, probability=round(chance, 4))))
    judged.sort(key=lambda one: -one[0])
    return [replace(place, rank=rank) for rank, (_, place) in enumerate(judged, 1)]


def count_alike(stored: StoredForest, places: Sequence[Place]) -> int | None:
    judged = [place.alike for place in places if place.alike is not None]
    return None if stored.likeness is None or len(judged) < len(places) else sum(judged)


def _describe_alike(
    stored: StoredForest, motion: StoredMotion, meanings: IndexArray
) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
    """Compute a motion's shares of the trees for each category and meaning, and its direction."""
    answers = ask_trees(stored, describe_clip(motion, stored.feature_set).features[None])
    assert answers.directions is not None
    shares = answers.shares()
    return shares[0], merge_votes(shares, meanings)[0], answers.directions[0]


@dataclass(frozen=True, slots=True)
class _Reading:
    """Reads takes for one search, and describes those whose windows are not stored.

    Parameters
    ----------
    stored : the forest of the library.
    choose : returns the forest for a body that lacks some joints, with a note; or None, with the reason.
    options, n_jobs : of reading files, and parts described at a time.
    """

    connection: sa.Connection
    stored: StoredForest
    choose: Callable[[Sequence[str]], tuple[StoredForest | None, Message | None]]
    options: ReadOptions
    n_jobs: int | None

    def describe(
        self, path: str, clip_id: int | None, motion: StoredMotion, notes: tuple[Message, ...] = ()
    ) -> ReadTake | Skipped:
        """Describe the windows of a recording, or return why it is skipped."""
        chosen, why = self.choose(motion.absent)
        if chosen is None:
            assert why is not None
            return Skipped(path, why)
        windows = describe_windows(chosen, motion, self.n_jobs, self.stored.grid)
        return ReadTake(path, clip_id, partial(_give, windows), chosen, motion if clip_id is None else None, notes)


class Takes:
    """Searches in takes, and keeps the first windows in memory until the forest learns."""

    def __init__(self, database: Database, forests: ForestCache, parts: PartForests) -> None:
        self._database = database
        self._forests = forests
        self._parts = parts
        self._part_windows: dict[int, tuple[StoredForest, TakeWindows]] = {}
        self._learned: int | None = None
        self._windows: dict[int, TakeWindows] = {}
        self._kept_bytes = 0
        self._keeps = True
        self._keeper = WindowKeeper(database)

    def find(
        self,
        query: Query,
        takes: Sequence[Query] | None,
        k: int,
        *,
        mirror: bool,
        exact: bool = False,
        options: ReadOptions,
        n_jobs: int | None,
        progress: Progress | None = None,
    ) -> FindResult:
        """Find the places of takes that are most like a motion, as ``Library.find`` does."""
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
            name, motion, doubts = self._read_query(connection, query, options)

            def choose(absent: Sequence[str]) -> tuple[StoredForest | None, Message | None]:
                return self._parts.choose(stored, {*motion.absent, *absent}, progress)

            part, note = choose(())
            if part is None:
                assert note is not None
                raise InvalidMotionError(note)
            reading = _Reading(connection, stored, choose, options, n_jobs)
            chosen, skipped = self._list_all(reading) if takes is None else self._list_chosen(reading, takes)
            asked = [motion, motion.mirror()] if mirror else [motion], chosen, k
            numbers = None if takes is None else {take.clip_id for take in chosen if take.clip_id is not None}
            far = None if exact else (connection, stored, numbers)
            found, seconds, sketched = self._find(far, asked, progress)
            places = judge_places(connection, stored, motion, chosen, rank_places(found, chosen, k))
        said = [(name, doubts), *((take.path, take.notes) for take in chosen)]
        notes = [Message("text.in_file", path=path, problem=doubt) for path, own in said for doubt in own]
        notes += [] if note is None else [note]
        fewer = sum(take.stored.hidden != part.hidden for take in chosen)
        if fewer:
            notes.append(Message("partial.some_takes", n=fewer))
        notes += sketched
        return FindResult(
            query=name,
            duration=motion.duration,
            n_takes=len(chosen),
            seconds=seconds,
            results=tuple(places),
            skipped=tuple(skipped),
            notes=tuple(notes),
            alike_count=count_alike(stored, places),
        )

    def _find(
        self,
        far: tuple[sa.Connection, StoredForest, set[int] | None] | None,
        asked: tuple[Sequence[StoredMotion], Sequence[ReadTake], int],
        progress: Progress | None,
        *,
        tries: int = 8,
    ) -> tuple[list[tuple[Found, bool]], float, list[Message]]:
        """Run ``find_places``, with files if the windows are many; damaged files are dropped.

        After so many tries, each of which found a file gone, all windows are read into memory.
        """
        from dousa.library.takes.portions import PortionGoneError

        if far is None:
            return *find_places(*asked), []
        connection, stored, numbers = far
        read = partial(self._read, connection, stored, keep=False)
        for _ in range(tries):
            on_disk = self._keeper.open(connection, stored, numbers, read, progress)
            if on_disk is None:
                break
            try:
                found = find_places(*asked, (stored, on_disk))
            except PortionGoneError as gone:
                self._keeper.drop(gone.path, damaged=gone.damaged)
            except OSError:  # while a file is read
                break
            else:
                return *found, [Message("library_takes.sketched", n=on_disk.n_compared)] if on_disk.leaves_out else []
        return *find_places(*asked), []

    def _read_query(
        self, connection: sa.Connection, query: Query, options: ReadOptions
    ) -> tuple[str, StoredMotion, tuple[Message, ...]]:
        """Return the name and motion of a query, and notes on reading it."""
        if not isinstance(query, int):
            return name_query(query), *read_rounded(query, options)
        path = find_row(connection, self._database.where, query).path
        (motion,) = load_motions(connection, [query])
        return path, motion, read_doubts(connection, query)

    def _list_all(self, reading: _Reading) -> tuple[list[ReadTake], list[Skipped]]:
        """Return all takes, sorted by path, and those that share too few joints; LibraryError if there are none."""
        table = schema.clips.c
        query = sa.select(table.id, table.path, table.absent).where(table.kind == schema.TAKE)
        rows = sorted(reading.connection.execute(query).all(), key=lambda row: row.path)
        if not rows:
            raise LibraryError("library_takes.none", library=self._database.where)
        return _part_skipped(self._read_rows(reading, rows))

    def _read_rows(self, reading: _Reading, rows: Sequence[Any]) -> list[ReadTake | Skipped]:
        """Return takes of the library, with stored windows where these are of its forest."""
        answers: list[ReadTake | Skipped] = []
        for row in rows:
            chosen, why = reading.choose(row.absent.split())
            if chosen is None:
                assert why is not None
                answers.append(Skipped(row.path, why))
                continue
            if chosen is reading.stored:
                read = partial(self._read, reading.connection, chosen, row.id)
            else:
                read = partial(_give, self._describe_part(reading, row.id, chosen))
            answers.append(ReadTake(row.path, row.id, read, chosen))
        return answers

    def _describe_part(self, reading: _Reading, number: int, stored: StoredForest) -> TakeWindows:
        """Describe a take by a forest for a part of the body; the last windows stay in memory."""
        known, grid = self._part_windows.get(number), reading.stored.grid
        if known is not None and known[0] is stored and known[1].grid == grid:
            return known[1]
        (motion,) = load_motions(reading.connection, [number])
        windows = describe_windows(stored, motion, None, grid)
        self._part_windows[number] = stored, windows
        return windows

    def _list_chosen(self, reading: _Reading, wanted: Sequence[Query]) -> tuple[list[ReadTake], list[Skipped]]:
        """Return takes given by number, path or as motions, each path once, and the skipped files.

        A file that is unchanged in the library is not read.
        """
        takes: list[ReadTake] = []
        skipped: list[Skipped] = []
        seen: set[str] = set()
        for item in wanted:
            if isinstance(item, int):
                some, missing = _part_skipped([self._by_number(reading, item)])
            elif isinstance(item, str | os.PathLike):
                some, missing = self._by_path(reading, item)
            else:
                motion, doubts = read_rounded(item, reading.options)
                some, missing = _part_skipped([reading.describe(name_query(item), None, motion, doubts)])
            skipped += missing
            if isinstance(item, int | str | os.PathLike):  # motions may have one name
                some = [take for take in some if take.path not in seen]
                seen.update(take.path for take in some)
            takes += some
        return takes, skipped

    def read_single(
        self, connection: sa.Connection, take: Query, options: ReadOptions
    ) -> tuple[str, int | None, StoredMotion, tuple[Message, ...]]:
        """Return path, number (None outside the library), motion and notes of one recording.

        A file that is unchanged in the library is not read.
        """
        number: int | None = None
        if isinstance(take, int):
            path, number = find_row(connection, self._database.where, take).path, take
        elif isinstance(take, str | os.PathLike):
            files, skipped = find_motion_files([take])
            path = str(files[0].path) if files else os.path.abspath(take)
            row = self._rows(connection, [path]).get(path)
            if row is not None and (not files or is_as_stored(row, options)):  # its file may be gone
                number = int(row.id)
            elif not files:
                raise MotionFileError(take, skipped[0].reason)
        else:
            return name_query(take), None, *read_rounded(take, options)
        if number is not None:
            (motion,) = load_motions(connection, [number])
            return path, number, motion, read_doubts(connection, number)
        (answer,) = read_clips([ReadTask(path, options, kind=schema.TAKE)], 1)
        if isinstance(answer, ClipRecord):
            return path, None, answer.motion, list_doubts(answer)
        raise MotionFileError(str(take), answer.reason if isinstance(answer, Skipped) else skipped[0].reason)

    def _by_number(self, reading: _Reading, number: int) -> ReadTake | Skipped:
        row = find_row(reading.connection, self._database.where, number)
        if row.kind == schema.TAKE:
            return self._read_rows(reading, [row])[0]
        (motion,) = load_motions(reading.connection, [number])
        return reading.describe(row.path, number, motion)

    def _by_path(self, reading: _Reading, path: str | os.PathLike[str]) -> tuple[list[ReadTake], list[Skipped]]:
        files, skipped = find_motion_files([path])
        paths = [str(file.path) for file in files]
        rows = self._rows(reading.connection, paths or [os.path.abspath(path)])
        if not paths and rows:  # its file is gone, but it is in the library
            paths, skipped = list(rows), []
        else:
            rows = {name: row for name, row in rows.items() if is_as_stored(row, reading.options)}
        kept = dict(zip(rows, self._read_rows(reading, list(rows.values())), strict=True))
        tasks = [ReadTask(name, reading.options, kind=schema.TAKE) for name in paths if name not in rows]
        read = {answer.path: answer for answer in read_clips(tasks, reading.n_jobs)}
        takes: list[ReadTake | Skipped] = []
        for name in paths:
            answer = read.get(name)
            if isinstance(answer, ClipRecord):
                takes.append(reading.describe(name, None, answer.motion, list_doubts(answer)))
            elif name in rows:
                takes.append(kept[name])
        there, lacking = _part_skipped(takes)
        return there, [*skipped, *(answer for answer in read.values() if isinstance(answer, Skipped)), *lacking]

    def _rows(self, connection: sa.Connection, paths: Sequence[str]) -> dict[str, Any]:
        """Return takes of the library, by path."""
        table = schema.clips.c
        query = sa.select(table.id, table.path, table.fingerprint, table.read_options, table.absent)
        query = query.where(table.kind == schema.TAKE)
        names = [path for path in paths if is_unicode(path)]
        return {row.path: row for row in fetch_in(connection, query, table.path, names)}

    def _read(
        self, connection: sa.Connection, stored: StoredForest, clip_id: int, *, keep: bool = True, room: int = MOST_KEPT
    ) -> TakeWindows:
        """Read or describe the windows of a take; with ``keep`` they stay in memory while there is room, in bytes."""
        if self._learned != stored.learned:
            self._learned, self._windows, self._kept_bytes = stored.learned, {}, 0
        known = self._windows.get(clip_id)
        if known is not None:
            return known
        windows = read_windows(connection, self._database.where, stored, clip_id)
        if windows is None:
            (motion,) = load_motions(connection, [clip_id])
            windows = describe_windows(stored, motion, None)
            self._keep(stored, clip_id, windows)
        if keep and self._kept_bytes + windows.n_bytes <= room:
            self._windows[clip_id] = windows
            self._kept_bytes += windows.n_bytes
        return windows

    def _keep(self, stored: StoredForest, clip_id: int, windows: TakeWindows) -> None:
        """Write windows that were missing, such as after a program was stopped, if possible."""
        if self._keeps and not self._database.is_read_only:
            try:
                replace_windows(self._database, stored, clip_id, windows.to_bytes())
            except LibraryError:
                self._keeps = False  # do not wait for other writers again


def _part_skipped(answers: Iterable[ReadTake | Skipped]) -> tuple[list[ReadTake], list[Skipped]]:
    takes: list[ReadTake] = []
    skipped: list[Skipped] = []
    for answer in answers:
        if isinstance(answer, Skipped):
            skipped.append(answer)
        else:
            takes.append(answer)
    return takes, skipped


def check_single(take: Any) -> None:
    """Raise MotionFileError for a folder without exactly one recording, before any is read."""
    if isinstance(take, str | os.PathLike) and os.path.isdir(take):
        files, _ = find_motion_files([take])
        if len(files) != 1:
            raise MotionFileError(take, "library_takes.not_one_file", n_files=len(files))


def _give(windows: TakeWindows) -> TakeWindows:
    return windows
