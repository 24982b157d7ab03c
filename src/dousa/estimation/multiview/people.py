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
from dousa.estimation.multiview.triangulation import meet, pixels_per_metre, reduce_known

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


@dataclass(frozen=True, slots=True, eq=False)
class PeopleMatching:
    """The people of several views, and what makes two of them one person.

    Parameters
    ----------
    cameras : (V,).
    views : (V,) people of each view, of T frames at the same moments.
    names : (K,) of the keypoints.
    same : m between the rays of one person's points, in the middle of points and frames.
    visible : least visibility of points that count.
    most_frames, least_frames : that both people are seen in and that are looked at.
    together : share of frames that two tracks of one view may share and still be one person's.
    trunk : m from the hips to the shoulders, at least and at most, as rays of two people can meet in empty space.
    """

    cameras: Sequence[Camera]
    views: Sequence[Sequence[PersonTrack]]
    names: Sequence[str]
    same: float = 0.12
    visible: float = 0.3
    most_frames: int = 80
    least_frames: int = 3
    together: float = 0.05
    trunk: tuple[float, float] = (0.2, 0.9)

    def propose(self, left: Sequence[Node], pair: tuple[Node, Node]) -> tuple[list[Node], float] | None:
        """Return the members of a proposed person and their mean error (m); None if the pair is not one person."""
        tracks = [self.views[view][number] for view, number in pair]
        common = np.flatnonzero(tracks[0].present & tracks[1].present)
        if len(common) < min(self.least_frames, tracks[0].n_frames):
            return None
        common = common[np.unique(np.linspace(0, len(common) - 1, self.most_frames).astype(int))]
        rows = [row for row, *_ in find_sources(self.names).values()]
        pick = np.ix_(common, rows)
        good = np.minimum(*(track.visibility[pick] for track in tracks)).ravel() > self.visible
        place = meet([self.cameras[view].compute_rays(np.where(good[:, None], track.points[pick].reshape(-1, 2), 0.0))
                      for (view, _), track in zip(pair, tracks, strict=True)])  # fmt: skip
        place[~good] = np.nan
        place = place.reshape(len(common), len(rows), 3)
        offs = [self._distance(node, place, pick) for node in pair]
        if not max(offs) < self.same or not self._is_body(place, [self.names[row] for row in rows]):
            return None
        members: list[Node] = list(pair)
        for off, node in sorted((self._distance(node, place, pick), node) for node in left if node not in pair):
            if off < self.same and not any(self._overlap(node, other) for other in members if other[0] == node[0]):
                members.append(node)
                offs.append(off)
        return members, float(np.mean(offs))

    def _distance(self, node: Node, place: FloatArray, pick: tuple[IndexArray, ...]) -> float:
        """Compute the median error (m) of points of space in a view; infinite where they are not seen."""
        camera, track = self.cameras[node[0]], self.views[node[0]][node[1]]
        points, visibility = track.points[pick], track.visibility[pick]
        off = np.linalg.norm(camera.project(place) - points, axis=-1) / pixels_per_metre(camera, place)
        known = np.isfinite(points[..., 0]) & (visibility > self.visible) & np.isfinite(place[..., 0])
        if known.sum() < 3 * min(self.least_frames, track.n_frames):
            return float("inf")
        return float(np.median(np.where(np.isfinite(off[known]), off[known], np.inf)))

    def _overlap(self, *pair: Node) -> bool:
        """Return whether two tracks of one view coexist, so that they are two people."""
        one, other = (self.views[view][number].present for view, number in pair)
        return bool((one & other).sum() > self.together * max(1, min(one.sum(), other.sum())))

    def _is_body(self, place: FloatArray, names: Sequence[str]) -> bool:
        """Return whether the trunk has a plausible length."""
        wanted = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
        if not set(wanted) <= set(names):
            return True
        left_top, right_top, left_low, right_low = (place[:, names.index(name)] for name in wanted)
        lengths = 0.5 * np.linalg.norm(left_top + right_top - left_low - right_low, axis=1)
        known = lengths[np.isfinite(lengths)]
        return len(known) == 0 or bool(self.trunk[0] < np.median(known) < self.trunk[1])


