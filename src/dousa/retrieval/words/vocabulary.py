"""The table of movement words in English and Japanese, and the reading of texts with it.

The words are in ``vocabulary.toml``. An English word counts by its stem (Porter 2, of Snowball), a Japanese verb by the
forms of its last syllable.
"""

from __future__ import annotations

import importlib.util
import re
import tomllib
import unicodedata
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

STOP = "stop"
"""The concept of words without meaning for a query."""

_NARROWER, _BROADER, _CLOSE = (
    0.85,
    0.45,
    0.6,
)  # value of another concept: a narrower, a broader, a close one
_KINDS = ("action", "style", "part", "side", "place", "direction", "object")

# Kana of the last syllable of a verb: 叩く is also 叩き, 叩か, 叩い ...
_ROWS = {
    "う": "わいうえおっ",
    "く": "かきくけこい",
    "ぐ": "がぎぐげごい",
    "す": "さしすせそ",
    "つ": "たちつてとっ",
    "ぬ": "なにぬねのん",
    "ぶ": "ばびぶべぼん",
    "む": "まみむめもん",
    "る": "らりるれろっ",
}
_ONE_ROW = frozenset("いきぎしじちにひびみりえけげせぜてでねへべめれ")  # after these る may be dropped: 上げる, 上げて


@dataclass(frozen=True, slots=True)
class Concept:
    """A concept that words name.

    Parameters
    ----------
    name : its key in the table.
    kind : such as ``"action"`` or ``"part"``.
    weight : its weight in a query.
    words : its first English and Japanese words, for display.
    """

    name: str
    kind: str
    weight: float
    words: dict[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """The table of words and concepts.

    Parameters
    ----------
    concepts : by name.
    english : phrases as tuples of stems to their concepts, one tuple for each meaning, of several for a compound.
    japanese : forms to the same.
    related : value of concept b where concept a is asked for, by (a, b); 1 for the same.
    opposites : (a, b) where b contradicts a query for a.
    implied : (part, action) where the action always uses the part.
    paired : parts of the body of which there are two.
    unknown : weight of a word that is not in the table.
    spelled : English words as written, by stem.
    """

    concepts: dict[str, Concept]
    english: dict[tuple[str, ...], tuple[tuple[str, ...], ...]]
    japanese: dict[str, tuple[tuple[str, ...], ...]]
    related: dict[tuple[str, str], float]
    opposites: frozenset[tuple[str, str]]
    implied: frozenset[tuple[str, str]]
    paired: frozenset[str]
    unknown: float
    spelled: dict[str, str]

    @property
    def longest_phrase(self) -> int:
        """Words of the longest English phrase."""
        return max(map(len, self.english))

    @property
    def longest_form(self) -> int:
        """Characters of the longest Japanese form."""
        return max(map(len, self.japanese))


def normalise(text: str) -> str:
    """Return one form for wide, narrow and combined characters."""
    return unicodedata.normalize("NFKC", text)


@cache
def _stemmer() -> Any:
    import snowballstemmer

    return snowballstemmer.stemmer("english")


@cache
def stem(word: str) -> str:
    """Return the stem of an English word: "kick" for "kicking" and "kicks"."""
    lower = word.casefold()
    return str(_stemmer().stemWord(lower)) if len(lower) > 2 else lower


def _list_irregular(phrase: tuple[str, ...], forms: dict[str, str]) -> list[tuple[str, ...]]:
    """Return a phrase with the irregular forms of its first word: "bent", "got up"."""
    return [(stem(form), *phrase[1:]) for form in forms.get(phrase[0], "").split()]


@cache
def load_vocabulary() -> Vocabulary:
    """Load the table of dousa."""
    text = resources.files(__package__).joinpath("vocabulary.toml").read_text(encoding="utf-8")
    return make_vocabulary(tomllib.loads(text))


def make_vocabulary(table: dict[str, Any]) -> Vocabulary:
    """Make a vocabulary from a table like ``vocabulary.toml``."""
    weights = table["weights"]
    irregular = {stem(word): forms for word, forms in table["irregular"].items()}
    concepts: dict[str, Concept] = {}
    english: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    japanese: dict[str, list[tuple[str, ...]]] = {}
    broader: dict[str, str] = {}
    close: dict[str, list[str]] = {}
    spelled: dict[str, str] = {}
    for kind in _KINDS:
        for name, line in table[kind].items():
            words, broader_name, close_names = _split_line(line)
            concepts[name] = Concept(name, kind, weights[kind], {"en": words[0][0], "ja": words[1][0]})
            broader |= {name: broader_name} if broader_name else {}
            close[name] = close_names
            for word in words[0]:
                phrase = tuple(stem(part) for part in word.split())
                for variant in (phrase, *_list_irregular(phrase, irregular)):
                    _add(english, variant, (name,))
                spelled.setdefault(" ".join(phrase), word)
            for word in words[1]:
                for form in inflect(normalise(word)):
                    _add(japanese, form, (name,))
    for word, names in table["compound"].items():
        _add(english if word.isascii() else japanese, (stem(word),) if word.isascii() else word, tuple(names.split()))
    for word in table["stop"]["en"].split():
        english.setdefault((stem(word),), [(STOP,)])
        english.setdefault((word,), [(STOP,)])
    for word in table["stop"]["ja"].split():
        japanese.setdefault(word, [(STOP,)])
    return Vocabulary(
        concepts,
        {key: tuple(meanings) for key, meanings in english.items()},
        {key: tuple(meanings) for key, meanings in japanese.items()},
        _relate(concepts, broader, close) | {_read_pair(pair): value for pair, value in table["counts"].items()},
        _read_opposites(table["opposites"]),
        frozenset((part, action) for part, line in table["implied"].items() for action in line.split()),
        frozenset(table["paired"]["parts"].split()),
        float(weights["unknown"]),
        spelled,
    )


def _split_line(line: str) -> tuple[list[list[str]], str, list[str]]:
    """Return English and Japanese words, the broader concept or an empty text, and the close ones."""
    rest, _, close = line.partition("~")
    rest, _, broader = rest.partition(">")
    words = [[word.strip() for word in part.split(",")] for part in rest.split("|")]
    return words, broader.strip(), [name.strip() for name in close.split(",") if name.strip()]


def _read_pair(text: str) -> tuple[str, str]:
    first, second = text.split()
    return first, second


def _read_opposites(table: dict[str, str]) -> frozenset[tuple[str, str]]:
    pairs = {_read_pair(pair) for pair in table["pairs"].split(",")}
    one_way = {_read_pair(pair) for pair in table["one_way"].split(",")}
    return frozenset(pairs | {(second, first) for first, second in pairs} | one_way)


def _add(forms: dict[Any, list[tuple[str, ...]]], key: Any, names: tuple[str, ...]) -> None:
    meanings = forms.setdefault(key, [])
    if names not in meanings:
        meanings.append(names)


def _relate(
    concepts: dict[str, Concept], broader: dict[str, str], close: dict[str, list[str]]
) -> dict[tuple[str, str], float]:
    """Return the values of related concepts; several steps up or down multiply."""
    related: dict[tuple[str, str], float] = {(name, name): 1.0 for name in concepts}
    for name in concepts:
        up, down = _BROADER, _NARROWER
        above = broader.get(name)
        while above is not None:
            related[name, above] = max(related.get((name, above), 0.0), up)
            related[above, name] = max(related.get((above, name), 0.0), down)
            up, down, above = up * _BROADER, down * _NARROWER, broader.get(above)
    for name, names in close.items():
        for other in names:
            for pair in ((name, other), (other, name)):
                related[pair] = max(related.get(pair, 0.0), _CLOSE)
    return related


def inflect(word: str) -> set[str]:
    """Return a Japanese word and, if it may be a verb or an adjective, the forms of its last syllable."""
    last, rest = word[-1], word[:-1]
    if len(word) < 2 or not any("\u3041" <= letter <= "\u309f" for letter in last):
        return {word}
    if last == "い" and (len(word) >= 3 or "\u4e00" <= rest[-1] <= "\u9fff"):
        return {word, *(rest + end for end in ("く", "かっ", "さ"))}
    if last not in _ROWS or not (len(word) >= 3 or "\u4e00" <= rest[-1] <= "\u9fff"):
        return {word}
    forms = {word, *(rest + kana for kana in _ROWS[last])}
    if last == "る" and (rest[-1] in _ONE_ROW or "\u4e00" <= rest[-1] <= "\u9fff") and len(rest) >= 2:
        forms.add(rest)
    if last == "る" and rest in ("寝", "見", "着"):  # stems of one character
        forms |= {rest + end for end in "ててたなま"}
    return forms


_CHUNKS = re.compile(r"[^\W_]+")
_LATIN = re.compile(r"[A-Za-z\u00c0-\u024f0-9']+")
_CAMEL = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z\u00df-\u024f]+|[A-Z]+|\d+")
_CODE = re.compile(r"[A-Za-z]{1,3}\d+")  # a07, s1: kept whole
_SIDED = re.compile(r"([LR])([a-z]{3,})")  # "Lelbow"
_RUNS = re.compile(r"[\u30a1-\u30ffー]+|[\u4e00-\u9fff々]")  # katakana together, kanji one by one
_LATIN_OR_OTHER = re.compile(r"[A-Za-z\u00c0-\u024f0-9']+|[^A-Za-z\u00c0-\u024f0-9']+")


