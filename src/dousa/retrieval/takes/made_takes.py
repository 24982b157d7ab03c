"""Make takes with known truth from clips, played one after another with rests, and disturb them for training."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import TrainingError
from dousa.motion.canonical.joints import CANONICAL_PARENTS, JOINT_INDEX, MIRRORED_JOINTS
from dousa.motion.rotations import from_axis_angle, to_matrix
from dousa.retrieval.features.channels import read_between, sample_positions, smooth_positions
from dousa.retrieval.features.posed_motion import LabelledClip, PosedMotion
from dousa.retrieval.takes.windows import TAKE_RATE

SERIES = 3
"""Least number of neighbours of one category that count as one repeated action (docs/takes.md)."""

_LEFT_HIP, _RIGHT_HIP = JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]
_LEFT_SHOULDER, _RIGHT_SHOULDER = JOINT_INDEX["left_shoulder"], JOINT_INDEX["right_shoulder"]


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a take from ``start`` to ``stop`` (frames at ``TAKE_RATE``, halves in the middle of a blend).

    The category is None for nothing; ``counted`` is False where the truth is unknown.
    """

    start: float
    stop: float
    category: str | None
    counted: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class JoinedTake:
    """A take of ``positions`` (n, 20, 3) m, body ``height`` m, and ``pieces`` in the order of time without gaps."""

    positions: FloatArray
    height: float
    pieces: tuple[Piece, ...]
    frame_rate: float = TAKE_RATE


def join_clips(
    clips: Sequence[LabelledClip],
    generator: np.random.Generator,
    *,
    tempos: Sequence[float] | None = None,
    blends: tuple[float, float] = (0.3, 0.5),
) -> JoinedTake:
    """Join clips of one performer into a take, with blends of random lengths, ``blends`` in s (docs/takes.md).

    ``tempos`` are speeds relative to the recordings; None for as recorded. TrainingError : no clip.
    """
    if not clips:
        raise TrainingError("labeller.no_clips")
    speeds = [1.0] * len(clips) if tempos is None else list(tempos)
    # Double speed is the same as half the frame rate.
    played = [
        sample_positions(clip.positions, clip.frame_rate * speed) / clip.height * clips[0].height
        for clip, speed in zip(clips, speeds, strict=True)
    ]
    parts, edges, length = [played[0]], [0.0], len(played[0])
    for clip in played[1:]:
        count = round(generator.uniform(*blends) * TAKE_RATE)
        last = parts[-1][-1]
        following = go_on(last, clip)
        parts += [_blend(last, following[0], count), following]
        edges.append(length + count / 2)
        length += count + len(following)
    edges.append(float(length))
    pieces = tuple(Piece(edges[k], edges[k + 1], clip.category) for k, clip in enumerate(clips))
    return JoinedTake(np.concatenate(parts), clips[0].height, pieces)


def _blend(last: FloatArray, following: FloatArray, count: int) -> FloatArray:
    """Return ``count`` poses from one to another, which ease in and out."""
    share = (np.arange(1, count + 1) / (count + 1))[:, None, None]
    ease = share * share * (3.0 - 2.0 * share)
    blend: FloatArray = last * (1.0 - ease) + following * ease
    return blend


def join_series(pieces: Sequence[Piece]) -> list[Piece]:
    """Join three or more pieces of one category in a row, as a labeller joins repeated actions."""
    joined: list[Piece] = []
    for _, run in itertools.groupby(pieces, key=lambda piece: (piece.category, piece.counted)):
        same = list(run)
        joined += [replace(same[0], stop=same[-1].stop)] if len(same) >= SERIES and same[0].category else same
    return joined


def go_on(last: FloatArray, clip: FloatArray) -> FloatArray:
    """Turn a clip (n, 20, 3) about the vertical and move it along the floor to follow a pose (20, 3)."""
    turn = _heading(clip[0]) - _heading(last)
    across, along = np.cos(turn), np.sin(turn)
    moved = clip - clip[0, 0] * (1.0, 0.0, 1.0)
    x, z = moved[..., 0].copy(), moved[..., 2].copy()
    moved[..., 0] = x * across + z * along
    moved[..., 2] = z * across - x * along
    found: FloatArray = moved + last[0] * (1.0, 0.0, 1.0)
    return found


