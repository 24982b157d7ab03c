"""Looking into takes: those of the library with the windows that it keeps, and others that are described on the fly."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import DousaError, InvalidMotionError, LibraryDamagedError, LibraryError, MotionFileError
from dousa.formats.motion_files import ReadOptions, Skipped, find_motion_files, is_unicode
from dousa.library import schema
from dousa.library.engine import Database, choose_jobs
from dousa.library.features import StoredMotion, describe_clip, find_feature_set, lacks, load_motions, round_positions
from dousa.library.forests import ForestCache, StoredForest, ask_trees
from dousa.library.ingest import ClipRecord, Query, ReadTask, is_as_stored, name_query, read_clips, read_query
from dousa.library.partial.forests import PartForests
from dousa.library.results import MIRROR_SCORE, FindResult, Place
from dousa.library.search import PartProgress
from dousa.library.selection import fetch_in, find_row
from dousa.library.text.meanings import find_meanings
from dousa.library.windows.keeper import WindowKeeper
from dousa.messages import Message
from dousa.retrieval.features.partial_bodies import count_placed, hide_joints
from dousa.retrieval.forest.likeness import merge_votes

if TYPE_CHECKING:
    from dousa.library.windows.scanning import TakesOnDisk
    from dousa.retrieval.takes.find import CutStretch, Found
    from dousa.retrieval.takes.windows import TakeWindows, WindowGrid

_ALIKE = 0.5
_TRIES = 8  # times that files of windows are looked into, where one after the other is gone
_SAME_PLACE = 0.3  # intersection over union of two answers that are the same place
_MOST_KEPT = 1 << 29  # bytes of windows that stay in memory: some 10 hours of takes, 20 in a training


def describe_windows(
    stored: StoredForest, motion: StoredMotion, n_jobs: int | None = 1, grid: WindowGrid | None = None
) -> TakeWindows:
    """The windows of a recording, by default those that the library keeps; a very short one has none."""
    from dousa.retrieval.takes.windows import describe_take

    kind = find_feature_set(stored.feature_set)
    seen = hide_joints(motion, kind.hidden)
    return describe_take(stored.forest, kind, seen, grid or stored.grid, n_jobs=choose_jobs(n_jobs))


def describe_takes(
    connection: sa.Connection,
    stored: StoredForest,
    known: Mapping[int, bytes] | None = None,
    n_jobs: int | None = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, bytes]:
    """Windows of takes, by number, but those that this forest described already are ``known``.

    Of all, unless these are many: then of some, and ``refresh_windows`` describes the others when they are written.
    ``progress`` is called with (takes described, takes to describe).
    """
    table = schema.clips.c
    rows = connection.execute(sa.select(table.id, table.absent).where(table.kind == schema.TAKE))
    ids = [row.id for row in rows if not lacks(stored.feature_set, row.absent)]
    windows = {clip_id: known[clip_id] for clip_id in ids if known and clip_id in known}
    new = [clip_id for clip_id in ids if clip_id not in windows]
    size = sum(map(len, windows.values()))
    for done, clip_id in enumerate(new, 1):
        if size > _MOST_KEPT:
            break
        (motion,) = load_motions(connection, [clip_id])  # one at a time: they are long
        windows[clip_id] = describe_windows(stored, motion, n_jobs).to_bytes()
        size += len(windows[clip_id])
        if progress is not None:
            progress(done, len(new))
    return windows


def save_windows(connection: sa.Connection, stored: StoredForest, windows: Mapping[int, bytes]) -> None:
    """Write the windows of takes of which nothing is written yet."""
    if windows:
        rows = [{"clip_id": clip_id, "learned": stored.learned, "data": data} for clip_id, data in windows.items()]
        connection.execute(sa.insert(schema.take_windows), rows)


def refresh_windows(
    database: Database,
    stored: StoredForest,
    n_jobs: int | None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Describe the takes anew that an earlier state of the forest described; each is written when it is done.

    ``progress`` is called with (takes described, takes to describe).
    """
    clips, table = schema.clips.c, schema.take_windows.c
    query = sa.select(clips.id, clips.absent).where(clips.kind == schema.TAKE)
    query = query.join(schema.take_windows, table.clip_id == clips.id, isouter=True)
    with database.reading() as connection:
        rows = connection.execute(query.where(table.learned.is_distinct_from(stored.learned)))
        stale = [row.id for row in rows if not lacks(stored.feature_set, row.absent)]
    for done, clip_id in enumerate(stale, 1):
        with database.reading() as connection:
            (motion,) = load_motions(connection, [clip_id])
        windows = describe_windows(stored, motion, n_jobs).to_bytes()
        if not _replace_windows(database, stored, clip_id, windows):
            return  # another program has changed the library, and sees to it
        if progress is not None:
            progress(done, len(stale))


