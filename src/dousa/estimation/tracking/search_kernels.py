"""The compiled search: candidates of one joint axis are posed, projected, drawn and counted together.

For every reading the mismatch of eq. 2 is ``|minus| + |P & plus| - |P & minus|`` with P the pixels of the moving parts
and two bit images independent of the candidate; see `fill_evidence`. Degrees of freedom: 0 to 2 place of the root,
3 to 5 turn of the root in its own axes, then the joint angles. Common arguments:

- ``model``: (tree, solids, subtrees, subtree_starts); ``tree`` as in `turn_part`, ``solids`` as in `outline_part`; the
  parts below part p, itself first, are ``subtrees[subtree_starts[p]:subtree_starts[p + 1]]``.
- ``views``: (cameras (V, 24), sizes (V, 2) width and height, seen (V,), silhouettes (V, H, words), and likewise pixels
  that do not count in the score of a whole pose).
- ``weights``: (reading, evidence, image, inertia): indices into `READINGS` and `EVIDENCES`, 1 / lambda per pixel, and
  weight of log W.
- ``reach``: (factor, half, stride): share of dR, candidates to either side, 1 for all of them or 2 for every other.
- ``bounds``: (spread (D,), ease (D, 2), limits (A, 2)): dR, neutral value and inverse stiffness, angle limits.
- ``scratch``: see `SearchSetup.make_scratch`.
"""

from __future__ import annotations

import numpy as np

from dousa.estimation.body.kinematics import hang_parts, turn_root
from dousa.estimation.raster.rasteriser import draw_intervals, outline_part, popcount
from dousa.kernels import kernel, part

_ONES, _ONE, _WORD, _BIT = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(1), np.uint64(6), np.uint64(63)
_ONE_PART, _MASKED = np.int64(1), np.int64(0)  # numbers as such would have the kernels compiled once more for them


@part
def move_axis(pose, axis, amount):  # type: ignore[no-untyped-def]
    """Move a pose row along one degree of freedom, in place."""
    if axis < 3:
        pose[axis] += amount
    elif axis < 6:
        x = amount if axis == 3 else 0.0
        y = amount if axis == 4 else 0.0
        turn_root(pose, x, y, amount if axis == 5 else 0.0)
    else:
        pose[axis + 1] += amount


@part
def place_parts(parts, n_turned, pose, tree, scratch):  # type: ignore[no-untyped-def]
    """Call `hang_parts` with the scratch."""
    hang_parts(parts, n_turned, pose, tree, scratch[12], scratch[5], scratch[6])


@part
def count_alone(plus, minus, low, high, first, last):  # type: ignore[no-untyped-def]
    """Count bits of plus less bits of minus under the intervals of one part."""
    total = np.int64(0)
    for row in range(first, last):
        if low[row] > high[row]:
            continue
        start, stop = np.uint64(low[row]), np.uint64(high[row])
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


@part
def count_unseen(plus, minus, drawn, low, high, first, last):  # type: ignore[no-untyped-def]
    """Count as `count_alone`, but only pixels not yet in ``drawn``, which are added to it."""
    total = np.int64(0)
    for row in range(first, last):
        if low[row] > high[row]:
            continue
        start, stop = np.uint64(low[row]), np.uint64(high[row])
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


