"""Long takes as windows, stored compactly, and searched and labelled without the motion.

A take is cut into overlapping windows of several lengths. The leaf of each window in every tree is kept, and one small
pose per frame of the take, from which the mean pose of any part of a window is one subtraction.
Source: the integral features of Hamada et al., eq. 4 and 5; long takes are the paper's future work.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.messages import Count, Message
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.feature_sets import FeatureSet, compute_track
from dousa.retrieval.features.pose_features import turn_to_body
from dousa.retrieval.features.posed_motion import (
    FRAME_JOINTS,
    PlainMotion,
    PosedMotion,
    check_shape,
    complete_positions,
)
from dousa.retrieval.features.sensor_noise import reduce_noise
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.forest_file import check, check_version, damaged, pack_arrays, unpack_arrays
from dousa.workers.threads import yield_answers

TAKE_RATE = 30.0
"""Hz, of the frames of a described take (docs/takes.md)."""

N_PARTS = 8
"""Parts of a window whose mean poses are compared; divides all window lengths (docs/takes.md)."""

_SHORTEST, _LONGEST = 16, 4096  # frames: windows of 0.5 s to more than two minutes
_SMALL_JOINTS = "head left_elbow left_hand right_elbow right_hand left_knee left_ankle right_knee right_ankle".split()
_SMALL_INDEX = [JOINT_INDEX[joint] for joint in _SMALL_JOINTS]
N_SMALL = 3 * len(_SMALL_JOINTS)  # by definition of the small poses (docs/takes.md)
_WHAT = Message("stored.windows")
_NAMES = ("version", "lengths", "leaves", "poses", "duration")


@dataclass(frozen=True, slots=True)
class WindowGrid:
    """The window lengths of a take.

    Parameters
    ----------
    lengths : frames at ``TAKE_RATE``, ascending, multiples of 8 from 16 to 4096. The windows of a length start a
        sixth of it apart, and one ends with the take.
    """

    lengths: tuple[int, ...]

    def __post_init__(self) -> None:
        whole = all(isinstance(n, int | np.integer) and n % N_PARTS == 0 for n in self.lengths)
        rising = list(self.lengths) == sorted(set(self.lengths))
        if not (self.lengths and whole and rising and _SHORTEST <= self.lengths[0] <= self.lengths[-1] <= _LONGEST):
            raise OptionError(
                "windows.lengths", parts=N_PARTS, shortest=_SHORTEST, longest=_LONGEST, found=self.lengths
            )
        object.__setattr__(self, "lengths", tuple(int(n) for n in self.lengths))

    def within(self, shortest: float, longest: float) -> WindowGrid:
        """Return the grid of the lengths in a range of frames, or of the nearest one."""
        inside = tuple(n for n in self.lengths if shortest <= n <= longest)
        nearest = min(self.lengths, key=lambda n: max(shortest / n, n / longest))
        return WindowGrid(inside or (nearest,))


def read_grid(lengths: NDArray[Any], what: Message) -> WindowGrid:
    """Make the grid of stored lengths; DousaError that ``what`` is damaged if they are invalid."""
    check(lengths.ndim == 1 and lengths.dtype == np.int64, what, "bad lengths")
    try:
        return WindowGrid(tuple(lengths.tolist()))
    except OptionError as error:
        raise damaged(what, error) from error


def choose_grid(durations: ArrayLike, least: float = 0.45, most: float = 2.2) -> WindowGrid:
    """Choose windows to search takes for motions as long as some clips.

    Parameters
    ----------
    durations : s, of the labelled clips; the shortest and longest 5 % do not count.
    least, most : windows from ``least`` times the shortest to ``most`` times the longest clip, as matches are
        half to twice as long as a query.

    Returns
    -------
    WindowGrid, of the lengths 16, 24, 32, 48, 64, 96 ... frames.

    Raises
    ------
    OptionError : no durations, or some not above 0.
    """
    seconds = np.asarray(durations, np.float64).ravel()
    if not len(seconds) or not np.isfinite(seconds).all() or seconds.min() <= 0:
        raise OptionError("windows.durations")
    shortest, longest = np.percentile(seconds, [5, 95]) * TAKE_RATE * (least, most)
    ladder = sorted(f * 2**k for f in (2, 3) for k in range(3, 12) if _SHORTEST <= f * 2**k <= _LONGEST)
    return WindowGrid(tuple(ladder)).within(float(shortest), float(longest))


def place_windows(grid: WindowGrid, n_frames: int) -> tuple[IntArray, IntArray]:
    """Return starts and stops (W,) of the windows of a take, in frames; shorter windows first, then earlier ones."""
    starts = [_starts(length, n_frames) for length in grid.lengths]
    lengths = np.repeat(np.array(grid.lengths, np.int64), [len(some) for some in starts])
    first = np.concatenate(starts)
    return first, first + lengths


def hop_of(length: int) -> int:
    """Return the frames between the starts of two windows of a length: a sixth of it, rounded."""
    return (length + 3) // 6


def count_windows(length: int, n_frames: int) -> int:
    """Count the windows of a length in a take."""
    if length > n_frames:
        return 0
    hops, left = divmod(n_frames - length, hop_of(length))
    return hops + 1 + (left > 0)


def _starts(length: int, n_frames: int) -> IntArray:
    if length > n_frames:
        return np.zeros(0, np.int64)
    starts = np.arange(0, n_frames - length + 1, hop_of(length), dtype=np.int64)
    return starts if starts[-1] == n_frames - length else np.append(starts, n_frames - length)


@dataclass(frozen=True, slots=True, eq=False)
class TakeWindows:
    """A take as windows.

    Parameters
    ----------
    grid : which windows.
    leaves : (W, n_trees) uint16 or int32, the leaf of each window in each tree, in the order of ``place_windows``.
    poses : (n, 27) float16, one small pose a frame at ``TAKE_RATE``.
    duration : s.

    Attributes
    ----------
    starts, stops : (W,) frames.
    sums : (n + 1, 27) running sums of the poses.
    """

    grid: WindowGrid
    leaves: NDArray[Any]
    poses: NDArray[np.float16]
    duration: float
    starts: IntArray = field(init=False, repr=False)
    stops: IntArray = field(init=False, repr=False)
    sums: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        starts, stops = place_windows(self.grid, len(self.poses))
        if len(self.leaves) != len(starts) or self.leaves.ndim != 2:
            raise InvalidMotionError(
                "windows.leaves", windows=len(starts), frames=len(self.poses), shape=self.leaves.shape
            )
        sums = np.zeros((len(self.poses) + 1, self.poses.shape[1]))
        np.cumsum(self.poses, axis=0, dtype=np.float64, out=sums[1:])
        for name, value in (("starts", starts), ("stops", stops), ("sums", sums)):
            object.__setattr__(self, name, value)

    @property
    def n_frames(self) -> int:
        """n, frames at ``TAKE_RATE``."""
        return len(self.poses)

    @property
    def n_bytes(self) -> int:
        """Memory of all arrays, bytes."""
        arrays = self.leaves, self.poses, self.starts, self.stops, self.sums
        return sum(array.nbytes for array in arrays)

    def rows_within(self, grid: WindowGrid) -> slice:
        """Return the rows from the shortest to the longest length of another grid."""
        lengths = self.stops - self.starts
        return slice(
            int(np.searchsorted(lengths, grid.lengths[0])),
            int(np.searchsorted(lengths, grid.lengths[-1], side="right")),
        )

    def to_bytes(self) -> bytes:
        """Return the bytes of an .npz file (no pickle); the same windows give the same bytes."""
        return pack_arrays(
            {
                "version": np.array(1, np.int64),
                "lengths": np.array(self.grid.lengths, np.int64),
                "leaves": np.ascontiguousarray(self.leaves),
                "poses": np.ascontiguousarray(self.poses),
                "duration": np.array(self.duration, np.float64),
            }
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> TakeWindows:
        """Read the bytes of ``to_bytes``; DousaError for damaged, other or newer bytes."""
        arrays = unpack_arrays(data, _NAMES, _WHAT)
        check_version(arrays, _WHAT, 1)
        leaves, poses, duration = arrays["leaves"], arrays["poses"], arrays["duration"]
        grid = read_grid(arrays["lengths"], _WHAT)
        right = poses.ndim == 2 and poses.shape[1] == N_SMALL and poses.dtype == np.float16
        check(right and bool(np.isfinite(poses).all()), _WHAT, "bad poses")
        right = leaves.ndim == 2 and leaves.shape[1] > 0 and leaves.dtype in (np.uint16, np.int32)
        check(right and leaves.flags.c_contiguous, _WHAT, "bad leaves")
        check(len(leaves) == len(place_windows(grid, len(poses))[0]), _WHAT, "another number of windows")
        check(not len(leaves) or int(leaves.min()) >= 0, _WHAT, "bad leaves")
        right = duration.shape == () and duration.dtype == np.float64
        check(right and bool(np.isfinite(duration)) and float(duration) >= 0, _WHAT, "bad duration")
        return cls(grid, leaves, poses, float(duration))


def describe_take(
    forest: MotionForest,
    feature_set: FeatureSet,
    motion: PosedMotion,
    grid: WindowGrid,
    *,
    n_jobs: int | None = None,
    progress: Count | None = None,
    chunk: int = 4096,
) -> TakeWindows:
    """Cut a take into windows and find their leaves, some two minutes at a time.

    Parameters
    ----------
    forest : trained on ``feature_set``.
    motion : of any length and frame rate; under half a second it has no windows.
    grid : lengths of the windows.
    n_jobs : threads; None for one. The result does not depend on it.
    progress : called with the frames done and their number.
    chunk : frames; windows that start in the same one are described together.

    Raises
    ------
    NotTrainedError : the forest is not trained.
    InvalidMotionError : another shape than (n, 20, 3), positions that are not finite, no body height.
    """
    points = check_shape(motion.positions, motion.height)
    quiet = reduce_noise(motion)
    sampled = sample_positions(quiet.positions, quiet.frame_rate)
    poses = compute_small_poses(sampled, quiet.height, feature_set.hidden)
    starts, stops = place_windows(grid, len(sampled))
    dtype = np.uint16 if forest.trees_.n_leaves < 2**16 else np.int32
    leaves = np.empty((len(starts), len(forest.trees_.roots)), dtype)
    portions = list(_portions(starts, len(sampled), chunk))

    def apply(rows: IndexArray) -> NDArray[np.integer[Any]]:
        return _apply_portion(forest, feature_set, (sampled, quiet.height), starts[rows], stops[rows])

    # Threads do not pay for a single portion.
    answers = yield_answers(apply, portions, n_jobs if len(portions) > 1 else 1)
    for done, (rows, answer) in enumerate(zip(portions, answers, strict=True), 1):
        leaves[rows] = answer
        if progress is not None:
            progress(len(sampled) * done // len(portions), len(sampled))
    return TakeWindows(grid, leaves, poses, len(points) / motion.frame_rate)


def compute_small_poses(
    sampled: FloatArray, height: float, hidden: tuple[str, ...] = (), farthest: float = 1000.0
) -> NDArray[np.float16]:
    """Compute the small pose of every frame: nine joints in the body-fixed system.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints.
    height : m.
    hidden : ignored joints, as in ``FeatureSet``; theirs are 0, and the others count more.
    farthest : body heights; positions beyond it, which half precision may not hold, are clipped.

    Returns
    -------
    (n, 27) in body heights; half precision is a millimetre.

    Raises
    ------
    InvalidMotionError : needed joints are not finite.
    """
    points = complete_positions(sampled, height, hidden, {*_SMALL_JOINTS, *FRAME_JOINTS}.difference(hidden))
    body = turn_to_body((points - points[:, :1]) / height)
    if hidden:
        n_left = len(set(_SMALL_JOINTS).difference(hidden))
        body *= np.sqrt(len(_SMALL_JOINTS) / max(n_left, 1))  # keeps root mean squares over the visible joints
    return np.clip(body[:, _SMALL_INDEX].reshape(len(body), -1), -farthest, farthest).astype(np.float16)


def _portions(starts: IntArray, n_frames: int, chunk: int) -> Iterator[IndexArray]:
    """Yield the rows of the windows that start within each chunk of a take."""
    order = np.argsort(starts, kind="stable")
    edges = np.searchsorted(starts[order], np.arange(0, n_frames + chunk, chunk))
    for first, last in pairwise(edges):
        if last > first:
            yield order[first:last]


def _apply_portion(
    forest: MotionForest,
    feature_set: FeatureSet,
    take: tuple[FloatArray, float],
    starts: IntArray,
    stops: IntArray,
    margin: int = 30,
) -> IntArray:
    """Return the leaves of windows; ``margin`` frames on either side are used, as channels are smoothed over time."""
    sampled, height = take
    first = max(int(starts.min()) - margin, 0)
    last = min(int(stops.max()) + margin, len(sampled))
    track = compute_track(PlainMotion(sampled[first:last], TAKE_RATE, height), feature_set)
    return forest.apply_windows(track, starts - first, stops - first)
