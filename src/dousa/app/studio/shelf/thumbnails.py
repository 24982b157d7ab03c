"""Small moving figures of clips, made once and kept in one file of the studio.

A figure is kept by the number of its clip together with what stands for the content of the clip
(`Library.contents`), so that it is never shown for another one. The file can be thrown away at any time; several
programs may use it at once.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.player import MINIATURE_BYTES, encode_miniature

if TYPE_CHECKING:
    from dousa.library import Library

__all__ = ["Thumbnails"]

_FORM = 1  # another one empties the file; count it up when encode_miniature draws otherwise
_WAIT = 5.0  # s for another program that writes
_AT_ONCE = 250  # figures made between two writes
_SPARE = 2_000  # figures of clips that are gone may stay so many


class Thumbnails:
    """The figures of one library.

    Parameters
    ----------
    path : file where they are kept; made when the first are.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    @classmethod
    def of(cls, home: Path) -> Thumbnails:
        """Those of the studio whose folder this is."""
        return cls(home / "thumbnails.sqlite")

    def get(self, library: Library, clip_ids: Sequence[int]) -> bytes:
        """Records of `encode_miniature`, one after the other in the order of the numbers.

        Parameters
        ----------
        library : where the clips are.
        clip_ids : a clip that is not there, or is damaged, gets a record of zeros.
        """
        contents = library.contents(clip_ids)
        records = self._read(contents)
        lacking = [clip_id for clip_id in contents if clip_id not in records]
        for start in range(0, len(lacking), _AT_ONCE):
            made = _make(library, lacking[start : start + _AT_ONCE])
            self._write({clip_id: (contents[clip_id], record) for clip_id, record in made.items()}, library)
            records |= made
        nothing = bytes(MINIATURE_BYTES)
        return b"".join(records.get(clip_id, nothing) for clip_id in clip_ids)

    def make_ahead(self, library: Library, clip_ids: Sequence[int]) -> None:
        """Make those that are lacking, so that nobody waits for them."""
        for start in range(0, len(clip_ids), _AT_ONCE):
            self.get(library, clip_ids[start : start + _AT_ONCE])

    def _read(self, contents: Mapping[int, str]) -> dict[int, bytes]:
        found: dict[int, bytes] = {}
        if not contents or not self._path.exists():
            return found
        with suppress(sqlite3.Error), self._open() as connection:
            marks = ",".join("?" * len(contents))
            query = f"SELECT clip_id, content, record FROM figures WHERE clip_id IN ({marks})"
            for clip_id, content, record in connection.execute(query, list(contents)):
                if content == contents[clip_id] and len(record) == MINIATURE_BYTES:
                    found[clip_id] = record
        return found

    def _write(self, made: Mapping[int, tuple[str, bytes]], library: Library) -> None:
        """Keep them; where that cannot be done they are made again next time."""
        rows = [(clip_id, content, record) for clip_id, (content, record) in made.items()]
        try:
            self._insert(rows, library)
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                return  # somebody else writes for long, or the disk is full
            for name in ("", "-wal", "-shm"):  # damaged
                with suppress(OSError):
                    Path(f"{self._path}{name}").unlink()

    def _insert(self, rows: Sequence[tuple[int, str, bytes]], library: Library) -> None:
        with self._open() as connection, connection:
            connection.executemany("INSERT OR REPLACE INTO figures VALUES (?, ?, ?)", rows)
            (count,) = connection.execute("SELECT count(*) FROM figures").fetchone()
            if count > _SPARE:
                self._forget_gone(connection, int(count), library)

    def _forget_gone(self, connection: sqlite3.Connection, count: int, library: Library) -> None:
        stats = library.stats()
        if count <= stats.n_clips + stats.n_takes + _SPARE:
            return
        kept = {clip.id for clip in library.clips()}
        known = [row[0] for row in connection.execute("SELECT clip_id FROM figures")]
        gone = [(clip_id,) for clip_id in known if clip_id not in kept]
        connection.executemany("DELETE FROM figures WHERE clip_id = ?", gone)

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        with closing(sqlite3.connect(self._path, timeout=_WAIT)) as connection:
            if connection.execute("PRAGMA user_version").fetchone()[0] != _FORM:
                _start(connection)
            yield connection


def _start(connection: sqlite3.Connection) -> None:
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        if connection.execute("PRAGMA user_version").fetchone()[0] == _FORM:
            return  # another program was quicker
        connection.execute("DROP TABLE IF EXISTS figures")
        connection.execute(
            "CREATE TABLE figures (clip_id INTEGER PRIMARY KEY, content TEXT NOT NULL, record BLOB NOT NULL)"
        )
        connection.execute(f"PRAGMA user_version = {_FORM}")


def _make(library: Library, clip_ids: Sequence[int]) -> dict[int, bytes]:
    """Figures by number, of those clips that can be drawn."""
    from dousa.errors import InvalidMotionError, LibraryDamagedError

    made: dict[int, bytes] = {}
    try:
        for clip_id, motion in library.iterate_trajectories(clip_ids):
            with suppress(InvalidMotionError):
                made[clip_id] = encode_miniature(motion)
    except LibraryDamagedError:
        if len(clip_ids) == 1:
            return {}
        # One of them is damaged; the others are shown.
        return {clip_id: record for one in clip_ids for clip_id, record in _make(library, [one]).items()}
    return made
