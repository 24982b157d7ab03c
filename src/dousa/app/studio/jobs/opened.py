"""What was opened of jobs, as long as it is looked at."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from dousa.app.studio.jobs.board import Job, JobBoard

Opened = TypeVar("Opened")


class OpenedJobs(Generic[Opened]):
    """What was looked at last, safe to be used from any thread.

    Parameters
    ----------
    board : the jobs.
    open_folder : opens what is in the folder of one.
    most : how many stay open.
    """

    def __init__(self, board: JobBoard, open_folder: Callable[[Path], Opened], most: int) -> None:
        self._board, self._open_folder, self._most = board, open_folder, most
        self._lock = threading.Lock()
        self._open: OrderedDict[str, Opened] = OrderedDict()

    def get(self, job: Job) -> Opened:
        """What is in the folder of a job."""
        with self._lock:
            if job.id not in self._open:
                self._open[job.id] = self._open_folder(self._board.folder(job))
            self._open.move_to_end(job.id)
            while len(self._open) > self._most:
                self._open.popitem(last=False)
            return self._open[job.id]
