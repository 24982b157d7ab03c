"""Explain votes of a forest: the few relations that decided them, in words with seconds.

A relation (where the right hand is, how far apart the feet are) is measured by several channels, kinds of values and
intervals. Its worth is the vote lost by **ablation**: at every node that tests it, the clip goes to both children with
the shares of the training clips there (the path-dependent expectation of TreeSHAP: Lundberg et al., "From local
explanations to global understanding with explainable AI for trees", Nature Machine Intelligence 2, 2020). The first
reason costs most when lost, each later one costs most with those before it already lost. The sentence of a reason
describes one test, so its numbers belong together. Pairs of clips are explained in the same way; the vote is then the
share of trees in which both end in the same leaf.
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
"""Least loss of the vote for a reason: half a tree of a hundred."""


@dataclass(frozen=True, slots=True)
class Reason:
    """A relation that the vote for a category rests on.

    Parameters
    ----------
    text : the relation in words.
    relation : the relation removed for ``vote_without``.
    channel, unit, kind : the quantity measured; the kind is ``"mean"``, ``"spread"`` or ``"trend"``.
    start, end : s, the interval.
    value, threshold : of the clip and of the test, in ``unit``.
    above : whether the value lies above the threshold.
    others, away : training clips of other categories that reached the test, and how many lie on the other side.
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
    """The ``reasons`` of a forest for a ``category``, the most important first; none if no tree votes for it.

    ``vote`` is the share of the trees that vote for it, ``vote_without_all`` that without all of these relations.
    """

    category: str | int
    vote: float
    reasons: tuple[Reason, ...]
    vote_without_all: float

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries, the text in the current language."""
        return _to_json(self)


@dataclass(frozen=True, slots=True)
class SharedReason:
    """A relation that two clips share, unlike other clips.

    Parameters
    ----------
    text, relation, channel, unit, kind, threshold, above : as of a ``Reason``.
    start, end, value : of the first clip; ``other_start``, ``other_end`` and ``other_value`` of the second.
    others, away : training clips that reached the test, and how many lie on the other side.
    alike_before, alike_without : share of the trees with both in one leaf, with and without the relation.
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
    """The share of trees with two clips in one leaf, with and without all the reasons, and the reasons."""

    alike: float
    reasons: tuple[SharedReason, ...]
    alike_without_all: float

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries, the text in the current language."""
        return _to_json(self)


def _to_json(found: Explanation | Likeness) -> dict[str, Any]:
    plain = asdict(found)
    for reason in plain["reasons"]:
        reason |= {"text": str(reason["text"]), "message": reason["text"].to_json()}
    return plain


@dataclass(frozen=True, slots=True)
class Speaker:
    """A node, the other clips that reached it, and how many of them went the other way."""

    node: int
    others: int
    away: int


@dataclass(frozen=True, slots=True, eq=False)
class WayDown:
    """The tests on the path of a clip.

    Parameters
    ----------
    nodes, above : (P,) nodes and answers.
    gaps : (P,) distance of the clip from the threshold.
    bits : (P,) information of each test about the category.
    others, away : (P,) other clips that reached the test, and those that went the other way.
    """

    nodes: IntArray
    above: BoolArray
    gaps: FloatArray
    bits: FloatArray
    others: FloatArray
    away: FloatArray

    def best(self, questions: Questions, relation: int) -> Speaker:
        """Return the best test of a relation, by support, distance from the threshold and clips sent away."""
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
    """Return the bits of tests about a category: the log of how much likelier it is after each, at least 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bits = np.log2(inside_after * sizes / (inside * sizes_after))
    return np.where(bits > 0.0, bits, 0.0)


class Explainer:
    """An explainer of the votes of one trained forest, which reads its nodes once; raises NotTrainedError."""

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
        """Return the vote for a category (by default the winner) without each relation of the trees, in their order."""
        questions = self._questions
        above = questions.evaluate(clip) > questions.threshold
        number = self._number(category, self._voted[questions.find_leaves(above)])
        worth = (self._voted == number).astype(np.float64)
        _, without = self._ablate(above, above, worth, np.zeros(len(questions.relations), bool))
        return dict(zip(questions.relations, without.tolist(), strict=True))

    def _number(self, category: str | int | None, voted: NDArray[np.int32]) -> int:
        if category is None:
            return int(np.bincount(voted, minlength=len(self._classes)).argmax())
        found = np.flatnonzero(self._classes == category)
        if not len(found):
            raise OptionError("explain.category", category=category)
        return int(found[0])

    def _count_leaves(self, number: int) -> FloatArray:
        trees = self._questions.trees
        counts = np.where(trees.leaf_classes == number, trees.leaf_counts, 0)
        return np.add.reduceat(counts, trees.leaf_starts[:-1]).astype(np.float64)

    def _ablate(
        self, above: BoolArray, other: BoolArray, worth: FloatArray, removed: BoolArray
    ) -> tuple[float, FloatArray]:
        """Return the vote without the removed relations, and (R,) votes without each other relation as well."""
        questions = self._questions
        without, seen = np.empty(len(removed)), np.empty(len(removed), np.int64)
        places = np.empty(len(questions.children) + 2, np.int64)  # only partly used
        base = kernels.ablate(
            self._roots, questions.children, above, other, questions.relation, questions.sizes, worth, removed,
            places, np.empty(len(places)), seen, without,
        )  # fmt: skip
        return float(base), without

    def _choose(
        self, above: BoolArray, other: BoolArray, worth: FloatArray, told: WayDown, limit: int
    ) -> tuple[float, list[tuple[int, float]], float]:
        """Return the vote, the chosen relations with the vote without each, and the vote without all of them."""
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
    """Explain why a forest assigns a clip to a category; removing any of the reasons lowers the vote.

    Parameters
    ----------
    forest : trained. Use one `Explainer` for many clips.
    clip : (T, F) features, those of the forest's feature set.
    duration : s, of the clip.
    category : by default the one that most trees vote for.
    limit : reasons at most, at least 1.

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
    """Explain why two clips are similar; removing any reason lowers the share of trees with both in one leaf.

    Parameters
    ----------
    forest : trained.
    query, hit : (T, F) features.
    durations : s, of the query and of the hit.
    limit : reasons at most, at least 1.

    Raises
    ------
    NotTrainedError
    InvalidMotionError : features of another shape, or not finite.
    OptionError : a duration or limit out of range.
    """
    return Explainer(forest).explain_pair(query, hit, durations, limit)
