"""Compiled search: candidates of one joint axis are posed, projected, drawn and counted in one go.

The mismatch of eq. 2 is, for every reading, ``|minus| + |P & plus| - |P & minus|`` with P the pixels of the parts that
move and two bit images that do not depend on the candidate; see `fill_evidence`. Numbers of degrees of freedom: 0 to 2
place of the root, 3 to 5 turn of the root in its own axes, then the joint angles.

Arguments that come together in every function:

- ``model``: (tree, solids, subtrees, subtree_starts); ``tree`` as in `turn_part`, ``solids`` as in
  `outline_part`; the parts below part p, itself first, are
  ``subtrees[subtree_starts[p]:subtree_starts[p + 1]]``.
- ``views``: (cameras (V, 24), sizes (V, 2) width and height, seen (V,), silhouettes (V, H, words)).
- ``weights``: (reading, evidence, image, inertia, floor): the first two are places in `READINGS` and `EVIDENCES`,
  image is 1 / lambda per pixel, inertia the weight of log W, floor (3,) its height in m, 1 / sigma^2 and the most it
  may cost.
- ``reach``: (factor, half, stride): share of dR, candidates to either side, 1 for all of them or 2 for every other.
- ``bounds``: (spread (D,), ease (D, 2), limits (A, 2)): dR of each degree of freedom, neutral value and inverse
  stiffness, least and greatest angle.
- ``scratch``: see `SearchSetup.make_scratch`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.estimation.body.kinematics import hang_part, turn_part, turn_root
from dousa.estimation.raster.rasteriser import borrow, draw_intervals, outline_part, popcount

_ONES, _ONE, _WORD, _BIT = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(1), np.uint64(6), np.uint64(63)
_LEAST_WEIGHT = 1e-3  # W below this (beyond 2 dR) is out of reach


@njit(cache=True, nogil=True, forceinline=True)
def move_axis(pose, axis, amount):  # type: ignore[no-untyped-def]
    """Move a pose row along one degree of freedom, in place."""
    if axis < 3:
        pose[axis] += amount
    elif axis < 6:
        turn_root(
            pose,
            amount if axis == 3 else 0.0,
            amount if axis == 4 else 0.0,
            amount if axis == 5 else 0.0,
        )
    else:
        pose[axis + 1] += amount


@njit(cache=True, nogil=True, forceinline=True)
def place_parts(parts, n_turned, pose, tree, scratch):  # type: ignore[no-untyped-def]
    """Place parts, parents first, of which only the first ``n_turned`` have angles other than when last placed."""
    work, local, rotations, positions = scratch[7], scratch[12], scratch[5], scratch[6]
    for i in range(n_turned):
        turn_part(parts[i], pose, tree, work, local)
    for part in parts:
        hang_part(part, pose, tree, local, rotations, positions)


@njit(cache=True, nogil=True, forceinline=True)
def count_alone(plus, minus, low, high, first, last):  # type: ignore[no-untyped-def]
    """Bits of plus less bits of minus under the intervals of one part."""
    total = np.int64(0)
    for row in range(first, last):
        start, stop = np.uint64(low[row]), np.uint64(high[row])
        if low[row] > high[row]:
            continue
        a, b = start >> _WORD, stop >> _WORD
        head, tail = _ONES << (start & _BIT), _ONES >> (_BIT - (stop & _BIT))
        if a == b:  # most limbs lie in one word
            mask = head & tail
            total += np.int64(popcount(plus[row, a] & mask)) - np.int64(popcount(minus[row, a] & mask))
            continue
        for word in range(a, b + _ONE):
            mask = head if word == a else (tail if word == b else _ONES)
            total += np.int64(popcount(plus[row, word] & mask)) - np.int64(popcount(minus[row, word] & mask))
    return total


@njit(cache=True, nogil=True, forceinline=True)
def count_unseen(plus, minus, drawn, low, high, first, last):  # type: ignore[no-untyped-def]
    """The same for what is not yet in ``drawn``, which takes it up: several parts count each pixel once."""
    total = np.int64(0)
    for row in range(first, last):
        start, stop = np.uint64(low[row]), np.uint64(high[row])
        if low[row] > high[row]:
            continue
        a, b = start >> _WORD, stop >> _WORD
        head, tail = _ONES << (start & _BIT), _ONES >> (_BIT - (stop & _BIT))
        for word in range(a, b + _ONE):
            mask = _ONES
            if word == a:
                mask &= head
            if word == b:
                mask &= tail
            mask &= ~drawn[row, word]
            drawn[row, word] |= mask
            total += np.int64(popcount(plus[row, word] & mask)) - np.int64(popcount(minus[row, word] & mask))
    return total


@njit(cache=True, nogil=True, forceinline=True)
def count_parts(parts, model, views, plus, minus, scratch):  # type: ignore[no-untyped-def]
    """``|P & plus| - |P & minus|`` over all views, P the union of parts that have been placed."""
    cameras, sizes, seen = views[0], views[1], views[2]
    work, drawn, rotations, positions = scratch[0], scratch[1], scratch[5], scratch[6]
    low, high = work[2], work[3]
    total = np.int64(0)
    for view in range(len(cameras)):
        if not seen[view]:
            continue
        camera, ahead, behind = cameras[view], plus[view], minus[view]
        width, height = sizes[view, 0], sizes[view, 1]
        if len(parts) == 1:
            first, last = outline_part(parts[0], camera, width, height, model[1], rotations, positions, work)
            total += count_alone(ahead, behind, low, high, first, last)
            continue
        least, most = height, 0
        for part in parts:
            first, last = outline_part(part, camera, width, height, model[1], rotations, positions, work)
            if first < last:
                total += count_unseen(ahead, behind, drawn, low, high, first, last)
                least, most = min(least, first), max(most, last)
        for row in range(least, most):
            for word in range(drawn.shape[1]):
                drawn[row, word] = np.uint64(0)
    return total


@njit(cache=True, nogil=True)
def count_parts_apart(parts, model, views, plus, minus, scratch):  # type: ignore[no-untyped-def]
    """`count_parts` where a call costs little beside the rest, compiled once and not into every caller."""
    return count_parts(parts, model, views, plus, minus, scratch)


@njit(cache=True, nogil=True)
def draw_parts_into(bits, parts, model, views, scratch):  # type: ignore[no-untyped-def]
    """Add parts that have been placed to bits (V, H, words) of the views that are seen."""
    cameras, sizes = views[0], views[1]
    work = scratch[0]
    for view in range(len(cameras)):
        if not views[2][view]:
            continue
        for part in parts:
            first, last = outline_part(
                part, cameras[view], sizes[view, 0], sizes[view, 1], model[1], scratch[5], scratch[6], work
            )
            draw_intervals(bits[view], work[2], work[3], first, last)


@njit(cache=True, nogil=True)
def fill_evidence(reading, silhouettes, fixed, plus, minus):  # type: ignore[no-untyped-def]
    """The two images that tell the mismatch of any candidate, for each reading of eq. 2.

    The mismatch is the number of pixels of X xor P_c that count: X and what counts is, by reading, masked: S, outside
    P_fixed; residual: S minus P_fixed; union: S or P_fixed; plain: S; literal: S and P_fixed, as printed.
    """
    for view in range(silhouettes.shape[0]):
        for row in range(silhouettes.shape[1]):
            for word in range(silhouettes.shape[2]):
                s, f = silhouettes[view, row, word], fixed[view, row, word]
                if reading == 0:
                    plus[view, row, word], minus[view, row, word] = ~s & ~f, s & ~f
                else:
                    x = s
                    if reading == 1:
                        x = s & ~f
                    elif reading == 2:
                        x = s | f
                    elif reading == 4:
                        x = s & f
                    plus[view, row, word], minus[view, row, word] = ~x, x


@njit(cache=True, nogil=True)
def _count_bits(bits, mask, masked):  # type: ignore[no-untyped-def]
    total = np.int64(0)
    for view in range(bits.shape[0]):
        for row in range(bits.shape[1]):
            for word in range(bits.shape[2]):
                kept = bits[view, row, word] & mask[view, row, word] if masked else bits[view, row, word]
                total += np.int64(popcount(kept))
    return total


@njit(cache=True, nogil=True, forceinline=True)
def _find_lowest(parts, solids, scratch):  # type: ignore[no-untyped-def]
    """Height m of the lowest point of parts that have been placed."""
    spheres, starts = solids
    rotations, positions = scratch[5], scratch[6]
    lowest = 1e30
    for part in parts:
        for s in range(starts[part], starts[part + 1]):
            height = positions[part, 1] - spheres[s, 3]
            for k in range(3):
                height += rotations[part, 1, k] * spheres[s, k]
            lowest = min(lowest, height)
    return lowest


@njit(cache=True, nogil=True, forceinline=True)
def _price_floor(lowest, floor):  # type: ignore[no-untyped-def]
    """What it costs that the lowest point is off the floor; capped, so that people may jump."""
    off = lowest - floor[0]
    return min(floor[2], off * off * floor[1])


@njit(cache=True, nogil=True)
def sweep(pose, shift, order, whole, reach, weights, bounds, model, views, scratch):  # type: ignore[no-untyped-def]
    """One pass over the parts in ``order``, axis by axis; moves ``pose`` and ``shift``, its way from the prediction.

    Each axis takes the best of 2 ``half`` + 1 candidates within ``factor`` dR of where it is. With ``whole`` false a
    part is judged alone, before those already placed (the paper; the root, which has none before it, with the whole
    body as predicted); else it carries all parts below it, and all others stand still around them.
    """
    weights, bounds, model, views, scratch = borrow((weights, bounds, model, views, scratch))
    pose, shift, order = borrow((pose, shift, order))
    tree, subtrees, starts = model[0], model[2], model[3]
    n_parts = len(tree[0])
    place_parts(subtrees[:n_parts], n_parts, pose, tree, scratch)
    for part in order:
        n_axes = 6 if part == 0 else tree[3][part]
        if n_axes == 0:
            continue
        below = subtrees[starts[part] : starts[part + 1]]
        moved = below if whole or part == 0 else below[:1]
        fixed = select_fixed(part, n_parts if whole else part, below, scratch[9])
        scratch[4][:] = np.uint64(0)
        draw_parts_into(scratch[4], fixed, model, views, scratch)
        fill_evidence(weights[0], views[3], scratch[4], scratch[2], scratch[3])
        lowest = _find_lowest(fixed, model[1], scratch)
        first = 0 if part == 0 else 6 + tree[5][part]
        for axis in range(first, first + n_axes):
            best = _search_axis(axis, moved, lowest, pose, shift, reach, weights, bounds, model, views, scratch)
            amount = reach[0] * bounds[0][axis] * best / reach[1]
            move_axis(pose, axis, amount)
            shift[axis] += amount
        place_parts(below, 1, pose, tree, scratch)


@njit(cache=True, nogil=True)
def select_fixed(part, end, below, chosen):  # type: ignore[no-untyped-def]
    """The parts before ``end`` that do not hang on ``part``, as a view of ``chosen``."""
    count, place = 0, 0
    for q in range(end):
        while place < len(below) and below[place] < q:
            place += 1
        if place < len(below) and below[place] == q:
            continue
        chosen[count] = q
        count += 1
    return chosen[:count]


@njit(cache=True, nogil=True, forceinline=True)
def _search_axis(axis, moved, lowest, pose, shift, reach, weights, bounds, model, views, scratch):  # type: ignore[no-untyped-def]
    """Number (-half to half) of the best candidate of one axis.

    All candidates, or every other one and then the two beside the best: few axes hide a second hill between.
    """
    half, stride = reach[1], reach[2]
    scratch[11][: 2 * half + 1] = -np.inf
    if weights[1] == 1:
        scratch[4][:] = np.uint64(0)  # P_fixed has done its work: now what any candidate can reach
    best = 0
    for stage in range(stride):
        first, last = (-half, half) if stage == 0 else (max(-half, best - 1), min(half, best + 1))
        step = stride if stage == 0 else 1
        for k in range(first, last + 1, step):
            if scratch[11][k + half] == -np.inf:
                _try_candidate(k, axis, moved, lowest, pose, shift, reach, weights, bounds, model, views, scratch)
        best = _choose(half, weights, scratch)
    return best


@njit(cache=True, nogil=True, forceinline=True)
def _try_candidate(k, axis, moved, lowest, pose, shift, reach, weights, bounds, model, views, scratch):  # type: ignore[no-untyped-def]
    """Mismatch and prior of candidate k of an axis; out of reach it keeps the prior -inf."""
    spread, limits = bounds[0], bounds[2]
    trial = scratch[8]
    amount = reach[0] * spread[axis] * k / reach[1]
    off = (shift[axis] + amount) / spread[axis]
    w = 1.0 - 0.25 * off * off
    if w <= _LEAST_WEIGHT and k != 0:
        return
    if axis >= 6 and k != 0:
        angle = pose[axis + 1] + amount
        if angle < limits[axis - 6, 0] or angle > limits[axis - 6, 1]:
            return
    trial[:] = pose
    move_axis(trial, axis, amount)
    place_parts(moved, 1, trial, model[0], scratch)
    prior = weights[3] * np.log(max(w, _LEAST_WEIGHT)) - _price_strain(axis, trial, bounds[1])
    if weights[4][1] > 0.0:
        prior -= _price_floor(min(lowest, _find_lowest(moved, model[1], scratch)), weights[4])
    scratch[10][k + reach[1]] = count_parts(moved, model, views, scratch[2], scratch[3], scratch)
    scratch[11][k + reach[1]] = prior
    if weights[1] == 1:
        draw_parts_into(scratch[4], moved, model, views, scratch)


@njit(cache=True, nogil=True)
def _choose(half, weights, scratch):  # type: ignore[no-untyped-def]
    """The best of the candidates tried so far; the nearer one where two are equal."""
    evidence, mismatches, priors = weights[1], scratch[10], scratch[11]
    ground = 0.0
    if evidence > 0:
        ground = float(_count_bits(scratch[3], scratch[4], evidence == 1))
    best, best_score = 0, -np.inf
    for k in range(-half, half + 1):
        if priors[k + half] == -np.inf:
            continue
        mismatch = mismatches[k + half]
        image = -weights[2] * mismatch if evidence == 0 else -np.log(1.0 + max(0.0, ground + mismatch))
        score = image + priors[k + half]
        if score > best_score + 1e-12 or (score > best_score - 1e-12 and abs(k) < abs(best)):
            best, best_score = k, score
    return best


@njit(cache=True, nogil=True, forceinline=True)
def _price_strain(axis, pose, ease):  # type: ignore[no-untyped-def]
    """What it costs to hold an angle away from where the joint is at ease."""
    if axis < 6:
        return 0.0
    strain = (pose[axis + 1] - ease[axis, 0]) * ease[axis, 1]
    return strain * strain


@njit(cache=True, nogil=True)
def score_pose(pose, shift, weights, bounds, model, views, scratch):  # type: ignore[no-untyped-def]
    """Log score of a whole pose: image, inertia, ease and floor, up to a constant that all poses of a frame share."""
    weights, bounds, model, views, scratch = borrow((weights, bounds, model, views, scratch))
    pose, shift = borrow((pose, shift))
    tree = model[0]
    n_parts = len(tree[0])
    every = model[2][:n_parts]  # the subtree of the root
    place_parts(every, n_parts, pose, tree, scratch)
    scratch[4][:] = np.uint64(0)
    fill_evidence(0, views[3], scratch[4], scratch[2], scratch[3])
    score = -weights[2] * count_parts_apart(every, model, views, scratch[2], scratch[3], scratch)
    for axis in range(len(shift)):
        off = shift[axis] / bounds[0][axis]
        score += weights[3] * np.log(max(_LEAST_WEIGHT, 1.0 - 0.25 * off * off)) - _price_strain(axis, pose, bounds[1])
    if weights[4][1] > 0.0:
        score -= _price_floor(_find_lowest(every, model[1], scratch), weights[4])
    return score