@dataclass(frozen=True, slots=True)
class Word:
    """A word, or a phrase that counts as one.

    Parameters
    ----------
    text : as written.
    key : for comparison: its stem; the text for Japanese.
    meanings : possible concepts; parts of a compound are separate words. Empty if not in the table.
    """

    text: str
    key: str
    meanings: tuple[str, ...] = ()


def split_name(name: str) -> list[str]:
    """Split a name into words: ``a07_tennis_serve`` is a07, tennis, serve."""
    words: list[str] = []
    for chunk in _CHUNKS.findall(normalise(name)):
        for run in _LATIN_OR_OTHER.findall(chunk):
            if not _LATIN.fullmatch(run) or _CODE.fullmatch(run):
                words.append(run)
            else:
                words += _CAMEL.findall(run) or [run]
    return words


def read_words(vocabulary: Vocabulary, text: str, *, name: bool = False) -> tuple[Word, ...]:
    """Read the words of a query or, with ``name``, of a name of a file or category, without stop words."""
    pieces = list(_split_sides(vocabulary, split_name(text))) if name else _split_text(text)
    words: list[Word] = []
    place = 0
    while place < len(pieces):
        if not _LATIN.fullmatch(pieces[place]):
            words += _read_japanese(vocabulary, pieces[place])
            place += 1
            continue
        taken, found = _read_english(vocabulary, pieces, place)
        words += found
        place += taken
    return tuple(words)


