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
from dousa.retrieval.features.posed_motion import LabelledClip, PosedMotion
from dousa.retrieval.takes.windows import TAKE_RATE

BLEND_SECONDS = (0.3, 0.5)

SERIES = 3
"""Least number of neighbours of one category that count as one repeated action."""

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
    clips: Sequence[LabelledClip], generator: np.random.Generator, *, tempos: Sequence[float] | None = None
) -> JoinedTake:
    """Join clips of one performer into a take, with blends of random lengths, 0.3 to 0.5 s.

    ``tempos`` are speeds relative to the recordings; None for as recorded. TrainingError : no clip.
    """
    from dousa.retrieval.features.channels import sample_positions

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


_BLENDS = (0.2, 1.2)  # s, of joins with rests
_RESTS = (0.3, 4.0)
_REST_SHARE = 0.4  # of the joins
_SWAY = 0.002  # m a frame, random drift of a resting body
_TEMPO = 0.35  # spread of the log tempo


def join_with_rests(clips: Sequence[LabelledClip], generator: np.random.Generator) -> JoinedTake:
    """Join clips of one performer at random tempos, with slow blends and some rests, pieces without a category."""
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
    """Return (n, 20, 3) from one pose to another: a blend, and sometimes a rest before or after it."""
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
    """Mirror (n, 20, 3) canonical joints."""
    image = np.take(points, MIRRORED_JOINTS, axis=1)
    np.negative(image[..., 0], out=image[..., 0])
    return image


MOVED_SHARE = 0.75
"""Share of the disturbed clips that are moved differently."""

_HELD, _EXTENT, _PLACED = 0.3, 0.3, 0.06  # greatest spreads over the bones: rad, log extent, m
_PASSED_ON = 0.5  # share of the turn of a bone passed on to its children
_ALIKE = 0.8  # share of people with symmetric posture
_BONES, _TILT, _HEIGHT = 0.06, 0.07, 0.03  # spreads: log lengths of bones, rad of the camera, log height
_SLOWEST = 10.0  # Hz
_NOISE = 0.035  # m, of the noisiest joints
_MISSING = 0.1  # greatest share of missing frames of a joint
_LONGEST_GAP = 6  # frames
_DRIFT, _LASTING = 0.05, (0.7, 4.0)  # m, of the largest lasting errors; frames of their standard deviation
_JUMP, _JUMPS, _JUMP_SHARE = 0.1, 0.01, 0.3  # m; share of the frames of a joint; share of the takes with jumps


def disturb(take: JoinedTake, generator: np.random.Generator) -> JoinedTake:
    """Give a take at ``TAKE_RATE`` another body, a tilted camera, and a slower, noisier sensor that loses joints."""
    points = _tilt(_stretch_bones(take.positions, generator), generator)
    rate = take.frame_rate
    if generator.random() < 0.5:
        rate = float(generator.uniform(_SLOWEST, rate))
        points = _sample_slower(points, max(round(len(points) * rate / take.frame_rate), 2))
        rate = take.frame_rate * len(points) / len(take.positions)
    noise = (
        _NOISE * generator.random() ** 2 / np.sqrt(3.0) * np.exp(generator.normal(0.0, 0.3, (1, points.shape[1], 1)))
    )
    points = points + generator.normal(size=points.shape) * noise
    points = _lose_joints(points, generator)
    if generator.random() < _JUMP_SHARE:
        jumping = generator.random(points.shape[:2]) < _JUMPS
        points[jumping] += generator.normal(0.0, _JUMP, (int(jumping.sum()), 3))
    height = take.height * float(np.exp(generator.normal(0.0, _HEIGHT)))
    return replace(take, positions=points, height=height, frame_rate=rate)


def disturb_motion(motion: PosedMotion, generator: np.random.Generator) -> JoinedTake:
    """Disturb a clip as ``disturb``, move three of four differently, and give half of them errors over some frames."""
    from dousa.retrieval.features.channels import sample_positions, smooth_positions

    points = sample_positions(motion.positions, motion.frame_rate)
    if generator.random() < MOVED_SHARE:
        points = move_differently(points, generator)
    if generator.random() < 0.5:
        errors = smooth_positions(generator.normal(size=points.shape), generator.uniform(*_LASTING))
        errors /= errors.std() + 1e-9
        points = points + errors * (_DRIFT * np.sqrt(generator.random() / 3.0))
    return disturb(JoinedTake(points, motion.height, ()), generator)


_PELVIS, _NECK = JOINT_INDEX["pelvis"], JOINT_INDEX["neck"]
_SIDES = tuple(JOINT_INDEX[name] for name in ("left_hip", "left_shoulder", "right_hip", "right_shoulder"))
_MIRROR = list(MIRRORED_JOINTS)


