"""Messages as the pages say them: without the folders of the studio and the options of the command line.

The table ``studio_instead`` has other words for messages that speak to the command line; they are keyed by the whole
code, as ``studio_instead."bvh.unit"``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dousa.errors import DousaError
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
