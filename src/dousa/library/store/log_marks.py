"""Marks that tie a library file to its write-ahead log.

SQLite applies any log that lies beside a file under its name: that of the library before a backup was copied over it,
too. Every transaction that writes therefore leaves a mark in the first page (``user_version``): its upper half
follows from the mark before it, its lower half is random. The first mark in a log follows from the file it began on.
"""

from __future__ import annotations

import secrets
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError

# Of https://sqlite.org/fileformat.html, 1.3.14, 4.1 and 4.2: place of the mark in the first page; header of a log
# (magic, version, bytes of a page, checkpoint, two salts, two checksums) and of a frame (page, size, salts, checksums).
_MARK = struct.Struct(">60xi")
_LOG = struct.Struct(">IIII8s8x")
_FRAME = struct.Struct(">II8s8x")


def leave_mark(connection: sa.Connection) -> None:
    """Leave the next mark in a transaction that writes to an SQLite file."""
    before = connection.exec_driver_sql("PRAGMA user_version").scalar_one()
    mark = _follow(before) << 16 | secrets.randbits(16)
    connection.exec_driver_sql(f"PRAGMA user_version = {mark - (1 << 32 if mark >> 31 else 0)}")


def _follow(mark: int) -> int:
    """Return the upper half of the mark after this one."""
    return zlib.crc32(struct.pack(">i", mark)) >> 16


def check_log(path: Path, read_mark: Callable[[], int | None], *, tries: int = 5, pause: float = 0.02) -> None:
    """Raise LibraryDamagedError if the log beside a library belongs to another file, or another state of it.

    ``read_mark`` : returns the mark in the file alone, None if that cannot be read. Programs that write meanwhile may
    change it between two looks: only a log that fits in none of ``tries`` looks, ``pause`` s apart, is another's.
    """
    log = Path(f"{path}-wal")
    for _ in range(tries):
        mark = read_mark()
        first: int | None = None
        for found in _list_marks(log):
            first = found if first is None else first
            # It was written from this state of the file on, or this state is one of its own, copied back from it.
            if mark is None or found == mark or (first & 0xFFFFFFFF) >> 16 == _follow(mark):
                return
        if first is None or mark is None:  # no log, or that of a dousa which left no marks
            return
        time.sleep(pause)
    raise LibraryDamagedError("library_file.other_log", library=path, log=log.name)


def _list_marks(log: Path) -> Iterator[int]:
    """Yield the marks in a log, the first first."""
    try:
        with open(log, "rb") as file:
            magic, _, size, _, salts = _LOG.unpack(file.read(_LOG.size))
            while magic >> 1 == 0x377F0682 >> 1:
                page, _, own = _FRAME.unpack(file.read(_FRAME.size))
                if own != salts:  # left from before the log began again
                    return
                if page == 1:
                    (mark,) = _MARK.unpack(file.read(_MARK.size))
                    yield mark
                    file.seek(size - _MARK.size, 1)
                else:
                    file.seek(size, 1)
    except (OSError, struct.error):
        return
