"""Left and right that a network took for each other, put right view by view.

Seen from behind or from the side, networks exchange the legs, the arms or all of a person. For arms and for legs the
sequence of exchanges over all views is found that makes the rays of the views meet, the points move steadily, and
exchanges few (dynamic programming over time, after Viterbi 1967).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.multiview.known_values import known_mean, known_median, known_span
from dousa.estimation.multiview.landmarks import SeenLandmarks
from dousa.estimation.multiview.triangulation import meet, pixels_per_metre

GROUPS: tuple[tuple[str, ...], ...] = (
    ("shoulder", "elbow", "wrist", "hand"),
    ("hip", "knee", "ankle", "heel", "toe"),
)
_AT_ONCE = 5  # views whose exchanges are searched for together; of more, in turn
_SIGMA = 0.05  # m at the person's distance
_MOST = 9.0  # what a point can cost at most
_EXCHANGE = 1.0  # what an exchange costs in a frame, a point
_STEP = 0.05  # m that a point moves in a frame, one sigma; and at most so many sigmas count
_ROUNDS = 3
_LEAST_SEEN = 0.2


def repair_sides(cameras: Sequence[Camera], seen: SeenLandmarks) -> tuple[SeenLandmarks, BoolArray]:
    """Exchange left and right where the views say so.

    Parameters
    ----------
    cameras : (V,).
    seen : (V, T, L) landmarks.

    Returns
    -------
    The landmarks put right, and (V, T, G) where arms and legs (`GROUPS`) were exchanged.
    """
    n_views, n_frames = seen.points.shape[:2]
    exchanged = np.zeros((n_views, n_frames, len(GROUPS)), bool)
    scale = _measure_scale(cameras, seen)
    points, visibility, world = seen.points.copy(), seen.visibility.copy(), seen.world.copy()
    for group, kinds in enumerate(GROUPS):
        left = [row for row, name in enumerate(seen.names) if name in [f"left_{kind}" for kind in kinds]]
        right = [seen.names.index("right_" + seen.names[row][5:]) for row in left
                 if "right_" + seen.names[row][5:] in seen.names]  # fmt: skip
        if not left or len(right) != len(left):
            continue
        exchanged[..., group] = _search(cameras, seen, np.array(left), np.array(right), scale)
        for array in (points, visibility, world):
            there = np.nonzero(exchanged[..., group])
            own = array[there]
            crossed = own.copy()
            crossed[:, left], crossed[:, right] = own[:, right], own[:, left]
            array[there] = crossed
    return SeenLandmarks(seen.names, points, visibility, world), exchanged


def _measure_scale(cameras: Sequence[Camera], seen: SeenLandmarks) -> FloatArray:
    """(V, T) px a metre about the person: by where the rays of their middles meet, else by their height."""
    middles = known_mean(np.where(seen.visibility[..., None] > _LEAST_SEEN, seen.points, np.nan), axis=2)
    rays = [camera.compute_rays(np.nan_to_num(middle)) for camera, middle in zip(cameras, middles, strict=True)]
    places = [meet([rays[a], rays[b]]) for a, b in combinations(range(len(cameras)), 2)]
    scale = np.full(middles.shape[:2], np.nan)
    if places:
        place = known_median(np.stack(places), axis=0)
        scale = np.stack([pixels_per_metre(camera, place) for camera in cameras])
    spans = known_span(seen.points[..., 1], axis=2)
    known = known_median(scale, axis=1)[:, None]
    known = np.where(np.isfinite(known), known, known_median(spans, axis=1)[:, None] / 1.5)
    return np.where(np.isfinite(scale), scale, known)


def _search(
    cameras: Sequence[Camera], seen: SeenLandmarks, left: IndexArray, right: IndexArray, scale: FloatArray
) -> BoolArray:
    """(V, T) where the sides of one group are exchanged."""
    n_views, n_frames = scale.shape
    pairs = {
        pair: np.stack([_disagree(cameras, seen, pair, rows, (left, right), scale) for rows in
                        ((left, right), (right, left))], axis=1)
        for pair in combinations(range(n_views), 2)
    }  # fmt: skip
    moves = np.stack([_move(seen, view, left, right, scale) for view in range(n_views)])
    known = np.asarray((seen.visibility[:, :, left] > _LEAST_SEEN).any(axis=2))
    state = np.zeros((n_views, n_frames), np.intp)
    for _ in range(1 if n_views <= _AT_ONCE else _ROUNDS):
        for start in range(0, n_views, _AT_ONCE):
            block = list(range(start, min(start + _AT_ONCE, n_views)))
            state[block] = _decode(block, state, pairs, moves, known, len(left))
    return state.astype(bool)


def _disagree(
    cameras: Sequence[Camera],
    seen: SeenLandmarks,
    pair: tuple[int, int],
    rows: tuple[IndexArray, IndexArray],
    usual: tuple[IndexArray, IndexArray],
    scale: FloatArray,
) -> FloatArray:
    """(T,) how far the rays of two views pass each other, the one's ``usual`` points against the other's ``rows``."""
    total = np.zeros(seen.points.shape[1])
    for own, other in zip(usual, rows, strict=True):
        a, b = seen.points[pair[0]][:, own], seen.points[pair[1]][:, other]
        weight = np.minimum(seen.visibility[pair[0]][:, own], seen.visibility[pair[1]][:, other])
        flat = [array.reshape(-1, 2) for array in (a, b)]
        rays = [cameras[view].compute_rays(np.nan_to_num(points)) for view, points in zip(pair, flat, strict=True)]
        place = meet(rays)
        off = np.zeros(a.shape[:2])
        for view, points in zip(pair, (a, b), strict=True):
            error = np.linalg.norm(cameras[view].project(place).reshape(points.shape) - points, axis=-1)
            off += (error / (_SIGMA * scale[view][:, None])) ** 2
        off = np.where(np.isfinite(off), np.minimum(off, _MOST), _MOST)
        total += np.where(np.isfinite(a[..., 0]) & np.isfinite(b[..., 0]), weight * off, 0.0).sum(axis=1)
    return total


def _move(seen: SeenLandmarks, view: int, left: IndexArray, right: IndexArray, scale: FloatArray) -> FloatArray:
    """(T, 2) how far points move since the frame before, as they are and exchanged; nothing before the first."""
    moves = np.zeros((seen.points.shape[1], 2))
    points, visibility = seen.points[view], seen.visibility[view]
    for way, (one, other) in enumerate((((left, left), (right, right)), ((left, right), (right, left)))):
        for before, after in (one, other):
            off = np.linalg.norm(points[1:, after] - points[:-1, before], axis=-1) / (_STEP * scale[view, 1:, None])
            weight = np.minimum(visibility[1:, after], visibility[:-1, before])
            cost = np.where(np.isfinite(off), np.minimum(off**2, _MOST), 0.0)
            moves[1:, way] += (weight * cost).sum(axis=1)
    return moves


def _decode(
    block: list[int],
    state: IndexArray,
    pairs: dict[tuple[int, int], FloatArray],
    moves: FloatArray,
    known: BoolArray,
    n_points: int,
) -> IndexArray:
    """(B, T) the exchanges of some views, those of the others given."""
    n_frames = moves.shape[1]
    choices = np.array(np.meshgrid(*[(0, 1)] * len(block), indexing="ij")).reshape(len(block), -1)
    costs = np.zeros((n_frames, choices.shape[1]))
    frames = np.arange(n_frames)
    for (a, b), disagree in pairs.items():
        if a not in block and b not in block:
            continue
        for number in range(choices.shape[1]):
            one = choices[block.index(a), number] if a in block else state[a]
            other = choices[block.index(b), number] if b in block else state[b]
            costs[:, number] += disagree[frames, one ^ other]
    costs += _EXCHANGE * n_points * np.einsum("vt,vc->tc", known[block].astype(np.float64), choices)
    differ = choices[:, :, None] ^ choices[:, None, :]  # (B, C, C)
    total = costs[0].copy()
    origin = np.zeros(costs.shape, np.int64)
    for t in range(1, n_frames):
        turn = np.where(differ, moves[block, t, 1][:, None, None], moves[block, t, 0][:, None, None]).sum(axis=0)
        way = total[:, None] + turn
        origin[t] = way.argmin(axis=0)
        total = way.min(axis=0) + costs[t]
    best = np.zeros(n_frames, np.int64)
    best[-1] = int(total.argmin())
    for t in range(n_frames - 1, 0, -1):
        best[t - 1] = origin[t, best[t]]
    return np.asarray(choices[:, best])
