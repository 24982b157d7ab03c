"""Motions as somebody else may do them, and as another sensor may see them.

The people and the sensor of a library are few. Disturbed copies of its clips and takes show what another body, another
way of holding and moving it, another camera, frame rate and noise do to the same motion, so that none of these is taken
for what tells one motion from another, nor for strangeness.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.joints import CANONICAL_PARENTS, JOINT_INDEX, MIRRORED_JOINTS
from dousa.motion.rotations import from_axis_angle, to_matrix
from dousa.retrieval.features.posed_motion import PosedMotion
from dousa.retrieval.takes.material.made_takes import JoinedTake

MOVED_SHARE = 0.75
"""Of the clips that are disturbed, by somebody who moves differently."""

_HELD, _EXTENT, _PLACED = 0.3, 0.3, 0.06  # at most: rad, log extent, m; spreads over the bones
_PASSED_ON = 0.5  # of how a bone is turned, to those behind it
_ALIKE = 0.8  # of the people hold both sides alike
_BONES, _TILT, _HEIGHT = 0.06, 0.07, 0.03  # spreads: log lengths of bones, rad of the camera, log height
_SLOWEST = 10.0  # Hz
_NOISE = 0.035  # m, of the noisiest joints
_MISSING = 0.1  # of the frames of a joint, at most
_LONGEST_GAP = 6  # frames
_DRIFT, _LASTING = 0.05, (0.7, 4.0)  # m, of the largest errors that last; frames of their standard deviation
_JUMP, _JUMPS, _JUMP_SHARE = 0.1, 0.01, 0.3  # m; share of the frames of a joint; share of the takes that have such


def disturb(take: JoinedTake, generator: np.random.Generator) -> JoinedTake:
    """The same take with another body, a tilted camera, a slower and noisier sensor that loses joints.

    Parameters
    ----------
    take : at ``TAKE_RATE``.
    generator : draws how much of each.
    """
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
    """A clip as somebody else may have done it and another sensor seen it; all its joints have a place.

    As in ``disturb``; three of four are moved differently, and half have errors that last for some frames, which no
    filter takes off.
    """
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
    """The same motion by somebody who holds the limbs otherwise and moves them more or less; feet stay on the floor.

    Each bone is turned by an angle that stays, its way about its mean direction is longer or shorter, and joints are
    seen at another place of the body, as every sensor and skeleton has its own: all in the frame of the trunk.

    Parameters
    ----------
    points : (n, 20, 3) m.
    generator : draws how.

    Returns
    -------
    (n, 20, 3) m; the pelvis moves as it did, but up or down where otherwise the lowest joint would.
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
    """(20, 20) what each joint gets of its own bone and of those before it, ``share`` of it passed on by each."""
    table = np.eye(len(CANONICAL_PARENTS))
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            table[joint] += share * table[parent]
    return table


_PASSING, _REACHED = _sum_along_bones(_PASSED_ON), _sum_along_bones(1.0)


def _frame_trunks(points: FloatArray) -> FloatArray:
    """(n, 3, 3) axes of the trunk as columns: to the left, along the spine, and across both."""
    along = points[:, _NECK] - points[:, _PELVIS]
    along = along / (np.linalg.norm(along, axis=1, keepdims=True) + _TINY)
    left = points[:, _SIDES[0]] + points[:, _SIDES[1]] - points[:, _SIDES[2]] - points[:, _SIDES[3]]
    left = left - (left * along).sum(axis=1, keepdims=True) * along
    left /= np.linalg.norm(left, axis=1, keepdims=True) + _TINY
    return np.stack([left, along, np.cross(left, along)], axis=2)


def _stretch_bones(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    factors = np.exp(generator.normal(0.0, _BONES, points.shape[1]))
    factors = np.sqrt(factors * factors[list(MIRRORED_JOINTS)])  # left and right alike
    stretched = points.copy()
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent >= 0:
            stretched[:, joint] = stretched[:, parent] + (points[:, joint] - points[:, parent]) * factors[joint]
    return stretched


def _tilt(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Turned a little about both horizontal axes."""
    a, b = generator.normal(0.0, _TILT, 2)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(a), -np.sin(a)], [0.0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(b), -np.sin(b), 0.0], [np.sin(b), np.cos(b), 0.0], [0.0, 0.0, 1.0]])
    middle = points.mean(axis=(0, 1))
    turned: FloatArray = (points - middle) @ (about_x @ about_z).T + middle
    return turned


def _sample_slower(points: FloatArray, count: int) -> FloatArray:
    """So many single poses at equal distances, as a slow sensor sees them."""
    places = np.clip((np.arange(count) + 0.5) * len(points) / count - 0.5, 0, len(points) - 1)
    below = np.minimum(places.astype(np.intp), max(len(points) - 2, 0))
    share = (places - below)[:, None, None]
    sampled: FloatArray = points[below] * (1.0 - share) + points[np.minimum(below + 1, len(points) - 1)] * share
    return sampled


def _lose_joints(points: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Some joints are gone for some frames, and held or bridged in a straight line."""
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
