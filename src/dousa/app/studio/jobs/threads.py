"""A lane whose work runs in a thread of the studio, where the kernels and the library are loaded already."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from dousa.app.studio.jobs.board import JobStopped

if TYPE_CHECKING:
    from collections.abc import Callable

    from dousa.app.studio.jobs.board import Job, JobBoard
    from dousa.app.studio.settings import Settings
    from dousa.app.studio.studio import Studio

__all__ = ["run_in_thread"]


def run_in_thread(
    settings: Settings, studio: Studio
) -> Callable[[Job, JobBoard, threading.Event], dict[str, Any]]:
    """What does jobs of any kind of `dousa.app.studio.work` in the thread of their lane."""

    def run(job: Job, board: JobBoard, stop: threading.Event) -> dict[str, Any]:
        from dousa.app.studio.work import WORK, Context

        def progress(done: int, total: int, what: str) -> None:
            if stop.is_set():
                raise JobStopped
            board.change(job, done=int(done), total=int(total), what=what)

        context = Context(
            library=settings.library,
            home=settings.folder,
            folder=board.folder(job),
            progress=progress,
            tell=lambda text: board.change(job, notes=[*job.notes, text]),
            shared=studio.library,
            studio=studio,
        )
        return WORK[job.kind](job.request, context)

    return run
