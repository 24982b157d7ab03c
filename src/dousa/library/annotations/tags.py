"""Tags of clips and takes, such as ``fight`` or ``draft``, and saved searches and selections.

A clip can have several tags; the forest ignores them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.library.label_rules import check_text, fits_category
from dousa.library.results import Answer
from dousa.library.store import schema
from dousa.library.store.checksums import SEARCHES
from dousa.library.store.engine import Database, next_revision
from dousa.library.store.rows import fetch_in, fetch_rows, insert_rows
from dousa.library.store.selection import list_clips, read_tags, save_tags

FAVOURITE = "favourite"
"""The tag that the studio shows as a star."""

CHECKED = "checked"
"""The tag of clips whose label was reviewed and found right."""


def check_tags(tags: Iterable[str]) -> tuple[str, ...]:
    """Return tags stripped and without repeats; OptionError for an invalid one."""
    names = []
    for tag in [tags] if isinstance(tags, str) else tags:
        name = tag.strip()
        check_text(name)
        if not name or not name.isprintable() or name[0] in "+-":
            raise OptionError("library_tags.not_a_tag", tag=tag)
        names.append(name)
    return tuple(dict.fromkeys(names))


def change_tags(
    connection: sa.Connection, ids: Sequence[int], add: Iterable[str], remove: Iterable[str], *, most: int = 100
) -> dict[int, tuple[str, ...]]:
    """Add and remove tags; return the tags of clips and takes that change. OptionError if one gets over ``most``."""
    there = read_tags(connection, ids)
    more, less = set(add), set(remove)
    wanted = {number: tuple(sorted((set(there.get(number, ())) - less) | more)) for number in ids}
    changed = {number: tags for number, tags in wanted.items() if tags != there.get(number, ())}
    if any(len(tags) > most for tags in changed.values()):
        raise OptionError("library_tags.too_many", most=most)
    save_tags(connection, changed)
    return changed


def count_tags(connection: sa.Connection) -> dict[str, int]:
    """Return the number of clips and takes of each tag."""
    return dict(sorted(Counter(tag for tags in read_tags(connection).values() for tag in tags).items()))


_FILTERS = ("text", "category", "performer", "tag", "kind", "min_s", "max_s", "clips")


@dataclass(frozen=True, slots=True)
class SavedSearch(Answer):
    """A saved search or selection.

    Parameters
    ----------
    name : of it.
    asked : values by filter: ``text``, ``category``, ``performer``, ``tag`` (lists: any of them; ``kick/`` stands for
        all categories below it), ``kind``, ``min_s``, ``max_s``; or ``clips``, numbers of a selection.
    """

    name: str
    asked: Mapping[str, Any]

    @property
    def is_selection(self) -> bool:
        """Whether it is a list of clips."""
        return "clips" in self.asked


class SavedSearches:
    """The saved searches and selections of a library, ``Library.searches``; ``most`` of them can be saved."""

    def __init__(self, database: Database, *, most: int = 500) -> None:
        self._database, self._most = database, most

    def all(self) -> list[SavedSearch]:
        """Return all, by name."""
        with self._database.reading() as connection:
            return _read(connection)

    def get(self, name: str) -> SavedSearch:
        """Return one; LibraryError if there is none of this name."""
        found = [one for one in self.all() if one.name == name]
        if not found:
            raise LibraryError("library_searches.none", library=self._database.where, name=name)
        return found[0]

    def save(self, name: str, asked: Mapping[str, Any]) -> SavedSearch:
        """Save one, replacing another of its name.

        Raises
        ------
        OptionError : an empty name, or unknown filters.
        LibraryError : the library cannot be written, or there are too many.
        """
        search = _check(name, asked)
        with self._database.writing() as connection:
            next_revision(connection)
            table = schema.saved_searches
            connection.execute(sa.delete(table).where(table.c.name == search.name))
            numbers = set(connection.execute(sa.select(table.c.number)).scalars())
            if len(numbers) >= self._most:
                raise LibraryError("library_searches.too_many", library=self._database.where, most=self._most)
            free = next(number for number in range(1, self._most + 1) if number not in numbers)
            row = {"number": free, "name": search.name, "asked": dict(search.asked)}
            insert_rows(connection, table, [row])
        return search

    def remove(self, name: str) -> None:
        """Delete one; LibraryError if there is none of this name."""
        with self._database.writing() as connection:
            next_revision(connection)
            table = schema.saved_searches
            gone = connection.execute(sa.delete(table).where(table.c.name == name))
            if not gone.rowcount:
                raise LibraryError("library_searches.none", library=self._database.where, name=name)

    def find(self, name: str) -> list[int]:
        """Return the numbers of the clips and takes that fit now, ascending; of a selection those that still exist."""
        asked = self.get(name).asked
        with self._database.reading() as connection:
            if "clips" in asked:
                clips = schema.clips.c
                return sorted(row.id for row in fetch_in(connection, sa.select(clips.id), clips.id, asked["clips"]))
            return sorted(clip.id for clip in list_clips(connection) if _fits(clip, asked))


def _read(connection: sa.Connection) -> list[SavedSearch]:
    found = (SavedSearch(row.name, row.asked) for row in fetch_rows(connection, SEARCHES))
    return sorted(found, key=lambda one: one.name)


def _check(name: str, asked: Mapping[str, Any]) -> SavedSearch:
    plain = name.strip()
    if not plain or not plain.isprintable():
        raise OptionError("library_searches.no_name", name=name)
    check_text(plain)
    unknown = sorted(set(asked) - set(_FILTERS))
    if unknown or not asked:
        raise OptionError("library_searches.no_filter", found=tuple(unknown), known=_FILTERS)
    kept = json.loads(json.dumps(dict(asked)))
    return SavedSearch(plain, kept)


def _fits(clip: Any, asked: Mapping[str, Any]) -> bool:
    categories, performers = _as_list(asked.get("category")), _as_list(asked.get("performer"))
    if categories and not any(fits_category(clip.category or "", one) for one in categories):
        return False
    if performers and (clip.performer or "") not in performers:
        return False
    tags = _as_list(asked.get("tag"))
    if tags and not (set(tags) & set(clip.tags) or ("" in tags and not clip.tags)):
        return False
    if asked.get("kind") and clip.kind != asked["kind"]:
        return False
    if not float(asked.get("min_s") or 0.0) <= clip.duration < float(asked.get("max_s") or float("inf")):
        return False
    said = " ".join([clip.path, clip.category or "", clip.performer or "", *clip.tags]).casefold()
    return all(word in said for word in str(asked.get("text") or "").casefold().split())


def _as_list(value: Any) -> Sequence[str]:
    if value is None:
        return ()
    return (value,) if isinstance(value, str) else tuple(_texts(value))


def _texts(values: Iterable[Any]) -> Iterable[str]:
    return (str(value) for value in values)
