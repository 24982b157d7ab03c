"""Messages as a code with values; the words are tables, one per language, rendered when read."""

from __future__ import annotations

from dousa.messages.message import Message
from dousa.messages.tables import LANGUAGES, get_language, load_section, render, use_language

__all__ = ["LANGUAGES", "Message", "get_language", "load_section", "render", "use_language"]
