"""Search long takes for places similar to a motion.

The query is compared with all windows half to twice as long, by the share of trees with the same leaf and by the poses
of eight parts. The best windows at different places are moved until their poses fit best, aligned with the query pose
by pose, and sorted again. Poses work for categories that no tree knows; leaves add trained knowledge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.posed_motion import PosedMotion
from dousa.retrieval.features.sensor_noise import reduce_noise
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.ranking.ranking import warp_distances
from dousa.retrieval.takes.moment_kernels import compare_leaves, compare_poses
from dousa.retrieval.takes.windows import N_PARTS, TAKE_RATE, TakeWindows, compute_small_poses

# Chosen on joined takes of UTD-MHAD and HDM05 with people and some of the categories left out (docs/takes.md).
POSE_WEIGHT, _LEAF_WEIGHT, _ALIGNED_WEIGHT = 3.0, 0.05, 2.0
_LEAST_SHARE = 0.02  # added to shares before their logarithm (docs/takes.md)

# Cost of the score one half, and its steepness, in units of the movement of the query.
_MIDDLE, _STEEPNESS, _LEAST_MOVEMENT = 2.42, 6.3, 0.05

# Weights of the log odds that a place shows the category of the query: of the log odds of the likeness of both as clips
# and of the score, and of the log of the votes. Fitted to hits in joined takes of people who did not train, as recorded
# and disturbed, of UTD-MHAD, HDM05, Bandai and UTKinect, each counting the same (docs/confidence.md).
_OFFSET, _BY_LIKENESS, _BY_SCORE, _BY_VOTES = 1.05, 0.71, 0.34, 2.74
_SAME_PLACE = 0.3  # least overlap (intersection over union) of the same place (docs/takes.md)


@dataclass(frozen=True, slots=True, eq=False)
class TakeQuery:
    """A motion to search for: its ``leaves`` (n_trees,), and its small ``poses`` (n, 27) at ``TAKE_RATE``."""

    leaves: IntArray
    poses: NDArray[np.float16]


@dataclass(frozen=True, slots=True)
class Found:
    """A place in a take that is similar to the query.

    Parameters
    ----------
    take : name of the take.
    start, stop : s, from the beginning of the take.
    score : 0 to 1, larger for more similar places.
    distance : root mean square of pose distances along the best alignment, body heights.
    shared_leaves : share of trees with the same leaf for both.
    tempo : speed relative to the query; 2 is double speed.
    """

    take: str
    start: float
    stop: float
    score: float
    distance: float
    shared_leaves: float
    tempo: float


def describe_query(forest: MotionForest, feature_set: FeatureSet, motion: PosedMotion) -> TakeQuery:
    """Make a query of a motion of at least 0.27 s, with the forest of the takes and its feature set.

    InvalidMotionError : too short, another shape, not finite, no body height.
    """
    quiet = reduce_noise(motion)
    sampled = sample_positions(quiet.positions, quiet.frame_rate)
    poses = compute_small_poses(sampled, quiet.height, feature_set.hidden)
    if len(poses) < N_PARTS:
        raise InvalidMotionError("find.short", least=N_PARTS / TAKE_RATE, found=len(poses) / TAKE_RATE)
    return TakeQuery(forest.apply(feature_set.compute(motion)[None])[0], poses)


def find_in_takes(
    query: TakeQuery,
    takes: Sequence[tuple[str, TakeWindows]],
    *,
    limit: int = 20,
    slowest: float = 0.5,
    fastest: float = 2.0,
    most_windows: int = 4000,
) -> list[Found]:
    """Find the places most similar to a query, best first, no two of them the same.

    Parameters
    ----------
    query : made with the forest of the takes.
    takes : names and windows.
    limit : most places.
    slowest, fastest : tempo relative to the query; windows of 1 / fastest to 1 / slowest of its length are compared.
    most_windows : best windows that are kept for the exact comparison.

    Raises
    ------
    OptionError : a limit below 1, or tempos that are not ascending and above 0.
    InvalidMotionError : a take with leaves of another forest.
    """
    search = TakeSearch(query, limit, slowest, fastest, most_windows)
    for name, windows in takes:
        search.look(name, windows)
    by_place = [windows for _, windows in takes]
    return search.finish(by_place.__getitem__)


WINDOW_NUMBERS = np.dtype(
    [("take", "i8"), ("row", "i8"), ("start", "i8"), ("stop", "i8"), ("cost", "f8"), ("share", "f8")]
)
"""A window of a take: its place, its cost, and the share of trees with the query's leaf."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """The frames of a take around a window.

    Parameters
    ----------
    first : its first frame in the take.
    poses : (n, 27) float16, its small poses.
    sums : (n + 1, 27) running sums of poses from any start.
    n_frames, duration : of the whole take, in frames at ``TAKE_RATE`` and s.
    """

    first: int
    poses: NDArray[np.float16]
    sums: FloatArray
    n_frames: int
    duration: float


CutStretch = Callable[[int, int], Stretch]
"""Returns the frames of a take from one to another, as far as they exist."""


def cut_stretch(windows: TakeWindows, first: int, last: int) -> Stretch:
    """Cut frames from a take in memory."""
    frames = slice(max(first, 0), last)
    sums = windows.sums[frames.start : last + 1]
    return Stretch(frames.start, windows.poses[frames], sums, windows.n_frames, windows.duration)


class TakeSearch:
    """A search as ``find_in_takes``, with the same errors, through takes that need not be in memory together."""

    def __init__(
        self,
        query: TakeQuery,
        limit: int = 20,
        slowest: float = 0.5,
        fastest: float = 2.0,
        most_windows: int = 4000,
    ) -> None:
        if limit < 1 or not 0 < slowest <= fastest < np.inf:
            raise OptionError("find.options", limit=limit, slowest=slowest, fastest=fastest)
        self._query, self._limit, self._tempos, self._most = query, limit, (slowest, fastest), most_windows
        self._parts = cut_parts(query.poses)
        self._names: list[str] = []
        self._best = np.zeros(0, WINDOW_NUMBERS)
        self._waiting: list[NDArray[Any]] = []
        self._farthest = np.inf

    def look(self, name: str, windows: TakeWindows) -> None:
        """Search the next take."""
        found = _compare(self._query, windows, self._tempos, self._farthest)
        found["take"] = self.include(name)
        self._wait(found)

    @property
    def leaves(self) -> IntArray:
        """(n_trees,) leaves of the query."""
        return self._query.leaves

    @property
    def parts(self) -> FloatArray:
        """(8, 27) mean poses of the parts of the query."""
        return self._parts

    @property
    def lengths(self) -> tuple[float, float]:
        """The shortest and longest compared windows, in frames, not rounded."""
        return _limit_lengths(len(self._query.poses), self._tempos)

    def include(self, name: str) -> int:
        """Add a take and return its number."""
        self._names.append(name)
        return len(self._names) - 1

    def consider(self, windows: NDArray[Any], sums: FloatArray, places: IntArray) -> None:
        """Compare ``windows`` (M,) ``WINDOW_NUMBERS`` of included takes, without costs.

        ``sums`` are running sums of poses that contain all of them, ``places`` (M,) their beginnings there.
        """
        distances = np.empty(len(windows))
        ends = places + windows["stop"] - windows["start"]
        compare_poses(sums, places, ends, self._parts, self._farthest / POSE_WEIGHT, distances)
        found = windows.copy()
        found["cost"] = cost_windows(distances, found["share"])
        self._wait(found[found["cost"] <= self._farthest])

    def _wait(self, found: NDArray[Any]) -> None:
        self._waiting.append(found)
        if sum(map(len, self._waiting)) >= self._most:
            self._keep_best()

    def _keep_best(self) -> None:
        found = np.concatenate([self._best, *self._waiting])
        self._waiting = []
        self._best = found[np.lexsort((found["row"], found["take"], found["cost"]))[: self._most]]
        if len(self._best) == self._most:
            self._farthest = float(self._best["cost"][-1])

    def finish(self, get_windows: Callable[[int], TakeWindows | CutStretch]) -> list[Found]:
        """Return the best places; ``get_windows`` returns the windows of the n-th take, or a ``CutStretch``."""
        self._keep_best()
        chosen = _different_places(self._best, 2 * self._limit + 20)
        found: list[Found] = []
        for take in np.unique(chosen["take"]):
            own = get_windows(int(take))
            cut = own if callable(own) else partial(cut_stretch, own)
            found += [
                _refine(self._query, (self._names[take], cut), one, self._tempos)
                for one in chosen[chosen["take"] == take]
            ]
        found.sort(key=lambda one: (-one.score, one.take, one.start))
        return _drop_same(found)[: self._limit]


def _compare(query: TakeQuery, take: TakeWindows, tempos: tuple[float, float], farthest: float) -> NDArray[Any]:
    """Return the windows of a take that cost at most ``farthest``, in order, as ``WINDOW_NUMBERS``."""
    if take.leaves.shape[1] != len(query.leaves):
        raise InvalidMotionError("find.other_forest", expected=len(query.leaves), found=take.leaves.shape[1])
    lengths = take.stops - take.starts
    shortest, longest = _limit_lengths(len(query.poses), tempos)
    first = int(np.searchsorted(lengths, shortest))
    last = max(int(np.searchsorted(lengths, longest, side="right")), first)
    distances = np.empty(last - first)
    starts, stops = take.starts[first:last], take.stops[first:last]
    # The leaves only add to the cost of the poses.
    compare_poses(take.sums, starts, stops, cut_parts(query.poses), farthest / POSE_WEIGHT, distances)
    near = np.flatnonzero(np.isfinite(distances))
    shares = np.empty(len(near))
    compare_leaves(take.leaves[first + near], query.leaves.astype(take.leaves.dtype), shares)
    costs = cost_windows(distances[near], shares)
    kept = costs <= farthest
    near = near[kept]
    found = np.empty(len(near), WINDOW_NUMBERS)
    found["row"], found["start"], found["stop"] = first + near, starts[near], stops[near]
    found["cost"], found["share"] = costs[kept], shares[kept]
    return found


def _limit_lengths(n_frames: int, tempos: tuple[float, float]) -> tuple[float, float]:
    slowest, fastest = tempos
    # A grid has gaps, so lengths next to the range are included.
    return n_frames / fastest / 1.1, n_frames / slowest * 1.1


def cost_windows(distances: Any, shares: Any) -> Any:
    """Compute the cost of windows from pose distances and shares of trees with the same leaf; 0 for the query."""
    return POSE_WEIGHT * distances + _LEAF_WEIGHT * np.log((1 + _LEAST_SHARE) / (shares + _LEAST_SHARE))


def cut_parts(poses: NDArray[Any]) -> FloatArray:
    """Return the (8, 27) mean poses of the parts of a sequence; parts start at whole frames, as in windows."""
    count = len(poses)
    edges = (np.arange(N_PARTS + 1) * count * 2 + N_PARTS) // (2 * N_PARTS)
    sums = np.zeros((count + 1, poses.shape[1]))
    np.cumsum(poses, axis=0, dtype=np.float64, out=sums[1:])
    means: FloatArray = np.diff(sums[edges], axis=0) / np.diff(edges)[:, None]
    return means


def _different_places(ordered: NDArray[Any], wanted: int) -> NDArray[Any]:
    kept: list[int] = []
    spans: dict[int, list[tuple[int, int]]] = {}
    for k, (take, start, stop) in enumerate(ordered[["take", "start", "stop"]].tolist()):
        others = spans.setdefault(take, [])
        if all(overlap((start, stop), other) < _SAME_PLACE for other in others):
            others.append((start, stop))
            kept.append(k)
            if len(kept) == wanted:
                break
    return ordered[kept]


def overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return the intersection over union of two spans (start, stop); 0 where both have no length."""
    union = max(one[1], other[1]) - min(one[0], other[0])
    shared = min(one[1], other[1]) - max(one[0], other[0])
    return max(shared, 0.0) / union if union > 0 else 0.0