@part
def count_parts(parts, model, views, plus, minus, scratch, spare):  # type: ignore[no-untyped-def]
    """Compute ``|P & plus| - |P & minus|`` over all views, P the union of placed parts.

    ``scratch[7]`` has ``-|minus|`` of each view, the least that it can add. Counting stops once the result must exceed
    ``spare``; the returned bound then exceeds it too.
    """
    cameras, sizes, seen = views[0], views[1], views[2]
    work, drawn, rotations, positions, least = scratch[0], scratch[1], scratch[5], scratch[6], scratch[7]
    low, high, alone = work[2], work[3], len(parts) == 1
    total = np.int64(0)
    for view in range(len(cameras)):
        total += least[view] if seen[view] else 0
    for view in range(len(cameras)):
        if not seen[view]:
            continue
        if total > spare:
            break
        total -= least[view]
        camera, ahead, behind = cameras[view], plus[view], minus[view]
        width, height = sizes[view, 0], sizes[view, 1]
        top, bottom = height, 0
        for i in range(len(parts)):
            first, last = outline_part(parts[i], camera, width, height, model[1], rotations, positions, work)
            if alone:
                total += count_alone(ahead, behind, low, high, first, last)
            elif first < last:
                total += count_unseen(ahead, behind, drawn, low, high, first, last)
                top = first if first < top else top
                bottom = last if last > bottom else bottom
        for row in range(top, bottom):
            for word in range(drawn.shape[1]):
                drawn[row, word] = np.uint64(0)
    return total


@part
def draw_parts_into(bits, parts, model, views, scratch):  # type: ignore[no-untyped-def]
    """Add placed parts to bits (V, H, words) of the views that are seen."""
    cameras, sizes = views[0], views[1]
    work = scratch[0]
    for view in range(len(cameras)):
        if not views[2][view]:
            continue
        for i in range(len(parts)):
            first, last = outline_part(
                parts[i], cameras[view], sizes[view, 0], sizes[view, 1], model[1], scratch[5], scratch[6], work
            )
            draw_intervals(bits[view], work[2], work[3], first, last)


@part
def clear_bits(bits):  # type: ignore[no-untyped-def]
    """Unset all bits (V, H, words)."""
    for view in range(bits.shape[0]):
        for row in range(bits.shape[1]):
            for word in range(bits.shape[2]):
                bits[view, row, word] = np.uint64(0)


@part
def fill_evidence(reading, silhouettes, fixed, plus, minus, least):  # type: ignore[no-untyped-def]
    """Fill ``plus``, ``minus`` and ``least`` (-|minus| of each view) for a reading of eq. 2.

    The mismatch is the number of pixels of X xor P_c that count: X and what counts is, by reading, masked: S, outside
    P_fixed; residual: S minus P_fixed; union: S or P_fixed; plain: S; literal: S and P_fixed, as printed.
    """
    for view in range(silhouettes.shape[0]):
        total = np.int64(0)
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
                total += np.int64(popcount(minus[view, row, word]))
        least[view] = -total


@part
def _count_bits(bits, mask, masked):  # type: ignore[no-untyped-def]
    total = np.int64(0)
    for view in range(bits.shape[0]):
        for row in range(bits.shape[1]):
            for word in range(bits.shape[2]):
                kept = bits[view, row, word] & mask[view, row, word] if masked else bits[view, row, word]
                total += np.int64(popcount(kept))
    return total


