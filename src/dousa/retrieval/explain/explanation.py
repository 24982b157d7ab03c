"""Reasons: the few things about a motion that decided the vote of a forest, in words with seconds.

A forest asks about *relations* (where the right hand is, how far the feet are apart, how fast the head moves), each by
several channels, kinds of values and intervals. What a relation is worth is told by **ablation**: it is taken away, and
the vote is counted anew. At every node that asks about it the clip is sent to both children, with the shares of the
training clips that went there, as if nothing were known of it; at all other nodes the clip answers for itself. (This is
the path-dependent expectation of TreeSHAP: Lundberg et al., "From local explanations to global understanding with
explainable AI for trees", Nature Machine Intelligence 2, 2020.) A relation without which the vote for the category
does not fall is no reason. The first reason is the one whose loss costs most; each following one costs most where those
before are gone already, so that two ways to say the same thing do not stand side by side.

The words of a reason are those of one test of the relation, on the way of the clip down the trees that voted for the
category, so that all numbers of a sentence belong together: the test with whose channel, interval and direction most
others agree, each weighed by the bits that it told about the category, that sent many of the other clips away, and that
the clip passed clearly.

Why two clips are alike is told in the same way: the vote is then the share of trees in which both end in the same leaf.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.errors import OptionError
from dousa.messages import Message
from dousa.retrieval.explain import questions as kernels
from dousa.retrieval.explain.phrases import FEW, Fact, say_fact, say_shared_fact
from dousa.retrieval.explain.questions import Questions, read_questions
from dousa.retrieval.forest.forest import MotionForest

_LEAST_DROP = 0.005
"""Of the vote: half a tree of a hundred; less is not worth a sentence."""


@dataclass(frozen=True, slots=True)
class Reason:
    """One relation that the vote for a category rests on.

    Parameters
    ----------
    text : the relation in words.
    relation : what is taken away for ``vote_without``.
    channel, unit, kind : what was measured of it; the kind is ``"mean"``, ``"spread"`` or ``"trend"``.
    start, end : s, the interval.
    value, threshold : of the clip and of the test, in ``unit``.
    above : whether the value lies above the threshold.
    others, away : training clips of other categories that came to the test, and how many of them lie on the other side.
    vote_before, vote_without : share of the trees that vote for the category, with and without the relation.
    """

    text: Message
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

    def to_json(self) -> dict[str, Any]:
        """The explanation as plain lists and dictionaries, the words in the language in use."""
        return _to_json(self)


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

    text: Message
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

    def to_json(self) -> dict[str, Any]:
        """As plain lists and dictionaries, the words in the language in use."""
        return _to_json(self)


def _to_json(found: Explanation | Likeness) -> dict[str, Any]:
    plain = asdict(found)
    for reason in plain["reasons"]:
        reason |= {"text": str(reason["text"]), "message": reason["text"].to_json()}
    return plain


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
        overlap = np.maximum(shared, 0) / (np.maximum(stop[:, None], stop) - np.minimum(start[:, None], start))
        says = 2 * (3 * questions.column[nodes] + questions.kind[nodes]) + self.above[own]
        agreeing = says[:, None] == says
        support = (agreeing * overlap) @ bits
        gap = self.gaps[own]
        clear = gap / (gap + (agreeing @ gap) / agreeing.sum(axis=1) + 1e-300)
        many = self.away[own] / (self.others[own] + FEW)
        best = own[int((support * clear * many).argmax())]
        return Speaker(int(self.nodes[best]), round(self.others[best]), round(self.away[best]))


def count_bits(inside: FloatArray, sizes: FloatArray, inside_after: FloatArray, sizes_after: FloatArray) -> FloatArray:
    """Bits that tests told about a category: how much more likely it is after the test; none below 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bits = np.log2(inside_after * sizes / (inside * sizes_after))
    return np.where(bits > 0.0, bits, 0.0)


