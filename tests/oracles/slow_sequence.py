"""The likeliest sequence of segments by trying all: literal, and slow."""

from itertools import pairwise, product

import numpy as np


def best_value(evidence, opening, closing, lengths, again):
    """The largest score of any way to cut (T, S) into segments, each no longer than ``lengths`` (M, S) has rows."""
    n, count = evidence.shape
    best = -np.inf
    for cuts in product((False, True), repeat=n - 1):
        edges = [0, *(k + 1 for k, cut in enumerate(cuts) if cut), n]
        parts = list(pairwise(edges))
        if max(stop - start for start, stop in parts) > len(lengths):
            continue
        for states in product(range(count), repeat=len(parts)):
            best = max(best, value_of(parts, states, evidence, opening, closing, lengths, again))
    return best


def value_of(parts, states, evidence, opening, closing, lengths, again):
    """The score of segments (start, stop) of states."""
    total = 0.0
    for number, ((start, stop), state) in enumerate(zip(parts, states, strict=True)):
        total += evidence[start:stop, state].sum() + lengths[stop - start - 1, state]
        total += opening[start, state] + closing[stop - 1, state]
        if number and states[number - 1] == state:
            total -= again[state]
    return total
