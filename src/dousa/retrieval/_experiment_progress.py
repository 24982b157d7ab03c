"""How an experiment says how far it has come."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress", "Reporter"]

Progress = Callable[[int, int, str], None]
"""Called with the steps done, their total, and what comes next."""


class Reporter:
    """Counts trainings for the progress callback."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def __call__(self, doing: str) -> None:
        if self.progress is not None:
            self.progress(self.done, self.total, doing)

    def skip(self, count: int) -> None:
        self.done += count