class Explainer:
    """Explains the votes of one forest; reads its nodes once.

    Parameters
    ----------
    forest : trained.

    Raises
    ------
    NotTrainedError
    """

    def __init__(self, forest: MotionForest) -> None:
        self._questions = read_questions(forest)
        self._classes = forest.classes_
        self._voted = forest.trees_.leaf_categories()
        self._roots = forest.trees_.roots

    def explain(
        self, clip: ArrayLike, duration: float, category: str | int | None = None, limit: int = 3
    ) -> Explanation:
        """See `explain`."""
        _check(limit, duration)
        questions = self._questions
        values = questions.evaluate(clip)
        above = values > questions.threshold
        voted = self._voted[questions.find_leaves(above)]
        number = self._number(category, voted)
        worth = (self._voted == number).astype(np.float64)
        nodes, taken = questions.follow(above, voted == number)
        inside = questions.sum_leaves(self._count_leaves(number))
        sizes = questions.sizes
        bits = count_bits(inside[nodes], sizes[nodes], inside[taken], sizes[taken])
        others = (sizes - inside)[nodes]
        gaps = np.abs(values - questions.threshold)[nodes]
        told = WayDown(nodes, above[nodes], gaps, bits, others, others - (sizes - inside)[taken])
        before, chosen, left = self._choose(above, above, worth, told, limit)
        reasons = tuple(
            self._reason(told.best(questions, relation), values, duration, (before, without))
            for relation, without in chosen
        )
        return Explanation(self._classes[number].item(), before, reasons, left)

    def explain_pair(
        self, query: ArrayLike, hit: ArrayLike, durations: tuple[float, float], limit: int = 3
    ) -> Likeness:
        """See `explain_pair`."""
        _check(limit, *durations)
        questions = self._questions
        values, hit_values = questions.evaluate(query), questions.evaluate(hit)
        above, hit_above = values > questions.threshold, hit_values > questions.threshold
        together = questions.find_leaves(above) == questions.find_leaves(hit_above)
        nodes, taken = questions.follow(above, together)
        came, stayed = questions.sizes[nodes], questions.sizes[taken]
        gaps = np.minimum(*(np.abs(each - questions.threshold)[nodes] for each in (values, hit_values)))
        told = WayDown(nodes, above[nodes], gaps, np.log2(came / stayed), came, came - stayed)
        worth = np.ones(len(self._voted))
        before, chosen, left = self._choose(above, hit_above, worth, told, limit)
        reasons = tuple(
            self._shared_reason(told.best(questions, relation), (values, hit_values), durations, (before, without))
            for relation, without in chosen
        )
        return Likeness(before, reasons, left)

    def votes_without(self, clip: ArrayLike, category: str | int | None = None) -> dict[str, float]:
        """The vote for a category (by default the winner) without each relation that the trees ask about.

        Parameters
        ----------
        clip, category : as in `explain`.

        Returns
        -------
        relation -> share of the trees; the relations in the order of the channels.
        """
        questions = self._questions
        above = questions.evaluate(clip) > questions.threshold
        number = self._number(category, self._voted[questions.find_leaves(above)])
        worth = (self._voted == number).astype(np.float64)
        _, without = self._ablate(above, above, worth, np.zeros(len(questions.relations), bool))
        return dict(zip(questions.relations, without.tolist(), strict=True))

    def _number(self, category: str | int | None, voted: NDArray[np.int32]) -> int:
        """Which category is meant: by default the one with most votes, the first of equals."""
        if category is None:
            return int(np.bincount(voted, minlength=len(self._classes)).argmax())
        found = np.flatnonzero(self._classes == category)
        if not len(found):
            raise OptionError("explain.category", category=category)
        return int(found[0])

    def _count_leaves(self, number: int) -> FloatArray:
        """(L,) training clips of one category in each leaf."""
        trees = self._questions.trees
        counts = np.where(trees.leaf_classes == number, trees.leaf_counts, 0)
        return np.add.reduceat(counts, trees.leaf_starts[:-1]).astype(np.float64)

    def _ablate(
        self, above: BoolArray, other: BoolArray, worth: FloatArray, removed: BoolArray
    ) -> tuple[float, FloatArray]:
        """The vote without some relations, and (R,) the votes without each of the rest besides."""
        questions = self._questions
        without, seen = np.empty(len(removed)), np.empty(len(removed), np.int64)
        places = np.empty(len(questions.children) + 2, np.int64)  # never all of it is touched
        base = kernels.ablate(
            self._roots, questions.children, above, other, questions.relation, questions.sizes, worth, removed,
            places, np.empty(len(places)), seen, without,
        )  # fmt: skip
        return float(base), without

    def _choose(
        self, above: BoolArray, other: BoolArray, worth: FloatArray, told: WayDown, limit: int
    ) -> tuple[float, list[tuple[int, float]], float]:
        """The vote, the most important relations with the vote without each, and the vote without all of them."""
        relations = self._questions.relations
        removed = np.zeros(len(relations), bool)
        before, alone = self._ablate(above, other, worth, removed)
        can = np.zeros(len(relations), bool)
        can[self._questions.relation[told.nodes[told.bits > 0.0]]] = True
        can &= alone <= before - _LEAST_DROP
        chosen: list[tuple[int, float]] = []
        left, without = before, alone
        while len(chosen) < limit and can.any():
            best = int(np.where(can, without, np.inf).argmin())
            if without[best] > left - _LEAST_DROP:
                break
            chosen.append((best, float(alone[best])))
            removed[best], can[best] = True, False
            left, without = self._ablate(above, other, worth, removed)
        return before, chosen, left

    def _fact(self, told: Speaker, values: FloatArray, duration: float) -> Fact:
        node = told.node
        asked, frames = self._questions.question(node), self._questions.trees.n_frames
        return Fact(
            channel=asked.channel,
            kind=asked.kind,
            above=bool(values[node] > asked.threshold),
            start=asked.start / frames * duration,
            end=asked.stop / frames * duration,
            whole=asked.stop - asked.start == frames,
            value=float(values[node]),
            threshold=asked.threshold,
            others=told.others,
            away=told.away,
        )

    def _reason(self, told: Speaker, values: FloatArray, duration: float, votes: tuple[float, float]) -> Reason:
        fact = self._fact(told, values, duration)
        before, without = votes
        return Reason(text=say_fact(fact), **_plain(fact), vote_before=before, vote_without=without)

    def _shared_reason(
        self,
        told: Speaker,
        values: tuple[FloatArray, FloatArray],
        durations: tuple[float, float],
        alike: tuple[float, float],
    ) -> SharedReason:
        fact, other = (self._fact(told, *pair) for pair in zip(values, durations, strict=True))
        return SharedReason(
            text=say_shared_fact(fact, other),
            **_plain(fact),
            other_start=other.start,
            other_end=other.end,
            other_value=other.value,
            alike_before=alike[0],
            alike_without=alike[1],
        )


