"""What the library answers about motions: plain values without a connection behind them, each with ``to_json()``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dousa.retrieval.explanation import Explanation, Likeness

__all__ = ["Classification", "Hit", "SearchResult", "Verdict"]

_CLEARLY = 0.05  # share of the trees: many motions are their own mirror image


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the forest takes a motion for.

    Parameters
    ----------
    category : the category, None if the motion is of none that the forest knows.
    guess : the category that most trees vote for, whether the motion is known or not.
    known : probability that the motion is of a category that the forest knows; None where the forest had too few
        categories to learn that, or was trained by an older dousa.
    confidence : probability that the guess is right; None likewise.
    histogram : share of the trees that vote for each category, the largest first.
    explanation : why, if that was asked for.
    """

    category: str | None
    guess: str
    known: float | None
    confidence: float | None
    histogram: dict[str, float]
    explanation: Explanation | None = None

    def fits_better_than(self, other: Verdict) -> bool:
        """Whether the forest is clearly surer of this than of another motion."""
        if (self.category is None) != (other.category is None):
            return other.category is None
        return self.histogram[self.guess] > other.histogram[other.guess] + _CLEARLY

    def to_json(self) -> dict[str, Any]:
        """The verdict as plain lists and dictionaries; ``explanation`` only where there is one."""
        answer: dict[str, Any] = {
            "category": self.category,
            "histogram": dict(self.histogram),
            "guess": self.guess,
            "known": self.known,
            "confidence": self.confidence,
        }
        if self.explanation is not None:
            answer["explanation"] = dataclasses.asdict(self.explanation)
        return answer


@dataclass(frozen=True, slots=True)
class Hit:
    """One clip that a search found.

    Parameters
    ----------
    path : file the clip came from.
    category : its category; the forest's, where nobody gave it one.
    distance : between the histograms of query and clip, eq. 8; 0 to sqrt(2).
    rank : 1 for the nearest.
    clip_id : number of the clip in the library.
    leaf_share : share of the trees in which query and clip end in the same leaf, 0 to 1.
    pose_distance : of the poses of both, aligned in time, body heights; None where they were not compared.
    rank_distance : what the order goes by; None where the poses decide and were not compared.
    mirrored : whether it is the mirror image of the query that the clip is like.
    likeness : why they are alike, if that was asked for.
    """

    path: str
    category: str
    distance: float
    rank: int
    clip_id: int
    leaf_share: float
    pose_distance: float | None = None
    rank_distance: float | None = None
    mirrored: bool = False
    likeness: Likeness | None = None

    def to_json(self) -> dict[str, Any]:
        """The hit as a plain dictionary; ``likeness`` only where there is one."""
        answer: dict[str, Any] = {
            "path": self.path,
            "category": self.category,
            "distance": self.distance,
            "rank": self.rank,
            "clip_id": self.clip_id,
            "leaf_share": self.leaf_share,
            "pose_distance": self.pose_distance,
            "rank_distance": self.rank_distance,
            "mirrored": self.mirrored,
        }
        if self.likeness is not None:
            answer["likeness"] = dataclasses.asdict(self.likeness)
        return answer


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The answer to a search.

    Parameters
    ----------
    query : the file that was asked for.
    verdict : what the forest takes it for.
    results : the most similar clips, the most similar first.
    ranking : what they were ordered by, one of ``dousa.retrieval.RANKINGS``.
    mirrored : what the forest takes its mirror image for, if that was asked for.
    """

    query: str
    verdict: Verdict
    results: tuple[Hit, ...]
    ranking: str
    mirrored: Verdict | None = None

    @property
    def category(self) -> str | None:
        """What the forest takes the query for, None if it is of no category that the forest knows."""
        return self.verdict.category

    @property
    def histogram(self) -> dict[str, float]:
        """Share of the trees that vote for each category, the largest first."""
        return self.verdict.histogram

    def to_json(self) -> dict[str, Any]:
        """The answer as plain lists and dictionaries."""
        return {
            "query": self.query,
            **self.verdict.to_json(),
            **_mirrored_json(self.verdict, self.mirrored),
            "ranking": self.ranking,
            "results": [hit.to_json() for hit in self.results],
        }


@dataclass(frozen=True, slots=True)
class Classification:
    """What the forest takes a file for.

    Parameters
    ----------
    path : the file.
    verdict : what it is taken for, None if the file cannot be used.
    mirrored : what its mirror image is taken for, if that was asked for.
    problem : why the file cannot be used, None if it can.
    """

    path: str
    verdict: Verdict | None
    mirrored: Verdict | None = None
    problem: str | None = None

    @property
    def category(self) -> str | None:
        """The category; None if the motion is of none that the forest knows, or the file cannot be used."""
        return None if self.verdict is None else self.verdict.category

    @property
    def histogram(self) -> dict[str, float]:
        """Share of the trees that vote for each category, the largest first; empty if the file cannot be used."""
        return {} if self.verdict is None else self.verdict.histogram

    def to_json(self) -> dict[str, Any]:
        """The answer as a plain dictionary; ``problem`` only where there is one."""
        if self.verdict is None:
            empty: dict[str, Any] = {
                "category": None,
                "histogram": {},
                "guess": None,
                "known": None,
                "confidence": None,
            }
            return {"path": self.path, **empty, "problem": self.problem}
        return {
            "path": self.path,
            **self.verdict.to_json(),
            **_mirrored_json(self.verdict, self.mirrored),
        }


def _mirrored_json(verdict: Verdict, mirrored: Verdict | None) -> dict[str, Any]:
    if mirrored is None:
        return {}
    return {"mirrored": {**mirrored.to_json(), "fits_better": mirrored.fits_better_than(verdict)}}