def _refine(query: TakeQuery, named: tuple[str, CutStretch], window: Any, tempos: tuple[float, float]) -> Found:
    """Move the edges of a window until its parts fit best, then align it pose by pose."""
    name, cut = named
    start, stop, share = int(window["start"]), int(window["stop"]), float(window["share"])
    # An edge moves by up to an eighth of the window's length.
    moves = np.unique(np.round(np.linspace(-0.125, 0.125, 7) * (stop - start)).astype(np.int64))
    starts = np.repeat(start + moves, len(moves))
    stops = np.tile(stop + moves, len(moves))
    # The window itself comes first and wins ties.
    starts, stops = np.append(start, starts), np.append(stop, stops)
    take = cut(int(starts.min()), int(stops.max()))
    inside = (starts >= 0) & (stops <= take.n_frames) & (stops - starts >= N_PARTS)
    starts, stops = starts[inside], stops[inside]
    # Windows may lie slightly outside the tempos, as the grid has gaps; answers only if they cannot be moved.
    tempo = len(query.poses) / (stops - starts)
    off = np.maximum(tempo / tempos[1], tempos[0] / tempo).clip(1.0)
    starts, stops = starts[off == off.min()], stops[off == off.min()]
    distances = np.empty(len(starts))
    compare_poses(take.sums, starts - take.first, stops - take.first, cut_parts(query.poses), np.inf, distances)
    best = int(np.argmin(distances))
    start, stop = int(starts[best]), int(stops[best])
    aligned = _align(query.poses, take.poses[start - take.first : stop - take.first])
    cost = float(cost_windows(distances[best], share)) + _ALIGNED_WEIGHT * aligned
    return Found(
        take=name,
        start=start / TAKE_RATE,
        stop=min(stop / TAKE_RATE, take.duration),
        score=_score(cost, query.poses),
        distance=aligned,
        shared_leaves=share,
        tempo=len(query.poses) / (stop - start),
    )


