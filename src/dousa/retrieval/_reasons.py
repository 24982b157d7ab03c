"""What an explanation is made of: reasons, and the tests on the way of a clip from which they are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval._phrases import FEW
from dousa.retrieval._questions import Questions

__all__ = ["Explanation", "Likeness", "Reason", "SharedReason", "Speaker", "WayDown", "count_bits"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Reason:
    """One relation that the vote for a category rests on.

    Parameters
    ----------
    text : in words.
    relation : what is taken away for ``vote_without``.
    channel, unit, kind : what was measured of it; the kind is ``"mean"``, ``"spread"`` or ``"trend"``.
    start, end : s, the interval.
    value, threshold : of the clip and of the test, in ``unit``.
    above : whether the value lies above the threshold.
    others, away : training clips of other categories that came to the test, and how many of them lie on the other side.
    vote_before, vote_without : share of the trees that vote for the category, with and without the relation.
    """

    text: str
    relation: str
    channel: str
    unit: str
    kind: str
    start: float
    end: float
    value: float
    threshold: float
    above: bool
    others: int
    away: int
    vote_before: float
    vote_without: float


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a forest votes for a category.

    Parameters
    ----------
    category : the one that is explained.
    vote : share of the trees that vote for it.
    reasons : the most important first; none if no tree voted for it, or if nothing in particular matters.
    vote_without_all : the vote without all of these relations.
    """

    category: str | int
    vote: float
    reasons: tuple[Reason, ...]
    vote_without_all: float


@dataclass(frozen=True, slots=True)
class SharedReason:
    """One relation in which two clips are alike, and unlike others.

    Parameters
    ----------
    text, relation, channel, unit, kind, threshold, above : as of a ``Reason``.
    start, end, value : of the first clip; ``other_start``, ``other_end`` and ``other_value`` of the second.
    others, away : training clips that came to the test, and how many of them lie on the other side.
    alike_before, alike_without : share of the trees in which both end in one leaf, with and without the relation.
    """

    text: str
    relation: str
    channel: str
    unit: str
    kind: str
    start: float
    end: float
    value: float
    other_start: float
    other_end: float
    other_value: float
    threshold: float
    above: bool
    others: int
    away: int
    alike_before: float
    alike_without: float


@dataclass(frozen=True, slots=True)
class Likeness:
    """Why two clips are alike: the share of trees in which both end in one leaf, the reasons, and without them all."""

    alike: float
    reasons: tuple[SharedReason, ...]
    alike_without_all: float


@dataclass(frozen=True, slots=True)
class Speaker:
    """A node, the other clips that came to it, and how many of them it sent away."""

    node: int
    others: int
    away: int


@dataclass(frozen=True, slots=True, eq=False)
class WayDown:
    """The tests on the way of a clip.

    Parameters
    ----------
    nodes, above : (P,) and the answers.
    gaps : (P,) how far the clip is from the threshold.
    bits : (P,) told by each.
    others, away : (P,) other clips that came to the test, and those of them that it sent away.
    """

    nodes: IntArray
    above: BoolArray
    gaps: FloatArray
    bits: FloatArray
    others: FloatArray
    away: FloatArray

    def best(self, questions: Questions, relation: int) -> Speaker:
        """The test that speaks for a relation."""
        own = np.flatnonzero((questions.relation[self.nodes] == relation) & (self.bits > 0.0))
        nodes, bits = self.nodes[own], self.bits[own]
        start, stop = questions.start[nodes], questions.stop[nodes]
        shared = np.minimum(stop[:, None], stop) - np.maximum(start[:, None], start)
        overlap = np.maximum(shared, 0) / (
            np.maximum(stop[:, None], stop) - np.minimum(start[:, None], start)
        )
        says = 2 * (3 * questions.column[nodes] + questions.kind[nodes]) + self.above[own]
        agreeing = says[:, None] == says
        support = (agreeing * overlap) @ bits
        gap = self.gaps[own]
        clear = gap / (gap + (agreeing @ gap) / agreeing.sum(axis=1) + 1e-300)
        many = self.away[own] / (self.others[own] + FEW)
        best = own[int((support * clear * many).argmax())]
        return Speaker(int(self.nodes[best]), round(self.others[best]), round(self.away[best]))


def count_bits(
    inside: FloatArray, sizes: FloatArray, inside_after: FloatArray, sizes_after: FloatArray
) -> FloatArray:
    """Bits that tests told about a category: how much more likely it is after the test; none below 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bits = np.log2(inside_after * sizes / (inside * sizes_after))
    return np.where(bits > 0.0, bits, 0.0)
