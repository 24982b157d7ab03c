"""Rendering of messages as sentences from the tables of words."""

from __future__ import annotations

import errno
import re
import string
import tomllib
from collections.abc import Mapping
from contextvars import ContextVar
from functools import cache
from importlib import resources
from typing import Any

LANGUAGES = ("en", "ja")
"""Languages with a table; the first one is the default."""

_LANGUAGE: ContextVar[str] = ContextVar("language", default=LANGUAGES[0])  # by definition the first
_JOINTS = {"en": (", ", " and ", " or "), "ja": ("、", "と", "または")}


def use_language(language: str) -> None:
    """Render messages in this language of `LANGUAGES` from now on, in this context and those started from it."""
    _LANGUAGE.set(language if language in LANGUAGES else LANGUAGES[0])


def get_language() -> str:
    """Return the language in use."""
    return _LANGUAGE.get()


@cache
def _read_sections(language: str) -> dict[str, str]:
    """Read the lines of each section of the TOML files of a language, which may be in several, unparsed."""
    sections: dict[str, str] = {}
    for file in sorted(resources.files(__package__).joinpath(language).iterdir(), key=lambda file: file.name):
        if file.name.endswith(".toml"):
            _, *parts = re.split(r"^\[(\w+)\]$", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
            for section, lines in zip(parts[::2], parts[1::2], strict=True):
                sections[section] = sections.get(section, "") + lines
    return sections


@cache
def _parse_section(section: str, language: str) -> dict[str, str]:
    return tomllib.loads(_read_sections(language).get(section, ""))


def load_section(section: str, language: str) -> dict[str, str]:
    """Load the templates of one section by key, not filled in, as for a page; only what is asked for is parsed."""
    return dict(_parse_section(section, language))


def load_table(language: str) -> dict[str, str]:
    """Load all sentences of a language by code: ``section.key`` of the TOML files of its folder."""
    return {
        f"{section}.{key}": text
        for section in _read_sections(language)
        for key, text in _parse_section(section, language).items()
    }


def _find_template(code: str, language: str) -> str | None:
    section, _, key = code.partition(".")
    return _parse_section(section, language).get(key)


def render(code: str, values: Mapping[str, Any], language: str | None = None) -> str:
    """Render the sentence of a code with its values.

    A template is a format string over the values. Besides Python's formats it may have ``{n:count frame|frames}``
    ("1 frame", "3 frames"), ``{n:plural is|are}`` (the word alone), and for tuples ``{names:list}``, ``{names:and}``,
    ``{names:or}``. Values that are messages are rendered in the same language.

    Parameters
    ----------
    code : ``section.key``.
    values : of its template.
    language : of `LANGUAGES`; None for the one in use.
    """
    language = language or get_language()
    if code == "system.error":
        return _say_system_error(language, **values)
    template = _find_template(code, language) or _find_template(code, LANGUAGES[0])
    if template is None:  # a defect that a test finds; the code is better than nothing
        return f"{code} {dict(values)}"
    return _Filler(language).vformat(template, (), values)


def _say_system_error(language: str, number: int, text: str) -> str:
    """An error of the operating system: from the table, else in its own words."""
    name = errno.errorcode.get(number, "")
    return _parse_section("system", language).get(name, text)


class _Filler(string.Formatter):
    def __init__(self, language: str) -> None:
        self._language = language

    def format_field(self, value: Any, spec: str) -> str:
        if hasattr(value, "code") and hasattr(value, "values"):
            value = render(value.code, value.values, self._language)
        kind, _, forms = spec.partition(" ")
        if isinstance(value, tuple) or kind in ("list", "and", "or"):
            return self._join(value if isinstance(value, tuple) else (value,), spec)
        if kind in ("count", "plural"):
            one, _, more = forms.partition("|")
            word = one if value == 1 else more
            return f"{value:,} {word}" if kind == "count" else word
        return format(str(value) if value is None else value, spec)

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        if conversion == "r" and isinstance(value, tuple):
            return tuple(repr(item) for item in value)
        return super().convert_field(value, conversion)

    def _join(self, items: tuple[Any, ...], spec: str, most: int = 40) -> str:
        """Join ``most`` items by ``list``, ``and`` or ``or``; their format may follow: ``{values:list .2f}``."""
        kind, _, item_spec = spec.partition(" ")
        comma, both, either = _JOINTS[self._language]
        words = [self.format_field(item, item_spec) for item in items[:most]]
        words += [f"... (+{len(items) - most:,})"] * (len(items) > most)
        last = {"and": both, "or": either}.get(kind, comma)
        return comma.join(words) if len(words) < 2 else comma.join(words[:-1]) + last + words[-1]
