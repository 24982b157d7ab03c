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
from dousa.errors import InvalidMotionError, OptionError
from dousa.kernels import kernel, part
from dousa.messages import Message
from dousa.retrieval.explain.phrases import Fact, say_fact, say_shared_fact, share_away
from dousa.retrieval.features.channels import Channel
from dousa.retrieval.features.feature_sets import DURATION, FEATURE_SETS, MEAN, SPREAD, TREND
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.trees import KIND_NAMES, Trees


@kernel
def sum_upwards(children: IntArray, leaves: FloatArray, sums: FloatArray) -> None:
    """Sum the leaves below every node into ``sums`` (M,)."""
    for node in range(len(children) - 1, -1, -1):
        child = children[node]
        sums[node] = leaves[-1 - child] if child < 0 else sums[child] + sums[child + 1]


@part
def _expect(
    root: int,
    extra: int,
    mark: int,
    children: IntArray,
    above: BoolArray,
    other: BoolArray,
    relation: IntArray,
    sizes: FloatArray,
    values: FloatArray,
    removed: BoolArray,
    places: IntArray,
    weights: FloatArray,
    seen: IntArray,
) -> float:
    """Return the expected value of the leaf that both clips reach together.

    At a node with a removed relation, or ``extra``, they go to both children with the shares of the training clips
    there; elsewhere they follow their answers, and add nothing once they part. Other relations are marked in ``seen``
    with ``mark``.
    """
    expected = 0.0
    places[0], weights[0] = root, 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        node, weight = places[depth], weights[depth]
        child = children[node]
        if child < 0:
            expected += weight * values[-1 - child]
            continue
        asked = relation[node]
        if removed[asked] or asked == extra:
            share = sizes[child] / sizes[node]
            places[depth], weights[depth] = child, weight * share
            places[depth + 1], weights[depth + 1] = child + 1, weight * (1.0 - share)
            depth += 2
            continue
        if mark >= 0:
            seen[asked] = mark
        if above[node] == other[node]:
            places[depth], weights[depth] = child + np.int64(above[node]), weight
            depth += 1
    return expected


@kernel
def ablate(
    roots: IntArray,
    children: IntArray,
    above: BoolArray,
    other: BoolArray,
    relation: IntArray,
    sizes: FloatArray,
    values: FloatArray,
    removed: BoolArray,
    places: IntArray,
    weights: FloatArray,
    seen: IntArray,
    without: FloatArray,
) -> float:
    """Compute the mean value of the leaves of two clips over the trees, and that without each relation.

    Parameters
    ----------
    roots : (n_trees,) first node of each tree.
    above, other : (M,) answers of two clips at every node; equal for one clip.
    sizes : (M,) training clips at each node.
    values : (L,) value of each leaf: 1 where it votes for the category.
    removed : (R,) relations already removed, also from the mean returned.
    places, weights, seen : memory for (M + 2,), (M + 2,) and (R,).
    without : (R,) filled with the mean without each relation as well.
    """
    total = 0.0
    without[:] = 0.0
    seen[:] = -1
    for tree in range(len(roots)):
        root = roots[tree]
        value = _expect(root, -1, tree, children, above, other, relation, sizes, values, removed, places, weights, seen)
        total += value
        for number in range(len(without)):
            if seen[number] == tree:
                without[number] += value - _expect(
                    root, number, -1, children, above, other, relation, sizes, values, removed, places, weights,
                    seen,
                )  # fmt: skip
    for number in range(len(without)):
        without[number] = (total - without[number]) / len(roots)
    return total / len(roots)


