"""People matched across views, and corrected exchanges of left and right.

People whose rays meet in all frames are one person (epipolar geometry). From behind or from the side, networks
exchange legs, arms or the whole person. For arms and for legs the sequence of exchanges over all views is found that
makes the rays meet and the points move steadily with few exchanges (dynamic programming over time, after Viterbi 1967).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.keypoints.keypoints import PersonTrack
from dousa.estimation.multiview.landmarks import SeenLandmarks, find_sources
from dousa.estimation.multiview.triangulation import known_mean, known_median, known_span, meet, pixels_per_metre

_SAME = 0.12  # m between the rays of one person's points, in the middle of points and frames
_MOST_FRAMES = 80
_LEAST_FRAMES = 3
_TOGETHER = 0.05  # share of frames that two tracks of one view may share and still be one person's
_LEAST_VISIBLE = 0.3
_TRUNK = (0.2, 0.9)  # m from the hips to the shoulders
_SHORT = 0.1  # of the longest track's frames: shorter ones are no people


Node = tuple[int, int]
"""A view, and the number of a person in it."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPerson:
    """One person in all views.

    Parameters
    ----------
    tracks : (V,) None where a view does not show the person.
    members : (V,) numbers of this person among the people of each view.
    """

    tracks: tuple[PersonTrack | None, ...]
    members: tuple[tuple[int, ...], ...]

    @property
    def seen(self) -> float:
        """Sum of visibilities; a tenth of it if only one of several views shows the person."""
        shown = [float(track.visibility.sum()) for track in self.tracks if track is not None]
        return sum(shown) if len(shown) > 1 or len(self.tracks) == 1 else 0.1 * sum(shown)


def match_people(
    cameras: Sequence[Camera], views: Sequence[Sequence[PersonTrack]], names: Sequence[str]
) -> tuple[MatchedPerson, ...]:
    """Match the people of several views, most seen first.

    Every two people of two views propose a person in space; matching people of other views join. The best proposal with
    most views becomes a person; then the next among the rest.

    Parameters
    ----------
    cameras : (V,).
    views : (V,) people of each view, of T frames at the same moments.
    names : (K,) of the keypoints.
    """
    rows = [row for sources in find_sources(names).values() for row in sources[:1]]
    nodes = [(view, number) for view, people in enumerate(views) for number in range(len(people))]
    longest = max((int(views[v][n].present.sum()) for v, n in nodes), default=0)
    left = [(v, n) for v, n in nodes if views[v][n].present.sum() >= max(_SHORT * longest, 1)]
    groups: list[list[Node]] = []
    while left:
        proposals = [_propose(cameras, views, names, rows, left, pair) for pair in combinations(left, 2)
                     if pair[0][0] != pair[1][0]]  # fmt: skip
        found = [proposal for proposal in proposals if proposal is not None]
        if not found:
            groups += [[node] for node in left]
            break
        best = min(found, key=lambda pair: (-len({view for view, _ in pair[0]}), -len(pair[0]), pair[1]))[0]
        groups.append(best)
        left = [node for node in left if node not in best]
    people = [_merge(group, views) for group in groups]
    return tuple(sorted(people, key=lambda person: -person.seen))


def _propose(
    cameras: Sequence[Camera],
    views: Sequence[Sequence[PersonTrack]],
    names: Sequence[str],
    rows: Sequence[int],
    left: Sequence[Node],
    pair: tuple[Node, Node],
) -> tuple[list[Node], float] | None:
    """Return the members of a proposed person and their mean error in metres; None if the pair is not one person."""
    (v, i), (w, j) = pair
    one, other = views[v][i], views[w][j]
    common = np.flatnonzero(one.present & other.present)
    if len(common) < min(_LEAST_FRAMES, one.n_frames):
        return None
    common = common[np.unique(np.linspace(0, len(common) - 1, _MOST_FRAMES).astype(int))]
    pick = np.ix_(common, rows)
    flat = [track.points[pick].reshape(-1, 2) for track in (one, other)]
    good = np.minimum(one.visibility[pick], other.visibility[pick]).ravel() > _LEAST_VISIBLE
    place = meet([camera.compute_rays(np.where(good[:, None], own, 0.0)) for camera, own in
                  zip((cameras[v], cameras[w]), flat, strict=True)])  # fmt: skip
    place[~good] = np.nan
    place = place.reshape(len(common), len(rows), 3)
    offs = [_distance(cameras[view], views[view][number], place, pick) for view, number in pair]
    if not max(offs) < _SAME or not _is_body(place, [names[row] for row in rows]):
        return None
    members: list[Node] = list(pair)
    others = [(_distance(cameras[view], views[view][number], place, pick), (view, number))
              for view, number in left if (view, number) not in pair]  # fmt: skip
    for off, (view, number) in sorted(others):
        if off < _SAME and not any(_overlap(views[view][number], views[view][n]) for u, n in members if u == view):
            members.append((view, number))
            offs.append(off)
    return members, float(np.mean(offs))


