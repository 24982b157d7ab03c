"""What a search in words answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.retrieval.words.relations import Relation


@dataclass(frozen=True, slots=True)
class TextHit:
    """A clip or take that fits the words.

    Parameters
    ----------
    clip_id, path, category, performer, kind : of it, as in ``ClipInfo``.
    rank : 1 for the best.
    score : share of what the words ask for that it has, 0 to 1.
    in_category, in_name : whether words are in its category, or in its name.
    relations : what it does that fits the words, with the longest stretch of it.
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
        """The hit as a plain dictionary; times in s."""
        names = ("rank", "clip_id", "path", "category", "performer", "kind", "score", "in_category", "in_name")
        relations = [
            {"name": one.name, "part": one.part or None, "text": str(one.message), "share": one.share}
            | {"start_s": one.start, "end_s": one.end}
            for one in self.relations
        ]
        return {name: getattr(self, name) for name in names} | {"relations": relations}


@dataclass(frozen=True, slots=True, eq=False)
class TextMatches:
    """The numbers of all clips and takes that fit words.

    Parameters
    ----------
    ids : (n,) the best first.
    scores : (n,) share of what the words ask for that each has, 0 to 1.
    corrections : words that were misspelt or that nobody knows, and what they were taken for.
    """

    ids: NDArray[np.int64]
    scores: FloatArray
    corrections: dict[str, str]


@dataclass(frozen=True, slots=True)
class TextResult:
    """The answer to a search in words.

    Parameters
    ----------
    text : what was asked.
    results : the clips and takes that fit, the best first; no more than fit.
    n_found : how many fit, of which ``results`` may be the first.
    n_searched : clips and takes that were looked at.
    corrections : words that were misspelt, and what they were taken for.
    replaced : words that nobody knows, and words of similar meaning that were searched for (with ``dousa[words]``).
    unknown : words that neither the table of words nor the library knows.
    near : words of the library near to the query, if nothing fits.
    """

    text: str
    results: tuple[TextHit, ...]
    n_found: int
    n_searched: int
    corrections: dict[str, str]
    replaced: dict[str, str]
    unknown: tuple[str, ...]
    near: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The answer as plain lists and dictionaries."""
        return {
            "text": self.text,
            "n_found": self.n_found,
            "n_searched": self.n_searched,
            "corrections": dict(self.corrections),
            "replaced": dict(self.replaced),
            "unknown_words": list(self.unknown),
            "near_words": list(self.near),
            "results": [hit.to_json() for hit in self.results],
        }
