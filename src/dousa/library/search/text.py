"""Search by words; the index of words stays in memory, and only changed motions are read again."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Any, ClassVar

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import OptionError
from dousa.library.label_rules import fits_category
from dousa.library.results import Answer
from dousa.library.search.text_store import load_relations
from dousa.library.store import schema
from dousa.library.store.checksums import LABELS
from dousa.library.store.engine import Database, read_revision
from dousa.library.store.rows import fetch_rows
from dousa.messages.tables import LANGUAGES
from dousa.notebooks import Tabular, short_repr
from dousa.retrieval.words.matching import (
    LEAST_OF_BEST,
    LEAST_SCORE,
    Fit,
    Fits,
    KnownWords,
    Matcher,
    MotionWords,
    Unit,
    WordColumns,
    find_negation,
    make_unit,
    read_query,
    split_alternatives,
)
from dousa.retrieval.words.relations import RELATIONS_VERSION, Relation
from dousa.retrieval.words.vocabulary import Vocabulary, load_replacement, load_vocabulary, normalise, read_words


@dataclass(frozen=True, slots=True)
class TextHit:
    """A clip or take that fits the words.

    Parameters
    ----------
    clip_id, path, category, performer, kind : as in ``ClipInfo``.
    rank : 1 for the best.
    score : share of the query that it meets, 0 to 1.
    in_category, in_name : whether words are in its category, or in its name.
    relations : relations that fit the words, each with its longest stretch.
    """

    clip_id: int
    path: str
    category: str | None
    performer: str | None
    kind: str
    rank: int
    score: float
    in_category: bool
    in_name: bool
    relations: tuple[Relation, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the hit as a plain dictionary; times in s."""
        names = ("rank", "clip_id", "path", "category", "performer", "kind", "score", "in_category", "in_name")
        relations = [
            {"name": one.name, "part": one.part or None, "text": str(one.message), "share": one.share}
            | {"start_s": one.start, "end_s": one.end}
            for one in self.relations
        ]
        return {name: getattr(self, name) for name in names} | {"relations": relations}


@dataclass(frozen=True, slots=True, eq=False)
class TextMatches:
    """All clips and takes that fit words.

    Parameters
    ----------
    ids : (n,) clip numbers, the best first.
    scores : (n,) share of the query that each meets, 0 to 1.
    corrections : misspelt or unknown words, and the words used instead.
    """

    ids: NDArray[np.int64]
    scores: FloatArray
    corrections: dict[str, str]


@short_repr
@dataclass(frozen=True, slots=True)
class TextResult(Answer, Tabular):
    """The answer to a search by words.

    Parameters
    ----------
    text : the query.
    results : the first clips and takes that fit, the best first.
    n_found : number of all that fit.
    n_searched : number of clips and takes that were searched.
    corrections : misspelt words, and their corrections.
    replaced : unknown words, and words of similar meaning used instead (with ``dousa[words]``).
    unknown : words that are neither in the vocabulary nor in the library.
    near : words of the library near to the query, if nothing fits.
    """

    _rows: ClassVar[str] = "results"

    text: str
    results: tuple[TextHit, ...]
    n_found: int
    n_searched: int
    corrections: dict[str, str]
    replaced: dict[str, str]
    unknown: tuple[str, ...]
    near: tuple[str, ...]

    _names: ClassVar[dict[str, str]] = {"unknown": "unknown_words", "near": "near_words"}

    def to_json(self) -> dict[str, Any]:
        """Return the answer as plain lists and dictionaries; ``results`` come last."""
        answer = Answer.to_json(self)
        results = answer.pop("results")
        return {**answer, "results": results}


_TIME = re.compile(r"#t=[0-9.]+,[0-9.]+(&id=[0-9]+)?$")  # of a segment, after the path of its take
_NEAR_MEANING, _NEAR_SPELLING = 0.4, 60  # least score of a near meaning; of a near spelling, in per cent


@dataclass(frozen=True, slots=True)
class _Entry:
    """A motion in the index: its row, the letters of its label and name, its relations, and its words."""

    row: Any
    literal: str
    relations: tuple[Relation, ...]
    words: MotionWords


@dataclass(frozen=True, slots=True, eq=False)
class _TextIndex:
    """The motions of a library at a revision, sorted by path.

    ``stamps``, the checksums of the labels and relations of each motion by number, show which have changed.
    """

    revision: int
    entries: tuple[_Entry, ...]
    columns: WordColumns
    words: KnownWords
    stamps: Mapping[int, tuple[Any, ...]]
    units: Mapping[tuple[str, str], Unit]