def _distance(camera: Camera, track: PersonTrack, place: FloatArray, pick: tuple[IndexArray, ...]) -> float:
    """Compute the median error (m) of points of space in a view; infinite where they are not seen."""
    points, visibility = track.points[pick], track.visibility[pick]
    off = np.linalg.norm(camera.project(place) - points, axis=-1) / pixels_per_metre(camera, place)
    known = np.isfinite(points[..., 0]) & (visibility > _LEAST_VISIBLE) & np.isfinite(place[..., 0])
    if known.sum() < 3 * min(_LEAST_FRAMES, track.n_frames):
        return float("inf")
    return float(np.median(np.where(np.isfinite(off[known]), off[known], np.inf)))


def _overlap(one: PersonTrack, other: PersonTrack) -> bool:
    """Return whether two tracks of one view coexist, so that they are two people."""
    both = (one.present & other.present).sum()
    return bool(both > _TOGETHER * max(1, min(one.present.sum(), other.present.sum())))


def _is_body(place: FloatArray, names: Sequence[str]) -> bool:
    """Return whether the trunk has a plausible length, as rays of two people can meet in empty space."""
    wanted = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    if not set(wanted) <= set(names):
        return True
    left_top, right_top, left_low, right_low = (place[:, names.index(name)] for name in wanted)
    lengths = 0.5 * np.linalg.norm(left_top + right_top - left_low - right_low, axis=1)
    known = lengths[np.isfinite(lengths)]
    return len(known) == 0 or bool(_TRUNK[0] < np.median(known) < _TRUNK[1])


def _merge(nodes: Sequence[tuple[int, int]], views: Sequence[Sequence[PersonTrack]]) -> MatchedPerson:
    tracks: list[PersonTrack | None] = []
    members = []
    for view, people in enumerate(views):
        own = sorted(number for v, number in nodes if v == view)
        members.append(tuple(own))
        tracks.append(_join([people[number] for number in own]) if own else None)
    return MatchedPerson(tuple(tracks), tuple(members))


def _join(tracks: Sequence[PersonTrack]) -> PersonTrack:
    """Join tracks of one person in one view."""
    if len(tracks) == 1:
        return tracks[0]
    chosen = np.stack([np.where(track.present, track.visibility.sum(axis=1), -1.0) for track in tracks]).argmax(axis=0)
    frames = np.arange(len(chosen))

    def take(arrays: Sequence[FloatArray]) -> FloatArray:
        return np.asarray(np.stack(arrays)[chosen, frames])

    worlds = [np.full((*track.points.shape[:2], 3), np.nan) if track.world is None else track.world for track in tracks]
    return PersonTrack(take([one.points for one in tracks]), take([one.visibility for one in tracks]), take(worlds))


def resample_track(track: PersonTrack, times: FloatArray, moments: FloatArray) -> PersonTrack:
    """Resample a track at other moments by linear interpolation, without masks.

    A point is not seen where either neighbouring frame lacks it, and outside the film.

    Parameters
    ----------
    track : of frames at ``times``.
    times : (T,) s, rising.
    moments : (S,) s.
    """
    after = np.clip(np.searchsorted(times, moments), 1, max(len(times) - 1, 1))
    before = after - 1
    if len(times) == 1:
        after = before = np.zeros(len(moments), int)
    span = np.where(after > before, times[after] - times[before], 1.0)
    share = np.clip((moments - times[before]) / span, 0.0, 1.0)
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    outside = (moments < times[0] - 0.5 * step) | (moments > times[-1] + 0.5 * step)

    def mix(array: FloatArray) -> FloatArray:
        part = share.reshape(-1, *[1] * (array.ndim - 1))
        # a frame that is hit exactly does not need the one beside it
        mixed = np.where(part == 0, array[before], np.where(part == 1, array[after],
                         (1.0 - part) * array[before] + part * array[after]))  # fmt: skip
        mixed[outside] = np.nan
        return np.asarray(mixed)

    points = mix(track.points)
    visibility = np.nan_to_num(np.clip(mix(track.visibility), 0.0, 1.0))
    return PersonTrack(points, visibility, None if track.world is None else mix(track.world))


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
    """Exchange left and right where the views require it.

    Returns the corrected landmarks, and (V, T, G) where arms and legs (`GROUPS`) were exchanged.

    Parameters
    ----------
    cameras : (V,).
    seen : (V, T, L) landmarks.
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
    """Compute (V, T) px per metre at the person, from where the rays of the middles meet, else from the height."""
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
    """Find (V, T) where the sides of one group are exchanged."""
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
    """Compute (T,) the distance of two views' rays, ``usual`` points of the first against ``rows`` of the second."""
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
    """Compute (T, 2) the movement since the frame before, unchanged and exchanged; 0 in the first."""
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
    """Find (B, T) the exchanges of some views, with those of the others given."""
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
