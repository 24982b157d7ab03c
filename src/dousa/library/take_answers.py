"""What the library answers about takes: what is where, and what happens when; each answer with ``to_json()``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dousa.library.reports import Skipped

if TYPE_CHECKING:
    from dousa.retrieval.labelling import Timeline

__all__ = ["FindResult", "LabelledTake", "Place"]


@dataclass(frozen=True, slots=True)
class Place:
    """A part of a take that is like the query.

    Parameters
    ----------
    take : file of the take.
    clip_id : its number in the library, None for a file that is not there.
    start, end : s, from the beginning of the take.
    score : 0 to 1, the larger the more alike.
    distance : of the poses of both along the best alignment, root mean square in body heights.
    shared_leaves : share of the trees in which both end in the same leaf.
    tempo : how much faster than the query it goes on; 2 is double speed.
    mirrored : whether it is the mirror image of the query that it is like.
    rank : 1 for the best.
    """

    take: str
    clip_id: int | None
    start: float
    end: float
    score: float
    distance: float
    shared_leaves: float
    tempo: float
    mirrored: bool
    rank: int

    def to_json(self) -> dict[str, Any]:
        """The place as a plain dictionary; times in s."""
        return {
            "take": self.take,
            "start_s": self.start,
            "end_s": self.end,
            "score": self.score,
            "rank": self.rank,
            "distance": self.distance,
            "shared_leaves": self.shared_leaves,
            "tempo": self.tempo,
            "mirrored": self.mirrored,
            "clip_id": self.clip_id,
        }


@dataclass(frozen=True, slots=True)
class FindResult:
    """The answer to a search inside takes.

    Parameters
    ----------
    query : the file that was asked for.
    duration : s, of the query.
    n_takes, seconds : takes that were looked into, and their duration.
    results : the places most like the query, best first, no two of them the same.
    skipped : takes that could not be used, and why.
    """

    query: str
    duration: float
    n_takes: int
    seconds: float
    results: tuple[Place, ...]
    skipped: tuple[Skipped, ...]

    def to_json(self) -> dict[str, Any]:
        """The answer as plain lists and dictionaries."""
        return {
            "query": self.query,
            "duration_s": self.duration,
            "n_takes": self.n_takes,
            "takes_s": self.seconds,
            "results": [place.to_json() for place in self.results],
            "skipped": [{"path": item.path, "reason": item.reason} for item in self.skipped],
        }


@dataclass(frozen=True, slots=True)
class LabelledTake:
    """What happens in a take, from beginning to end.

    Parameters
    ----------
    take : its file.
    clip_id : its number in the library, None for a file that is not there.
    timeline : its stretches, one after another without gaps, with their categories and how sure they are.
    """

    take: str
    clip_id: int | None
    timeline: Timeline

    def to_json(self) -> dict[str, Any]:
        """The timeline as plain lists and dictionaries; times in s."""
        return {"take": self.take, "clip_id": self.clip_id, **self.timeline.to_json()}