def _replace_windows(database: Database, stored: StoredForest, clip_id: int, windows: bytes) -> bool:
    """Write the windows of a take, if forest and take are still there."""
    clips, table = schema.clips.c, schema.take_windows
    with database.writing() as connection:
        now = connection.execute(sa.select(schema.forests.c.learned)).scalar_one_or_none()
        there = connection.execute(sa.select(clips.id).where(clips.id == clip_id)).scalar_one_or_none()
        if now != stored.learned or there is None:
            return False
        connection.execute(sa.delete(table).where(table.c.clip_id == clip_id))
        save_windows(connection, stored, {clip_id: windows})
    return True


@dataclass(frozen=True, slots=True, eq=False)
class ReadTake:
    """A take whose windows can be looked at.

    Parameters
    ----------
    path : its file.
    clip_id : its number in the library, None for a file that is not there.
    read : gives its windows; of many takes not all are in memory at a time.
    stored : that forest: the present one, or one for the joints that take and query have in common.
    motion : of a take that is not in the library.
    """

    path: str
    clip_id: int | None
    read: Callable[[], TakeWindows]
    stored: StoredForest
    motion: StoredMotion | None = None


@dataclass(frozen=True, slots=True)
class Describing:
    """How takes are described that are not kept.

    Parameters
    ----------
    stored : the forest of the library.
    choose : gives the forest for a body that lacks some joints, and the grid of its windows; or None, and why.
    options : what is said about files.
    n_jobs : parts described at a time.
    """

    stored: StoredForest
    choose: Callable[[Sequence[str]], tuple[tuple[StoredForest, WindowGrid] | None, Message | None]]
    options: ReadOptions
    n_jobs: int | None

    def describe(self, path: str, clip_id: int | None, motion: StoredMotion) -> ReadTake | Skipped:
        """A recording with its windows, or why it has none."""
        chosen, why = self.choose(motion.absent)
        if chosen is None:
            assert why is not None
            return Skipped(path, why)
        stored, grid = chosen
        kept = motion if clip_id is None else None
        windows = describe_windows(stored, motion, self.n_jobs, grid)
        return ReadTake(path, clip_id, lambda: windows, stored, kept)


