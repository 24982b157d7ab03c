"""The leaves of very many clips, in parts and as codes: the same as those of a plain array."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.retrieval.forest.standing_leaves import LeafCodes, StandingLeaves

N_TREES, N_EACH = 3, 5  # leaves of each tree


def draw_parts(seed: int, sizes: list[int]) -> tuple[np.ndarray, StandingLeaves]:
    """Plain leaves (N, n_trees), and the same in parts, of which every fourth row does not count."""
    rng = np.random.default_rng(seed)
    count = sum(sizes)
    plain = rng.integers(0, N_EACH, (count, N_TREES)).astype(np.int32) + np.arange(N_TREES, dtype=np.int32) * N_EACH
    mixed, parts, start = rng.permutation(count), [], 0
    for number, size in enumerate(sizes):
        own = mixed[start : start + size]
        start += size
        table = np.concatenate([t * N_EACH + rng.permutation(N_EACH) for t in range(N_TREES)]).astype(np.int32)
        offsets = np.arange(N_TREES) * N_EACH
        ranks = np.empty(len(table), np.int64)
        ranks[table] = np.arange(len(table)) - np.repeat(offsets, N_EACH)
        codes, places = ranks[plain[own]].astype((np.uint16, np.int32)[number % 2]), own
        gone = rng.integers(0, N_EACH, (size // 4, N_TREES)).astype(codes.dtype)
        where = np.sort(rng.integers(0, size + 1, len(gone)))
        parts.append(
            LeafCodes(
                np.insert(codes, where, gone, axis=0), table, offsets, np.insert(places, where, -1).astype(np.int64)
            )
        )
    return plain, StandingLeaves(parts, count)


@pytest.mark.parametrize("chosen", [False, True])
@given(st.integers(0, 10_000), st.lists(st.integers(0, 12), min_size=1, max_size=3))
def test_parts_say_what_a_plain_array_says(chosen, seed, sizes):
    plain, standing = draw_parts(seed, sizes)
    rng = np.random.default_rng(seed + 1)
    if chosen:
        some = rng.random(len(plain)) < 0.6
        plain, standing = plain[some], standing.only(some)
    assert len(standing) == len(plain) and standing.n_trees == N_TREES
    rows = rng.integers(0, len(plain), 7) if len(plain) else np.zeros(0, np.int64)
    assert np.array_equal(standing.take(rows), plain[rows])
    marked = rng.random(N_TREES * N_EACH) < 0.3
    assert np.array_equal(standing.find(marked), np.flatnonzero(marked[plain].any(axis=1)))
    clips, leaves = standing.list(marked)
    wanted = [(clip, leaf) for clip, row in enumerate(plain) for leaf in row if marked[leaf]]
    assert list(zip(clips.tolist(), leaves.tolist(), strict=True)) == wanted
    ranks = np.where(marked, rng.integers(0, 4, len(marked)), -1)
    categories = rng.integers(0, 3, len(plain)).astype(np.int32)
    slow = np.zeros((ranks.max() + 1, 3), int)
    for clip, row in enumerate(plain):
        for leaf in row[ranks[row] >= 0]:
            slow[ranks[leaf], categories[clip]] += 1
    assert np.array_equal(standing.count(ranks, categories, 3), slow)


def test_plain_leaves_are_one_part():
    leaves = np.array([[0, 3], [1, 2]])
    standing = StandingLeaves.of(leaves, 4)
    assert StandingLeaves.of(standing, 4) is standing
    assert np.array_equal(standing.take(np.array([1, 0])), leaves[::-1])
