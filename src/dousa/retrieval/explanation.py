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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import OptionError
from dousa.retrieval import _explain_kernels as kernels
from dousa.retrieval._phrases import Fact, say_fact, say_shared_fact
from dousa.retrieval._questions import read_questions
from dousa.retrieval._reasons import Explanation, Likeness, Reason, SharedReason, Speaker, WayDown, count_bits
from dousa.retrieval.forest import MotionForest

__all__ = ["Explainer", "Explanation", "Likeness", "Reason", "SharedReason", "explain", "explain_pair"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LEAST_DROP = 0.005
"""Of the vote: half a tree of a hundred; less is not worth a sentence."""


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
            self._shared_reason(
                told.best(questions, relation), (values, hit_values), durations, (before, without)
            )
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
            raise OptionError(f"the forest knows no category '{category}'")
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
        base = kernels.ablate(  # type: ignore[call-arg]
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

    def _reason(
        self, told: Speaker, values: FloatArray, duration: float, votes: tuple[float, float]
    ) -> Reason:
        fact = self._fact(told, values, duration)
        return Reason(
            text=say_fact(fact),
            relation=fact.channel.relation,
            channel=fact.channel.name,
            unit=fact.channel.unit,
            kind=fact.kind,
            start=fact.start,
            end=fact.end,
            value=fact.value,
            threshold=fact.threshold,
            above=fact.above,
            others=fact.others,
            away=fact.away,
            vote_before=votes[0],
            vote_without=votes[1],
        )

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
            relation=fact.channel.relation,
            channel=fact.channel.name,
            unit=fact.channel.unit,
            kind=fact.kind,
            start=fact.start,
            end=fact.end,
            value=fact.value,
            other_start=other.start,
            other_end=other.end,
            other_value=other.value,
            threshold=fact.threshold,
            above=fact.above,
            others=fact.others,
            away=fact.away,
            alike_before=alike[0],
            alike_without=alike[1],
        )


def _check(limit: int, *durations: float) -> None:
    if limit < 1:
        raise OptionError(f"expected a limit of at least one reason, got {limit}")
    for duration in durations:
        if not (np.isfinite(duration) and duration > 0.0):
            raise OptionError(f"expected a duration in s above 0, got {duration}")


def explain(
    forest: MotionForest,
    clip: ArrayLike,
    duration: float,
    category: str | int | None = None,
    limit: int = 3,
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
    forest: MotionForest,
    query: ArrayLike,
    hit: ArrayLike,
    durations: tuple[float, float],
    limit: int = 3,
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
