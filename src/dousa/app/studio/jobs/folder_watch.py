"""A folder that is watched: what appears in it goes into the library."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from dousa.errors import DousaError
from dousa.formats.motion_files import find_motion_files

LOOK_EVERY = 3.0
"""s between looks; files that somebody is still writing change from look to look."""

_Seen = frozenset[tuple[str, int, int]]  # path, bytes, time of the last change


class FolderWatch:
    """Asks for what is new in a folder to be added each time that it has come to rest.

    Parameters
    ----------
    folder : with motion files, at any depth.
    take_in : called with the paths of what is new or has changed; a job that adds them. What the library has already
        is left alone by it.
    is_busy : whether such a job is under way.
    """

    def __init__(self, folder: Path, take_in: Callable[[list[str]], object], is_busy: Callable[[], bool]) -> None:
        self._folder, self._take_in, self._is_busy = folder.absolute(), take_in, is_busy
        self._last: _Seen = frozenset()
        self._taken: _Seen = frozenset()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="folder watch", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def end(self) -> None:
        """Look no more."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def look(self) -> bool:
        """Look once; whether something is to be added."""
        now = self._read()
        rests, self._last = now == self._last, now
        if not rests or now <= self._taken or self._is_busy():
            return False
        self._take_in(sorted({path for path, _, _ in now - self._taken}))
        self._taken = now
        return True

    def _read(self) -> _Seen:
        seen = set()
        for file in find_motion_files([self._folder])[0]:
            with suppress(OSError):  # gone since
                state = file.path.stat()
                seen.add((str(file.path), state.st_size, state.st_mtime_ns))
        return frozenset(seen)

    def _run(self) -> None:
        while not self._over.wait(LOOK_EVERY):
            # A queue that is full, a disk that is away: the next look may do better.
            with suppress(DousaError, OSError):
                self.look()