@dataclass(frozen=True, slots=True, eq=False)
class Questions:
    """The tests of all nodes of a forest.

    Parameters
    ----------
    trees : of the forest.
    channels : (F,) of the columns of the features.
    relations : names of the relations tested; one empty name if there are none.
    children : (M,) left child or ``-1 - leaf``.
    kind, column, partner, start, stop : (M,) see ``tree_kernels``; meaningless at leaves.
    threshold : (M,) of the mean, spread or trend.
    relation : (M,) number of the relation.
    sizes : (M,) training clips at each node.
    """

    trees: Trees
    channels: tuple[Channel, ...]
    relations: tuple[str, ...]
    children: IntArray
    kind: IntArray
    column: IntArray
    partner: IntArray
    start: IntArray
    stop: IntArray
    threshold: FloatArray
    relation: IntArray
    sizes: FloatArray

    def evaluate(self, clip: ArrayLike) -> FloatArray:
        """Compute the (M,) values of all tests for a clip (T, F); InvalidMotionError for another shape or NaN."""
        pose = np.asarray(clip, dtype=np.float64)
        wanted = (self.trees.n_frames, self.trees.n_features)
        if pose.shape != wanted or not np.isfinite(pose).all():
            raise InvalidMotionError(
                "explain.not_finite" if pose.shape == wanted else "explain.shape",
                wanted=wanted,
                shape=pose.shape,
            )
        integrals = np.zeros((pose.shape[1], pose.shape[0] + 1))
        np.cumsum(pose.T, axis=1, out=integrals[:, 1:])
        length = (self.stop - self.start).astype(np.float64)
        difference = integrals[self.column, self.stop] - integrals[self.column, self.start]
        values: FloatArray = difference / length
        for kind in (SPREAD, TREND):
            at = np.flatnonzero(self.kind == kind)
            start, stop, partner = self.start[at], self.stop[at], self.partner[at]
            other = integrals[partner, stop] - integrals[partner, start]
            if kind == SPREAD:
                values[at] = np.sqrt(np.maximum(other / length[at] - values[at] ** 2, 0.0))
            else:
                middle = 0.5 * (start + stop)
                values[at] = 12.0 * (other - middle * difference[at]) / length[at] ** 2
        return values

    def sum_leaves(self, leaves: FloatArray) -> FloatArray:
        """Return the (M,) sums over the leaves below every node."""
        sums = np.empty(len(self.children))
        sum_upwards(self.children, leaves, sums)
        return sums

    def follow(self, above: BoolArray, trees: BoolArray) -> tuple[IntArray, IntArray]:
        """Return the inner nodes on the paths of a clip with answers (M,) in some trees, and the child of each."""
        places = self.trees.roots[trees]
        nodes = []
        while len(places):
            places = places[self.children[places] >= 0]
            nodes.append(places)
            places = self.children[places] + above[places]
        asked = np.concatenate(nodes) if nodes else np.zeros(0, np.int64)
        return asked, self.children[asked] + above[asked]

    def find_leaves(self, above: BoolArray) -> IntArray:
        """Return the (n_trees,) leaves of a clip with these answers."""
        places = self.trees.roots.copy()
        while True:
            inner = np.flatnonzero(self.children[places] >= 0)
            if not len(inner):
                return -1 - self.children[places]
            places[inner] = self.children[places[inner]] + above[places[inner]]


def read_questions(forest: MotionForest) -> Questions:
    """Read the tests of a trained forest; NotTrainedError before ``fit``."""
    trees, width = forest.trees_, forest.trees_.n_frames + 1
    nodes = trees.nodes.astype(np.int64)
    children, shift = nodes[:, 2], nodes[:, 3]
    column, stop = np.divmod(nodes[:, 0], width)
    start = nodes[:, 1] % width
    leaf = children < 0
    column[leaf], start[leaf], stop[leaf], shift[leaf] = 0, 0, 1, 0
    kind = np.where(shift == 0, MEAN, np.where(shift > 0, SPREAD, TREND))
    # The stored threshold of a mean is multiplied by the length of the interval.
    threshold = trees.cuts[:, 2] / np.where(kind == MEAN, stop - start, 1)
    channels = _find_channels(forest.feature_names_)
    asked = np.unique(column[~leaf])  # columns of squares and moments occur as partners only
    names = tuple(dict.fromkeys(channels[i].relation for i in asked)) or ("",)
    number = np.zeros(len(channels), np.int64)
    number[asked] = [names.index(channels[i].relation) for i in asked]
    sizes = np.empty(len(nodes))
    per_leaf = np.add.reduceat(trees.leaf_counts, trees.leaf_starts[:-1]).astype(np.float64)
    sum_upwards(children.copy(), per_leaf, sizes)
    return Questions(
        trees=trees,
        channels=channels,
        relations=names,
        children=children.copy(),
        kind=kind,
        column=column,
        partner=column + np.abs(shift) // width,
        start=start,
        stop=stop,
        threshold=threshold,
        relation=number[column],
        sizes=sizes,
    )


