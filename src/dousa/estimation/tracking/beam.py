"""The beam search over frames, and repeated tracking of single stretches."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.estimation.body.kinematics import compute_points, pose_difference, step_poses
from dousa.estimation.tracking.search_setup import Frame, SearchSetup


class _Track(NamedTuple):
    score: float
    pose: FloatArray
    velocity: FloatArray
    parent: int


class Settled(NamedTuple):
    """A frame whose pose will not change any more."""

    pose: FloatArray
    frame: Frame


@dataclass(frozen=True, slots=True, eq=False)
class BeamState:
    """The state of a beam as plain arrays, complete enough to continue from.

    Parameters
    ----------
    scores, beam_poses, velocities : (b,), (b, 7 + A), (b, 6 + A) of the newest frame.
    pending_poses : (L, B, 7 + A) of the frames not yet settled, NaN where the beam was narrower.
    pending_parents : (L, B) index of the parent track in the frame before.
    """

    scores: FloatArray
    beam_poses: FloatArray
    velocities: FloatArray
    pending_poses: FloatArray
    pending_parents: NDArray[np.int64]


class Beam:
    """Keep the best poses from frame to frame.

    Parameters
    ----------
    setup : body, cameras and settings.
    start : (7 + A,) the pose of the first frame.
    n_threads : threads; the result does not depend on their number.
    memory : share of the score so far that still counts a frame later; 0 judges each frame for itself.
    apart : rad, poses nearer than this to a better one in all angles are the same pose.
    """

    def __init__(
        self, setup: SearchSetup, start: FloatArray, n_threads: int = 1, *, memory: float = 0.7, apart: float = 0.12
    ) -> None:
        self.setup, self._memory, self._apart = setup, memory, apart
        self.pool = ThreadPoolExecutor(n_threads) if n_threads > 1 else None
        self._tracks = [_Track(0.0, start.copy(), np.zeros(setup.n_axes), 0)]
        self._pending: deque[tuple[list[_Track], Frame]] = deque()

    def close(self) -> None:
        """Stop the threads."""
        if self.pool is not None:
            self.pool.shutdown(wait=True, cancel_futures=True)

    @property
    def best(self) -> FloatArray:
        """The best pose (7 + A,) of the newest frame; it may still change."""
        return self._tracks[0].pose

    def begin(self, frame: Frame) -> None:
        """Take the first frame, whose pose is the start."""
        self._pending.append((self._tracks, frame))

    def step(self, frame: Frame, beside: Callable[[], None] = lambda: None) -> None:
        """Follow the poses into the next frame; ``beside`` gives the threads more to do while some would wait."""
        settings = self.setup.settings
        if not frame.seen.any():
            self._tracks = [self._coast(number, track) for number, track in enumerate(self._tracks)]
            self._pending.append((self._tracks, frame))
            return
        tasks = [(number, damping, frame) for number in range(len(self._tracks)) for damping in settings.damping]
        searched = sorted(self._map(self._search, tasks), key=lambda found: -found[0])
        kept: list[tuple[float, int, FloatArray, FloatArray]] = []
        for found in searched:
            new = all(np.abs(found[2][7:] - other[2][7:]).max(initial=0.0) > self._apart for other in kept)
            if not kept or (new and len(kept) < self.setup.beam):
                kept.append(found)
        revisited = self._map(self._revisit, [(*found, frame) for found in kept], beside)
        tracks = sorted(revisited, key=lambda track: -track.score)
        best = tracks[0].score
        self._tracks = [track._replace(score=track.score - best) for track in tracks]
        self._pending.append((self._tracks, frame))

    @property
    def line(self) -> list[Settled]:
        """The frames not yet settled, oldest first, each with the ancestor of the present best pose."""
        pairs = zip(self._trace(), self._pending, strict=True)
        return [Settled(tracks[chosen].pose, frame) for chosen, (tracks, frame) in pairs]

    def _trace(self) -> list[int]:
        """Return the numbers of the ancestors of the present best pose in the frames not yet settled."""
        line = [0]
        for tracks, _ in reversed(self._pending):
            line.append(tracks[line[-1]].parent)
        return line[-2::-1]

    def replace_newest(self, poses: FloatArray) -> None:
        """Replace the poses of the newest frames by others (n, 7 + A), oldest first."""
        kept = []
        parent = 0
        for _ in poses:
            tracks, frame = self._pending.pop()
            kept.append(frame)
            parent = tracks[parent].parent
        still = np.zeros(self.setup.n_axes)
        for number, (pose, frame) in enumerate(zip(poses, reversed(kept), strict=True)):
            moved = pose_difference(poses[number - 1], pose) if number else still
            self._tracks = [_Track(0.0, pose.copy(), moved, 0 if number else parent)]
            self._pending.append((self._tracks, frame))

    def settle(self, lag: int) -> Iterator[Settled]:
        """Yield the frames older than ``lag``, each with the ancestor of the present best pose."""
        while len(self._pending) > lag:
            settled = self._trace()[0]
            tracks, frame = self._pending.popleft()
            self._forget_others(settled)
            yield Settled(tracks[settled].pose, frame)

    def _forget_others(self, settled: int) -> None:
        alive = {settled}
        for number, (tracks, frame) in enumerate(self._pending):
            kept = [i for i, track in enumerate(tracks) if track.parent in alive]
            places = {old: new for new, old in enumerate(sorted(alive))}
            kept_tracks = [tracks[i]._replace(parent=places[tracks[i].parent]) for i in kept]
            self._pending[number] = (kept_tracks, frame)
            alive = set(kept)
        if self._pending:
            self._tracks = self._pending[-1][0]

    def _map(self, work: Any, tasks: list[Any], beside: Callable[[], None] = lambda: None) -> list[Any]:
        done = self.pool.map(work, tasks) if self.pool is not None else map(work, tasks)
        beside()
        return list(done)

    def _predict(self, track: _Track, damping: float) -> FloatArray:
        predicted = step_poses(track.pose, damping * track.velocity)
        limits = self.setup.bounds[2]
        predicted[7:] = np.clip(predicted[7:], limits[:, 0], limits[:, 1])
        return predicted

    def _search(self, task: tuple[int, float, Frame]) -> tuple[float, int, FloatArray, FloatArray]:
        """Run the first pass from one prediction of one track."""
        number, damping, frame = task
        setup, track, scratch = self.setup, self._tracks[number], self.setup.own_scratch()
        pose, shift = self._predict(track, damping), np.zeros(setup.n_axes)
        found = setup.sweep(pose, shift, setup.settings.passes[0], frame, scratch)
        return self._memory * track.score + found, number, pose, shift

    def _revisit(self, task: tuple[float, int, FloatArray, FloatArray, Frame]) -> _Track:
        """Run the finer passes over a kept pose."""
        _, number, pose, shift, frame = task
        setup, track, scratch = self.setup, self._tracks[number], self.setup.own_scratch()
        for factor in setup.settings.passes[1:]:
            setup.sweep(pose, shift, factor, frame, scratch, setup.half_later)
        pose[3:7] /= np.linalg.norm(pose[3:7])
        score = self._memory * track.score + setup.score(pose, shift, frame, scratch)
        return _Track(score, pose, pose_difference(track.pose, pose), number)

    def _coast(self, number: int, track: _Track) -> _Track:
        """Move a track by its damped velocity alone."""
        damping = self.setup.settings.damping[0]
        return _Track(track.score, self._predict(track, damping), damping * track.velocity, number)

    def save(self) -> BeamState:
        """Return the state; the frames not yet settled are not part of it."""
        widest, n_numbers = max(len(tracks) for tracks, _ in self._pending), len(self.best)
        poses = np.full((len(self._pending), widest, n_numbers), np.nan)
        parents = np.zeros((len(self._pending), widest), np.int64)
        for number, (tracks, _) in enumerate(self._pending):
            for place, track in enumerate(tracks):
                poses[number, place], parents[number, place] = track.pose, track.parent
        return BeamState(
            np.array([track.score for track in self._tracks]),
            np.stack([track.pose for track in self._tracks]),
            np.stack([track.velocity for track in self._tracks]),
            poses,
            parents,
        )

    def load(self, state: BeamState, frames: list[Frame]) -> None:
        """Continue from a saved state; ``frames`` are those not yet settled, oldest first."""
        self._pending.clear()
        rest = np.zeros(self.setup.n_axes)
        for poses, parents, frame in zip(state.pending_poses, state.pending_parents, frames, strict=True):
            there = ~np.isnan(poses[:, 0])
            tracks = [_Track(0.0, pose, rest, int(p)) for pose, p in zip(poses[there], parents[there], strict=True)]
            self._pending.append((tracks, frame))
        parents = self._pending[-1][0]
        self._tracks = [
            _Track(float(score), pose, velocity, old.parent)
            for score, pose, velocity, old in zip(
                state.scores, state.beam_poses, state.velocities, parents, strict=True
            )
        ]
        self._pending[-1] = (self._tracks, frames[-1])


class Replay(NamedTuple):
    """Poses (n, 7 + A) tracked from the first, and log scores (n,) of image and ease, each frame for itself."""

    poses: FloatArray
    scores: FloatArray


def replay(setup: SearchSetup, pose: FloatArray, frames: Sequence[Frame], n_threads: int = 1) -> Replay:
    """Track frames in the given order from the pose of the first of them."""
    beam = Beam(setup, pose, n_threads)
    try:
        beam.begin(frames[0])
        for frame in frames[1:]:
            beam.step(frame)
        poses = np.array([settled.pose for settled in beam.settle(0)])
    finally:
        beam.close()
    return Replay(poses, score_frames(setup, poses, frames))


def score_frames(setup: SearchSetup, poses: FloatArray, frames: Sequence[Frame]) -> FloatArray:
    """Compute log scores (n,) of poses without inertia; 0 for a frame without a person."""
    scratch, still = setup.make_scratch(), np.zeros(setup.n_axes)
    return np.array(
        [
            setup.score(pose, still, frame, scratch) if frame.seen.any() else 0.0
            for pose, frame in zip(poses, frames, strict=True)
        ]
    )


def choose_track(tracks: Sequence[Replay], most: float = 5.0) -> int:
    """Return the index of the best of several tracks of the same frames.

    In one frame a track falls behind by no more than the log score ``most``, as any track may lose a limb for a moment.
    """
    scores = np.array([track.scores for track in tracks])
    behind = np.minimum(scores.max(axis=0) - scores, most)
    return int(np.argmin(behind.mean(axis=1)))


def choose_switch(setup: SearchSetup, old: Replay, new: Replay, jump: float = 30.0) -> int:
    """Return the frame, 0 to n, from which track ``new`` replaces ``old``; n keeps the old one.

    Weighs the scores against the jump of the joints of the body between the tracks, both in order of time: a metre
    costs the log score ``jump``.
    """
    n = len(old.poses)
    before, after = (compute_points(setup.body, track.poses) for track in (old, new))
    # After switch s: old before it, new from it on; the jump is from the old pose at s - 1 to the new at s.
    totals = np.concatenate(([0.0], np.cumsum(old.scores))) + np.concatenate((np.cumsum(new.scores[::-1])[::-1], [0.0]))
    usual = np.linalg.norm(np.diff(before, axis=0), axis=-1).mean(axis=-1)
    jumps = np.linalg.norm(after[1:] - before[:-1], axis=-1).mean(axis=-1)
    totals[1:n] -= jump * np.maximum(0.0, jumps - usual)
    return int(np.argmax(totals))
