"""The side of a library that lists, counts, changes and hands out clips."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.library import _contents, schema
from dousa.library._arrays import unpack
from dousa.library._engine import reading, writing
from dousa.library._revision import next_revision, read_revision
from dousa.library.reports import ClipInfo, LibraryStats
from dousa.library.selection import UNCHANGED, Selection, Unchanged, portions, select_ids

if TYPE_CHECKING:
    from dousa.motion import Trajectories

__all__ = ["Managing"]


class Managing:
    """What a library knows of its clips without asking the forest."""

    _engine: sa.Engine
    _where: str

    def clips(
        self, selection: Selection | None = None, *, category: str | None = None, performer: str | None = None
    ) -> list[ClipInfo]:
        """Clips and takes in the order of their paths: all, or those chosen.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : only clips of this label.

        Raises
        ------
        LibraryError : nothing fits.
        """
        with reading(self._engine, self._where) as connection:
            if selection is None and category is None and performer is None:
                return _contents.list_clips(connection)
            chosen = () if selection is None else selection
            return _contents.list_clips(
                connection, select_ids(connection, self._where, chosen, category, performer)
            )

    @property
    def revision(self) -> int:
        """Number of the last write, of this program or another; while it is the same, nothing has changed."""
        with reading(self._engine, self._where) as connection:
            return read_revision(connection)

    def contents(self, clip_ids: Sequence[int]) -> dict[int, str]:
        """What stands for the content of clips, by number: whoever keeps something made of a clip knows it by this.

        Parameters
        ----------
        clip_ids : of clips and takes; numbers that are not there are left out.
        """
        clips = schema.clips.c
        query = sa.select(clips.id, clips.content_hash, clips.read_options)
        wanted = [number for number in clip_ids if schema.is_id(number)]
        with reading(self._engine, self._where) as connection:
            return {
                row.id: f"{row.content_hash} {row.read_options}"
                for some in portions(wanted)
                for row in connection.execute(query.where(clips.id.in_(some)))
            }

    def trajectories(self, clip_id: int) -> Trajectories:
        """The canonical joints of a clip, in metres.

        Raises
        ------
        LibraryError : no such clip; LibraryDamagedError: its numbers are damaged.
        """
        found = dict(self.iterate_trajectories([clip_id]))
        if clip_id not in found:
            raise LibraryError(f"{self._where}: no clip {clip_id}; see: dousa list")
        return found[clip_id]

    def iterate_trajectories(self, clip_ids: Sequence[int]) -> Iterator[tuple[int, Trajectories]]:
        """Numbers and canonical joints of many clips, in any order; one at a time is in memory.

        Parameters
        ----------
        clip_ids : of clips and takes; numbers that are not there are left out.

        Raises
        ------
        LibraryDamagedError : the numbers of one are damaged.
        """
        clips, arrays = schema.clips.c, schema.clip_trajectories.c
        query = sa.select(clips.id, clips.path, clips.n_frames, clips.frame_rate, arrays.positions)
        query = query.join(schema.clip_trajectories, arrays.clip_id == clips.id)
        wanted = [number for number in clip_ids if schema.is_id(number)]
        with reading(self._engine, self._where) as connection:
            for some in portions(wanted):
                for row in connection.execute(query.where(clips.id.in_(some))):
                    yield row.id, _unpack(row)

    def remove(
        self, selection: Selection = (), *, category: str | None = None, performer: str | None = None
    ) -> list[str]:
        """Take clips or takes out of the library; their files stay on the disk.

        The forest still knows what it learned from them, until the next training.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : only clips of this label.

        Returns
        -------
        Paths of the clips that were removed.

        Raises
        ------
        OptionError : nothing is chosen.
        LibraryError : something chosen is not there, or the library cannot be written.
        """
        with writing(self._engine, self._where) as connection:
            ids = select_ids(connection, self._where, selection, category, performer)
            paths = [clip.path for clip in _contents.list_clips(connection, ids)]
            if ids:
                next_revision(connection)
                _contents.delete_clips(connection, ids)
        return paths

    def relabel(
        self,
        selection: Selection = (),
        *,
        category: str | Unchanged | None = UNCHANGED,
        performer: str | Unchanged | None = UNCHANGED,
        where_category: str | None = None,
        where_performer: str | None = None,
    ) -> list[str]:
        """Give clips or takes another category or performer; the forest learns of it in the next training.

        Parameters
        ----------
        selection : numbers, files, or folders, which stand for all clips below them.
        category, performer : the new labels, None for no label.
        where_category, where_performer : only clips that have this label now.

        Returns
        -------
        Paths of the clips that were chosen.

        Raises
        ------
        OptionError : nothing is chosen, or no new label is given, or an empty one.
        LibraryError : something chosen is not there, or the library cannot be written.
        """
        if category is UNCHANGED and performer is UNCHANGED:
            raise OptionError("expected a new category or performer, got neither")
        if any(isinstance(label, str) and not label.strip() for label in (category, performer)):
            raise OptionError("expected the name of a category or performer, got an empty one")
        with writing(self._engine, self._where) as connection:
            ids = select_ids(connection, self._where, selection, where_category, where_performer)
            if ids:
                next_revision(connection)
                _contents.set_labels(connection, ids, category, performer)
            return [clip.path for clip in _contents.list_clips(connection, ids)]

    def categories(self) -> dict[str, int]:
        """Number of clips of each category, by name."""
        with reading(self._engine, self._where) as connection:
            return _contents.count_by(connection, "category")

    def stats(self) -> LibraryStats:
        """The library in numbers."""
        with reading(self._engine, self._where) as connection:
            return _contents.summarise(connection)


def _unpack(row: Any) -> Trajectories:
    from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories

    positions = unpack(row.positions, "<f4", (row.n_frames, len(CANONICAL_JOINTS), 3), row.path)
    parents = np.array(CANONICAL_PARENTS)
    return Trajectories(CANONICAL_JOINTS, positions.astype(np.float64), row.frame_rate, parents)
