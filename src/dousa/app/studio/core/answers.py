"""What the studio answers when something cannot be done: a status and a message."""

from __future__ import annotations

import errno
import json
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from starlette.responses import JSONResponse

from dousa.errors import (
    DousaError,
    LibraryError,
    LibraryLockedError,
    MissingExtraError,
    NotTrainedError,
    TrainingError,
)
from dousa.files.json_values import to_json_value
from dousa.messages import LANGUAGES, Message
from dousa.messages.tables import load_table

_PACKED = "$message"


def to_message(text: Message | str) -> Message:
    """A message, or a text that is none as a message."""
    return text if isinstance(text, Message) else Message("text.verbatim", text=str(text))


def read_message(stored: Mapping[str, Any] | str) -> Message:
    """The message that was stored; what older versions stored is a text."""
    return to_message(stored) if isinstance(stored, str) else Message.from_json(stored)


def name_error(error: DousaError, home: Path) -> Message:
    """What an error says, with the files of the studio named as they were uploaded.

    Parameters
    ----------
    error : of any room.
    home : the studio's folder.
    """
    return shorten(error.located, home)


def shorten(message: Message, home: Path) -> Message:
    """A message whose values name files by their place in the batch or job."""
    inside = re.compile(re.escape(str(home)) + r"/(?:(?:files|jobs)(?:/[0-9a-f]{16}(?:/|$)|$))?")
    short: Message = _map_values(message, lambda text: inside.sub("", text))
    return short


def _map_values(value: Any, change: Callable[[str], str]) -> Any:
    if isinstance(value, Message):
        return Message(value.code, **{name: _map_values(one, change) for name, one in value.values.items()})
    if isinstance(value, tuple):
        return tuple(_map_values(one, change) for one in value)
    return change(value) if isinstance(value, str) else value


def say(message: Message) -> str:
    """The sentence in the language in use, in the words of the pages where they have other ones."""
    return reword(message).render()


def reword(message: Message) -> Message:
    """The message that the pages have for it; the same one if they have no other words."""
    found: Message = _reword(message, load_table(LANGUAGES[0]))
    return found


def _reword(value: Any, table: Mapping[str, str]) -> Any:
    if isinstance(value, Message):
        code = f"studio_instead.{value.code}"
        values = {name: _reword(one, table) for name, one in value.values.items()}
        return Message(code if code in table else value.code, **values)
    return tuple(_reword(one, table) for one in value) if isinstance(value, tuple) else value


def pack(value: Any) -> Any:
    """Plain values with the messages among them as JSON, to be said later in the language of whoever asks."""
    if isinstance(value, Message):
        return {_PACKED: value.to_json()}
    if isinstance(value, dict):
        return {name: pack(one) for name, one in value.items()}
    return [pack(one) for one in value] if isinstance(value, list | tuple) else value


def say_packed(value: Any) -> Any:
    """Plain values that were packed, with every message said in the language in use."""
    if isinstance(value, dict):
        if value.keys() == {_PACKED}:
            return say(Message.from_json(value[_PACKED]))
        return {name: say_packed(one) for name, one in value.items()}
    return [say_packed(one) for one in value] if isinstance(value, list) else value


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