def _plain(fact: Fact) -> dict[str, Any]:
    """The fields that a fact gives to a reason."""
    channel, names = fact.channel, ("kind", "start", "end", "value", "threshold", "above", "others", "away")
    words = {"relation": channel.relation, "channel": channel.name, "unit": channel.unit}
    return words | {name: getattr(fact, name) for name in names}


def _check(limit: int, *durations: float) -> None:
    if limit < 1:
        raise OptionError("explain.limit", limit=limit)
    for duration in durations:
        if not (np.isfinite(duration) and duration > 0.0):
            raise OptionError("explain.duration", duration=duration)


def explain(
    forest: MotionForest, clip: ArrayLike, duration: float, category: str | int | None = None, limit: int = 3
) -> Explanation:
    """Why a forest takes a clip for a category.

    Parameters
    ----------
    forest : trained. Who explains many clips makes one `Explainer`.
    clip : (T, F) features, those of the forest's feature set.
    duration : s, of the clip.
    category : by default the one that most trees vote for.
    limit : reasons at most, at least 1.

    Returns
    -------
    The explanation; each of its reasons lowers the vote when it is taken away.

    Raises
    ------
    NotTrainedError
    InvalidMotionError : features of another shape, or not finite.
    OptionError : a category that the forest does not know, a duration or limit out of range.
    """
    return Explainer(forest).explain(clip, duration, category, limit)


def explain_pair(
    forest: MotionForest, query: ArrayLike, hit: ArrayLike, durations: tuple[float, float], limit: int = 3
) -> Likeness:
    """Why a forest finds two clips alike.

    Parameters
    ----------
    forest : trained.
    query, hit : (T, F) features.
    durations : s, of the query and of the hit.
    limit : reasons at most, at least 1.

    Returns
    -------
    The reasons; each of them lowers the share of trees in which both end in one leaf when it is taken away.

    Raises
    ------
    NotTrainedError
    InvalidMotionError : features of another shape, or not finite.
    OptionError : a duration or limit out of range.
    """
    return Explainer(forest).explain_pair(query, hit, durations, limit)
