"""Words that no table has: the vectors of WordLlama, where the extra ``dousa[words]`` is installed.

The package holds one vector of 256 numbers for each of 32,000 pieces of words (16 MB), learned for English; the pieces
of Japanese are mostly single bytes, and their vectors say nothing: Japanese goes through the table of words alone. Its
files are read as they lie; the package itself is not imported, and nothing is fetched.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dousa.retrieval.words.vocabulary import load_vocabulary

_WEIGHTS = "weights/l2_supercat_256.safetensors"
_PIECES = "tokenizers/l2_supercat_tokenizer_config.json"


def find_vectors() -> Path | None:
    """The folder of the package, None where it or what reads its files is not installed."""
    found = [importlib.util.find_spec(name) for name in ("wordllama", "tokenizers", "safetensors")]
    if any(spec is None or spec.origin is None for spec in found):
        return None
    folder = Path(str(found[0].origin)).parent if found[0] is not None else Path()
    return folder if (folder / _WEIGHTS).is_file() and (folder / _PIECES).is_file() else None


@cache
def load_replacement() -> Callable[[str], tuple[str, float] | None] | None:
    """What finds the word of the table that means most nearly the same as an English word, with the cosine; or None."""
    folder = find_vectors()
    return None if folder is None else cache(_Replacement(folder))


class _Replacement:
    """The words of the table as vectors; read at the first question."""

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
        """The mean of the vectors of the pieces of a word, of length 1."""
        rows = self._pieces.encode(word.casefold(), add_special_tokens=False).ids
        vector = self._vectors[rows].astype(np.float32).mean(axis=0)
        return vector / max(float(np.linalg.norm(vector)), 1e-9)
