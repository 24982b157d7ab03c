"""The index of words of a library, and searching in it; it stays in memory until the library changes."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import sqlalchemy as sa

from dousa.errors import OptionError
from dousa.library.engine import Database, read_revision
from dousa.library.seals.checksums import LABELS
from dousa.library.text.answers import TextHit, TextResult
from dousa.library.text.store import load_relations
from dousa.messages.tables import LANGUAGES
from dousa.retrieval.words.matching import (
    LEAST_OF_BEST,
    LEAST_SCORE,
    Fit,
    Matcher,
    ReadQuery,
    Unit,
    make_unit,
    read_query,
)
from dousa.retrieval.words.reading import Word, read_words
from dousa.retrieval.words.relations import Relation
from dousa.retrieval.words.vectors import load_replacement
from dousa.retrieval.words.vocabulary import Vocabulary, load_vocabulary, normalise

_LONGEST = 500  # characters of a query
_LITERAL = 0.6  # score of a name that has the query in it letter by letter
_MOST_NEAR = 5  # words that are offered where nothing fits
_NEAR_MEANING, _NEAR_SPELLING = 0.4, 60  # weight of what such a word finds; per cent of its letters


@dataclass(frozen=True, slots=True)
class _Entry:
    """A motion in the index: its row, the words of its category and name, its relations with theirs."""

    row: Any
    category: Unit
    name: Unit
    literal: str
    relations: tuple[Relation, ...]
    units: tuple[tuple[Unit, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _TextIndex:
    """The motions in the order of their paths, as of a revision of the library."""

    revision: int
    entries: tuple[_Entry, ...]
    words: frozenset[Word]


class TextSearcher:
    """Answers questions in words about one library."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._index: _TextIndex | None = None

    def search(
        self,
        text: str,
        k: int | None,
        *,
        category: str | None = None,
        performer: str | None = None,
        kind: str | None = None,
    ) -> TextResult:
        """The motions that fit a text; as ``Library.search_text``."""
        _check_text(text)
        with self._database.reading() as connection:
            revision = read_revision(connection)
            if self._index is None or self._index.revision != revision:
                self._index = _load_index(connection, revision)
            index = self._index
        chosen = [entry for entry in index.entries if _is_chosen(entry.row, category, performer, kind)]
        vocabulary = load_vocabulary()
        query = read_query(vocabulary, text, index.words, load_replacement())
        fits = _find(vocabulary, query, text, chosen)
        hits = tuple(_make_hit(entry, fit, rank) for rank, (entry, fit) in enumerate(fits[:k], start=1))
        near = () if fits else _find_near(vocabulary, query, chosen)
        return TextResult(text, hits, len(fits), len(chosen), query.corrections, query.replaced, query.unknown, near)


def _check_text(text: str) -> None:
    if not text.strip():
        raise OptionError("library_text.empty")
    if len(text) > _LONGEST:
        raise OptionError("library_text.too_long", most=_LONGEST, found=len(text))


def _is_chosen(row: Any, category: str | None, performer: str | None, kind: str | None) -> bool:
    wanted = (("category", category), ("performer", performer), ("kind", kind))
    return all(value is None or getattr(row, name) == value for name, value in wanted)


def _load_index(connection: sa.Connection, revision: int) -> _TextIndex:
    query = sa.select(*LABELS.columns)
    relations = load_relations(connection)
    vocabulary = load_vocabulary()
    units: dict[tuple[str, str], Unit] = {}
    categories: dict[str, Unit] = {}
    entries = []
    rows = connection.execute(query).all()
    for row in rows:
        LABELS.check(connection, row)
    for row in sorted(rows, key=lambda row: str(row.path)):
        label = row.category or ""
        if label not in categories:
            categories[label] = make_unit(vocabulary, read_words(vocabulary, label, name=True))
        own = relations.get(row.id, ())
        for relation in own:
            if (relation.name, relation.part) not in units:
                units[relation.name, relation.part] = _make_relation_unit(vocabulary, relation)
        name = _name_of(row.path)
        entries.append(
            _Entry(
                row,
                categories[label],
                make_unit(vocabulary, read_words(vocabulary, name, name=True)),
                _literal(f"{label} {name}"),
                own,
                tuple((units[one.name, one.part], one.share) for one in own),
            )
        )
    words = frozenset(word for entry in entries for unit in (entry.category, entry.name) for word in unit.words)
    return _TextIndex(revision, tuple(entries), words)


