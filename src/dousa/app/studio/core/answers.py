"""What the studio answers when something cannot be done: a status and a message."""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import quote

from starlette.responses import JSONResponse

from dousa.app.studio.core.words import say
from dousa.errors import (
    DousaError,
    LibraryError,
    LibraryLockedError,
    MissingExtraError,
    NotTrainedError,
    TrainingError,
)
from dousa.files.json_values import to_json_value
from dousa.messages import Message

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

_NO_ROOM_CODES = frozenset(
    {
        "disk.full",
        "disk.quota",
        "disk.large_file",
        "export.no_room",
        "library_file.disk_full",
        "library_file.server_disk_full",
    }
)

_CONFLICTS = frozenset(
    {
        "journal.changed_later",
        "journal.changed_since",
        "journal.in_force",
        "journal.not_kept",
        "journal.nothing_to_redo",
        "journal.nothing_to_undo",
        "journal.undone_already",
    }
)


class RefusedError(DousaError):
    """A request that the studio does not carry out.

    Parameters
    ----------
    status : of HTTP, 400 to 499.
    code, values : what was expected, what came and what to do.
    """

    def __init__(self, status: int, code: str | Message, /, **values: Any) -> None:
        super().__init__(code, **values)
        self.status = status


def status_of(error: DousaError) -> int:
    """The status of HTTP that goes with an error a person can put right."""
    if isinstance(error, RefusedError):
        return error.status
    if error.code in _NO_ROOM_CODES:
        return 507
    if isinstance(error, NotTrainedError | TrainingError | LibraryLockedError) or error.code in _CONFLICTS:
        return 409
    if isinstance(error, LibraryError):
        return 404
    if isinstance(error, MissingExtraError):
        return 501
    return 422


def describe_disk(error: OSError) -> Message | None:
    """What to say where the disk takes no more; None where something else is wrong."""
    return Message("studio.no_room", reason=error) if error.errno in _NO_ROOM else None


def to_answer(problem: Message) -> dict[str, Any]:
    """A problem as JSON: the sentence in the language of the request, the code and its values."""
    return {"problem": say(problem), **problem.to_json()}


BYTES: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}
}
"""What the description of the interface says of an answer that is no JSON."""


class Answer(JSONResponse):
    """JSON in which numbers that are not finite are null and halves of characters are question marks."""

    def render(self, content: Any) -> bytes:
        """The bytes of an answer."""
        try:
            text = _ENCODER.encode(content)
        except (ValueError, TypeError):  # not finite, or words of a message
            text = _ENCODER.encode(to_json_value(content))
        return text.encode("utf-8", "replace")


_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def attachment(name: str) -> str:
    """The header Content-Disposition for a file: in ASCII for old programs, and as it is (RFC 6266)."""
    kept = "".join(
        character if character.isascii() and (character.isalnum() or character in "._- ") else "_" for character in name
    )
    return f"attachment; filename=\"{kept}\"; filename*=UTF-8''{quote(name.encode('utf-8', 'replace'), safe='')}"


class Gate:
    """Lets some through, keeps some waiting, sends the others away.

    Parameters
    ----------
    at_once : how many are inside.
    waiting : how many may wait; each holds a thread of the studio, which has some forty.
    problem : what those who are sent away are told.
    """

    def __init__(self, at_once: int, waiting: int, problem: Message) -> None:
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
