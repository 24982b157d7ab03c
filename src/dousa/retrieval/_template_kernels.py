"""Dynamic time warping over small matrices: what motion templates spend their time in.

Steps are (1, 1), (1, 0) and (0, 1). Where two predecessors cost the same the diagonal wins, then the step
along the motion.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["merge_along_path", "warped_costs"]

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _accumulate(reference: Array, motion_by_feature: Array) -> Array:
    """(K, L) cost of the best path that ends in each pair of frames; local costs are Manhattan distances."""
    n_reference, n_features = reference.shape
    n_motion = motion_by_feature.shape[1]
    total = np.zeros((n_reference, n_motion))
    for i in range(n_reference):
        row = total[i]
        for f in range(n_features):
            here = reference[i, f]
            there = motion_by_feature[f]
            for j in range(n_motion):
                row[j] += abs(here - there[j])
        if i == 0:
            for j in range(1, n_motion):
                row[j] += row[j - 1]
        else:
            above = total[i - 1]
            row[0] += above[0]
            for j in range(1, n_motion):
                row[j] += min(above[j - 1], above[j], row[j - 1])
    return total


@njit(cache=True, nogil=True)
def merge_along_path(reference: Array, motion_by_feature: Array, values: Array, weights: Array) -> float:
    """Warp a motion to a reference and add it to the reference's running sums.

    Parameters
    ----------
    reference : (K, F).
    motion_by_feature : (F, L), the motion transposed, so that the inner loop runs over memory in order.
    values : (K, F), increased by weight x motion frame for every pair on the best path.
    weights : (K,), increased by the weights. A motion frame that meets n reference frames gives each 1/n, so
        a motion adds L in all.

    Returns
    -------
    Cost of the best path.
    """
    total = _accumulate(reference, motion_by_feature)
    i = len(total) - 1
    for j in range(total.shape[1] - 1, -1, -1):
        last = i  # motion frame j meets the reference frames i..last
        while i > 0 and (j == 0 or total[i - 1, j] < min(total[i, j - 1], total[i - 1, j - 1])):
            i -= 1
        share = 1.0 / (last - i + 1)
        for k in range(i, last + 1):
            weights[k] += share
            for f in range(reference.shape[1]):
                values[k, f] += share * motion_by_feature[f, j]
        if i > 0 and total[i - 1, j - 1] <= total[i, j - 1]:
            i -= 1
    return total[-1, -1]


@njit(cache=True, nogil=True)
def warped_costs(costs: Array, bounds: NDArray[np.intp]) -> Array:
    """Cost of the best warping of one motion to each of several templates.

    Parameters
    ----------
    costs : (sum of template lengths, L) local cost of every template frame against every motion frame.
    bounds : (C + 1,) where each template starts in ``costs``.

    Returns
    -------
    (C,) cost along the best path; diagonal steps count twice, so that every path has weight K + L, by which
    the sum is divided.
    """
    n_motion = costs.shape[1]
    answer = np.empty(len(bounds) - 1)
    row = np.empty(n_motion)
    for c in range(len(bounds) - 1):
        start, stop = bounds[c], bounds[c + 1]
        row[0] = 2.0 * costs[start, 0]
        for j in range(1, n_motion):
            row[j] = row[j - 1] + costs[start, j]
        for i in range(start + 1, stop):
            diagonal = row[0]
            row[0] += costs[i, 0]
            for j in range(1, n_motion):
                cost = costs[i, j]
                best = min(diagonal + cost, row[j], row[j - 1]) + cost
                diagonal = row[j]
                row[j] = best
        answer[c] = row[n_motion - 1] / (stop - start + n_motion)
    return answer