def _heading(pose: FloatArray) -> float:
    """Return the heading in rad, from hips and shoulders, as hips alone fail for a person lying on one side."""
    line = pose[_LEFT_HIP] - pose[_RIGHT_HIP] + 0.5 * (pose[_LEFT_SHOULDER] - pose[_RIGHT_SHOULDER])
    return float(np.arctan2(line[2], line[0]))


def shuffle_into_takes(
    clips: Sequence[LabelledClip], generator: np.random.Generator, n_clips: int = 12
) -> list[list[int]]:
    """Return indices of the clips of each performer in random order, in groups of ``n_clips`` or a few more."""
    groups = []
    performers = sorted({clip.performer or "" for clip in clips})
    for performer in performers:
        own = np.array([k for k, clip in enumerate(clips) if (clip.performer or "") == performer])
        order = generator.permutation(own)
        count = max(1, len(order) // n_clips)
        groups += [group.tolist() for group in np.array_split(order, count)]
    return groups


def join_with_rests(
    clips: Sequence[LabelledClip], generator: np.random.Generator, log_tempo: float = 0.35
) -> JoinedTake:
    """Join clips of one performer at random tempos, with slow blends and some rests, pieces without a category.

    ``log_tempo`` is the largest logarithm of a tempo.
    """
    parts: list[FloatArray] = []
    pieces: list[Piece] = []
    length = 0
    for clip in clips:
        tempo = float(np.exp(generator.uniform(-log_tempo, log_tempo)))
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


def _make_transition(
    last: FloatArray,
    following: FloatArray,
    generator: np.random.Generator,
    *,
    blends: tuple[float, float] = (0.2, 1.2),
    rests: tuple[float, float] = (0.3, 4.0),
    rest_share: float = 0.4,
    sway: float = 0.002,
) -> FloatArray:
    """Return (n, 20, 3) from one pose to another: a blend, and sometimes a rest before or after it.

    Parameters
    ----------
    last, following : (20, 3) m.
    generator : draws lengths between those of ``blends`` and ``rests`` (s; docs/takes.md).
    rest_share : share of the transitions that rest.
    sway : m a frame, random drift of a resting body.
    """
    blend = _blend(last, following, max(round(_draw_log(generator, *blends) * TAKE_RATE), 1))
    if generator.random() >= rest_share:
        return blend
    n_rest = round(_draw_log(generator, *rests) * TAKE_RATE)
    drift = np.cumsum(generator.normal(0.0, sway, (n_rest, *last.shape)), axis=0)
    drift *= (np.linspace(0.0, 1.0, n_rest) * np.linspace(1.0, 0.0, n_rest))[:, None, None]
    if generator.random() < 0.5:
        return np.concatenate([last + drift, blend])
    return np.concatenate([blend, following + drift])


MOVED_SHARE = 0.75
"""Share of the disturbed clips that are moved differently (docs/confidence.md)."""


def disturb(
    take: JoinedTake,
    generator: np.random.Generator,
    *,
    slowest: float = 10.0,
    noise: float = 0.035,
    jump: float = 0.1,
    jumping: float = 0.01,
    jump_share: float = 0.3,
    log_height: float = 0.03,
) -> JoinedTake:
    """Give a take at ``TAKE_RATE`` another body, a tilted camera, and a slower, noisier sensor that loses joints.

    Parameters
    ----------
    take, generator : what is disturbed, and how much of the following it is.
    slowest : Hz (docs/takes.md).
    noise : m, of the noisiest joints (docs/takes.md).
    jump, jumping, jump_share : m; share of the frames of a joint that jump; share of the takes with jumps.
    log_height : spread of the log height.
    """
    points = _tilt(_stretch_bones(take.positions, generator), generator)
    rate = take.frame_rate
    if generator.random() < 0.5:
        rate = float(generator.uniform(slowest, rate))
        points = _sample_slower(points, max(round(len(points) * rate / take.frame_rate), 2))
        rate = take.frame_rate * len(points) / len(take.positions)
    common = noise * generator.random() ** 2 / np.sqrt(3.0)
    spread = common * np.exp(generator.normal(0.0, 0.3, (1, points.shape[1], 1)))
    points = _lose_joints(points + generator.normal(size=points.shape) * spread, generator)
    if generator.random() < jump_share:
        far = generator.random(points.shape[:2]) < jumping
        points[far] += generator.normal(0.0, jump, (int(far.sum()), 3))
    height = take.height * float(np.exp(generator.normal(0.0, log_height)))
    return replace(take, positions=points, height=height, frame_rate=rate)


def disturb_motion(
    motion: PosedMotion,
    generator: np.random.Generator,
    *,
    drift: float = 0.05,
    lasting: tuple[float, float] = (0.7, 4.0),
) -> JoinedTake:
    """Disturb a clip as ``disturb``, move three of four differently, and give half of them errors over some frames.

    The largest of these are ``drift`` m (docs/confidence.md); ``lasting`` are frames of their standard deviation.
    """
    points = sample_positions(motion.positions, motion.frame_rate)
    if generator.random() < MOVED_SHARE:
        points = move_differently(points, generator)
    if generator.random() < 0.5:
        errors = smooth_positions(generator.normal(size=points.shape), generator.uniform(*lasting))
        errors /= errors.std() + 1e-9
        points = points + errors * (drift * np.sqrt(generator.random() / 3.0))
    return disturb(JoinedTake(points, motion.height, ()), generator)


_PELVIS, _NECK = JOINT_INDEX["pelvis"], JOINT_INDEX["neck"]
_SIDES = tuple(JOINT_INDEX[name] for name in ("left_hip", "left_shoulder", "right_hip", "right_shoulder"))
_MIRROR = list(MIRRORED_JOINTS)


def move_differently(
    points: FloatArray,
    generator: np.random.Generator,
    *,
    most_held: float = 0.3,
    most_extent: float = 0.3,
    most_placed: float = 0.06,
    symmetric: float = 0.8,
) -> FloatArray:
    """Change the posture and the extent of the movement of points (n, 20, 3) m at random; feet stay on the floor.

    Each bone is turned by a constant angle, its way about its mean direction is scaled, and joints are displaced as
    between sensors and skeletons, all in the frame of the trunk. The whole body is then moved up or down so that the
    lowest joint keeps its height.

    Parameters
    ----------
    points, generator : what is changed.
    most_held, most_extent, most_placed : greatest spreads over the bones: rad, log extent, m (docs/confidence.md).
    symmetric : share of people with symmetric posture (docs/confidence.md).
    """
    held, extent, placed = (most * generator.random() for most in (most_held, most_extent, most_placed))
    turns = generator.normal(0.0, held, (len(_MIRROR), 3))
    if generator.random() < symmetric:
        turns = (turns + turns[_MIRROR] * (1.0, -1.0, -1.0)) / np.sqrt(2.0)
    rotations = to_matrix(from_axis_angle(_PASSING @ turns))
    extents = generator.normal(0.0, extent, len(_MIRROR))
    extents = np.exp((extents + extents[_MIRROR]) / 2.0)[:, None]
    places = generator.normal(0.0, placed / np.sqrt(3.0), (len(_MIRROR), 3))
    places = (places + places[_MIRROR] * (-1.0, 1.0, 1.0)) / np.sqrt(2.0)

    frames, pelvis = _frame_trunks(points), points[:, _PELVIS : _PELVIS + 1]
    bones = (points - points[:, _PARENTS]) @ frames
    lengths = np.linalg.norm(bones, axis=2, keepdims=True) + 1e-9
    directions = bones / lengths
    means = directions.mean(axis=0)
    directions = means + extents * (directions - means)
    directions *= lengths / (np.linalg.norm(directions, axis=2, keepdims=True) + 1e-9)
    bones = (directions.transpose(1, 0, 2) @ rotations.transpose(0, 2, 1)).transpose(1, 0, 2)
    moved: FloatArray = pelvis + (_REACHED @ bones + places) @ frames.transpose(0, 2, 1)
    moved[..., 1] += (points[..., 1].min(axis=1) - moved[..., 1].min(axis=1))[:, None]
    return moved


# The root is its own parent, by definition.
_PARENTS = np.array([joint if parent < 0 else parent for joint, parent in enumerate(CANONICAL_PARENTS)])


def _sum_along_bones(share: float) -> FloatArray:
    """Return (20, 20) shares of all bones in each joint: its own, and its ancestors' times ``share`` for each step."""
    table = np.eye(len(CANONICAL_PARENTS))
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            table[joint] += share * table[parent]
    return table


# Half of the turn of a bone is passed on to its children (docs/confidence.md).
_PASSING, _REACHED = _sum_along_bones(0.5), _sum_along_bones(1.0)


def _frame_trunks(points: FloatArray) -> FloatArray:
    """Return (n, 3, 3) axes of the trunk as columns: to the left, along the spine, and across both."""
    along = points[:, _NECK] - points[:, _PELVIS]
    along = along / (np.linalg.norm(along, axis=1, keepdims=True) + 1e-9)
    left = points[:, _SIDES[0]] + points[:, _SIDES[1]] - points[:, _SIDES[2]] - points[:, _SIDES[3]]
    left = left - (left * along).sum(axis=1, keepdims=True) * along
    left /= np.linalg.norm(left, axis=1, keepdims=True) + 1e-9
    return np.stack([left, along, np.cross(left, along)], axis=2)


def _stretch_bones(points: FloatArray, generator: np.random.Generator, log_length: float = 0.06) -> FloatArray:
    factors = np.exp(generator.normal(0.0, log_length, points.shape[1]))
    factors = np.sqrt(factors * factors[_MIRROR])[:, None]  # the same left and right
    bones = (points - points[:, _PARENTS]) * factors
    stretched: FloatArray = points[:, _PELVIS : _PELVIS + 1] + _REACHED @ bones
    return stretched


def _tilt(points: FloatArray, generator: np.random.Generator, spread: float = 0.07) -> FloatArray:
    """Turn points about their middle, by angles of a ``spread`` in rad about both horizontal axes."""
    a, b = generator.normal(0.0, spread, 2)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(a), -np.sin(a)], [0.0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(b), -np.sin(b), 0.0], [np.sin(b), np.cos(b), 0.0], [0.0, 0.0, 1.0]])
    middle = points.mean(axis=(0, 1))
    turned: FloatArray = (points - middle) @ (about_x @ about_z).T + middle
    return turned