def move_differently(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Change the posture and the extent of the movement of points (n, 20, 3) m at random; feet stay on the floor.

    Each bone is turned by a constant angle, its way about its mean direction is scaled, and joints are displaced as
    between sensors and skeletons, all in the frame of the trunk. The whole body is then moved up or down so that the
    lowest joint keeps its height.
    """
    held, extent, placed = (most * generator.random() for most in (_HELD, _EXTENT, _PLACED))
    turns = generator.normal(0.0, held, (len(_MIRROR), 3))
    if generator.random() < _ALIKE:
        turns = (turns + turns[_MIRROR] * (1.0, -1.0, -1.0)) / np.sqrt(2.0)
    rotations = to_matrix(from_axis_angle(_PASSING @ turns))
    extents = generator.normal(0.0, extent, len(_MIRROR))
    extents = np.exp((extents + extents[_MIRROR]) / 2.0)[:, None]
    places = generator.normal(0.0, placed / np.sqrt(3.0), (len(_MIRROR), 3))
    places = (places + places[_MIRROR] * (-1.0, 1.0, 1.0)) / np.sqrt(2.0)

    frames, pelvis = _frame_trunks(points), points[:, _PELVIS : _PELVIS + 1]
    bones = (points - points[:, _PARENTS]) @ frames
    lengths = np.linalg.norm(bones, axis=2, keepdims=True) + _TINY
    directions = bones / lengths
    means = directions.mean(axis=0)
    directions = means + extents * (directions - means)
    directions *= lengths / (np.linalg.norm(directions, axis=2, keepdims=True) + _TINY)
    bones = (directions.transpose(1, 0, 2) @ rotations.transpose(0, 2, 1)).transpose(1, 0, 2)
    moved: FloatArray = pelvis + (_REACHED @ bones + places) @ frames.transpose(0, 2, 1)
    moved[..., 1] += (points[..., 1].min(axis=1) - moved[..., 1].min(axis=1))[:, None]
    return moved


_TINY = 1e-9
_PARENTS = np.array([joint if parent < 0 else parent for joint, parent in enumerate(CANONICAL_PARENTS)])


def _sum_along_bones(share: float) -> FloatArray:
    """Return (20, 20) shares of all bones in each joint: its own, and its ancestors' times ``share`` for each step."""
    table = np.eye(len(CANONICAL_PARENTS))
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            table[joint] += share * table[parent]
    return table


_PASSING, _REACHED = _sum_along_bones(_PASSED_ON), _sum_along_bones(1.0)


def _frame_trunks(points: FloatArray) -> FloatArray:
    """Return (n, 3, 3) axes of the trunk as columns: to the left, along the spine, and across both."""
    along = points[:, _NECK] - points[:, _PELVIS]
    along = along / (np.linalg.norm(along, axis=1, keepdims=True) + _TINY)
    left = points[:, _SIDES[0]] + points[:, _SIDES[1]] - points[:, _SIDES[2]] - points[:, _SIDES[3]]
    left = left - (left * along).sum(axis=1, keepdims=True) * along
    left /= np.linalg.norm(left, axis=1, keepdims=True) + _TINY
    return np.stack([left, along, np.cross(left, along)], axis=2)


def _stretch_bones(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    factors = np.exp(generator.normal(0.0, _BONES, points.shape[1]))
    factors = np.sqrt(factors * factors[list(MIRRORED_JOINTS)])  # the same left and right
    stretched = points.copy()
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            stretched[:, joint] = stretched[:, parent] + (points[:, joint] - points[:, parent]) * factors[joint]
    return stretched


def _tilt(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    a, b = generator.normal(0.0, _TILT, 2)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(a), -np.sin(a)], [0.0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(b), -np.sin(b), 0.0], [np.sin(b), np.cos(b), 0.0], [0.0, 0.0, 1.0]])
    middle = points.mean(axis=(0, 1))
    turned: FloatArray = (points - middle) @ (about_x @ about_z).T + middle
    return turned


def _sample_slower(points: FloatArray, count: int) -> FloatArray:
    """Sample ``count`` single poses at equal distances, as a slow sensor does."""
    places = np.clip((np.arange(count) + 0.5) * len(points) / count - 0.5, 0, len(points) - 1)
    below = np.minimum(places.astype(np.intp), max(len(points) - 2, 0))
    share = (places - below)[:, None, None]
    sampled: FloatArray = points[below] * (1.0 - share) + points[np.minimum(below + 1, len(points) - 1)] * share
    return sampled


def _lose_joints(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Remove joints for some frames, and hold or bridge them linearly."""
    share, length = _MISSING * generator.random() ** 2, int(generator.integers(1, _LONGEST_GAP))
    held = generator.random() < 0.5
    lost = generator.random(points.shape[:2]) < share / length
    gone = lost.copy()
    for k in range(1, min(length, len(points))):
        gone[k:] |= lost[:-k]
    gone[0] = False
    points = points.copy()
    frames = np.arange(len(points))
    for joint in np.flatnonzero(gone.any(axis=0)):
        seen = np.flatnonzero(~gone[:, joint])
        before = seen[np.searchsorted(seen, frames, side="right") - 1]
        after = before if held else seen[np.minimum(np.searchsorted(seen, frames), len(seen) - 1)]
        share_of = ((frames - before) / np.maximum(after - before, 1))[:, None]
        points[:, joint] = points[before, joint] * (1.0 - share_of) + points[after, joint] * share_of
    return points