def _find_channels(names: tuple[str, ...]) -> tuple[Channel, ...]:
    known = {channel.name: channel for features in FEATURE_SETS.values() for channel in features.channels}
    known[DURATION.name] = DURATION
    return tuple(known.get(name, Channel(name, name, "")) for name in names)


@dataclass(frozen=True, slots=True)
class _Decisive:
    """A relation that an answer rests on, as one test of it shows.

    Parameters
    ----------
    text : the relation in words.
    relation : the relation removed for ``vote_without`` or ``alike_without``.
    channel, unit, kind : the quantity measured; the kind is ``"mean"``, ``"spread"`` or ``"trend"``.
    start, end : s, the interval.
    value, threshold : of the clip and of the test, in ``unit``.
    above : whether the value lies above the threshold.
    others, away : other training clips that reached the test, and how many lie on the other side.
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


@dataclass(frozen=True, slots=True)
class Reason(_Decisive):
    """A relation that the vote for a category rests on; the others are training clips of other categories.

    ``vote_before`` and ``vote_without`` are the shares of the trees that vote for the category, with and without it.
    """

    vote_before: float
    vote_without: float


@dataclass(frozen=True, slots=True)
class SharedReason(_Decisive):
    """A relation that two clips share, unlike other clips.

    ``other_start``, ``other_end`` and ``other_value`` are of the second clip; ``alike_before`` and ``alike_without``
    the shares of the trees with both in one leaf, with and without the relation.
    """

    other_start: float
    other_end: float
    other_value: float
    alike_before: float
    alike_without: float


class _Reasons:
    """What reasons are given for."""

    __slots__ = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries, the text in the current language."""
        plain = asdict(self)  # type: ignore[call-overload]  # of the dataclasses below this one
        for reason in plain["reasons"]:
            reason |= {"text": str(reason["text"]), "message": reason["text"].to_json()}
        return dict(plain)


@dataclass(frozen=True, slots=True)
class Explanation(_Reasons):
    """The ``reasons`` of a forest for a ``category``, the most important first; none if no tree votes for it.

    ``vote`` is the share of the trees that vote for it, ``vote_without_all`` that without all of these relations.
    """

    category: str | int
    vote: float
    reasons: tuple[Reason, ...]
    vote_without_all: float