def _name_of(path: str) -> str:
    """The file's name without its suffix."""
    return PurePath(os.path.basename(path)).stem or path


def _make_relation_unit(vocabulary: Vocabulary, relation: Relation) -> Unit:
    """The words of a relation in every language; each language says the same, so it weighs once."""
    texts = [relation.message.render(language) for language in LANGUAGES]
    read = [make_unit(vocabulary, read_words(vocabulary, text)) for text in texts]
    first = read[0]
    known = {name for word in first.words for name in word.meanings}
    more = tuple(word for unit in read[1:] for word in unit.words if not known.intersection(word.meanings))
    return Unit(first.words + more, first.weight)


def _literal(text: str) -> str:
    return "".join(letter for letter in normalise(text).casefold() if letter.isalnum())


def _find(vocabulary: Vocabulary, query: ReadQuery, text: str, entries: Iterable[_Entry]) -> list[tuple[_Entry, Fit]]:
    """The motions that fit, the best first; equals in the order of their paths."""
    matcher = Matcher(vocabulary, query)
    letters = _literal(text)
    found = []
    for entry in entries:
        fit = matcher.fit(entry.category, entry.name, entry.units)
        if fit.score < _LITERAL and len(letters) >= 3 and letters in entry.literal:
            fit = Fit(_LITERAL, (), in_category=False, in_name=True)
        if fit.score >= LEAST_SCORE:
            found.append((entry, fit))
    found.sort(key=lambda item: -round(item[1].score, 3))
    best = found[0][1].score if found else 0.0
    return [item for item in found if item[1].score >= LEAST_OF_BEST * best]


def _make_hit(entry: _Entry, fit: Fit, rank: int) -> TextHit:
    row = entry.row
    return TextHit(
        clip_id=row.id,
        path=row.path,
        category=row.category,
        performer=row.performer,
        kind=row.kind,
        rank=rank,
        score=round(fit.score, 3),
        in_category=fit.in_category,
        in_name=fit.in_name,
        relations=tuple(entry.relations[place] for place in fit.relations),
    )


def _find_near(vocabulary: Vocabulary, query: ReadQuery, entries: Iterable[_Entry]) -> tuple[str, ...]:
    """Words of categories and relations that come nearest: by what they mean, else by their letters."""
    from rapidfuzz import fuzz, process

    units: dict[str, Unit] = {}
    counts: Counter[str] = Counter()
    for entry in entries:
        told = [(str(one.message), unit) for one, (unit, _) in zip(entry.relations, entry.units, strict=True)]
        for text, unit in [(entry.row.category or "", entry.category), *told]:
            units[text] = unit
            counts[text] += 1
    units.pop("", None)
    matcher = Matcher(vocabulary, query)
    weights = [slot.weight for slot in query.slots]
    # An action that is near, not a limb or a side: those are everywhere.
    scores = {
        text: max((w * value for w, value in zip(weights, matcher.find(unit)[0], strict=True)), default=0.0)
        for text, unit in units.items()
    }
    meant = sorted(
        (text for text in units if scores[text] >= _NEAR_MEANING), key=lambda text: (-scores[text], -counts[text], text)
    )
    words = sorted({word.text for unit in units.values() for word in unit.words if len(word.text) > 2})
    spelled = [
        found
        for word in query.unknown
        for found, ratio, _ in process.extract(word, words, scorer=fuzz.ratio, limit=2)
        if ratio >= _NEAR_SPELLING
    ]
    return tuple(dict.fromkeys([*meant, *spelled]))[:_MOST_NEAR]
