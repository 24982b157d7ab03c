"""One studio for each folder: a lock that ends with its process, and how another start finds the one that runs.

Two studios over one folder would take each other's jobs for interrupted ones, resume and delete them. The lock is the
system's own, so that it is gone however the process ends.
"""

from __future__ import annotations

import errno
import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, Any
from urllib import request

from dousa.errors import OptionError

LOCK, RUNNING = "studio.lock", "studio.json"
TAKEN = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""What the system answers where another process has the lock."""
_PATIENCE = 5.0  # s for the running studio to answer


class HomeTakenError(OptionError):
    """The folder of a studio belongs to another one, which runs."""


class HomeLock:
    """The right to a studio's folder, from its making until it is released or the process ends.

    Parameters
    ----------
    home : the folder; it exists.

    Raises
    ------
    HomeTakenError : another studio has it.
    OSError : the folder cannot be written.
    """

    def __init__(self, home: Path) -> None:
        self._home = home
        self._file: IO[bytes] | None = open_private(home / LOCK)
        try:
            lock_file(self._file)
        except OSError as error:
            if error.errno not in TAKEN:
                return  # a disk without locks
            self._file.close()
            self._file = None
            raise HomeTakenError("studio.taken", folder=home, process=_read(home).get("process", "?")) from None
        self.announce(None, None, None)

    def announce(self, address: str | None, token: str | None, library: Path | None) -> None:
        """Leave a note, for this user alone, where the studio answers, and of which library it is."""
        known = None if library is None else str(library.absolute())
        note = {"process": os.getpid(), "address": address, "token": token, "library": known}
        temporary = self._home / f".{RUNNING}"
        with open_private(temporary) as file:
            file.truncate(0)
            file.write(json.dumps(note).encode())
        os.replace(temporary, self._home / RUNNING)

    def release(self) -> None:
        """Let another studio have the folder."""
        if self._file is not None:
            with suppress(OSError):
                (self._home / RUNNING).unlink(missing_ok=True)
            self._file.close()
            self._file = None


def open_private(path: Path) -> IO[bytes]:
    """A file, made if missing, that nobody else on this machine can read; its content is kept."""
    return os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), "r+b")


def lock_file(file: IO[bytes]) -> None:
    """Lock a file until it is closed or the process ends; OSError at once where another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _read(home: Path) -> dict[str, Any]:
    with suppress(OSError, ValueError):
        note = json.loads((home / RUNNING).read_bytes())
        if isinstance(note, dict):
            return note
    return {}


def other_library(home: Path, library: Path) -> str | None:
    """The library of the studio that has a folder, if it is another one than this."""
    known = _read(home).get("library")
    return known if known is not None and known != str(library.absolute()) else None


def ask_running(home: Path) -> str | None:
    """An address that opens the studio that has a folder, once; None where it does not answer."""
    note = _read(home)
    address, token = note.get("address"), note.get("token")
    if not address or not token:
        return None
    asked = request.Request(f"{address}/code", b"", {"authorization": f"Bearer {token}"})
    with suppress(OSError, ValueError, KeyError):
        opener = request.build_opener(request.ProxyHandler({}))
        with opener.open(asked, timeout=_PATIENCE) as answer:
            return f"{address}/?code={json.load(answer)['code']}"
    return None