def match_people(
    cameras: Sequence[Camera], views: Sequence[Sequence[PersonTrack]], names: Sequence[str], *, short: float = 0.1
) -> tuple[MatchedPerson, ...]:
    """Match the people of several views, most seen first.

    Every two people of two views propose a person in space; matching people of other views join. The best proposal with
    most views becomes a person; then the next among the rest.

    Parameters
    ----------
    cameras : (V,).
    views : (V,) people of each view, of T frames at the same moments.
    names : (K,) of the keypoints.
    short : share of the longest track's frames; shorter tracks are no people.
    """
    matching = PeopleMatching(cameras, views, names)
    nodes = [(view, number) for view, people in enumerate(views) for number in range(len(people))]
    longest = max((int(views[v][n].present.sum()) for v, n in nodes), default=0)
    left = [(v, n) for v, n in nodes if views[v][n].present.sum() >= max(short * longest, 1)]
    groups: list[list[Node]] = []
    while left:
        proposals = [matching.propose(left, pair) for pair in combinations(left, 2) if pair[0][0] != pair[1][0]]
        found = [proposal for proposal in proposals if proposal is not None]
        if not found:
            groups += [[node] for node in left]
            break
        best = min(found, key=lambda pair: (-len({view for view, _ in pair[0]}), -len(pair[0]), pair[1]))[0]
        groups.append(best)
        left = [node for node in left if node not in best]
    people = [_merge(group, views) for group in groups]
    return tuple(sorted(people, key=lambda person: -person.seen))


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


def repair_sides(cameras: Sequence[Camera], seen: SeenLandmarks) -> tuple[SeenLandmarks, BoolArray]:
    """Exchange left and right where the views require it.

    Returns the corrected landmarks, and (V, T, G) where arms and legs (`GROUPS`) were exchanged.

    Parameters
    ----------
    cameras : (V,).
    seen : (V, T, L) landmarks.
    """
    exchanged = np.zeros((*seen.points.shape[:2], len(GROUPS)), bool)
    scale = _measure_scale(cameras, seen)
    points, visibility, world = seen.points.copy(), seen.visibility.copy(), seen.world.copy()
    for group, kinds in enumerate(GROUPS):
        left = [row for row, name in enumerate(seen.names) if name in [f"left_{kind}" for kind in kinds]]
        others = [seen.names[row].replace("left_", "right_") for row in left]
        if not left or not set(others) <= set(seen.names):
            continue
        right = [seen.names.index(name) for name in others]
        exchanged[..., group] = SideSearch(cameras, seen, np.array(left), np.array(right), scale).run()
        for array in (points, visibility, world):
            there = np.nonzero(exchanged[..., group])
            own = array[there]
            crossed = own.copy()
            crossed[:, left], crossed[:, right] = own[:, right], own[:, left]
            array[there] = crossed
    return SeenLandmarks(seen.names, points, visibility, world), exchanged


def _measure_scale(cameras: Sequence[Camera], seen: SeenLandmarks, visible: float = 0.2) -> FloatArray:
    """Compute (V, T) px per metre at the person, from where the rays of the middles meet, else from the height.

    Points up to this visibility do not count.
    """
    shown = np.where(seen.visibility[..., None] > visible, seen.points, np.nan)
    middles = reduce_known(np.nanmean, shown, axis=2)
    rays = [camera.compute_rays(np.nan_to_num(middle)) for camera, middle in zip(cameras, middles, strict=True)]
    places = [meet([rays[a], rays[b]]) for a, b in combinations(range(len(cameras)), 2)]
    scale = np.full(middles.shape[:2], np.nan)
    if places:
        place = reduce_known(np.nanmedian, np.stack(places), axis=0)
        scale = np.stack([pixels_per_metre(camera, place) for camera in cameras])
    high, low = (reduce_known(limit, seen.points[..., 1], axis=2) for limit in (np.nanmax, np.nanmin))
    known = reduce_known(np.nanmedian, scale, axis=1)[:, None]
    known = np.where(np.isfinite(known), known, reduce_known(np.nanmedian, high - low, axis=1)[:, None] / 1.5)
    return np.where(np.isfinite(scale), scale, known)