class Takes:
    """Looks into takes, and keeps windows of the library's in memory until the forest or the takes change.

    Of many takes those that come first, and the others are read each time.
    """

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
        progress: PartProgress | None = None,
    ) -> FindResult:
        """The places of takes that are most like a motion; as ``Library.find``."""
        with self._database.reading() as connection:
            stored = self._forests.load(connection)
            name, motion = self._read_query(connection, query, options)

            def choose(
                absent: Sequence[str],
            ) -> tuple[tuple[StoredForest, WindowGrid] | None, Message | None]:
                part, note = self._parts.choose(stored, {*motion.absent, *absent}, progress)
                return (None if part is None else (part, stored.grid)), note

            part, note = self._parts.choose(stored, motion.absent, progress)
            if part is None:
                assert note is not None
                raise InvalidMotionError(note)
            describing = Describing(stored, choose, options, n_jobs)
            if takes is None:
                chosen, skipped = self.all_takes(connection, describing)
            else:
                chosen, skipped = self.chosen(connection, describing, takes)
            asked = [motion, motion.mirror()] if mirror else [motion], chosen, k
            numbers = None if takes is None else {take.clip_id for take in chosen if take.clip_id is not None}
            far = None if exact else (connection, stored, numbers)
            found, seconds, sketched = self._find(far, asked, progress)
            places = _judge_places(connection, stored, motion, chosen, _rank(found, chosen, k))
        notes = [] if note is None else [note]
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
            alike_count=_count_alike(stored, places),
        )

    def _find(
        self,
        far: tuple[sa.Connection, StoredForest, set[int] | None] | None,
        asked: tuple[Sequence[StoredMotion], Sequence[ReadTake], int],
        progress: PartProgress | None,
    ) -> tuple[list[tuple[Found, bool]], float, list[Message]]:
        """``_find``, in the files of windows if there are many, without any that is damaged."""
        from dousa.library.windows.portions import PortionGoneError
        from dousa.library.windows.scanning import MOST_COMPARED

        if far is None:
            return *_find(*asked), []
        connection, stored, numbers = far
        read = partial(self._read, connection, stored, keep=False)
        for _ in range(_TRIES):
            on_disk = self._keeper.open(connection, stored, numbers, read, progress)
            if on_disk is None:
                break
            try:
                found = _find(*asked, (stored, on_disk))
            except PortionGoneError as gone:
                self._keeper.drop(gone.path, damaged=gone.damaged)
            except OSError:  # while a file is read
                break
            else:
                return *found, [Message("library_takes.sketched", n=MOST_COMPARED)] if on_disk.leaves_out else []
        return *_find(*asked), []

    def _read_query(self, connection: sa.Connection, query: Query, options: ReadOptions) -> tuple[str, StoredMotion]:
        """The name and the motion of a query."""
        if not isinstance(query, int):
            return name_query(query), round_positions(read_query(query, options))
        path = find_row(connection, self._database.where, query).path
        (motion,) = load_motions(connection, [query])
        return path, motion

    def all_takes(self, connection: sa.Connection, describing: Describing) -> tuple[list[ReadTake], list[Skipped]]:
        """Every take of the library, in the order of their paths; LibraryError where there are none.

        Those that share too little of the body with the query are named.
        """
        table = schema.clips.c
        query = sa.select(table.id, table.path, table.absent).where(table.kind == schema.TAKE)
        rows = sorted(connection.execute(query).all(), key=lambda row: row.path)
        if not rows:
            raise LibraryError("library_takes.none", library=self._database.where)
        answers = self._read_rows(connection, describing, rows)
        return _part_skipped(answers)

    def _read_rows(
        self, connection: sa.Connection, describing: Describing, rows: Sequence[Any]
    ) -> list[ReadTake | Skipped]:
        """Takes of the library: of those that the forest of the library describes the windows are kept."""
        answers: dict[int, ReadTake | Skipped] = {}
        kept = []
        for row in rows:
            chosen, why = describing.choose(row.absent.split())
            if chosen is None:
                assert why is not None
                answers[row.id] = Skipped(row.path, why)
            elif chosen[0] is describing.stored:
                kept.append(row)
            else:
                part = self._describe_part(connection, row.id, *chosen)
                answers[row.id] = ReadTake(row.path, row.id, partial(_give, part), chosen[0])
        for row in kept:
            read = partial(self._read, connection, describing.stored, row.id)
            answers[row.id] = ReadTake(row.path, row.id, read, describing.stored)
        return [answers[row.id] for row in rows]

    def _describe_part(
        self, connection: sa.Connection, number: int, stored: StoredForest, grid: WindowGrid
    ) -> TakeWindows:
        """Windows of a take by a forest for a part of the body; the last ones stay in memory."""
        known = self._part_windows.get(number)
        if known is not None and known[0] is stored and known[1].grid == grid:
            return known[1]
        (motion,) = load_motions(connection, [number])
        windows = describe_windows(stored, motion, None, grid)
        self._part_windows[number] = stored, windows
        return windows

    def chosen(
        self, connection: sa.Connection, describing: Describing, wanted: Sequence[Query]
    ) -> tuple[list[ReadTake], list[Skipped]]:
        """Takes by number, file or folder, or as motions, each once; and the files that cannot be used.

        A file that is in the library, and has not changed since, is not read: its windows are kept.
        """
        takes: list[ReadTake] = []
        skipped: list[Skipped] = []
        seen: set[str] = set()
        for item in wanted:
            some: Sequence[ReadTake]
            if isinstance(item, int):
                some, missing = _part_skipped([self._by_number(connection, describing, item)])
                skipped += missing
            elif isinstance(item, str | os.PathLike):
                some, missing = self._by_path(connection, describing, item)
                skipped += missing
            else:
                motion = round_positions(read_query(item, describing.options))
                some, missing = _part_skipped([describing.describe(name_query(item), None, motion)])
                takes += some
                skipped += missing
                continue  # motions may have one name
            takes += [take for take in some if take.path not in seen]
            seen.update(take.path for take in some)
        return takes, skipped

    def read_single(
        self, connection: sa.Connection, take: Query, options: ReadOptions
    ) -> tuple[str, int | None, StoredMotion]:
        """Path, number in the library (None for a file that is not there) and motion of one recording.

        A file that is in the library, and has not changed since, is not read.
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
            return name_query(take), None, round_positions(read_query(take, options))
        if number is not None:
            (motion,) = load_motions(connection, [number])
            return path, number, motion
        (answer,) = read_clips([ReadTask(path, options, kind=schema.TAKE)], 1)
        if isinstance(answer, ClipRecord):
            return path, None, answer.motion
        raise MotionFileError(str(take), answer.reason if isinstance(answer, Skipped) else skipped[0].reason)

    def _by_number(self, connection: sa.Connection, describing: Describing, number: int) -> ReadTake | Skipped:
        row = find_row(connection, self._database.where, number)
        if row.kind == schema.TAKE:
            return self._read_rows(connection, describing, [row])[0]
        (motion,) = load_motions(connection, [number])
        return describing.describe(row.path, number, motion)

    def _by_path(
        self, connection: sa.Connection, describing: Describing, path: str | os.PathLike[str]
    ) -> tuple[list[ReadTake], list[Skipped]]:
        files, skipped = find_motion_files([path])
        paths = [str(file.path) for file in files]
        rows = self._rows(connection, paths or [os.path.abspath(path)])
        if not paths and rows:  # its file is gone, and the library kept it
            paths, skipped = list(rows), []
        else:
            rows = {name: row for name, row in rows.items() if is_as_stored(row, describing.options)}
        kept = dict(zip(rows, self._read_rows(connection, describing, list(rows.values())), strict=True))
        tasks = [ReadTask(name, describing.options, kind=schema.TAKE) for name in paths if name not in rows]
        read = {answer.path: answer for answer in read_clips(tasks, describing.n_jobs)}
        takes: list[ReadTake | Skipped] = []
        for name in paths:
            answer = read.get(name)
            if isinstance(answer, ClipRecord):
                takes.append(describing.describe(name, None, answer.motion))
            elif name in rows:
                takes.append(kept[name])
        there, lacking = _part_skipped(takes)
        return there, [*skipped, *(answer for answer in read.values() if isinstance(answer, Skipped)), *lacking]

    def _rows(self, connection: sa.Connection, paths: Sequence[str]) -> dict[str, Any]:
        """Takes of the library, by path."""
        table = schema.clips.c
        query = sa.select(table.id, table.path, table.fingerprint, table.read_options, table.absent)
        query = query.where(table.kind == schema.TAKE)
        names = [path for path in paths if is_unicode(path)]
        return {row.path: row for row in fetch_in(connection, query, table.path, names)}

    def _read(self, connection: sa.Connection, stored: StoredForest, clip_id: int, *, keep: bool = True) -> TakeWindows:
        """Windows of a take; those that are not stored are described. They stay in memory, if they shall and can."""
        from dousa.retrieval.takes.windows import TakeWindows

        if self._learned != stored.learned:
            self._learned, self._windows, self._kept_bytes = stored.learned, {}, 0
        known = self._windows.get(clip_id)
        if known is not None:
            return known
        table, where = schema.take_windows.c, self._database.where
        query = sa.select(table.data).where(table.learned == stored.learned, table.clip_id == clip_id)
        data = connection.execute(query).scalar_one_or_none()
        if data is None:
            (motion,) = load_motions(connection, [clip_id])
            windows = describe_windows(stored, motion, None)
            self._keep(stored, clip_id, windows)
        else:
            try:
                windows = TakeWindows.from_bytes(data)
            except DousaError as error:
                raise LibraryDamagedError(
                    "library_takes.damaged", library=where, number=clip_id, problem=error
                ) from error
            # Leaves are looked up by number, so there must be such leaves.
            trees, leaves = stored.forest.trees_, windows.leaves
            if leaves.shape[1] != len(trees.roots) or (leaves.size and leaves.max() >= trees.n_leaves):
                raise LibraryDamagedError("library_takes.other_forest", library=where, number=clip_id)
        if keep and self._kept_bytes + windows.n_bytes <= _MOST_KEPT:
            self._windows[clip_id] = windows
            self._kept_bytes += windows.n_bytes
        return windows

    def _keep(self, stored: StoredForest, clip_id: int, windows: TakeWindows) -> None:
        """Write windows that had to be described, such as after a program was stopped; unless that cannot be."""
        if self._keeps and not self._database.is_read_only:
            try:
                _replace_windows(self._database, stored, clip_id, windows.to_bytes())
            except LibraryError:
                self._keeps = False  # once is enough to wait for others


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
    """MotionFileError for a folder of other than one recording, before any of them is read."""
    if isinstance(take, str | os.PathLike) and os.path.isdir(take):
        files, _ = find_motion_files([take])
        if len(files) != 1:
            raise MotionFileError(take, "library_takes.not_one_file", n_files=len(files))


def _give(windows: TakeWindows) -> TakeWindows:
    return windows


def _find(
    motions: Sequence[StoredMotion],
    takes: Sequence[ReadTake],
    k: int,
    on_disk: tuple[StoredForest, TakesOnDisk] | None = None,
) -> tuple[list[tuple[Found, bool]], float]:
    """The best places of the query, and of its mirror image if there is one, and the seconds of all takes.

    Takes that are compared by the same joints are ordered together. Each is read once, and again where a place is; but
    those that are ``on_disk``, by a forest.
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
                search.look(str(row), windows)  # two files may have one name, and numbers are compared fast
        if far is not None:
            far.search(searches, wanted)
        # Of a body of which less can be compared, less is known to be alike.
        share = count_placed(kind.hidden) / most
        for mirrored, search in enumerate(searches):
            places = search.finish(partial(_look_again, takes, rows, far))
            found += [(one if share == 1.0 else replace(one, score=one.score * share), mirrored > 0) for one in places]
    return found, sum(seconds[row] for row in range(len(takes)))


