"""Tags of clips and takes: several of each, such as ``fight`` or ``draft``; nothing is learned from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import sqlalchemy as sa

from dousa.errors import OptionError
from dousa.library.labels import check_text
from dousa.library.selection import read_tags, save_tags

FAVOURITE = "favourite"
"""The tag that the studio shows as a star."""

CHECKED = "checked"
"""The tag of clips whose label somebody has looked at and found right."""

MOST_TAGS = 100
"""Of a clip."""


def check_tags(tags: Iterable[str]) -> tuple[str, ...]:
    """Names of tags without spaces around them, each once; OptionError for one that is none."""
    names = []
    for tag in [tags] if isinstance(tags, str) else tags:
        name = tag.strip()
        check_text(name)
        if not name or not name.isprintable() or name[0] in "+-":
            raise OptionError("library_tags.not_a_tag", tag=tag)
        names.append(name)
    return tuple(dict.fromkeys(names))


def change_tags(
    connection: sa.Connection, ids: Sequence[int], add: Iterable[str], remove: Iterable[str]
) -> dict[int, tuple[str, ...]]:
    """Give tags to clips and takes and take others away; returns the tags of those that change.

    Raises
    ------
    OptionError : more tags than a clip can have.
    """
    there = read_tags(connection, ids)
    more, less = set(add), set(remove)
    wanted = {number: tuple(sorted((set(there.get(number, ())) - less) | more)) for number in ids}
    changed = {number: tags for number, tags in wanted.items() if tags != there.get(number, ())}
    if any(len(tags) > MOST_TAGS for tags in changed.values()):
        raise OptionError("library_tags.too_many", most=MOST_TAGS)
    save_tags(connection, changed)
    return changed


def count_tags(connection: sa.Connection) -> dict[str, int]:
    """Number of clips and takes that have a tag, by name."""
    return dict(sorted(Counter(tag for tags in read_tags(connection).values() for tag in tags).items()))
