"""Messages as a code with values; the words are tables, one per language, rendered when read."""

from __future__ import annotations

from collections.abc import Callable

from dousa.messages.message import Message
from dousa.messages.tables import LANGUAGES, get_language, load_section, render, use_language

Progress = Callable[[int, int, Message], None]
"""What long work calls with (steps done, steps in all, what)."""

Count = Callable[[int, int], None]
"""The same where all steps are of one kind: (number done, number of all)."""

__all__ = ["LANGUAGES", "Count", "Message", "Progress", "get_language", "load_section", "render", "use_language"]
