"""Takes made by joining clips: known actions, one after another, with blends between them.

Each clip is turned and moved so that it goes on where the one before it ended, and the poses of a blend lead from the
last pose of one to the first of the next. So a take has no jump, and the truth is known: a piece begins and ends in the
middle of a blend.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import TrainingError
from dousa.motion.joints import JOINT_INDEX
from dousa.retrieval._experiment_result import LabelledClip
from dousa.retrieval.takes import TAKE_RATE

__all__ = ["JoinedTake", "Piece", "join_clips", "shuffle_into_takes"]

FloatArray = NDArray[np.float64]

BLEND_SECONDS = (0.3, 0.5)
_LEFT_HIP, _RIGHT_HIP = JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]
_LEFT_SHOULDER, _RIGHT_SHOULDER = JOINT_INDEX["left_shoulder"], JOINT_INDEX["right_shoulder"]


@dataclass(frozen=True, slots=True)
class Piece:
    """What a take shows from ``start`` to ``stop`` (frames at ``TAKE_RATE``, halves in the middle of a blend)."""

    start: float
    stop: float
    category: str


@dataclass(frozen=True, slots=True, eq=False)
class JoinedTake:
    """A take of known pieces.

    Parameters
    ----------
    positions : (n, 20, 3) m at ``frame_rate``.
    height : m.
    pieces : in the order of time, each beginning where the one before it ends.
    """

    positions: FloatArray
    height: float
    pieces: tuple[Piece, ...]
    frame_rate: float = TAKE_RATE


def join_clips(
    clips: Sequence[LabelledClip], generator: np.random.Generator, *, tempos: Sequence[float] | None = None
) -> JoinedTake:
    """Play clips of one performer one after another.

    Parameters
    ----------
    clips : at least one.
    generator : draws the lengths of the blends, 0.3 to 0.5 s.
    tempos : how much faster than recorded each clip is played; None for as recorded.

    Raises
    ------
    TrainingError : no clip.
    """
    from dousa.retrieval.channels import sample_positions

    if not clips:
        raise TrainingError("expected clips to join into a take, got none")
    speeds = [1.0] * len(clips) if tempos is None else list(tempos)
    # A clip played at double speed has the poses of a clip of half the frame rate.
    played = [
        sample_positions(clip.positions, clip.frame_rate * speed) / clip.height * clips[0].height
        for clip, speed in zip(clips, speeds, strict=True)
    ]
    parts, edges, length = [played[0]], [0.0], len(played[0])
    for clip in played[1:]:
        count = round(generator.uniform(*BLEND_SECONDS) * TAKE_RATE)
        last = parts[-1][-1]
        following = _go_on(last, clip)
        share = (np.arange(1, count + 1) / (count + 1))[:, None, None]
        ease = share * share * (3.0 - 2.0 * share)
        parts += [last * (1.0 - ease) + following[0] * ease, following]
        edges.append(length + count / 2)
        length += count + len(following)
    edges.append(float(length))
    pieces = tuple(Piece(edges[k], edges[k + 1], clip.category) for k, clip in enumerate(clips))
    return JoinedTake(np.concatenate(parts), clips[0].height, pieces)


def _go_on(last: FloatArray, clip: FloatArray) -> FloatArray:
    """A clip (n, 20, 3) turned about the vertical and moved along the floor to follow a pose (20, 3)."""
    turn = _heading(clip[0]) - _heading(last)
    across, along = np.cos(turn), np.sin(turn)
    moved = clip - clip[0, 0] * (1.0, 0.0, 1.0)
    x, z = moved[..., 0].copy(), moved[..., 2].copy()
    moved[..., 0] = x * across + z * along
    moved[..., 2] = z * across - x * along
    return moved + last[0] * (1.0, 0.0, 1.0)


def _heading(pose: FloatArray) -> float:
    """rad, from the line of hips and shoulders: the hips of a person who lies on one side say nothing."""
    line = pose[_LEFT_HIP] - pose[_RIGHT_HIP] + 0.5 * (pose[_LEFT_SHOULDER] - pose[_RIGHT_SHOULDER])
    return float(np.arctan2(line[2], line[0]))


def shuffle_into_takes(
    clips: Sequence[LabelledClip], generator: np.random.Generator, n_clips: int = 12
) -> list[list[int]]:
    """The clips of every performer in a random order, in groups of ``n_clips`` or a few more: indices."""
    groups = []
    performers = sorted({clip.performer or "" for clip in clips})
    for performer in performers:
        own = np.array([k for k, clip in enumerate(clips) if (clip.performer or "") == performer])
        order = generator.permutation(own)
        count = max(1, len(order) // n_clips)
        groups += [group.tolist() for group in np.array_split(order, count)]
    return groups