def _look_again(
    takes: Sequence[ReadTake], rows: Sequence[int], far: TakesOnDisk | None, place: int
) -> TakeWindows | CutStretch:
    """The take at one of the rows: its windows, or what cuts stretches out of it."""
    take = takes[rows[place]]
    if far is not None and take.clip_id is not None and take.clip_id in far:
        return far.cutter(take.clip_id)
    return take.read()


def _rank(found: list[tuple[Found, bool]], takes: Sequence[ReadTake], k: int) -> list[Place]:
    """Places of the query and of its mirror image, best first, each once."""
    from dousa.retrieval.takes.find import overlap

    found.sort(key=lambda one: (one[1] * MIRROR_SCORE - one[0].score, int(one[0].take), one[0].start))
    kept: list[tuple[Found, bool]] = []
    for one, mirrored in found:
        same = (
            other.take == one.take and overlap((one.start, one.stop), (other.start, other.stop)) >= _SAME_PLACE
            for other, _ in kept
        )
        if not any(same):
            kept.append((one, mirrored))
    places = []
    for rank, (one, mirrored) in enumerate(kept[:k], 1):
        take, measures = takes[int(one.take)], (one.score, one.distance, one.shared_leaves, one.tempo)
        places.append(Place(take.path, take.clip_id, one.start, one.stop, *measures, mirrored, rank))
    return places


