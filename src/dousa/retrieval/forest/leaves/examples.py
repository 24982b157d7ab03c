"""A few clips of each leaf of a training, from which it grows later: what else is in it need not be read then.

Of each category as many, as far as there are so many; between equals the first in the order in which clips are given,
which is one of their contents. So they do not depend on when clips were added.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import IntArray
from dousa.retrieval.forest import tree_kernels as kernels

MOST_EXAMPLES = 8
"""Of a leaf."""


def choose_examples(
    portions: Iterable[tuple[IntArray, NDArray[np.int32], NDArray[np.int32]]],
    n_leaves: int,
    most: int = MOST_EXAMPLES,
) -> NDArray[np.int32]:
    """(L, E) numbers of the examples of each leaf, -1 where it has fewer clips.

    Parameters
    ----------
    portions : of clips in the order of their contents: numbers (n,), categories (n,), leaves (n, n_trees).
    n_leaves : L.
    most : E.
    """
    kept = np.full((n_leaves, most), -1, np.int32)
    categories = np.full((n_leaves, most), -1, np.int32)
    for numbers, own, leaves in portions:
        kernels.keep_examples(numbers.astype(np.int32), own, np.ascontiguousarray(leaves), kept, categories)
    return kept
