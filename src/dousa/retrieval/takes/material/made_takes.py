"""Takes whose truth is known: clips played one after another, with rests between them.

A library of clips has no takes to learn from, so takes are made of its clips.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import TrainingError
from dousa.motion.canonical.joints import JOINT_INDEX, MIRRORED_JOINTS
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.windows import TAKE_RATE

BLEND_SECONDS = (0.3, 0.5)

SERIES = 3
"""Neighbours of one category that are one action, repeated: two may be two."""

_LEFT_HIP, _RIGHT_HIP = JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]
_LEFT_SHOULDER, _RIGHT_SHOULDER = JOINT_INDEX["left_shoulder"], JOINT_INDEX["right_shoulder"]


@dataclass(frozen=True, slots=True)
class Piece:
    """What a take shows from ``start`` to ``stop`` (frames at ``TAKE_RATE``, halves in the middle of a blend).

    Without a category it is nothing that has a name; where it is not ``counted``, nobody can say.
    """

    start: float
    stop: float
    category: str | None
    counted: bool = True


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
    from dousa.retrieval.features.channels import sample_positions

    if not clips:
        raise TrainingError("labeller.no_clips")
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
        following = go_on(last, clip)
        share = (np.arange(1, count + 1) / (count + 1))[:, None, None]
        ease = share * share * (3.0 - 2.0 * share)
        parts += [last * (1.0 - ease) + following[0] * ease, following]
        edges.append(length + count / 2)
        length += count + len(following)
    edges.append(float(length))
    pieces = tuple(Piece(edges[k], edges[k + 1], clip.category) for k, clip in enumerate(clips))
    return JoinedTake(np.concatenate(parts), clips[0].height, pieces)


def join_series(pieces: Sequence[Piece]) -> list[Piece]:
    """Pieces of which three or more of one category in a row are one: an action repeated, as a labeller says it."""
    joined: list[Piece] = []
    for _, run in itertools.groupby(pieces, key=lambda piece: (piece.category, piece.counted)):
        same = list(run)
        joined += [replace(same[0], stop=same[-1].stop)] if len(same) >= SERIES and same[0].category else same
    return joined


def go_on(last: FloatArray, clip: FloatArray) -> FloatArray:
    """A clip (n, 20, 3) turned about the vertical and moved along the floor to follow a pose (20, 3)."""
    turn = _heading(clip[0]) - _heading(last)
    across, along = np.cos(turn), np.sin(turn)
    moved = clip - clip[0, 0] * (1.0, 0.0, 1.0)
    x, z = moved[..., 0].copy(), moved[..., 2].copy()
    moved[..., 0] = x * across + z * along
    moved[..., 2] = z * across - x * along
    found: FloatArray = moved + last[0] * (1.0, 0.0, 1.0)
    return found


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


_BLENDS = (0.2, 1.2)  # s, of the joins that are not those of `join_clips`
_RESTS = (0.3, 4.0)
_REST_SHARE = 0.4  # of the joins
_SWAY = 0.002  # m a frame that a resting body drifts, in no direction
_TEMPO = 0.35  # spread of the log tempo


def join_with_rests(clips: Sequence[LabelledClip], generator: np.random.Generator) -> JoinedTake:
    """Play clips of one performer one after another at other tempos, slowly blended, with rests between some.

    Parameters
    ----------
    clips : at least one.
    generator : draws tempos, blends and rests.

    Returns
    -------
    A take in which blends and rests are pieces without a category.
    """
    from dousa.retrieval.features.channels import sample_positions

    parts: list[FloatArray] = []
    pieces: list[Piece] = []
    length = 0
    for clip in clips:
        tempo = float(np.exp(generator.uniform(-_TEMPO, _TEMPO)))
        played = sample_positions(clip.positions, clip.frame_rate * tempo) / clip.height * clips[0].height
        if parts:
            played = go_on(parts[-1][-1], played)
            between = _make_transition(parts[-1][-1], played[0], generator)
            parts.append(between)
            pieces.append(Piece(length, length + len(between), None))
            length += len(between)
        parts.append(played)
        pieces.append(Piece(length, length + len(played), clip.category))
        length += len(played)
    return JoinedTake(np.concatenate(parts), clips[0].height, tuple(pieces))


def _draw_log(generator: np.random.Generator, least: float, most: float) -> float:
    return float(np.exp(generator.uniform(np.log(least), np.log(most))))


def _make_transition(last: FloatArray, following: FloatArray, generator: np.random.Generator) -> FloatArray:
    """(n, 20, 3) from one pose to another: a blend, and sometimes a rest before or after it."""
    count = max(round(_draw_log(generator, *_BLENDS) * TAKE_RATE), 1)
    share = (np.arange(1, count + 1) / (count + 1))[:, None, None]
    ease = share * share * (3.0 - 2.0 * share)
    blend: FloatArray = last * (1.0 - ease) + following * ease
    if generator.random() >= _REST_SHARE:
        return blend
    n_rest = round(_draw_log(generator, *_RESTS) * TAKE_RATE)
    drift = np.cumsum(generator.normal(0.0, _SWAY, (n_rest, *last.shape)), axis=0)
    drift *= (np.linspace(0.0, 1.0, n_rest) * np.linspace(1.0, 0.0, n_rest))[:, None, None]
    if generator.random() < 0.5:
        return np.concatenate([last + drift, blend])
    return np.concatenate([blend, following + drift])


def mirror_positions(points: FloatArray) -> FloatArray:
    """(n, 20, 3) canonical joints with left and right the other way round."""
    image = np.take(points, MIRRORED_JOINTS, axis=1)
    np.negative(image[..., 0], out=image[..., 0])
    return image