@kernel
def sweep(pose, shift, order, whole, reach, weights, bounds, model, views, scratch, widths):  # type: ignore[no-untyped-def]
    """Run one pass over the parts in ``order``, axis by axis, and return the log score of the whole pose.

    Moves ``pose`` and ``shift``, its way from the prediction. Each axis takes the best of 2 ``half`` + 1 candidates
    within ``factor`` dR. With ``whole`` false a part is judged alone, before those already placed (the paper; the root
    with the whole body as predicted); else it carries all parts below it, and all others stay.

    If ``widths`` (D, 2) is not empty, it is filled instead, and nothing moves: how far each axis moves down and up
    before the image score drops by one. It is one kernel, as nearly all of the code to compile is the same.
    """
    tree, subtrees, starts = model[0], model[2], model[3]
    n_parts, half = len(tree[0]), reach[1]
    place_parts(subtrees[:n_parts], n_parts, pose, tree, scratch)
    for i in range(len(order)):
        part = order[i]
        n_axes = 6 if part == 0 else tree[3][part]
        below = subtrees[starts[part] : starts[part + 1]]
        moved = below if whole or part == 0 else below[:1]
        others, above = subtrees[: n_parts if whole else part], tree[0][part]
        if whole and i > 0 and order[i - 1] == above and weights[1] != 1:  # its parent's P_fixed is still drawn
            others = subtrees[starts[above] : starts[above + 1]]
        else:
            clear_bits(scratch[4])
        fixed = scratch[9][: select_fixed(others, below, scratch[9])]
        draw_parts_into(scratch[4], fixed, model, views, scratch)
        fill_evidence(weights[0], views[3], scratch[4], scratch[2], scratch[3], scratch[7])
        first = 0 if part == 0 else 6 + tree[5][part]
        if len(widths) > 0:
            _measure_axes(first, first + n_axes, moved, pose, weights, bounds, model, views, scratch, widths)
            place_parts(below, _ONE_PART, pose, tree, scratch)
            continue
        known = np.inf  # no number of pixels
        for axis in range(first, first + n_axes):
            best = _search_axis(axis, moved, known, pose, shift, reach, weights, bounds, model, views, scratch)
            amount = reach[0] * bounds[0][axis] * best / half
            move_axis(pose, axis, amount)
            shift[axis] += amount
            known = scratch[10][best + half]
        place_parts(below, _ONE_PART, pose, tree, scratch)
    return _score(pose, shift, weights, bounds, model, views, scratch) if len(widths) == 0 else 0.0


@part
def _measure_axes(first, end, moved, pose, weights, bounds, model, views, scratch, widths):  # type: ignore[no-untyped-def]
    """Fill ``widths`` of axes with dR / 32, / 8 or / 2, or 0."""
    trial, reach = scratch[8], bounds[0]
    allowed = count_parts(moved, model, views, scratch[2], scratch[3], scratch, np.inf) + 1.0 / weights[2]
    for axis in range(first, end):
        for side in range(2):
            amount = reach[axis] / 32.0
            while amount <= reach[axis]:
                for number in range(len(pose)):
                    trial[number] = pose[number]
                move_axis(trial, axis, amount if side == 1 else -amount)
                place_parts(moved, _ONE_PART, trial, model[0], scratch)
                if count_parts(moved, model, views, scratch[2], scratch[3], scratch, allowed) > allowed:
                    break
                widths[axis, side] = amount
                amount *= 4.0


@part
def select_fixed(others, below, chosen):  # type: ignore[no-untyped-def]
    """Write those of ``others`` that are not in ``below``, both rising, into ``chosen`` and return their number."""
    count, place = np.int64(0), np.int64(0)
    for q in others:
        inside = place < len(below) and below[place] == q
        chosen[count] = q  # the next one overwrites it if it is inside
        place, count = place + inside, count + (not inside)
    return count


@part
def _search_axis(axis, moved, known, pose, shift, reach, weights, bounds, model, views, scratch):  # type: ignore[no-untyped-def]
    """Return the number (-half to half) of the best candidate of one axis.

    Tries all candidates, or every other one and then the neighbours of the best. The middle comes first, as it is
    mostly the best; a candidate that cannot win is dropped early. ``known`` is the mismatch of the middle, if counted.
    """
    half, stride, priors, trial = reach[1], reach[2], scratch[11], scratch[8]
    for k in range(2 * half + 1):
        priors[k] = -np.inf
    if weights[1] == 1:
        clear_bits(scratch[4])  # P_fixed has done its work: now what any candidate can reach
    best, best_score = 0, -np.inf
    for stage in range(stride):
        for n in range(2 * half + 1):
            k = (n + 1) // 2 if n % 2 == 0 else -((n + 1) // 2)
            wanted = (k + half) % stride == 0 if stage == 0 else abs(k - best) <= 1
            if not wanted or priors[k + half] != -np.inf:
                continue
            amount = reach[0] * bounds[0][axis] * k / half
            prior = _weigh(k, axis, amount, pose, shift, weights, bounds)
            if prior == -np.inf:
                continue
            settled = k == 0 and known < np.inf and weights[1] != 1
            if not settled:
                for number in range(len(pose)):
                    trial[number] = pose[number]
                move_axis(trial, axis, amount)
                place_parts(moved, _ONE_PART, trial, model[0], scratch)
                # beyond rounding errors: equal candidates are counted to the end
                spare = np.inf if weights[1] > 0 else (prior - best_score + 1e-6) / weights[2]
                found = count_parts(moved, model, views, scratch[2], scratch[3], scratch, spare)
                if found > spare:
                    continue
                scratch[10][k + half] = found
                if weights[1] == 1:
                    draw_parts_into(scratch[4], moved, model, views, scratch)
            else:
                scratch[10][k + half] = known
            priors[k + half] = prior
            score = prior - weights[2] * scratch[10][k + half]
            best_score = score if score > best_score else best_score
        best = _choose(half, weights, scratch)
    return best