def _score(cost: float, poses: NDArray[np.float16]) -> float:
    """Return the score, 0 to 1; costs weigh more for a query with little movement, which is near everything at rest."""
    values = poses.astype(np.float64)
    movement = float(np.sqrt(np.mean((values - values.mean(axis=0)) ** 2)))
    return float(1.0 / (1.0 + (cost / (_MIDDLE * (movement + _LEAST_MOVEMENT))) ** _STEEPNESS))


def judge_place(likeness: float, score: float, votes: float) -> float:
    """Compute the probability that a place shows the category of the query.

    Parameters
    ----------
    likeness : probability that query and place, as clips, show the same category at even prior odds.
    score : of ``Found``.
    votes : share of the trees that vote for the category of the query at the place.
    """
    odds = [np.log(chance / (1.0 - chance)) for chance in np.clip((likeness, score), 1e-4, 1 - 1e-4)]
    total = _OFFSET + _BY_LIKENESS * odds[0] + _BY_SCORE * odds[1] + _BY_VOTES * np.log(votes + _LEAST_SHARE)
    return float(1.0 / (1.0 + np.exp(-total)))


def _align(one: NDArray[np.float16], other: NDArray[np.float16], band: float = 0.15) -> float:
    """Return the root mean square distance of two sequences of small poses along the cheapest warping path.

    A pair lies off the diagonal by at most a share ``band`` of the length.
    """
    query, frames = _thin(one), _thin(other)
    distance = np.empty(1)
    ends = np.array([0, len(frames)])
    warp_distances(query, frames, ends[:1], ends[1:], band * len(frames), distance)
    # A straight path counts each pair once, but is divided by both lengths.
    return float(2.0 * distance[0] / np.sqrt(query.shape[1]))


def _thin(poses: NDArray[np.float16], most: int = 64) -> NDArray[np.float32]:
    count = min(len(poses), most)
    return poses[((np.arange(count) + 0.5) * len(poses) / count).astype(np.intp)].astype(np.float32)


def _drop_same(found: list[Found]) -> list[Found]:
    """Drop the worse of answers at the same place, as refining may move them together."""
    kept: list[Found] = []
    for one in found:
        same = (
            other.take == one.take and overlap((one.start, one.stop), (other.start, other.stop)) >= _SAME_PLACE
            for other in kept
        )
        if not any(same):
            kept.append(one)
    return kept
