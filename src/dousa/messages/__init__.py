"""What dousa says: a code with values. The words are tables, one a language, rendered where a person reads them."""

from __future__ import annotations

from dousa.messages.message import Message
from dousa.messages.tables import LANGUAGES, get_language, load_section, render, use_language

__all__ = ["LANGUAGES", "Message", "get_language", "load_section", "render", "use_language"]
