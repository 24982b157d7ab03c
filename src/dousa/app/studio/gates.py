"""What takes long is done by few at a time, so that those who ask for something quick find a thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from dousa.app.studio.problems import RefusedError

__all__ = ["Gate"]


class Gate:
    """Lets some through, keeps some waiting, sends the others away.

    Parameters
    ----------
    at_once : how many are inside.
    waiting : how many may wait; each holds a thread of the studio, which has some forty.
    problem : the sentence for those who are sent away.
    """

    def __init__(self, at_once: int, waiting: int, problem: str) -> None:
        self._inside = threading.BoundedSemaphore(at_once)
        self._known = threading.BoundedSemaphore(at_once + waiting)
        self._problem = problem

    @contextmanager
    def enter(self, seconds: float) -> Iterator[None]:
        """Wait at most so long, in s.

        Raises
        ------
        RefusedError : too many wait already, or it took too long.
        """
        if not self._known.acquire(blocking=False):
            raise RefusedError(429, self._problem)
        try:
            if not self._inside.acquire(timeout=seconds):
                raise RefusedError(429, self._problem)
            try:
                yield
            finally:
                self._inside.release()
        finally:
            self._known.release()
