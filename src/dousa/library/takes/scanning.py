"""Search for a motion in the windows of many takes: scan all sketches, and compare the cheapest windows.

Leaves are read of the windows with the cheapest sketches, and poses of those that stay cheap with these. A sketch only
approximates the cost, so many times as many windows are compared as can become answers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray, IntArray
from dousa.kernels import kernel
from dousa.library.takes.portions import N_MARKS, Portion, PortionGoneError, cost_marks
from dousa.motion.runs import find_runs
from dousa.retrieval.takes.find import POSE_WEIGHT, WINDOW_NUMBERS, CutStretch, Stretch, TakeSearch, cost_windows
from dousa.retrieval.takes.moment_kernels import compare_leaves


@kernel(allocates=True)
def scan_sketches(
    sketches, marks, first, last, query, rests, leaves, added, weight, most, rows, costs, tile_size=2048
):  # pragma: no cover - compiled
    """Write windows of cost at most ``most`` by their sketches into ``rows`` and ``costs``; return their number.

    Parameters
    ----------
    sketches : (R + 1, N) int8, coordinates in steps and, last, rests from -128 on.
    marks : (N, S) uint8, codes of leaves.
    query, leaves : (R,) float32 coordinates and (S,) marks of the query.
    rests : (256,) float32, squared distance in steps that each rest adds.
    added : (S + 1,) cost by the number of equal marks.
    weight : cost of a step.
    tile_size : windows whose distances are computed at a time, so that they stay in the processor's cache.
    """
    n_values, n_marks = sketches.shape[0] - 1, marks.shape[1]
    tile = np.empty(tile_size, np.float32)
    nearest = most - added.min()
    limit = np.float32((nearest / weight) ** 2 if nearest > 0.0 else -1.0)
    count = 0
    for start in range(first, last, tile_size):
        size = min(tile_size, last - start)
        for w in range(size):
            tile[w] = rests[np.int64(sketches[n_values, start + w]) + 128]
        for k in range(n_values):
            wanted = query[k]
            own = sketches[k, start : start + size]
            for w in range(size):
                apart = np.float32(own[w]) - wanted
                tile[w] += apart * apart
        for w in range(size):
            if tile[w] <= limit:
                same = 0
                for k in range(n_marks):
                    same += marks[start + w, k] == leaves[k]
                cost = weight * np.sqrt(np.float64(tile[w])) + added[same]
                if cost <= most:
                    rows[count], costs[count] = start + w, cost
                    count += 1
    return count


# All three are measured by python -m lab.benchmarks.find: lab/notes/takes.md has the shares that were found.
MOST_KEPT = 16_384
"""Windows whose leaves are read, or twice as many as are compared if that is more; measured as above."""

MOST_COMPARED = 4096
"""Windows that are compared, the cheapest by sketches and leaves; more in more than 50 hours; measured as above."""

# Measured: with one of 400 windows all of the first ten places were found in 50 and in 200 hours. The limit bounds
# memory and time beyond 200 hours.
_ONE_OF, _MOST_OF_MANY = 400, 16_384

_CHOSEN = np.dtype([("cost", "f8"), ("share", "f8"), ("portion", "i8"), ("length", "i8"), ("window", "i8")])


@dataclass(slots=True, eq=False)
class _Sieve:
    """Keeps the ``n_kept`` windows with the cheapest sketches, of cost up to ``most``."""

    n_kept: int
    most: float = np.inf
    _kept: list[NDArray[Any]] = field(default_factory=list)
    _count: int = 0

    def add(self, portion: int, length: int, windows: NDArray[Any], costs: NDArray[Any]) -> None:
        own = np.empty(len(windows), _CHOSEN)
        own["cost"], own["portion"], own["length"], own["window"] = costs, portion, length, windows
        self._kept.append(own)
        self._count += len(own)
        if self._count > 2 * self.n_kept:
            self._kept = [self.cheapest()]
            self._count = len(self._kept[0])
            self.most = float(self._kept[0]["cost"].max())

    def cheapest(self) -> NDArray[Any]:
        """Return the cheapest windows in the order in which they were added."""
        return _choose(np.concatenate([np.empty(0, _CHOSEN), *self._kept]), self.n_kept)


def _choose(windows: NDArray[Any], count: int) -> NDArray[Any]:
    """Return the cheapest windows in their order."""
    if len(windows) <= count:
        return windows
    return windows[np.sort(np.argpartition(windows["cost"], count)[:count])]


@dataclass(slots=True, eq=False)
class _Room:
    """Memory for the sketches of a file and the results of a scan, reused as the system clears new memory."""

    data: NDArray[np.int8] = field(default_factory=lambda: np.empty(0, np.int8))
    rows: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    costs: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def give(self, n_bytes: int, n_rows: int) -> tuple[NDArray[np.int8], IntArray, NDArray[np.float64]]:
        """Return arrays for ``n_bytes`` of sketches, and ``n_rows`` rows and costs."""
        if len(self.data) < n_bytes:
            self.data = np.empty(n_bytes, np.int8)
        if len(self.rows) < n_rows:
            self.rows, self.costs = np.empty(n_rows, np.int64), np.empty(n_rows)
        return self.data[:n_bytes], self.rows, self.costs


class TakesOnDisk:
    """Takes whose windows are in files.

    ``places`` : by take number, its file and its place in it.

    Attributes
    ----------
    leaves_out : whether a search compared only some of its candidates.
    n_compared : the most windows that it compares.
    """

    def __init__(self, portions: Sequence[Portion], places: Mapping[int, tuple[int, int]]) -> None:
        self._portions, self._places = portions, places
        self.leaves_out, self.n_compared = False, MOST_COMPARED

    def __contains__(self, number: int | None) -> bool:
        return number in self._places

    def duration(self, number: int) -> float:
        """Return the duration of a take in s."""
        portion, place = self._places[number]
        return float(self._portions[portion].durations[place])

    def search(self, searches: Sequence[TakeSearch], wanted: Mapping[int, int]) -> None:
        """Pass candidate windows to searches for motions of one length.

        PortionGoneError if a file is missing or damaged.

        ``wanted`` : by take number, its number in each search.
        """
        chosen: dict[int, BoolArray] = {}
        for number in wanted:
            portion, place = self._places[number]
            own = chosen.setdefault(portion, np.zeros(len(self._portions[portion].ids), np.bool_))
            own[place] = True
        n_windows = sum(_count(self._portions[number], own, searches[0].lengths) for number, own in chosen.items())
        self.n_compared = max(MOST_COMPARED, min(n_windows // _ONE_OF, _MOST_OF_MANY))
        sieves = [_Sieve(max(MOST_KEPT, 2 * self.n_compared)) for _ in searches]
        room = _Room()
        for number in sorted(chosen):
            with _open(self._portions[number]) as file:
                _scan(
                    file,
                    (number, self._portions[number]),
                    chosen[number],
                    list(zip(searches, sieves, strict=True)),
                    room,
                )
        for search, sieve in zip(searches, sieves, strict=True):
            kept = sieve.cheapest()
            self.leaves_out |= len(kept) > self.n_compared
            for file, one, rows in self._parts(kept):
                kept[rows] = _read_leaves(file, one, search, kept[rows])
            kept = _choose(kept, self.n_compared)
            for file, one, rows in self._parts(kept):
                _compare(file, one, search, kept[rows], wanted)

    def _parts(self, windows: NDArray[Any]) -> Iterator[tuple[IO[bytes], Portion, IndexArray]]:
        """Yield the open files, and which windows are in each."""
        order = np.argsort(windows["portion"], kind="stable")
        numbers, firsts = np.unique(windows["portion"][order], return_index=True)
        for number, own in zip(numbers.tolist(), np.split(order, firsts[1:]), strict=False):
            with _open(self._portions[number]) as file:
                yield file, self._portions[number], own

    def cutter(self, number: int) -> CutStretch:
        """Return a function that reads stretches of a take; it raises PortionGoneError as ``search`` does."""
        index, place = self._places[number]
        portion = self._portions[index]

        def cut(first: int, last: int) -> Stretch:
            with _open(portion) as file:
                begin, poses = portion.read_frames(file, place, first, last)
            return Stretch(begin, poses, _add_up(poses), int(portion.n_frames[place]), float(portion.durations[place]))

        return cut


def _open(portion: Portion) -> IO[bytes]:
    try:
        return open(portion.path, "rb", buffering=0)
    except OSError as error:
        raise PortionGoneError(portion.path, damaged=False) from error


def _add_up(poses: NDArray[np.float16]) -> NDArray[np.float64]:
    """Return running sums: exact for half precision in double precision, so they may begin anywhere."""
    sums = np.zeros((len(poses) + 1, poses.shape[1]))
    np.cumsum(poses, axis=0, dtype=np.float64, out=sums[1:])
    return sums


def _find_lengths(portion: Portion, lengths: tuple[float, float]) -> tuple[int, int]:
    """Return the range of the window lengths between two lengths."""
    shortest, longest = lengths
    first = int(np.searchsorted(portion.lengths, shortest))
    return first, int(np.searchsorted(portion.lengths, longest, side="right"))


def _count(portion: Portion, chosen: BoolArray, lengths: tuple[float, float]) -> int:
    """Count the windows of some takes of a file between two lengths."""
    first, last = _find_lengths(portion, lengths)
    return int(np.diff(portion.ends[first:last], axis=1)[:, chosen].sum())


def _scan(
    file: IO[bytes],
    numbered: tuple[int, Portion],
    chosen: BoolArray,
    searches: Sequence[tuple[TakeSearch, _Sieve]],
    room: _Room,
) -> None:
    """Add the windows of some takes of a file to sieves."""
    number, portion = numbered
    first, last = _find_lengths(portion, searches[0][0].lengths)
    if last <= first:
        return
    begin, end = int(portion.places[first]), int(portion.places[last])
    data, rows, costs = room.give(end - begin, int(portion.ends[first:last, -1].max()))
    file.seek(begin)
    if file.readinto(data.data) != len(data):  # type: ignore[attr-defined]
        raise PortionGoneError(portion.path)
    asked = [
        (*portion.sketcher.ask(search.parts), portion.encode(search.leaves)[:N_MARKS].astype(np.uint8))
        for search, _ in searches
    ]
    added, weight = cost_marks(min(N_MARKS, portion.n_trees)), POSE_WEIGHT * float(portion.sketcher.steps[0])
    for length in range(first, last):
        ends = portion.ends[length]
        own = data[int(portion.places[length]) - begin : int(portion.places[length + 1]) - begin]
        sketches, marks = portion.sketches(own, length)
        for start, stop in find_runs(chosen).tolist():
            for (_, sieve), (query, rests, leaves) in zip(searches, asked, strict=True):
                span = sketches, marks, ends[start], ends[stop]
                count = scan_sketches(*span, query, rests, leaves, added, weight, sieve.most, rows, costs)
                sieve.add(number, length, rows[:count], costs[:count])


def _read_leaves(file: IO[bytes], portion: Portion, search: TakeSearch, windows: NDArray[Any]) -> NDArray[Any]:
    """Return windows of a file with their shares of equal leaves, and their costs by these and their sketches."""
    codes = portion.read_rows(file, windows["length"], windows["window"])
    wanted, found = portion.encode(search.leaves), windows.copy()
    shares = np.empty(len(windows))
    compare_leaves(codes, wanted, shares)
    marks = codes[:, :N_MARKS].astype(np.uint8) == wanted[:N_MARKS].astype(np.uint8)
    found["share"] = shares
    found["cost"] += cost_windows(0.0, shares) - cost_marks(marks.shape[1])[marks.sum(axis=1)]
    return found


def _compare(
    file: IO[bytes], portion: Portion, search: TakeSearch, nearest: NDArray[Any], wanted: Mapping[int, int]
) -> None:
    """Pass windows of a file to a search."""
    found = np.empty(len(nearest), WINDOW_NUMBERS)
    places = np.empty(len(nearest), np.int64)
    for length in np.unique(nearest["length"]).tolist():
        own = nearest["length"] == length
        places[own], found["row"][own], found["start"][own] = portion.locate(length, nearest["window"][own])
    found["stop"] = found["start"] + portion.lengths[nearest["length"]]
    found["take"] = [wanted[number] for number in portion.ids[places].tolist()]
    found["share"] = nearest["share"]
    poses, starts = _read_around(file, portion, places, found)
    search.consider(found, _add_up(poses), starts)


def _read_around(
    file: IO[bytes], portion: Portion, places: IntArray, windows: NDArray[Any]
) -> tuple[NDArray[np.float16], IntArray]:
    """Read the poses of all windows, each stretch once, and return where each window begins in them."""
    starts = np.empty(len(windows), np.int64)
    parts: list[NDArray[np.float16]] = []
    length = 0
    order = deque(np.lexsort((windows["start"], places)).tolist())
    spans = list(zip(places.tolist(), windows["start"].tolist(), windows["stop"].tolist(), strict=True))
    while order:
        take, first, last = spans[order[0]]
        together = []
        while order and spans[order[0]][0] == take and spans[order[0]][1] <= last:
            last = max(last, spans[order[0]][2])
            together.append(order.popleft())
        begin, poses = portion.read_frames(file, take, first, last)
        for row in together:
            starts[row] = length + spans[row][1] - begin
        parts.append(poses)
        length += len(poses)
    return np.concatenate(parts), starts
