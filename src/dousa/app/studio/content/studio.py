"""What all requests share: settings, folder, jobs, the open library."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Depends, Request

from dousa.app.studio.content.clip_words import Meanings
from dousa.app.studio.content.clips import Figures, KeptMap, Listing
from dousa.app.studio.content.companions import Companions
from dousa.app.studio.content.evaluations import Evaluations
from dousa.app.studio.content.footage import Footages
from dousa.app.studio.content.live import Live
from dousa.app.studio.content.masks import MaskDesks
from dousa.app.studio.content.motions import Motions
from dousa.app.studio.core.answers import Gate
from dousa.app.studio.core.workspace import Settings, Workspace
from dousa.app.studio.jobs.board import JobBoard, Lane
from dousa.app.studio.jobs.lanes import Reader, answer_question
from dousa.app.vmc import VmcSender
from dousa.errors import LibraryError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.studio.content.sharing import Sharing
    from dousa.library import Library

Step = tuple[int, int, Message]
"""Steps done, steps, message about the next step."""


class Learning:
    """The progress of forests that searches train, for bodies of which parts are missing."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: dict[object, Step] = {}

    @contextmanager
    def follow(self) -> Iterator[Callable[[int, int, Message], None]]:
        """Provide the progress function of a search; its steps count until the search ends."""
        mine = object()

        def tell(done: int, total: int, what: Message) -> None:
            with self._lock:
                self._steps[mine] = (done, total, what)

        try:
            yield tell
        finally:
            with self._lock:
                self._steps.pop(mine, None)

    def now(self) -> Step | None:
        """Return the step of the search that began first; None if none trains."""
        with self._lock:
            return next(iter(self._steps.values()), None)


class Studio:
    """One library and all that belongs to it.

    Raises LibraryError if the file is no library, OptionError if the folder cannot be made, HomeTakenError if another
    studio uses the folder.

    Parameters
    ----------
    settings : of the studio.
    make_lanes : returns the lanes by kind of job.
    """

    def __init__(self, settings: Settings, make_lanes: Callable[[Studio], Mapping[str, Lane]]) -> None:
        self.settings = settings
        self.vmc = VmcSender(settings.vmc) if settings.vmc else None
        self._opening = threading.Lock()
        self._library: Library | None = None
        self._file: tuple[int, int] | None = None
        self.get_library()  # first: a file that is no library gets no folder beside it
        self.workspace = Workspace(settings.folder)
        self.held = self.workspace.hold()  # before the jobs are read, as those of another studio are not interrupted
        self.jobs = JobBoard(self.workspace, make_lanes(self))
        self.reader = Reader(settings.most_memory)
        self.asker = Reader(None, 2, 6, "studio_jobs.busy_files")
        self.motions = Motions(self.get_library, self.workspace, self.jobs, self.reader)
        self.evaluations = Evaluations(self.motions, self.jobs)
        self.companions = Companions(self.workspace, self.jobs, self.motions, self.reader)
        self.listing = Listing(self.get_library, self.workspace.root / "files")
        self.map = KeptMap(self.workspace.root, self.get_library, self.listing)
        self.meanings = Meanings(self.get_library)
        self.footage = Footages(self.jobs)
        self.masks = MaskDesks(self.jobs)
        self.live = Live()
        self.learning = Learning()
        self.searching = Gate(4, 12, Message("studio_motions.busy_searching"), patience_s=20.0)
        self.figures = Figures()
        self.sharing: Sharing | None = None  # set by `serve` if the studio is shared

    def get_library(self) -> Library:
        """Return the library, opened once and made if missing when the studio starts.

        Raises LibraryError if it is no library, or was deleted meanwhile: changes to a deleted file would be lost.
        """
        from dousa.library import Library

        with self._opening:
            found = _identify(self.settings.library)
            if self._library is None:
                self._library = Library.open(self.settings.library, create=True, timeout=20.0)
                self._file = _identify(self.settings.library)
                if found is None:  # made here: readable by this user alone
                    _make_private(self.settings.library)
            elif found is None:
                raise LibraryError("studio.library_gone", library=self.settings.library)
            elif found != self._file:  # another one has its name; who still asks the old one may end
                self._library = Library.open(self.settings.library, timeout=20.0)
                self._file = found
            return self._library

    @property
    def library(self) -> Library:
        """The library."""
        return self.get_library()

    def ask(self, name: str, request: dict[str, Any], folder: Path) -> dict[str, Any]:
        """Return the result of short work in a process; an older question about the same batch is dropped.

        Raises DousaError as the work, and RefusedError as `Reader.run`: backgrounds of long films take a while, and
        kernels compile at first.
        """
        where = self.settings.library, self.settings.folder, folder
        about = name, request.get("batch")
        return self.asker.run(answer_question, name, request, *where, seconds=180.0, about=about)

    def close(self) -> None:
        """Stop all work and sharing, and close the library."""
        if self.sharing is not None:
            self.sharing.end()
        if self.vmc is not None:
            self.vmc.end()
        self.jobs.close()
        self.reader.close()
        self.asker.close()
        self.meanings.close()
        with self._opening:
            if self._library is not None:
                self._library.close()
                self._library = None
        self.workspace.release()


def _make_private(library: Path) -> None:
    for path in (library, *(library.with_name(library.name + more) for more in ("-wal", "-shm"))):
        with suppress(OSError):
            path.chmod(0o600)


def _identify(path: Path) -> tuple[int, int] | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _of_request(request: Request) -> Studio:
    studio: Studio = request.app.state.studio
    return studio


StudioNow = Annotated[Studio, Depends(_of_request)]
"""Type of a parameter that is the studio."""
