"""Opening a motion library and reading its contents."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

import sqlalchemy as sa

from dousa.errors import LibraryError
from dousa.formats.motion_files import ReadOptions
from dousa.library.results import ClipInfo, LibraryStats
from dousa.library.store import schema
from dousa.library.store import selection as _selection
from dousa.library.store.engine import read_revision
from dousa.library.store.features import load_trajectories
from dousa.library.store.forests import ForestCache
from dousa.library.store.opening import open_database
from dousa.library.store.rows import fetch_in
from dousa.library.store.selection import KnownClips, Selection, select_ids

if TYPE_CHECKING:
    from dousa.library.export import ExportProgress, ExportReport
    from dousa.library.store.engine import Database
    from dousa.motion import Trajectories


class LibraryContents:
    """The part of `dousa.library.Library` that reads and exports clips, their joints and labels.

    Parameters
    ----------
    database : with the tables of a library.
    """

    def __init__(self, database: Database) -> None:
        self.database = database
        self._forests = ForestCache(database.where)
        self._last = threading.local()

    @classmethod
    def open(
        cls, path_or_url: str | os.PathLike[str], *, create: bool = False, read_only: bool = False, timeout: float = 5.0
    ) -> Self:
        """Open a library, or make one.

        Parameters
        ----------
        path_or_url : a file of any name, by custom ``NAME.dousa``; or the SQLAlchemy URL of a database.
        create : make a library that does not exist.
        read_only : refuse every change.
        timeout : s to wait while another program writes.

        Raises
        ------
        LibraryError : no library there, no such folder, no permission.
        LibraryDamagedError : not a library, or damaged.
        LibraryVersionError : written by a newer dousa.
        LibraryLockedError : another program is writing, longer than the timeout.

        >>> with dousa.Library.open("moves.dousa", read_only=True) as library:
        ...     len(library.clips())
        12
        """
        return cls(open_database(path_or_url, create=create, read_only=read_only, timeout=timeout))

    @property
    def name(self) -> str:
        """The path or URL it was opened with.

        >>> library.name
        'moves.dousa'
        """
        return self.database.where

    def close(self) -> None:
        """Close the file; the library opens again when it is used.

        >>> library.close()
        """
        self.database.engine.dispose()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def clips(
        self,
        selection: Selection | None = None,
        *,
        category: str | None = None,
        performer: str | None = None,
        tag: str | None = None,
    ) -> list[ClipInfo]:
        """Return clips and takes sorted by path: all, or those chosen.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer, tag : only clips of this label, with this tag.

        Raises
        ------
        LibraryError : nothing fits.

        >>> [clip.id for clip in library.clips(category="squat")]
        [1, 2, 3, 4]
        """
        with self.database.reading() as connection:
            if selection is None and category is None and performer is None and tag is None:
                return _selection.list_clips(connection)
            chosen = () if selection is None else selection
            ids = select_ids(connection, self.name, chosen, category, performer, tag)
            return _selection.list_clips(connection, ids)

    def renew_clips(self, known: KnownClips | None = None) -> KnownClips:
        """Return all clips and takes by number; only changes since the ``known`` result are read.

        >>> known = library.renew_clips()
        >>> len(known.clips)
        12
        """
        with self.database.reading() as connection:
            return _selection.renew_clips(connection, known or KnownClips())

    def iterate_clips(self, *, category: str | None = None, performer: str | None = None) -> Iterator[ClipInfo]:
        """Yield clips and takes (of these labels) in the order of their numbers, a thousand in memory at a time.

        Clips added meanwhile are included; suitable for a million clips.

        >>> sum(clip.duration > 1.0 for clip in library.iterate_clips())
        12
        """
        last = 0
        while True:
            with self.database.reading() as connection:
                page = _selection.read_page(connection, last, category, performer)
            yield from page
            if not page:
                return
            last = page[-1].id

    @property
    def revision(self) -> int:
        """Number of the last write, of this program or another; equal if nothing has changed.

        >>> before, removed = library.revision, library.remove(1)
        >>> library.revision > before
        True
        """
        with self.database.reading() as connection:
            return read_revision(connection)

    def contents(self, clip_ids: Sequence[int]) -> dict[int, str]:
        """Return content hashes and read options of clips and takes, by number, to identify data derived from them.

        Missing numbers are left out.

        >>> list(library.contents([1, 2, 999]))
        [1, 2]
        """
        clips = schema.clips.c
        query = sa.select(clips.id, clips.content_hash, clips.read_options)
        wanted = [number for number in clip_ids if schema.is_id(number)]
        with self.database.reading() as connection:
            rows = fetch_in(connection, query, clips.id, wanted)
            return {row.id: f"{row.content_hash} {row.read_options}" for row in rows}

    def trajectories(self, clip_id: int) -> Trajectories:
        """Return the canonical joints of a clip, in metres.

        Raises
        ------
        LibraryError : no such clip; LibraryDamagedError: its numbers are damaged.

        >>> library.trajectories(1).positions.shape[1:]
        (20, 3)
        """
        found = dict(self.iterate_trajectories([clip_id]))
        if clip_id not in found:
            raise LibraryError("library_clips.no_clip", library=self.name, number=clip_id)
        return found[clip_id]

    def iterate_trajectories(self, clip_ids: Sequence[int]) -> Iterator[tuple[int, Trajectories]]:
        """Yield numbers and canonical joints of clips and takes, in any order, one in memory at a time.

        Missing numbers are left out. LibraryDamagedError if the numbers of one are damaged.

        >>> {number: motion.frame_rate for number, motion in library.iterate_trajectories([1, 2])}
        {1: 30.0, 2: 30.0}
        """
        with self.database.reading() as connection:
            yield from load_trajectories(connection, [number for number in clip_ids if schema.is_id(number)])

    def export(
        self,
        path: str | os.PathLike[str],
        selection: Selection | None = None,
        *,
        category: str | None = None,
        performer: str | None = None,
        tag: str | None = None,
        to: str = "original",
        onto: str | os.PathLike[str] | None = None,
        keep_reach: bool = False,
        frame_rate: float | None = None,
        options: ReadOptions | None = None,
        progress: ExportProgress | None = None,
    ) -> ExportReport:
        """Write clips as files, a folder per category, with a ``manifest.csv`` of their labels.

        A repeated call keeps unchanged files, so that an interrupted export goes on. Of a clip whose file is gone the
        stored joints are written, as stated in the column ``from``.

        Parameters
        ----------
        path : folder, made if necessary, in which other files are left alone; or a ZIP file, by its suffix.
        selection : numbers, files, or folders, which stand for all clips below them; by default all.
        category, performer, tag : only clips of this label, with this tag.
        to : name of an output format, such as ``"glb"`` or ``"bvh"``, or ``"original"``.
        onto : file of a character to retarget the motions to; see ``dousa.motion.retarget``.
        keep_reach : keep the places that hands reach, instead of arm directions.
        frame_rate : Hz to resample to.
        options : how to read the files, if not as when they were added.
        progress : called with (clips done, clips, name of the next).

        Returns
        -------
        The files written, kept and skipped.

        Raises
        ------
        LibraryError : nothing fits.
        OptionError : a format that does not exist, the originals put onto a character, a character without a skeleton.

        >>> report = library.export("squats.zip", category="squat", to="trc")
        >>> len(report.written)
        4
        """
        from dousa.library.export import ExportFormat, export_clips

        form = ExportFormat(to, onto, keep_reach, frame_rate)
        clips = self.clips(selection, category=category, performer=performer, tag=tag)
        return export_clips(self, clips, path, form, options, progress)

    def categories(self) -> dict[str, int]:
        """Return the number of clips of each category.

        >>> library.categories()
        {'squat': 4, 'walk': 4, 'wave_right': 4}
        """
        with self.database.reading() as connection:
            return _selection.count_by(connection, "category")

    def stats(self) -> LibraryStats:
        """Return the library in numbers.

        >>> stats = library.stats()
        >>> stats.n_clips, stats.forest_is_current
        (12, True)
        """
        with self.database.reading() as connection:
            return _selection.summarise(connection)
