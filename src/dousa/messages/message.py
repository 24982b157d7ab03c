"""Messages as data."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from dousa.messages.tables import render


class Message:
    """A message of dousa. Messages are equal if code and values are; ``str()`` renders in the language in use.

    Parameters
    ----------
    code : ``section.key`` of the tables, as ``bvh.too_few_values``.
    values : of the sentence: text, numbers, paths, other messages, errors, or tuples of these.
    """

    __slots__ = ("code", "values")

    def __init__(self, code: str, /, **values: Any) -> None:
        self.code = code
        self.values: Mapping[str, Any] = {name: _plain(value) for name, value in values.items()}

    def render(self, language: str | None = None) -> str:
        """Return the sentence, in a language of `LANGUAGES` or in the one in use."""
        return render(self.code, self.values, language)

    def to_json(self) -> dict[str, Any]:
        """Return ``code`` and ``values``, with messages among the values converted too."""
        return {"code": self.code, "values": {name: _to_json(value) for name, value in self.values.items()}}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Message:
        """Build the message from its ``to_json()``."""
        return cls(data["code"], **{name: _from_json(value) for name, value in data["values"].items()})

    def __str__(self) -> str:
        return self.render()

    def __repr__(self) -> str:
        values = "".join(f", {name}={value!r}" for name, value in self.values.items())
        return f"Message({self.code!r}{values})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Message) and (self.code, self.values) == (other.code, other.values)

    def __hash__(self) -> int:
        return hash((self.code, *self.values))

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self.code, dict(self.values))


def _rebuild(code: str, values: dict[str, Any]) -> Message:
    return Message(code, **values)


def _plain(value: Any) -> Any:
    """Values that do not depend on the process, survive JSON, and do not change with an array."""
    if value is None or isinstance(value, str | int | float | Message):
        return value
    if isinstance(value, BaseException):
        return _say_error(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return tuple(_plain(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value))
    return str(value)


def _say_error(error: BaseException) -> Message | str:
    """Message of a dousa error, number and text of a system error, text of any other."""
    message = getattr(error, "message", None)
    if isinstance(message, Message):
        return message
    if isinstance(error, OSError) and error.errno is not None:
        return Message("system.error", number=error.errno, text=error.strerror or str(error))
    return str(error) or type(error).__name__


def _to_json(value: Any) -> Any:
    if isinstance(value, Message):
        return value.to_json()
    return [_to_json(item) for item in value] if isinstance(value, tuple) else value


def _from_json(value: Any) -> Any:
    if isinstance(value, dict):
        return Message.from_json(value)
    return tuple(_from_json(item) for item in value) if isinstance(value, list) else value