def _split_text(text: str) -> list[str]:
    pieces: list[str] = []
    for chunk in re.findall(r"[^\W_]+(?:'[^\W_]+)?", normalise(text)):
        for run in _LATIN_OR_OTHER.findall(chunk):
            mixed = _LATIN.fullmatch(run) and not _CODE.fullmatch(run) and re.search(r"[a-z][A-Z]|\d[A-Za-z]", run)
            pieces += split_name(run) if mixed else [run]
    return pieces


def _split_sides(vocabulary: Vocabulary, pieces: list[str]) -> Iterator[str]:
    """Split ``Lelbow`` into l and elbow if only the rest is a known word."""
    for piece in pieces:
        sided = _SIDED.fullmatch(piece)
        if sided and (stem(piece),) not in vocabulary.english and (stem(sided[2]),) in vocabulary.english:
            yield from sided.groups()
        else:
            yield piece


def _read_english(vocabulary: Vocabulary, pieces: list[str], place: int) -> tuple[int, list[Word]]:
    """Return the number of pieces of the longest phrase at a place, and its words."""
    for length in range(min(vocabulary.longest_phrase, len(pieces) - place), 0, -1):
        some = pieces[place : place + length]
        key = tuple(stem(piece.removesuffix("'s")) for piece in some)
        meanings = vocabulary.english.get(key)
        if meanings is not None:
            return length, _make_words(" ".join(some), " ".join(key), meanings)
    piece = pieces[place]
    return 1, [Word(piece, stem(piece))]


