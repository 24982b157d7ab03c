"""The likeliest sequence of segments, from the probability of each category at each moment and typical lengths.

A hidden semi-Markov model whose states are the categories and "nothing". The score of a segment is the weighted sum of
the log probability of its state over its moments (neighbours see the same frames), plus the log
probability of its length. Lengths are log-normal, fitted per state and shrunk to the spread of all; far beyond
them they are geometric.
Source: explicit-duration models, Yu, "Hidden semi-Markov models", Artificial Intelligence 174, 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.retrieval.takes.moment_kernels import find_best_sequence
from dousa.retrieval.takes.moment_model import HOP

_SPREAD, _STRENGTH = 0.3, 4.0  # least spread of the log length; weight of the common spread, in segments
_LONGEST = 250  # moments of the table of lengths; longer segments grow by single moments


@dataclass(frozen=True, slots=True)
class SequenceWeights:
    """Weights learned on people left out.

    ``evidence`` weighs the log probability of a moment, ``nothing`` is added to that of nothing, ``edges`` weighs the
    log odds that a segment begins, and ends, where it does.
    """

    evidence: float = 0.4
    nothing: float = -1.0
    edges: float = 0.5


FLOOR = 0.01
"""Added to probabilities, so that no moment excludes a category (docs/takes.md)."""

N_PHASES = 3
"""Phases of an action: beginning, middle, end (docs/takes.md)."""

PHASE_FRAMES = 12
"""Frames of the beginning, and of the end, of an action; at most half of it each (docs/takes.md)."""


def join_phases(shares: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (M, C + 1) probabilities of the categories and of nothing, from those of the phases (M, 3 C + 1)."""
    count = shares.shape[1] // N_PHASES
    joined = np.empty((len(shares), count + 1), np.float32)
    phases = shares[:, :-1]  # added one by one, as NumPy is slow at sums over short rows
    np.add(phases[:, ::N_PHASES], phases[:, 1::N_PHASES], out=joined[:, :-1])
    joined[:, :-1] += phases[:, 2::N_PHASES]
    joined[:, -1] = shares[:, -1]
    return joined


@dataclass(frozen=True, slots=True)
class Run:
    """Moments ``start`` to below ``stop`` of one state."""

    start: int
    stop: int
    state: int


