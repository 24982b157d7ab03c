"""Match motions with queries in words.

A query is a list of weighted words: an action weighs more than a side or a chair. It finds a word of a motion if both
have the same stem or name related concepts. Names and categories are taken together, relations at most two at a time
(the left of one and the raised hand of another make no raised left hand). The score is the share of the query's weight
that is found, 0 to 1.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.retrieval.words.vocabulary import Vocabulary, Word, read_words, stem

LEAST_SCORE, LEAST_OF_BEST = 0.5, 0.78
"""Least score of an answer: absolute, and as a share of the best score."""

# Words of a name, relative to those of a category; relations of motions whose category names no action, and of others.
NAME, DOES, ALSO_DOES = 0.95, 0.95, 0.7
_SPELLING, _MEANING = 0.9, 0.85  # a corrected word; a similar word in place of an unknown one
OPPOSITE = 0.3  # factor for words with the opposite meaning (docs/words.md)
_BOTH, _TACIT = "both", 0.1  # hands without a side are both, at a small weight
_OR = re.compile(r"\s+or\s+|または|もしくは|あるいは", re.IGNORECASE)
_NOT = re.compile(r"\b(?:not?|never|without|except|\w+n't)\b|(?<=[かがさたなばまらわ])ない|ません|以外", re.IGNORECASE)
_ALIKE, _LONG = 0.45, 4  # least cosine of similar words, and their least number of letters


@dataclass(frozen=True, slots=True)
class Slot:
    """A word of a query.

    Parameters
    ----------
    word : as understood.
    weight : its share of the query.
    factor : value of finding it; below 1 if the word was corrected or replaced.
    tacit : whether it was added, so that nothing contradicts it.
    """

    word: Word
    weight: float
    factor: float = 1.0
    tacit: bool = False


@dataclass(frozen=True, slots=True)
class ReadQuery:
    """A query as understood.

    Parameters
    ----------
    slots : its words.
    corrections : misspelt words and their corrections.
    replaced : unknown words and known words of similar meaning.
    unknown : unknown words without a replacement.
    """

    slots: tuple[Slot, ...]
    corrections: dict[str, str]
    replaced: dict[str, str]
    unknown: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Unit:
    """Words that belong together: those of a name or of one relation.

    Parameters
    ----------
    words : the words.
    weight : the sum of their weights.
    """

    words: tuple[Word, ...]
    weight: float


@dataclass(frozen=True, slots=True)
class Fit:
    """The match of a motion with a query.

    Parameters
    ----------
    score : 0 to 1.
    relations : places of the relations that raised the score, the most useful first.
    in_category, in_name : whether their words matched.
    """

    score: float
    relations: tuple[int, ...]
    in_category: bool
    in_name: bool


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """The matches of N motions with a query, as of ``Fit``; ``relations`` (N, 2), -1 for none."""

    scores: FloatArray
    relations: IndexArray
    in_category: NDArray[np.bool_]
    in_name: NDArray[np.bool_]

    def of(self, row: int) -> Fit:
        """Return the match of one motion."""
        used = tuple(place for place in self.relations[row].tolist() if place >= 0)
        return Fit(float(self.scores[row]), used, bool(self.in_category[row]), bool(self.in_name[row]))


def weigh_word(vocabulary: Vocabulary, word: Word) -> float:
    """Return the weight of a word in a query."""
    if not word.meanings:
        return vocabulary.unknown
    return max(vocabulary.concepts[name].weight for name in word.meanings)


def make_unit(vocabulary: Vocabulary, words: Sequence[Word]) -> Unit:
    """Make a unit of words; duplicates count once."""
    distinct = tuple(dict.fromkeys(words))
    return Unit(distinct, sum(weigh_word(vocabulary, word) for word in distinct))


class KnownWords:
    """The words of motions that the vocabulary lacks, by key.

    Parameters
    ----------
    words : of the motions.
    """

    def __init__(self, words: Iterable[Word]) -> None:
        self.own = {word.key: word for word in words if not word.meanings}
        self.spelled = {key: word for key, word in self.own.items() if not any(map(str.isdigit, key))}


Replace = Callable[[str], "tuple[str, float] | None"]
"""Return a known word similar to an unknown English one, and its cosine, or None."""


def read_query(vocabulary: Vocabulary, text: str, known: KnownWords, replacement: Replace | None = None) -> ReadQuery:
    """Read a query.

    Parameters
    ----------
    text : in English, Japanese or both.
    known : words of the motions searched.
    replacement : for words that neither the motions nor the vocabulary have.
    """
    slots: list[Slot] = []
    corrections: dict[str, str] = {}
    replaced: dict[str, str] = {}
    unknown: list[str] = []
    for word in dict.fromkeys(read_words(vocabulary, text)):
        slot = Slot(word, weigh_word(vocabulary, word))
        if not word.meanings and word.key not in known.own:
            other = _correct(vocabulary, word, known)
            similar = (
                replacement(word.text)
                if other is None and replacement and word.text.isascii() and len(word.text) >= _LONG
                else None
            )
            if other is not None:
                corrections[word.text] = other.text
                slot = Slot(other, weigh_word(vocabulary, other), _SPELLING)
            elif similar is not None and similar[1] >= _ALIKE:
                replaced[word.text] = similar[0]
                near = read_words(vocabulary, similar[0])
                slot = replace(slot, word=near[0] if near else word, factor=_MEANING)
            else:
                unknown.append(word.text)
        slots.append(slot)
    if _speaks_of_both(vocabulary, [slot.word for slot in slots]):
        slots.append(Slot(Word(_BOTH, _BOTH, (_BOTH,)), _TACIT, tacit=True))
    return ReadQuery(_weigh_implied(vocabulary, _without_extras(slots)), corrections, replaced, tuple(unknown))


def _speaks_of_both(vocabulary: Vocabulary, words: Sequence[Word]) -> bool:
    """Return whether words name a limb in the plural, or in Japanese, without a side."""
    kinds = {vocabulary.concepts[name].kind for word in words for name in word.meanings}
    return "side" not in kinds and any(
        vocabulary.paired.intersection(word.meanings)
        and (not word.text.isascii() or word.text.casefold() == "feet" or word.text.casefold().endswith("s"))
        for word in words
    )


def split_alternatives(vocabulary: Vocabulary, text: str) -> list[str]:
    """Return the parts of "walk or sit" if each names an action, else the text as it is."""
    parts = [part for part in _OR.split(text) if part.strip()]

    def acts(part: str) -> bool:
        words = read_words(vocabulary, part)
        return any(vocabulary.concepts[name].kind == "action" for word in words for name in word.meanings)

    return parts if len(parts) > 1 and all(map(acts, parts)) else [text]


def find_negation(text: str) -> str | None:
    """Return the first negation in a text, if any."""
    found = _NOT.search(text)
    return None if found is None else found[0].strip()


def _without_extras(slots: list[Slot]) -> tuple[Slot, ...]:
    seen: dict[tuple[str, ...], Slot] = {}
    for slot in slots:
        seen.setdefault(slot.word.meanings or (slot.word.key,), slot)
    return tuple(seen.values())


def _weigh_implied(vocabulary: Vocabulary, slots: tuple[Slot, ...], share: float = 0.3) -> tuple[Slot, ...]:
    """Reduce the weight of parts that an action of the query implies, the hands of clapping, to a ``share``."""
    meant = {name for slot in slots for name in slot.word.meanings}
    implied = {part for part, action in vocabulary.implied if action in meant}
    return tuple(
        replace(slot, weight=share * slot.weight) if implied.intersection(slot.word.meanings) else slot
        for slot in slots
    )


def _correct(vocabulary: Vocabulary, word: Word, known: KnownWords) -> Word | None:
    """Return the known word nearest to a misspelt one, if near enough."""
    edits = (len(word.text) >= 3) + (len(word.text) >= 8)  # two from eight letters on
    if not edits or any(letter.isdigit() for letter in word.text):
        return None
    from rapidfuzz import process
    from rapidfuzz.distance import OSA

    choices: dict[str, Word] = {}
    if word.text.isascii():
        for key, meanings in vocabulary.english.items():
            written = vocabulary.spelled.get(key[0], key[0]) if len(key) == 1 else ""
            if len(written) > 2 and len(meanings[0]) == 1 and meanings[0][0] in vocabulary.concepts:
                meant = Word(written, key[0], tuple(names[0] for names in meanings))
                choices |= dict.fromkeys((written, key[0], f"{key[0]}ing", f"{written}s"), meant)
    else:
        for form, meanings in vocabulary.japanese.items():
            if len(form) >= 4 and len(meanings[0]) == 1 and meanings[0][0] in vocabulary.concepts:
                choices[form] = Word(form, form, tuple(names[0] for names in meanings))
    choices |= known.spelled
    for asked in (word.text.casefold(), stem(word.text)):
        best = process.extractOne(asked, choices.keys(), scorer=OSA.distance, score_cutoff=edits)
        # The first letter is seldom wrong, and short words are near too many others.
        if best is not None and (best[0][:1] == asked[:1] or len(asked) >= 6):
            return choices[best[0]]
    return None


class Matcher:
    """Compare one query with units of words; equal units are compared once."""

    def __init__(self, vocabulary: Vocabulary, query: ReadQuery) -> None:
        self._vocabulary = vocabulary
        self.query = query
        self._found: dict[Unit, tuple[tuple[float, ...], bool]] = {}
        self._relations: dict[Unit, tuple[float, ...]] = {}

    def find(self, unit: Unit) -> tuple[tuple[float, ...], bool]:
        """Return the value of each slot in a unit, 0 to 1, and whether the unit contradicts a slot that it lacks."""
        found = self._found.get(unit)
        if found is None:
            values = tuple(self._find_slot(slot, unit) for slot in self.query.slots)
            against = self._contradicts(unit, values)
            found = self._found[unit] = values, against
        return found

    def _find_slot(self, slot: Slot, unit: Unit) -> float:
        related = self._vocabulary.related
        best = 0.0
        for word in unit.words:
            if word.key == slot.word.key:
                return slot.factor
            for asked in slot.word.meanings:
                for said in word.meanings:
                    best = max(best, related.get((asked, said), 0.0))
        return slot.factor * best

    def _contradicts(self, unit: Unit, values: Sequence[float]) -> bool:
        """Return whether a unit has the opposite of a missing concept, or names only other parts of the body."""
        said = {name for other in unit.words for name in other.meanings}
        opposites = self._vocabulary.opposites
        slots = list(zip(self.query.slots, values, strict=True))
        lacking = {name for slot, value in slots if not value and not slot.tacit for name in slot.word.meanings}
        if any((asked, other) in opposites for asked in lacking for other in said):
            return True
        parts = [value for slot, value in slots if any(map(self._is_part, slot.word.meanings))]
        return bool(parts) and not any(parts) and any(map(self._is_part, said))

    def _is_part(self, name: str) -> bool:
        return self._vocabulary.concepts[name].kind == "part"

    def find_relation(self, unit: Unit) -> tuple[float, ...]:
        """Return the value of each slot in a relation, reduced if the query names only a small part of it."""
        found = self._relations.get(unit)
        if found is None:
            values, against = self.find(unit)
            scale = self._scale_relation(unit) * (OPPOSITE if against else 1.0)
            found = self._relations[unit] = tuple(scale * value for value in values)
        return found

    def _scale_relation(self, unit: Unit, least: float = 0.5, enough: float = 0.6, done: float = 0.9) -> float:
        """Return the share of a relation that a query covers: by its action, or by most of its words.

        It counts if the query names more than a share ``least`` of its words, and fully from ``enough``; at least by
        ``done`` if the query names the action.
        """
        named = [word for word in unit.words if any(self._is_named(word, slot) for slot in self.query.slots)]
        actions = [word for word in unit.words if self.is_action(word)]
        share = sum(weigh_word(self._vocabulary, word) for word in named) / unit.weight
        whole = min(1.0, share / enough) if share > least else 0.0
        return max(whole, done) if actions and any(word in named for word in actions) else whole

    def _is_named(self, word: Word, slot: Slot) -> bool:
        related = self._vocabulary.related
        return word.key == slot.word.key or any(
            (asked, said) in related for asked in slot.word.meanings for said in word.meanings
        )

    def is_action(self, word: Word) -> bool:
        return any(self._vocabulary.concepts[name].kind == "action" for name in word.meanings)


def is_whole(values: Sequence[float], slots: Sequence[Slot]) -> bool:
    """Return whether a relation matches an action of the query, not only its side or limb."""
    return any(value > 0.5 and slot.weight >= 1.0 for value, slot in zip(values, slots, strict=True))


@dataclass(frozen=True, slots=True)
class MotionWords:
    """The words of one motion.

    Parameters
    ----------
    category, name : their words.
    relations : its relations, each with the share of the motion for which it holds.
    """

    category: Unit
    name: Unit
    relations: tuple[tuple[Unit, float], ...]


class WordColumns:
    """The words of N motions."""

    def __init__(self, motions: Sequence[MotionWords]) -> None:
        self.motions = tuple(motions)
        self._categories, self._category_of = _number([one.category for one in motions])
        named = {one.name for one in motions}
        meant = {unit: Unit(tuple(word for word in unit.words if word.meanings), 0.0) for unit in named}
        self._names, self._name_of = _number([meant[one.name] for one in motions])
        spelled: dict[str, list[int]] = {}
        for row, one in enumerate(motions):
            for key in {word.key for word in one.name.words if not word.meanings}:
                spelled.setdefault(key, []).append(row)
        self._spelled = {key: np.array(rows, np.intp) for key, rows in spelled.items()}
        flat = [(row, unit, share) for row, one in enumerate(motions) for unit, share in one.relations]
        self._relations, self._unit_of = _number([unit for _, unit, _ in flat])
        self._row_of = np.array([row for row, _, _ in flat], np.intp)
        shares = np.array([share for _, _, share in flat], np.float64)
        self._lasting = 0.8 + 0.2 * np.minimum(1.0, 2.0 * shares)

    def fit(self, matcher: Matcher, enough: float = 0.4) -> Fits:
        """Match all motions; words of a category or name count as matched above the value ``enough``."""
        query = matcher.query
        n_motions, weights = len(self.motions), np.array([slot.weight for slot in query.slots], np.float64)
        used = np.full((n_motions, 2), -1, np.intp)
        if not weights.sum():
            nothing = np.zeros(n_motions, bool)
            return Fits(np.zeros(n_motions), used, nothing, nothing)
        by_category, by_name, base, trust = self._compare_names(matcher)
        found = np.array([matcher.find_relation(unit) for unit in self._relations]).reshape(-1, len(weights))
        useful: NDArray[np.bool_] = np.any(found != 0, axis=1).astype(bool).reshape(-1)
        helps = np.flatnonzero(useful[self._unit_of])
        gains = (trust[self._row_of[helps]] * self._lasting[helps])[:, np.newaxis] * found[self._unit_of[helps]]
        # A second one helps only if the query names its action: walking, with both hands up.
        whole = np.array([is_whole(values, query.slots) for values in gains.tolist()], bool)
        total = weights.sum()
        scores: FloatArray = base @ weights / total
        for turn, chosen in enumerate((np.ones(len(helps), bool), whole)):
            rows = self._row_of[helps[chosen]]
            base, scores, best = _take_best(base, scores, rows, gains[chosen], weights / total)
            if not len(best):
                break
            relations = helps[chosen][best]
            used[rows[best], turn] = relations - np.searchsorted(self._row_of, rows[best])
        matched = (np.asarray((values > enough).any(axis=1)) for values in (by_category, by_name))
        return Fits(scores, used, *matched)

    def _compare_names(self, matcher: Matcher) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return (N, slots) values in categories, in names and in both, and (N,) factors of relations."""
        n_slots = len(matcher.query.slots)
        category, against = _compare(matcher, self._categories, n_slots)
        name, name_against = _compare(matcher, self._names, n_slots)
        by_category, by_name, against_name = (
            category[self._category_of],
            name[self._name_of],
            name_against[self._name_of],
        )
        for rows, unit in self._list_spelled({slot.word.key for slot in matcher.query.slots}):
            by_name[rows], against_name[rows] = matcher.find(unit)
        opposes: NDArray[np.bool_] = np.logical_or(against[self._category_of], against_name)
        scale = np.where(opposes, OPPOSITE, 1.0).reshape(-1, 1)
        base = scale * np.maximum(by_category, NAME * by_name)
        acts = np.array([any(map(matcher.is_action, unit.words)) for unit in self._categories], bool)
        trust = np.where(acts, ALSO_DOES, DOES)
        return by_category, by_name, base, trust[self._category_of]

    def _list_spelled(self, keys: set[str]) -> Iterator[tuple[IndexArray, Unit]]:
        """Yield the motions whose names have unknown words of these keys, with the unit of their names."""
        there = sorted(keys.intersection(self._spelled))
        if not there:
            return
        has = np.zeros((len(self.motions), len(there)), bool)
        for place, key in enumerate(there):
            has[self._spelled[key], place] = True
        some = np.flatnonzero(has.any(axis=1))
        kinds, kind_of = np.unique(np.column_stack([self._name_of[some], has[some]]), axis=0, return_inverse=True)
        for number, (name, *own) in enumerate(kinds.tolist()):
            words = tuple(Word(key, key) for key, is_there in zip(there, own, strict=True) if is_there)
            yield some[kind_of.ravel() == number], Unit((*self._names[name].words, *words), 0.0)


