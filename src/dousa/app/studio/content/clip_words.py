"""Understand the text in the search box of the Library page: names and labels by their letters, or by meaning."""

from __future__ import annotations

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


def find_words(texts: Sequence[str], text: str) -> Mask | None:
    """Find the texts of clips, normalised by `plain`, that contain every word of a text; None without words."""
    words = plain(text).split()
    fits = np.ones(len(texts), bool)
    for word in words:  # one loop for each word is five times as fast as one over all
        fits &= np.array([word in known for known in texts], bool)
    return fits if words else None


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
    texts: Sequence[str], ids: NDArray[np.int64], text: str, match: Callable[[str], TextMatches | None], *, wide: bool
) -> Reading:
    """Understand a text: by its letters if any clip is called so, else as `Library.match_text` does.

    Parameters
    ----------
    texts, ids : of the clips.
    text : as it was typed.
    match : finds clips by what they do, like `Meanings.match`; it also corrects what is misspelt.
    wide : include clips that do what the words say even if others are called so.
    """
    literal = find_words(texts, text)
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
    scores[literal] = np.maximum(scores[literal], 1.0)
    corrected = {} if matches is None else {word: other for word, other in matches.corrections.items() if word != other}
    return Reading(scores > 0, scores, corrected, pending=matches is None)
