"""Choosing clips by number, by path, by folder or by category."""

from __future__ import annotations

import enum
import os
from collections.abc import Iterable, Sequence, Set
from typing import Any, TypeVar

import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.library import schema

__all__ = ["UNCHANGED", "Selection", "Unchanged", "portions", "select_ids"]

_VALUES_AT_ONCE = 500  # databases limit the number of values in one query

Item = TypeVar("Item")

Selection = int | str | os.PathLike[str] | Iterable[int | str | os.PathLike[str]]
"""One clip or several: numbers, paths of files, or folders, which stand for all clips below them."""


class Unchanged(enum.Enum):
    """The type of ``UNCHANGED``."""

    UNCHANGED = enum.auto()


UNCHANGED = Unchanged.UNCHANGED
"""Leaves a label as it is, where None would take it away."""


def select_ids(
    connection: sa.Connection, where: str, selection: Selection, category: str | None, performer: str | None
) -> list[int]:
    """Numbers of the clips that are chosen, ascending.

    Parameters
    ----------
    connection, where : the library and its name for messages.
    selection : clips; nothing chosen means all clips, of the category or performer where one is given.
    category, performer : only clips of this label.

    Raises
    ------
    OptionError : nothing is chosen at all.
    LibraryError : a number or path that fits no clip.
    """
    items = _as_items(selection)
    if not items and category is None and performer is None:
        raise OptionError("expected clips (numbers, files or folders) or a category, got nothing")
    table = schema.clips.c
    query = sa.select(table.id, table.path)
    if category is not None:
        query = query.where(table.category == category)
    if performer is not None:
        query = query.where(table.performer == performer)
    rows = connection.execute(query).all()
    if not rows and not items:
        named = [
            text for text, value in (("category", category), ("performer", performer)) if value is not None
        ]
        values = " and ".join(f"{name} '{category if name == 'category' else performer}'" for name in named)
        raise LibraryError(f"{where}: no clip of {values}; see: dousa list")
    if not items:
        return sorted(row.id for row in rows)
    known = {row.id for row in rows}
    chosen: set[int] = set()
    for item in items:
        chosen |= _numbered(known, item, where) if isinstance(item, int) else _below(rows, item, where)
    return sorted(chosen)


def _as_items(selection: Selection) -> list[int | str | os.PathLike[str]]:
    if isinstance(selection, int | str | os.PathLike):
        return [selection]
    return list(selection)


def _numbered(known: Set[int], number: int, where: str) -> set[int]:
    if number not in known:
        raise LibraryError(f"{where}: no clip {number}; see: dousa list")
    return {number}


def _below(rows: Sequence[Any], item: str | os.PathLike[str], where: str) -> set[int]:
    path = os.path.abspath(item)
    below = path.rstrip(os.sep) + os.sep
    found = {row.id for row in rows if row.path == path or row.path.startswith(below)}
    if not found:
        raise LibraryError(f"{where}: no clip of '{os.fspath(item)}'; see: dousa list")
    return found


def portions(ids: Sequence[Item]) -> Iterable[Sequence[Item]]:
    """Numbers, or what goes with them, in lists short enough for one query."""
    return (ids[start : start + _VALUES_AT_ONCE] for start in range(0, len(ids), _VALUES_AT_ONCE))