def _number(units: Sequence[Unit]) -> tuple[list[Unit], IndexArray]:
    places: dict[Unit, int] = {}
    # Most units occur many times, and comparing identities is faster than comparing words.
    objects = {id(unit): unit for unit in units}
    known = {key: places.setdefault(unit, len(places)) for key, unit in objects.items()}
    return list(places), np.array([known[id(unit)] for unit in units], np.intp)


def _compare(matcher: Matcher, units: Sequence[Unit], n_slots: int) -> tuple[FloatArray, NDArray[np.bool_]]:
    found = [matcher.find(unit) for unit in units]
    values = np.array([values for values, _ in found], np.float64).reshape(-1, n_slots)
    return values, np.array([against for _, against in found], bool)


def _take_best(
    base: FloatArray, score: FloatArray, rows: IndexArray, gains: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Add to (N, slots) values the relation that helps each motion most; return values, scores, places of those added.

    ``rows`` are the motions of the relations, ascending, and the array after them holds their values.
    """
    more = np.maximum(base[rows], gains) @ weights
    order = np.lexsort((-more, rows))
    first = order[np.unique(rows[order], return_index=True)[1]]
    first = first[more[first] > score[rows[first]] + 1e-9]
    base, score = base.copy(), score.copy()
    base[rows[first]] = np.maximum(base[rows[first]], gains[first])
    score[rows[first]] = more[first]
    return base, score, first