def _sample_slower(points: FloatArray, count: int) -> FloatArray:
    """Sample ``count`` single poses at equal distances, as a slow sensor does."""
    places = np.clip((np.arange(count) + 0.5) * len(points) / count - 0.5, 0, len(points) - 1)
    return read_between(points.reshape(len(points), -1), places).reshape(count, *points.shape[1:])


def _lose_joints(
    points: FloatArray, generator: np.random.Generator, missing: float = 0.1, longest_gap: int = 6
) -> FloatArray:
    """Remove joints for some frames, and hold or bridge them linearly.

    At most a share ``missing`` of the frames of a joint is removed, in gaps below ``longest_gap`` frames.
    """
    share, length = missing * generator.random() ** 2, int(generator.integers(1, longest_gap))
    held = generator.random() < 0.5
    lost = generator.random(points.shape[:2]) < share / length
    gone = lost.copy()
    for k in range(1, min(length, len(points))):
        gone[k:] |= lost[:-k]
    gone[0] = False
    frames = np.arange(len(points))[:, None]
    before = np.maximum.accumulate(np.where(gone, 0, frames))
    after = before
    if not held:
        after = np.minimum.accumulate(np.where(gone, len(points), frames)[::-1])[::-1]
        after = np.where(after < len(points), after, before)  # nothing follows a gap at the end
    share_of = ((frames - before) / np.maximum(after - before, 1))[..., None]
    joints = np.arange(points.shape[1])
    bridged: FloatArray = points[before, joints] * (1.0 - share_of) + points[after, joints] * share_of
    return bridged
