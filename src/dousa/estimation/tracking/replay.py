"""Tracking a stretch of frames once more, from another pose or the other way round, and what of it is better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.tracking.beam import Beam
from dousa.estimation.tracking.search_setup import Frame, SearchSetup

_MOST = 5.0  # log score that a track can fall behind in one frame: any track may lose a limb for some frames
_JUMP = 30.0  # log score that a metre costs by which the joints jump where one track ends and another begins


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """A stretch that was tracked from its first pose.

    Parameters
    ----------
    poses : (n, 7 + A).
    scores : (n,) log scores of image, ease and floor, each frame for itself.
    """

    poses: FloatArray
    scores: FloatArray


def narrow(setup: SearchSetup, area: float) -> SearchSetup:
    """The same search with a beam of one pose."""
    settings = replace(setup.settings, beam=1)
    return SearchSetup(setup.body, setup.cameras, settings, setup.frame_rate, area)


def replay(setup: SearchSetup, pose: FloatArray, frames: Sequence[Frame], n_threads: int = 1) -> Replay:
    """Track frames from the pose of the first of them, in whichever direction of time they are given."""
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
    """(n,) log scores of poses, each in its own frame and without inertia; 0 where nobody is seen."""
    scratch, still = setup.make_scratch(), np.zeros(setup.n_axes)
    return np.array(
        [
            setup.score(pose, still, frame, scratch) if frame.seen.any() else 0.0
            for pose, frame in zip(poses, frames, strict=True)
        ]
    )


def choose_track(tracks: Sequence[Replay]) -> int:
    """Which of several tracks of the same frames fits best, frame by frame and no frame counting much."""
    scores = np.array([track.scores for track in tracks])
    behind = np.minimum(scores.max(axis=0) - scores, _MOST)
    return int(np.argmin(behind.mean(axis=1)))


def choose_switch(setup: SearchSetup, old: Replay, new: Replay) -> int:
    """From which frame on the new track is to stand instead of the old one, by score and the jump between them.

    Parameters
    ----------
    setup : whose body the poses are of.
    old, new : of the same frames, in order of time.

    Returns
    -------
    0 to n: the frames from this one on are the new track's; n keeps the old one.
    """
    n = len(old.poses)
    before, after = (compute_points(setup.body, track.poses) for track in (old, new))
    # After switch s: old before it, new from it on; the jump is from the old pose at s - 1 to the new at s.
    totals = np.concatenate(([0.0], np.cumsum(old.scores))) + np.concatenate((np.cumsum(new.scores[::-1])[::-1], [0.0]))
    usual = np.linalg.norm(np.diff(before, axis=0), axis=-1).mean(axis=-1)
    jumps = np.linalg.norm(after[1:] - before[:-1], axis=-1).mean(axis=-1)
    totals[1:n] -= _JUMP * np.maximum(0.0, jumps - usual)
    return int(np.argmax(totals))