@dataclass(frozen=True, slots=True)
class Likeness(_Reasons):
    """The share of trees with two clips in one leaf, with and without all the reasons, and the reasons."""

    alike: float
    reasons: tuple[SharedReason, ...]
    alike_without_all: float


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
        best = own[int((support * clear * share_away(self.away[own], self.others[own])).argmax())]
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
        """Explain why the forest assigns a clip to a category; removing any of the reasons lowers the vote.

        Parameters
        ----------
        clip : (T, F) features, those of the forest's feature set.
        duration : s, of the clip.
        category : by default the one that most trees vote for.
        limit : reasons at most, at least 1.

        Raises
        ------
        InvalidMotionError : features of another shape, or not finite.
        OptionError : a category that the forest does not know, a duration or limit out of range.
        """
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
        path = WayDown(nodes, above[nodes], gaps, bits, others, others - (sizes - inside)[taken])
        before, chosen, left = self._choose(above, above, worth, path, limit)
        reasons = tuple(
            self._reason(path.best(questions, relation), values, duration, (before, without))
            for relation, without in chosen
        )
        return Explanation(self._classes[number].item(), before, reasons, left)

    def explain_pair(
        self, query: ArrayLike, hit: ArrayLike, durations: tuple[float, float], limit: int = 3
    ) -> Likeness:
        """Explain why two clips are similar; removing any reason lowers the share of trees with both in one leaf.

        ``query``, ``hit`` are features (T, F), ``durations`` theirs in s; ``limit`` and errors are as of `explain`.
        """
        _check(limit, *durations)
        questions = self._questions
        values, hit_values = questions.evaluate(query), questions.evaluate(hit)
        above, hit_above = values > questions.threshold, hit_values > questions.threshold
        together = questions.find_leaves(above) == questions.find_leaves(hit_above)
        nodes, taken = questions.follow(above, together)
        came, stayed = questions.sizes[nodes], questions.sizes[taken]
        gaps = np.minimum(*(np.abs(each - questions.threshold)[nodes] for each in (values, hit_values)))
        path = WayDown(nodes, above[nodes], gaps, np.log2(came / stayed), came, came - stayed)
        worth = np.ones(len(self._voted))
        before, chosen, left = self._choose(above, hit_above, worth, path, limit)
        reasons = tuple(
            self._shared_reason(path.best(questions, relation), (values, hit_values), durations, (before, without))
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
        base = ablate(
            self._roots, questions.children, above, other, questions.relation, questions.sizes, worth, removed,
            places, np.empty(len(places)), seen, without,
        )  # fmt: skip
        return float(base), without

    def _choose(
        self,
        above: BoolArray,
        other: BoolArray,
        worth: FloatArray,
        path: WayDown,
        limit: int,
        least_drop: float = 0.005,
    ) -> tuple[float, list[tuple[int, float]], float]:
        """Return the vote, the chosen relations with the vote without each, and the vote without all of them.

        A reason costs at least ``least_drop`` of the vote, half a tree of a hundred.
        """
        relations = self._questions.relations
        removed = np.zeros(len(relations), bool)
        before, alone = self._ablate(above, other, worth, removed)
        can = np.zeros(len(relations), bool)
        can[self._questions.relation[path.nodes[path.bits > 0.0]]] = True
        can &= alone <= before - least_drop
        chosen: list[tuple[int, float]] = []
        left, without = before, alone
        while len(chosen) < limit and can.any():
            best = int(np.where(can, without, np.inf).argmin())
            if without[best] > left - least_drop:
                break
            chosen.append((best, float(alone[best])))
            removed[best], can[best] = True, False
            left, without = self._ablate(above, other, worth, removed)
        return before, chosen, left

    def _fact(self, speaker: Speaker, values: FloatArray, duration: float) -> Fact:
        questions, node = self._questions, speaker.node
        start, stop, frames = int(questions.start[node]), int(questions.stop[node]), questions.trees.n_frames
        return Fact(
            channel=questions.channels[questions.column[node]],
            kind=KIND_NAMES[questions.kind[node]],
            above=bool(values[node] > questions.threshold[node]),
            start=start / frames * duration,
            end=stop / frames * duration,
            whole=stop - start == frames,
            value=float(values[node]),
            threshold=float(questions.threshold[node]),
            others=speaker.others,
            away=speaker.away,
        )

    def _reason(self, speaker: Speaker, values: FloatArray, duration: float, votes: tuple[float, float]) -> Reason:
        fact = self._fact(speaker, values, duration)
        return Reason(text=say_fact(fact), **_plain(fact), vote_before=votes[0], vote_without=votes[1])

    def _shared_reason(
        self,
        speaker: Speaker,
        values: tuple[FloatArray, FloatArray],
        durations: tuple[float, float],
        shares: tuple[float, float],
    ) -> SharedReason:
        fact, other = (self._fact(speaker, *pair) for pair in zip(values, durations, strict=True))
        return SharedReason(
            text=say_shared_fact(fact, other),
            **_plain(fact),
            other_start=other.start,
            other_end=other.end,
            other_value=other.value,
            alike_before=shares[0],
            alike_without=shares[1],
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
