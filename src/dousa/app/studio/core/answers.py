"""Answers of the studio: JSON, problems with a status, and messages in the words of the pages.

The pages show no folders of the studio and no options of the command line. The table ``studio_instead`` has other words
for messages that name them, keyed by the whole code, such as ``studio_instead."bvh.unit"``.
"""

from __future__ import annotations

import errno
import json
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict
from starlette.responses import JSONResponse, Response

from dousa.errors import DousaError, LibraryError, LibraryLockedError, MissingExtraError, NotTrainedError, TrainingError
from dousa.files.json_values import refuse_infinite, to_json_value
from dousa.messages import LANGUAGES, Message
from dousa.messages.tables import load_table

_PACKED = "$message"


def to_message(text: Message | str) -> Message:
    """Return a message, or a text as a message."""
    return text if isinstance(text, Message) else Message("text.verbatim", text=str(text))


def name_error(error: DousaError, home: Path) -> Message:
    """Return the message of an error, with files below the studio's folder named as they were uploaded."""
    return shorten(error.located, home)


def shorten(message: Message, home: Path) -> Message:
    """Replace paths below the studio's folder in a message by their place in the batch or job."""
    inside = re.compile(re.escape(str(home)) + r"/(?:(?:files|jobs)(?:/[0-9a-f]{16}(?:/|$)|$))?")
    short: Message = _map_message(message, lambda text: inside.sub("", text), lambda code: code)
    return short


def _map_message(value: Any, change_text: Callable[[str], str], change_code: Callable[[str], str]) -> Any:
    if isinstance(value, Message):
        values = {name: _map_message(one, change_text, change_code) for name, one in value.values.items()}
        return Message(change_code(value.code), **values)
    if isinstance(value, tuple):
        return tuple(_map_message(one, change_text, change_code) for one in value)
    return change_text(value) if isinstance(value, str) else value


def say(message: Message) -> str:
    """Render a message in the current language, in the words of the pages."""
    return reword(message).render()


def reword(message: Message) -> Message:
    """Return the message that the pages have instead, if there is one."""
    table = load_table(LANGUAGES[0])

    def change(code: str) -> str:
        instead = f"studio_instead.{code}"
        return instead if instead in table else code

    found: Message = _map_message(message, lambda text: text, change)
    return found


def pack(value: Any) -> Any:
    """Replace the messages among plain values by JSON, to be rendered later in the language of the request."""
    if isinstance(value, Message):
        return {_PACKED: value.to_json()}
    if isinstance(value, dict):
        return {name: pack(one) for name, one in value.items()}
    return [pack(one) for one in value] if isinstance(value, list | tuple) else value


def say_packed(value: Any) -> Any:
    """Render the messages among packed values in the current language."""
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
        "journal.of_another",
        "journal.undone_already",
    }
)


class RefusedError(DousaError):
    """A request that the studio refuses.

    Parameters
    ----------
    status : of HTTP, 400 to 499.
    code, values : of the message: what was expected, what came and the remedy.
    """

    def __init__(self, status: int, code: str | Message, /, **values: Any) -> None:
        super().__init__(code, **values)
        self.status = status


def status_of(error: DousaError) -> int:
    """Return the HTTP status for an error that the user can correct."""
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
    """Return the message for a full disk; None for other errors."""
    return Message("studio.no_room", reason=error) if error.errno in _NO_ROOM else None


def to_answer(problem: Message) -> dict[str, Any]:
    """Return a problem as JSON: the sentence in the current language, the code and its values."""
    answer: dict[str, Any] = to_json_value({"problem": say(problem), **problem.to_json()})  # it may tell of infinities
    return answer


def describe_bytes(*kinds: str, form: str | None = "binary") -> dict[int | str, dict[str, Any]]:
    """Return the responses in OpenAPI of an address that answers with files of these types; form None: texts."""
    schema = {"type": "string"} if form is None else {"type": "string", "format": form}
    return {200: {"content": {kind: {"schema": schema} for kind in kinds}}}


def give_files(*kinds: str, form: str | None = "binary") -> dict[str, Any]:
    """Return the arguments of a route that answers with files of these types; form None: texts."""
    return {"response_class": Response, "responses": describe_bytes(*kinds, form=form)}


FILE = give_files("application/octet-stream")
"""The arguments of a route that answers with a file."""


def describe_body(kind: str) -> dict[str, Any]:
    """Return the request body in OpenAPI of an address that receives a file of this media type."""
    return {"requestBody": {"required": True, "content": describe_bytes(kind)[200]["content"]}}


class StrictModel(BaseModel):
    """Fields of a request; unknown ones are refused."""

    model_config = ConfigDict(extra="forbid")


class Answer(JSONResponse):
    """JSON in which NaN, a number that is not known, is null and lone surrogates are question marks."""

    def render(self, content: Any) -> bytes:
        """Encode the content; OptionError for infinities."""
        try:
            text = _ENCODER.encode(content)
        except (ValueError, TypeError):  # not finite, or words of a message
            text = _ENCODER.encode(to_json_value(content, refuse_infinite))
        return text.encode("utf-8", "replace")


_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def attachment(name: str) -> str:
    """Return the header Content-Disposition of a download, in ASCII and in UTF-8 (RFC 6266)."""
    kept = "".join(
        character if character.isascii() and (character.isalnum() or character in "._- ") else "_" for character in name
    )
    return f"attachment; filename=\"{kept}\"; filename*=UTF-8''{quote(name.encode('utf-8', 'replace'), safe='')}"


class Gate:
    """Limits how many run at once and how many wait; refuses the others.

    Parameters
    ----------
    at_once : how many run.
    waiting : how many may wait; each occupies one of the studio's forty threads.
    problem : message for those refused.
    patience_s : how long one waits for its turn; a browser gives up after minutes.
    """

    def __init__(self, at_once: int, waiting: int, problem: Message, patience_s: float = 60.0) -> None:
        self._inside = threading.BoundedSemaphore(at_once)
        self._known = threading.BoundedSemaphore(at_once + waiting)
        self._problem, self._patience_s = problem, patience_s

    @contextmanager
    def enter(self, patience_s: float | None = None) -> Iterator[None]:
        """Wait for others; RefusedError if too many wait already, or it takes longer than ``patience_s``."""
        if not self._known.acquire(blocking=False):
            raise RefusedError(429, self._problem)
        try:
            if not self._inside.acquire(timeout=self._patience_s if patience_s is None else patience_s):
                raise RefusedError(429, self._problem)
            try:
                yield
            finally:
                self._inside.release()
        finally:
            self._known.release()
