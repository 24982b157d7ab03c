"""Reading names and queries: which words they have, and which concepts those name.

Names of files and categories are taken apart at separators, between small and capital letters and before and after
numbers: ``punchLFront1Reps`` is punch, l, front, 1, reps. Text without blanks is taken apart by the longest words of
the table; what is in no table stays a word of its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from dousa.retrieval.words.vocabulary import STOP, Vocabulary, normalise, stem

_CHUNKS = re.compile(r"[^\W_]+")
_LATIN = re.compile(r"[A-Za-z\u00c0-\u024f0-9']+")
_CAMEL = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z\u00df-\u024f]+|[A-Z]+|\d+")
_CODE = re.compile(r"[A-Za-z]{1,3}\d+")  # a07, s1: as it is
_SIDED = re.compile(r"([LR])([a-z]{3,})")  # "Lelbow"
_RUNS = re.compile(r"[\u30a1-\u30ffー]+|[\u4e00-\u9fff々]")  # katakana hang together; of kanji each says something
_LATIN_OR_OTHER = re.compile(r"[A-Za-z\u00c0-\u024f0-9']+|[^A-Za-z\u00c0-\u024f0-9']+")


@dataclass(frozen=True, slots=True)
class Word:
    """A word, or a phrase that counts as one.

    Parameters
    ----------
    text : as it is written.
    key : what it is compared by: its stem; the text for Japanese.
    meanings : concepts that it may name; those of a compound are words of their own. Empty where the table lacks it.
    """

    text: str
    key: str
    meanings: tuple[str, ...] = ()


def split_name(name: str) -> list[str]:
    """The words of a name: ``a07_tennis_serve`` is a07, tennis, serve."""
    words: list[str] = []
    for chunk in _CHUNKS.findall(normalise(name)):
        for run in _LATIN_OR_OTHER.findall(chunk):
            if not _LATIN.fullmatch(run) or _CODE.fullmatch(run):
                words.append(run)
            else:
                words += _CAMEL.findall(run) or [run]
    return words


def read_words(vocabulary: Vocabulary, text: str, *, name: bool = False) -> tuple[Word, ...]:
    """The words of a query or, with ``name``, of a name of a file or category; words that say nothing are left out."""
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
    """``Lelbow`` is l, elbow where it is no word itself and the rest is one."""
    for piece in pieces:
        sided = _SIDED.fullmatch(piece)
        if sided and (stem(piece),) not in vocabulary.english and (stem(sided[2]),) in vocabulary.english:
            yield from sided.groups()
        else:
            yield piece


def _read_english(vocabulary: Vocabulary, pieces: list[str], place: int) -> tuple[int, list[Word]]:
    """The longest phrase that begins at a place: how many pieces it takes, and what it says."""
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