@part
def _weigh_inertia(off):  # type: ignore[no-untyped-def]
    """Compute W (eq. 3) of a candidate ``off`` dR from the prediction; 0.001 where less, from nearly 2 dR on."""
    w = 1.0 - 0.25 * off * off
    return w if w > 1e-3 else 1e-3


@part
def _weigh(k, axis, amount, pose, shift, weights, bounds):  # type: ignore[no-untyped-def]
    """Compute inertia and ease of candidate k of an axis; -inf where it is out of reach."""
    spread, ease, limits = bounds
    w = _weigh_inertia((shift[axis] + amount) / spread[axis])
    if k != 0 and w <= 1e-3:
        return -np.inf
    price = 0.0
    if axis >= 6:
        angle = pose[axis + 1] + amount
        if k != 0 and (angle < limits[axis - 6, 0] or angle > limits[axis - 6, 1]):
            return -np.inf
        price = _price_strain(axis, angle, ease)
    return weights[3] * np.log(w) - price


@part
def _choose(half, weights, scratch):  # type: ignore[no-untyped-def]
    """Return the best candidate so far; the nearer one where two are equal."""
    evidence, mismatches, priors = weights[1], scratch[10], scratch[11]
    ground = 0.0
    if evidence > 0:
        ground = float(_count_bits(scratch[3], scratch[4], evidence == 1))
    best, best_score = 0, -np.inf
    for k in range(-half, half + 1):
        if priors[k + half] == -np.inf:
            continue
        mismatch = mismatches[k + half]
        image = (
            -weights[2] * mismatch
            if evidence == 0
            else -np.log(1.0 + (ground + mismatch if ground + mismatch > 0.0 else 0.0))
        )
        score = image + priors[k + half]
        if score > best_score + 1e-12 or (score > best_score - 1e-12 and abs(k) < abs(best)):
            best, best_score = k, score
    return best


@part
def _price_strain(axis, angle, ease):  # type: ignore[no-untyped-def]
    """Compute the cost of an angle away from its neutral value."""
    strain = (angle - ease[axis, 0]) * ease[axis, 1]
    return strain * strain


@part
def _score(pose, shift, weights, bounds, model, views, scratch):  # type: ignore[no-untyped-def]
    """Compute the log score of a whole pose: image, inertia and ease, up to a constant of the frame."""
    n_parts = len(model[0][0])
    every = model[2][:n_parts]  # the subtree of the root
    place_parts(every, n_parts, pose, model[0], scratch)
    fill_evidence(_MASKED, views[3], views[4], scratch[2], scratch[3], scratch[7])
    score = -weights[2] * count_parts(every, model, views, scratch[2], scratch[3], scratch, np.inf)
    for axis in range(len(shift)):
        score += weights[3] * np.log(_weigh_inertia(shift[axis] / bounds[0][axis]))
        if axis >= 6:
            score -= _price_strain(axis, pose[axis + 1], bounds[1])
    return score