def _judge_places(
    connection: sa.Connection, stored: StoredForest, query: StoredMotion, takes: Sequence[ReadTake], places: list[Place]
) -> list[Place]:
    """Places with the probability that they show what the query does, the likeliest first.

    Each is looked at as a clip of its own; those that are likelier so than not are alike.
    """
    from dousa.retrieval.takes.find import judge_place

    if stored.likeness is None or not places or any(take.stored is not stored for take in takes):
        return places  # bodies that lack joints are looked at by forests of their own
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
        shares, told, direction = _describe_alike(stored, part, meanings)
        own = asked[place.mirrored]
        likeness = float(stored.likeness.judge(*own[1:], told[None], direction[None])[0])
        chance = judge_place(likeness, place.score, float(shares[own[0].argmax()]))
        judged.append((chance, replace(place, alike=chance >= _ALIKE, probability=round(chance, 4))))
    judged.sort(key=lambda one: -one[0])
    return [replace(place, rank=rank) for rank, (_, place) in enumerate(judged, 1)]


def _count_alike(stored: StoredForest, places: Sequence[Place]) -> int | None:
    judged = [place.alike for place in places if place.alike is not None]
    return None if stored.likeness is None or len(judged) < len(places) else sum(judged)


def _describe_alike(
    stored: StoredForest, motion: StoredMotion, meanings: IndexArray
) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
    """Shares of the trees for each category and for each meaning, and the direction, of a motion."""
    answers = ask_trees(stored, describe_clip(motion, stored.feature_set).features[None])
    assert answers.directions is not None
    shares = answers.shares()
    return shares[0], merge_votes(shares, meanings)[0], answers.directions[0]
