"""Runs of a mask and of equal values against counting by hand."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dousa.motion.runs import find_equal_runs, find_runs


def list_groups(values: list[int]) -> list[tuple[int, int, int]]:
    """(value, first, one past the last) of each group of equal neighbours."""
    groups, first = [], 0
    for value, group in itertools.groupby(values):
        stop = first + len(list(group))
        groups.append((value, first, stop))
        first = stop
    return groups


@given(st.lists(st.booleans(), max_size=20))
def test_runs_of_a_mask(mask: list[bool]) -> None:
    expected = [[first, stop] for value, first, stop in list_groups(mask) if value]
    runs = find_runs(np.array(mask, bool))
    assert runs.shape == (len(expected), 2)
    assert runs.tolist() == expected


@given(st.lists(st.integers(-1, 2), max_size=20))
def test_runs_of_equal_values_cover_the_array(values: list[int]) -> None:
    expected = [[first, stop] for _, first, stop in list_groups(values)]
    runs = find_equal_runs(np.array(values, int))
    assert runs.shape == (len(expected), 2)
    assert runs.tolist() == expected