@dataclass(frozen=True, slots=True, eq=False)
class SequenceModel:
    """Means and standard deviations (S,) of the log lengths in frames of the states, the last of which is nothing."""

    log_lengths: FloatArray
    spreads: FloatArray
    weights: SequenceWeights

    def find_runs(self, shares: NDArray[np.float32], *, never_nothing: bool = False) -> list[Run]:
        """Find the best sequence of states from the probabilities (M, 3 C + 1) of the phases and of nothing at moments.

        Runs follow in order without gaps, none for no moment; ``never_nothing`` gives every moment a category.
        """
        if not len(shares):
            return []
        tables = self._weigh(shares)
        lengths, tails = self._tabulate(len(shares))
        again = np.zeros(len(tails))
        again[-1] = np.inf
        last = -1 if never_nothing else len(tails)
        evidence, opening, closing, lengths = (np.ascontiguousarray(table[:, :last]) for table in (*tables, lengths))
        return _search(evidence, opening, closing, lengths, tails[:last], again[:last])

    def cut_repetitions(self, shares: NDArray[np.float32], run: Run, repeated: float = 2.4) -> list[Run]:
        """Cut a run of a category into parts of about its usual length, where it likeliest ends and begins.

        ``shares`` are those of `find_runs`, of all moments. A run of up to ``repeated`` times the usual length is
        returned whole (docs/takes.md).
        """
        usual = float(np.exp(self.log_lengths[run.state])) / HOP
        if run.stop - run.start <= repeated * usual:
            return [run]
        most = max(int(repeated * usual), 1)
        tables = *self._weigh(shares[run.start : run.stop]), self._tabulate(most)[0][:most]
        evidence, opening, closing, lengths = (
            np.ascontiguousarray(table[:, run.state : run.state + 1]) for table in tables
        )
        parts = _search(evidence, opening, closing, lengths, np.full(1, -1e9), np.zeros(1))  # never longer
        return [Run(run.start + one.start, run.start + one.stop, run.state) for one in parts]

    def _weigh(self, shares: NDArray[np.float32]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (M, S) weighted evidence for each state, for its beginning and for its end at each moment."""
        weights = self.weights
        joined = np.maximum(join_phases(shares), 0.0).astype(np.float64)
        evidence = np.log(joined + FLOOR)
        evidence[:, -1] += weights.nothing
        evidence *= weights.evidence
        opening, closing = np.zeros(evidence.shape), np.zeros(evidence.shape)
        for phase, edge in ((0, opening), (N_PHASES - 1, closing)):
            own = np.maximum(shares[:, phase:-1:N_PHASES], 0.0)
            edge[:, :-1] = weights.edges * np.log((own + FLOOR) / (np.maximum(joined[:, :-1] - own, 0.0) + FLOOR))
        return evidence, opening, closing

    def _tabulate(self, n_moments: int) -> tuple[FloatArray, FloatArray]:
        """Return (L, S) log probabilities of lengths of 1, 2 ... moments, and (S,) that of each further moment."""
        longest = np.exp(self.log_lengths[:-1] + 2.0 * self.spreads[:-1]).max(initial=1.0) / HOP
        most = int(min(max(longest, 10.0), _LONGEST, max(n_moments, 1)))
        frames = np.arange(1, most + 1)[:, None] * float(HOP)
        off = (np.log(frames) - self.log_lengths) / self.spreads
        table = -0.5 * off * off - np.log(self.spreads * frames * np.sqrt(2.0 * np.pi) / HOP)
        tails = -HOP / np.exp(self.log_lengths)
        return table, tails

    def with_lengths(self, lengths: Sequence[Sequence[float]]) -> SequenceModel:
        """Add states before nothing, with the lengths (frames) of their segments."""
        new = fit_lengths([*lengths, [1.0]], self.weights, pooled=float(np.median(self.spreads[:-1])))
        means = np.concatenate([self.log_lengths[:-1], new.log_lengths[:-1], self.log_lengths[-1:]])
        spreads = np.concatenate([self.spreads[:-1], new.spreads[:-1], self.spreads[-1:]])
        return SequenceModel(means, spreads, self.weights)


def _search(
    evidence: FloatArray,
    opening: FloatArray,
    closing: FloatArray,
    lengths: FloatArray,
    tails: FloatArray,
    again: FloatArray,
) -> list[Run]:
    n, count = evidence.shape
    sums, entry = np.empty((2, n + 1, count))
    begins, before, numbers = np.empty((3, n + 3, count), np.int32)
    tables, room = (evidence, opening, closing, lengths, tails, again), (sums, entry, np.empty((2, count)), numbers)
    state = find_best_sequence(*tables, *room, begins, before)
    runs, stop = [], n
    while stop > 0:
        start = int(begins[stop, state])
        runs.append(Run(start, stop, int(state)))
        stop, state = start, before[stop, state]
    return runs[::-1]


def fit_lengths(
    lengths: Sequence[Sequence[float]], weights: SequenceWeights, pooled: float | None = None
) -> SequenceModel:
    """Fit the lengths of the states.

    Parameters
    ----------
    lengths : for each state the lengths of its segments in frames; a state without any gets the mean of all.
    weights : of evidence, nothing and edges.
    pooled : spread of the log lengths within states; None to measure it.
    """
    logs = [np.log(np.maximum(np.asarray(some, np.float64), 1.0)) for some in lengths]
    there = [some for some in logs if len(some)]
    everything = np.concatenate(there) if there else np.log([30.0])
    if pooled is None:
        pooled = float(np.concatenate([some - some.mean() for some in there] or [np.zeros(1)]).std())
    common = max(pooled, _SPREAD)
    means = np.array([some.mean() if len(some) else everything.mean() for some in logs])
    own = np.array([((some - some.mean()) ** 2).sum() if len(some) else 0.0 for some in logs])
    counts = np.array([len(some) for some in logs])
    spreads = np.sqrt((own + _STRENGTH * common**2) / (counts + _STRENGTH) + _SPREAD**2)
    return SequenceModel(means, spreads, weights)