@dataclass(frozen=True, slots=True, eq=False)
class SideSearch:
    """The search for exchanges of left and right in one group of points.

    Parameters
    ----------
    cameras : (V,).
    seen : (V, T, L) landmarks.
    left, right : (n,) the points of the group.
    scale : (V, T) px per metre at the person.
    at_once : views whose exchanges are searched for together; if there are more, these take turns.
    rounds : such turns.
    sigma : m at the person's distance, one sigma of the distance of a point from another view's ray.
    step : m that a point moves in a frame, one sigma.
    most : squared sigmas that a point can be off at most.
    price : what an exchange costs in a frame, a point, in squared sigmas: the more, the rarer exchanges are.
    visible : visibility above which a point counts as known.
    """

    cameras: Sequence[Camera]
    seen: SeenLandmarks
    left: IndexArray
    right: IndexArray
    scale: FloatArray
    at_once: int = 5
    rounds: int = 3
    sigma: float = 0.05
    step: float = 0.05
    most: float = 9.0
    price: float = 1.0
    visible: float = 0.2

    def run(self) -> BoolArray:
        """Find (V, T) where the sides are exchanged."""
        n_views, n_frames = self.scale.shape
        pairs = {
            pair: np.stack([self._disagree(pair, crossed) for crossed in (False, True)], axis=1)
            for pair in combinations(range(n_views), 2)
        }
        moves = np.stack([self._move(view) for view in range(n_views)])
        known = np.asarray((self.seen.visibility[:, :, self.left] > self.visible).any(axis=2))
        state = np.zeros((n_views, n_frames), np.intp)
        for _ in range(1 if n_views <= self.at_once else self.rounds):
            for start in range(0, n_views, self.at_once):
                block = list(range(start, min(start + self.at_once, n_views)))
                state[block] = self._decode(block, state, pairs, moves, known)
        return state.astype(bool)

    def _match(self, crossed: bool) -> tuple[tuple[IndexArray, IndexArray], ...]:
        """Return the points of one image, and those of another that are the same, sides ``crossed`` or not."""
        others = (self.right, self.left) if crossed else (self.left, self.right)
        return tuple(zip((self.left, self.right), others, strict=True))

    def _disagree(self, pair: tuple[int, int], crossed: bool) -> FloatArray:
        """Compute (T,) the distance of two views' rays."""
        seen, total = self.seen, np.zeros(self.scale.shape[1])
        for own, other in self._match(crossed):
            ends = [seen.points[view][:, rows] for view, rows in zip(pair, (own, other), strict=True)]
            weight = np.minimum(seen.visibility[pair[0]][:, own], seen.visibility[pair[1]][:, other])
            place = meet([self.cameras[view].compute_rays(np.nan_to_num(points.reshape(-1, 2)))
                          for view, points in zip(pair, ends, strict=True)])  # fmt: skip
            off = np.zeros(weight.shape)
            for view, points in zip(pair, ends, strict=True):
                error = np.linalg.norm(self.cameras[view].project(place).reshape(points.shape) - points, axis=-1)
                off += (error / (self.sigma * self.scale[view][:, None])) ** 2
            off = np.where(np.isfinite(off), np.minimum(off, self.most), self.most)
            known = np.isfinite(ends[0][..., 0]) & np.isfinite(ends[1][..., 0])
            total += np.where(known, weight * off, 0.0).sum(axis=1)
        return total

    def _move(self, view: int) -> FloatArray:
        """Compute (T, 2) the movement since the frame before, unchanged and exchanged; 0 in the first."""
        moves = np.zeros((self.scale.shape[1], 2))
        points, visibility = self.seen.points[view], self.seen.visibility[view]
        for crossed in (False, True):
            for before, after in self._match(crossed):
                way = np.linalg.norm(points[1:, after] - points[:-1, before], axis=-1)
                off = way / (self.step * self.scale[view, 1:, None])
                weight = np.minimum(visibility[1:, after], visibility[:-1, before])
                cost = np.where(np.isfinite(off), np.minimum(off**2, self.most), 0.0)
                moves[1:, int(crossed)] += (weight * cost).sum(axis=1)
        return moves

    def _decode(
        self,
        block: list[int],
        state: IndexArray,
        pairs: dict[tuple[int, int], FloatArray],
        moves: FloatArray,
        known: BoolArray,
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
        costs += self.price * len(self.left) * np.einsum("vt,vc->tc", known[block].astype(np.float64), choices)
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
