"""The words of very many motions in columns, so that a query is compared with what differs between them, once.

What `Matcher.fit` says of one motion at a time is said here of all: categories, the known words of names, and relations
are few even where motions are many, so each of them is compared once and the rest is arithmetic on columns. A word of a
name that the table lacks, such as a number, is found by its letters alone, and looked up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.retrieval.words.matching import (
    ALSO_DOES,
    DOES,
    NAME,
    OPPOSITE,
    Fit,
    Matcher,
    Unit,
    is_whole,
)
from dousa.retrieval.words.reading import Word

_NOTHING = Unit((), 0.0)


@dataclass(frozen=True, slots=True)
class MotionWords:
    """What is said of one motion.

    Parameters
    ----------
    category, name : words of these.
    relations : what it does, with the share of the motion for which each holds.
    """

    category: Unit
    name: Unit
    relations: tuple[tuple[Unit, float], ...]


class WordColumns:
    """The words of N motions.

    Parameters
    ----------
    motions : of each.
    """

    def __init__(self, motions: Sequence[MotionWords]) -> None:
        self.motions = tuple(motions)
        self._categories, self._category_of = _number([one.category for one in motions])
        meant = {unit: _keep_meant(unit) for unit in {one.name for one in motions}}
        self._names, self._name_of = _number([meant[one.name] for one in motions])
        spelled: dict[str, list[int]] = {}
        for row, one in enumerate(motions):
            for key in {word.key for word in one.name.words if not word.meanings}:
                spelled.setdefault(key, []).append(row)
        self._spelled = {key: np.array(rows, np.intp) for key, rows in spelled.items()}
        flat = [(row, unit, share) for row, one in enumerate(motions) for unit, share in one.relations]
        self._relations, self._unit_of = _number([unit for _, unit, _ in flat])
        self._row_of = np.array([row for row, _, _ in flat], np.intp)
        shares = np.array([share for _, _, share in flat], np.float64)
        self._lasting = 0.8 + 0.2 * np.minimum(1.0, 2.0 * shares)

    def score(self, matcher: Matcher) -> FloatArray:
        """How well each motion fits a query: (N,) ``Fit.score`` of `Matcher.fit`."""
        query = matcher.query
        weights = np.array([slot.weight for slot in query.slots], np.float64)
        if not weights.sum():
            return np.zeros(len(self.motions))
        base, trust = self._compare_names(matcher)
        found = np.array([matcher.find_relation(unit) for unit in self._relations]).reshape(-1, len(weights))
        useful: NDArray[np.bool_] = np.any(found != 0, axis=1).astype(bool).reshape(-1)
        helps = useful[self._unit_of]
        rows, units = self._row_of[helps], self._unit_of[helps]
        told = (trust[rows] * self._lasting[helps])[:, np.newaxis] * found[units]
        whole = np.array([is_whole(values, query.slots) for values in told.tolist()], bool)
        total = weights.sum()
        score: FloatArray = base @ weights / total
        for chosen in (np.ones(len(rows), bool), whole):
            base, score, better = _take_best(base, score, rows[chosen], told[chosen], weights / total)
            if not better:
                break
        return score

    def fit(self, matcher: Matcher, row: int) -> Fit:
        """All that is to be said of one."""
        one = self.motions[row]
        return matcher.fit(one.category, one.name, one.relations)

    def _compare_names(self, matcher: Matcher) -> tuple[FloatArray, FloatArray]:
        """What categories and names say, (N, slots), and what relations count beside each category, (N,)."""
        n_slots = len(matcher.query.slots)
        category, against = _compare(matcher, self._categories, n_slots)
        name, name_against = _compare(matcher, self._names, n_slots)
        by_name, against_name = name[self._name_of], name_against[self._name_of]
        for rows, unit in self._list_spelled({slot.word.key for slot in matcher.query.slots}):
            by_name[rows], against_name[rows] = matcher.find(unit)
        opposes: NDArray[np.bool_] = np.logical_or(against[self._category_of], against_name)
        scale = np.where(opposes, OPPOSITE, 1.0).reshape(-1, 1)
        base = scale * np.maximum(category[self._category_of], NAME * by_name)
        acts = np.array([any(map(matcher.is_action, unit.words)) for unit in self._categories], bool)
        trust = np.where(acts, ALSO_DOES, DOES)
        return base, trust[self._category_of]

    def _list_spelled(self, keys: set[str]) -> Iterator[tuple[IndexArray, Unit]]:
        """Motions whose names have words of these keys that the table lacks; each kind with what its names say."""
        there = sorted(keys.intersection(self._spelled))
        if not there:
            return
        has = np.zeros((len(self.motions), len(there)), bool)
        for place, key in enumerate(there):
            has[self._spelled[key], place] = True
        some = np.flatnonzero(has.any(axis=1))
        kinds, kind_of = np.unique(np.column_stack([self._name_of[some], has[some]]), axis=0, return_inverse=True)
        for number, (name, *own) in enumerate(kinds.tolist()):
            words = tuple(Word(key, key) for key, is_there in zip(there, own, strict=True) if is_there)
            yield some[kind_of.ravel() == number], Unit((*self._names[name].words, *words), 0.0)


def _number(units: Sequence[Unit]) -> tuple[list[Unit], IndexArray]:
    """Different units, and the place of each one among these."""
    places: dict[Unit, int] = {}
    # Most units are there many times; to compare their words takes longer than to see that they are the same.
    objects = {id(unit): unit for unit in units}
    known = {key: places.setdefault(unit, len(places)) for key, unit in objects.items()}
    return list(places), np.array([known[id(unit)] for unit in units], np.intp)


def _keep_meant(unit: Unit) -> Unit:
    words = tuple(word for word in unit.words if word.meanings)
    return Unit(words, 0.0) if words else _NOTHING


def _compare(matcher: Matcher, units: Sequence[Unit], n_slots: int) -> tuple[FloatArray, NDArray[np.bool_]]:
    found = [matcher.find(unit) for unit in units]
    values = np.array([values for values, _ in found], np.float64).reshape(-1, n_slots)
    return values, np.array([against for _, against in found], bool)


def _take_best(
    base: FloatArray, score: FloatArray, rows: IndexArray, told: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray, bool]:
    """What is said of motions (N, slots) with the relation of each that helps it most, the new score, whether any did.

    ``rows`` ascending: the motion of each relation; ``told`` what these find.
    """
    more = np.maximum(base[rows], told) @ weights
    order = np.lexsort((-more, rows))
    first = order[np.unique(rows[order], return_index=True)[1]]
    first = first[more[first] > score[rows[first]] + 1e-9]
    base, score = base.copy(), score.copy()
    base[rows[first]] = np.maximum(base[rows[first]], told[first])
    score[rows[first]] = more[first]
    return base, score, bool(len(first))
