"""Understand the text in the search box of the Library page: names and labels by their letters, misspelt, or by
meaning."""

from __future__ import annotations

import re
import threading
import unicodedata
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, TimeoutError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import Mask
from dousa.errors import DousaError
from dousa.library import TextMatches

if TYPE_CHECKING:
    from dousa.library import Library

_WORD = re.compile(r"[^\W_]+")


def plain(text: str) -> str:
    """Normalise a text for comparison: full and half width, upper and lower case are equal."""
    return unicodedata.normalize("NFKC", text).casefold()


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """How a text was understood.

    Parameters
    ----------
    fits : (n,) whether each clip fits; None for all.
    scores : (n,) how well each clip fits; None if clips only fit or not.
    taken_for : words that the library does not have, and the words used instead.
    more : number of clips left out that do what the words say.
    pending : whether the words of the library are still being read, so that more clips may fit.
    """

    fits: Mask | None
    scores: NDArray[np.float64] | None = None
    taken_for: dict[str, str] = field(default_factory=dict)
    more: int = 0
    pending: bool = False


class ClipWords:
    """The names and labels of clips; ``texts`` holds one text for each clip, normalised by `plain`."""

    def __init__(self, texts: Sequence[str]) -> None:
        self._texts = texts
        self._known: list[str] | None = None

    def find(self, text: str) -> Mask | None:
        """Find clips that contain every word of a text; None for a text without words."""
        words = plain(text).split()
        if not words:
            return None
        fits = np.ones(len(self._texts), bool)
        for word in words:
            fits &= self._having([word])
        return fits

    def find_misspelt(self, text: str) -> tuple[Mask, dict[str, str]]:
        """Find clips that contain every word, unknown words replaced by the nearest known ones; returns these too."""
        fits, taken_for = np.ones(len(self._texts), bool), {}
        for word in plain(text).split():
            own = self._having([word])
            if not own.any():
                others = self._correct(word)
                own = self._having(others)
                if others:
                    taken_for[word] = ", ".join(others)
            fits &= own
        return fits, taken_for

    def _having(self, words: Sequence[str]) -> Mask:
        """Find clips that contain any of the words; one loop for each word is five times as fast as one over all."""
        fits = np.zeros(len(self._texts), bool)
        for word in words:
            fits |= np.array([word in known for known in self._texts], bool)
        return fits

    def _correct(self, word: str, *, letters: Sequence[int] = (4, 8)) -> list[str]:
        """Find the known words nearest to a word that differ from it by few letters.

        A word may be misspelt once, twice ... from so many ``letters`` on; with fewer, short words find anything.
        """
        from rapidfuzz import process
        from rapidfuzz.distance import OSA

        edits = sum(len(word) >= least for least in letters)
        if not edits or any(letter.isdigit() for letter in word):
            return []
        if self._known is None:
            found = {known for text in self._texts for known in _WORD.findall(text)}
            self._known = sorted(known for known in found if not known.isdigit())
        # words that a misspelt one may have been
        near = process.extract(word, self._known, scorer=OSA.distance, score_cutoff=edits, limit=3)
        best = min((distance for _, distance, _ in near), default=0)
        return [known for known, distance, _ in near if distance == best]


class Meanings:
    """Match texts with what motions do, in a thread of its own: large libraries take a while to read.

    Parameters
    ----------
    library : returns the open library.
    """

    def __init__(self, library: Callable[[], Library]) -> None:
        self._library = library
        self._lock = threading.Lock()
        self._reader: ThreadPoolExecutor | None = None
        self._busy: Future[TextMatches] | None = None

    def match(self, text: str, *, patience_s: float = 0.15) -> TextMatches | None:
        """Find the clips that fit a text; None while the words of the library are being read."""
        # patience_s: that a list waits for the words of the library to be read
        with self._lock:
            if self._busy is not None and not self._busy.done():
                return None
            if self._reader is None:
                self._reader = ThreadPoolExecutor(1, "words")
            self._busy = self._reader.submit(lambda: self._library().match_text(text))
            busy = self._busy
        try:
            return busy.result(patience_s)
        except TimeoutError:
            return None
        except DousaError:  # what the library lacks for this, lists do not need
            return TextMatches(np.zeros(0, np.int64), np.zeros(0), {})

    def close(self) -> None:
        """Wait for the thread to end; a later question starts a new one."""
        with self._lock:
            reader, self._reader, self._busy = self._reader, None, None
        if reader is not None:
            reader.shutdown(cancel_futures=True)


def read_text(
    words: ClipWords, ids: NDArray[np.int64], text: str, match: Callable[[str], TextMatches | None], *, wide: bool
) -> Reading:
    """Understand a text: by its letters if any clip is called so, else misspelt or by meaning.

    Parameters
    ----------
    words, ids : of the clips.
    text : as it was typed.
    match : finds clips by what they do, like `Meanings.match`.
    wide : include clips that do what the words say even if others are called so.
    """
    literal = words.find(text)
    if literal is None:
        return Reading(None)
    matches = match(text)
    scores = np.zeros(len(ids))
    if matches is not None and len(matches.ids):
        rows = np.searchsorted(ids, matches.ids, sorter=(order := np.argsort(ids)))
        rows = order[np.minimum(rows, len(ids) - 1)]
        there = ids[rows] == matches.ids
        scores[rows[there]] = matches.scores[there]
    if literal.any() and not wide:
        return Reading(literal, more=int(((scores > 0) & ~literal).sum()), pending=matches is None)
    near, taken_for = (literal, {}) if literal.any() else words.find_misspelt(text)
    scores[near] = np.maximum(scores[near], 1.0)
    corrected = {} if matches is None else {word: other for word, other in matches.corrections.items() if word != other}
    return Reading(scores > 0, scores, {**corrected, **taken_for}, pending=matches is None)