def _read_japanese(vocabulary: Vocabulary, text: str) -> list[Word]:
    words: list[Word] = []
    place = 0
    while place < len(text):
        for length in range(min(vocabulary.longest_form, len(text) - place), 0, -1):
            form = text[place : place + length]
            meanings = vocabulary.japanese.get(form)
            if meanings is not None:
                words += _make_words(form, form, meanings)
                place += length
                break
        else:
            run = _RUNS.match(text, place)
            if run:
                words.append(Word(run[0], run[0]))
            place = run.end() if run else place + 1
    return words


def _make_words(text: str, key: str, meanings: tuple[tuple[str, ...], ...]) -> list[Word]:
    if meanings == ((STOP,),):
        return []
    compound = next((names for names in meanings if len(names) > 1), None)
    if compound is not None:
        return [Word(text, f"{key}:{name}", (name,)) for name in compound]
    return [Word(text, key, tuple(names[0] for names in meanings))]


_WEIGHTS = "weights/l2_supercat_256.safetensors"
_PIECES = "tokenizers/l2_supercat_tokenizer_config.json"


def find_vectors() -> Path | None:
    """Return the folder of the word vectors; None if wordllama or its readers are not installed."""
    found = [importlib.util.find_spec(name) for name in ("wordllama", "tokenizers", "safetensors")]
    if any(spec is None or spec.origin is None for spec in found):
        return None
    folder = Path(str(found[0].origin)).parent if found[0] is not None else Path()
    return folder if (folder / _WEIGHTS).is_file() and (folder / _PIECES).is_file() else None


@cache
def load_replacement() -> Callable[[str], tuple[str, float] | None] | None:
    """Return a function from an English word to the nearest word of the table and its cosine; None without vectors."""
    folder = find_vectors()
    return None if folder is None else cache(_Replacement(folder))


class _Replacement:
    """The words of the table as vectors, read at the first call."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._words: list[str] = []
        self._vectors: Any = None

    def __call__(self, word: str) -> tuple[str, float] | None:
        if self._vectors is None:
            self._read()
        cosines = self._known @ self._embed(word)
        best = int(cosines.argmax())
        return self._words[best], float(cosines[best])

    def _read(self) -> None:
        from safetensors.numpy import load_file
        from tokenizers import Tokenizer

        self._pieces = Tokenizer.from_file(str(self._folder / _PIECES))
        self._vectors = next(iter(load_file(str(self._folder / _WEIGHTS)).values()))
        vocabulary = load_vocabulary()
        kinds = ("action", "style", "part")
        self._words = sorted(
            vocabulary.spelled[key[0]]
            for key, meanings in vocabulary.english.items()
            if len(key) == 1 and key[0] in vocabulary.spelled
            and len(meanings[0]) == 1 and vocabulary.concepts[meanings[0][0]].kind in kinds
        )  # fmt: skip
        self._known = np.stack([self._embed(word) for word in self._words])

    def _embed(self, word: str) -> Any:
        """Return the normalised mean of the vectors of the pieces of a word."""
        rows = self._pieces.encode(word.casefold(), add_special_tokens=False).ids
        vector = self._vectors[rows].astype(np.float32).mean(axis=0)
        return vector / max(float(np.linalg.norm(vector)), 1e-9)
