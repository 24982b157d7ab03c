"""Which uploads jobs live from: their batches stand in the files of the jobs."""

from __future__ import annotations

import os
import re
import threading
from contextlib import suppress
from pathlib import Path

_BATCH = re.compile(rb"(?=([0-9a-f]{16}))")  # also within a longer number


class MentionedBatches:
    """Batches that the files of jobs name. A file is read again only when it is another one.

    Parameters
    ----------
    root : folder of the studio.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._known: dict[Path, tuple[tuple[int, int, int], frozenset[str]]] = {}

    def list(self) -> set[str]:
        """Those that are there and named; a job names none that is made later."""
        with self._lock:
            found = {}
            there = {os.fsencode(folder.name) for folder in (self._root / "files").iterdir()}
            for path in (self._root / "jobs").glob("*/*.json"):
                with suppress(OSError):
                    state = path.stat()
                    mark = (state.st_ino, state.st_mtime_ns, state.st_size)
                    before = self._known.get(path)
                    if before is None or before[0] != mark:
                        names = (match[1] for match in _BATCH.finditer(path.read_bytes()))
                        before = (mark, frozenset(name.decode() for name in names if name in there))
                    found[path] = before
            self._known = found
            return {name for _, names in found.values() for name in names}