class TextSearcher:
    """Searches one library by words."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._index: _TextIndex | None = None

    def match(self, text: str) -> TextMatches:
        """Return the numbers of all motions that fit a text, the best first, as ``Library.match_text`` does."""
        _check_text(text)
        index = self._load()
        matchers = _read(index, text)
        fits = [index.columns.fit(one) for one in matchers]
        rows, scores, _ = _find(fits, text, index, np.arange(len(index.entries)))
        ids = np.array([index.entries[row].row.id for row in rows.tolist()], np.int64)
        taken = _join([one.query.corrections | one.query.replaced for one in matchers])
        return TextMatches(ids, scores, taken)

    def search(
        self,
        text: str,
        k: int | None,
        *,
        category: str | None = None,
        performer: str | None = None,
        kind: str | None = None,
    ) -> TextResult:
        """Find the motions that fit a text, as ``Library.search_text`` does."""
        _check_text(text)
        index = self._load()
        chosen = _choose(index.entries, category, performer, kind)
        matchers = _read(index, text)
        fits = [index.columns.fit(one) for one in matchers]
        rows, scores, fitting = _find(fits, text, index, chosen)
        found = zip(rows[:k].tolist(), scores.tolist(), fitting.tolist(), strict=False)
        hits = tuple(
            _make_hit(index.entries[row], _fit(fits[which], row, score), rank)
            for rank, (row, score, which) in enumerate(found, start=1)
        )
        queries = [one.query for one in matchers]
        near: tuple[str, ...] = ()
        if not len(rows):
            there = [index.entries[row] for row in chosen]
            near = _find_near(matchers, there)
        corrections = _join([one.corrections for one in queries]), _join([one.replaced for one in queries])
        unknown = tuple(word for one in queries for word in one.unknown)
        return TextResult(text, hits, len(rows), len(chosen), *corrections, unknown, near)

    def _load(self) -> _TextIndex:
        with self._database.reading() as connection:
            revision = read_revision(connection)
            if self._index is None or self._index.revision != revision:
                self._index = _load_index(connection, revision, self._index)
            return self._index


def _read(index: _TextIndex, text: str) -> list[Matcher]:
    """Return a matcher for each alternative in a text."""
    vocabulary, letters = load_vocabulary(), _literal(text)
    negation = find_negation(text)
    if negation is not None and not any(letters in entry.literal for entry in index.entries):
        raise OptionError("library_text.negation", word=negation)
    parts = split_alternatives(vocabulary, text)
    return [Matcher(vocabulary, read_query(vocabulary, part, index.words, load_replacement())) for part in parts]


def _join(parts: Iterable[Mapping[str, str]]) -> dict[str, str]:
    return {word: other for part in parts for word, other in part.items()}


def _check_text(text: str, *, most: int = 500) -> None:
    """Raise OptionError for a query that is empty, or has more characters than this."""
    if not text.strip():
        raise OptionError("library_text.empty")
    if len(text) > most:
        raise OptionError("library_text.too_long", most=most, found=len(text))


def _choose(entries: Sequence[_Entry], category: str | None, performer: str | None, kind: str | None) -> IndexArray:
    """Return the places of the motions with these labels."""
    fits = [
        (category is None or fits_category(entry.row.category, category))
        and performer in (None, entry.row.performer)
        and kind in (None, entry.row.kind)
        for entry in entries
    ]
    return np.flatnonzero(np.array(fits, bool))


def _load_index(connection: sa.Connection, revision: int, known: _TextIndex | None) -> _TextIndex:
    """Load the index at a revision; of motions unchanged since a ``known`` index only checksums are read."""
    stamps = _read_stamps(connection)
    if known is not None and known.stamps == stamps:
        return replace(known, revision=revision)
    kept: list[_Entry] = []
    if known is not None:
        same = {number for number, own in known.stamps.items() if None not in own and own == stamps.get(number)}
        kept = [one for one in known.entries if one.row.id in same]
    there = {one.row.id for one in kept}
    some = None if not kept else [number for number in stamps if number not in there]
    vocabulary = load_vocabulary()
    units = {} if known is None else dict(known.units)
    categories = {one.row.category or "": one.words.category for one in kept}
    relations = load_relations(connection, some)
    for row in fetch_rows(connection, LABELS, some):
        label = row.category or ""
        if label not in categories:
            categories[label] = make_unit(vocabulary, read_words(vocabulary, label, name=True))
        own = relations.get(row.id, ())
        for relation in own:
            if (relation.name, relation.part) not in units:
                units[relation.name, relation.part] = _make_relation_unit(vocabulary, relation)
        name = _name_of(row.path)
        kept.append(
            _Entry(
                row,
                _literal(f"{label} {name}"),
                own,
                MotionWords(
                    categories[label],
                    make_unit(vocabulary, read_words(vocabulary, name, name=True)),
                    tuple((units[one.name, one.part], one.share) for one in own),
                ),
            )
        )
    entries = tuple(sorted(kept, key=lambda entry: str(entry.row.path)))
    columns = WordColumns([entry.words for entry in entries])
    words = KnownWords(
        word for entry in entries for unit in (entry.words.category, entry.words.name) for word in unit.words
    )
    return _TextIndex(revision, entries, columns, words, stamps, units)


def _read_stamps(connection: sa.Connection) -> dict[int, tuple[Any, ...]]:
    """Read the checksums of the labels and relations (None without) of all motions, by number."""
    clips, table = schema.clips.c, schema.clip_relations.c
    own = sa.select(table.clip_id, table.checksum).where(table.version == RELATIONS_VERSION)
    relations: dict[int, Any] = dict(connection.execute(own).all())
    labels = connection.execute(sa.select(clips.id, clips.label_checksum))
    return {number: (label, relations.get(number)) for number, label in labels}


def _name_of(path: str) -> str:
    """Return the file name without its suffix and the time of a segment."""
    name = _TIME.sub("", os.path.basename(path))
    return PurePath(name).stem or path


def _make_relation_unit(vocabulary: Vocabulary, relation: Relation) -> Unit:
    """Return the words of a relation in every language, with the weight of one language."""
    texts = [relation.message.render(language) for language in LANGUAGES]
    read = [make_unit(vocabulary, read_words(vocabulary, text)) for text in texts]
    first = read[0]
    known = {name for word in first.words for name in word.meanings}
    more = tuple(word for unit in read[1:] for word in unit.words if not known.intersection(word.meanings))
    return Unit(first.words + more, first.weight)


def _literal(text: str) -> str:
    return "".join(letter for letter in normalise(text).casefold() if letter.isalnum())


def _find(
    fits: Sequence[Fits], text: str, index: _TextIndex, chosen: IndexArray, *, literal: float = 0.6
) -> tuple[IndexArray, FloatArray, IndexArray]:
    """Return places, scores and best alternatives of the motions that fit, the best first, equals by path.

    A label or name that contains the query letter by letter fits; it has the score ``literal``, unless its words have
    more.
    """
    alternatives, letters = np.stack([one.scores for one in fits]), _literal(text)
    fitting, scores = alternatives.argmax(axis=0), alternatives.max(axis=0)
    called = np.zeros(len(scores), bool)
    if len(letters) >= 3:
        called[chosen] = [letters in index.entries[row].literal for row in chosen.tolist()]
        scores[called] = np.maximum(scores[called], literal)
    found = chosen[scores[chosen] >= LEAST_SCORE]
    found = found[np.argsort(-np.round(scores[found], 3), kind="stable")]
    best = scores[found[0]] if len(found) else 0.0
    found = found[called[found] | (scores[found] >= LEAST_OF_BEST * best)]
    return found, scores[found], fitting[found]


def _fit(fits: Fits, row: int, score: float, *, rounding: float = 1e-6) -> Fit:
    """Return how a motion fits: by its words, or by its letters if these score higher than ``rounding`` explains."""
    fit = fits.of(row)
    return fit if fit.score >= score - rounding else Fit(score, (), in_category=False, in_name=True)


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


def _find_near(matchers: Sequence[Matcher], entries: Sequence[_Entry], *, most: int = 5) -> tuple[str, ...]:
    """Find the ``most`` nearest words of categories and relations."""
    near = (word for one in matchers for word in _find_near_words(one, entries)[:most])
    return tuple(dict.fromkeys(near))[:most]


def _find_near_words(matcher: Matcher, entries: Iterable[_Entry]) -> list[str]:
    """Find words of categories and relations that are near by meaning, then by spelling."""
    from rapidfuzz import fuzz, process

    units: dict[str, Unit] = {}
    counts: Counter[str] = Counter()
    does: Counter[tuple[str, str]] = Counter()
    examples: dict[tuple[str, str], tuple[Relation, Unit]] = {}
    for entry in entries:
        label = entry.row.category or ""
        counts[label] += 1
        units.setdefault(label, entry.words.category)
        for one, (unit, _) in zip(entry.relations, entry.words.relations, strict=True):
            does[one.name, one.part] += 1
            examples.setdefault((one.name, one.part), (one, unit))
    for key, (relation, unit) in examples.items():
        units[str(relation.message)] = unit
        counts[str(relation.message)] += does[key]
    units.pop("", None)
    query = matcher.query
    weights = [slot.weight for slot in query.slots]
    # The best slot counts: a near action, as limbs and sides are everywhere.
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
    return list(dict.fromkeys([*meant, *spelled]))
