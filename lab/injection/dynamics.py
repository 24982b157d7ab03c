"""Errors made by dynamics: a limb or a body is a system that follows its target, and follows it badly.

Late is a dead time, a critically damped spring, or a reaction time before a spring or a limit of speed; smaller is a
velocity that is followed in part, or a joint that goes no further; wrong is a target that was replaced and is followed
through a spring. What came of it is measured afterwards, as a spring makes a movement late *and* small: what is
neither one nor the other is dropped.
Directions are followed as the eye sees them: relative to where the body faces, not to the part that they hang on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.joints import MIRRORED_JOINTS
from lab.injection.composition import Maker, Recipe, Scene, keep_floor
from lab.injection.edits import (
    Body,
    find_heading,
    measure_angles,
    put_together,
    rotate,
    sample_body,
    slerp,
    take_apart,
    turn,
)
from lab.injection.truth import Draft

_LAGS_S = (0.1, 0.45)
_SPRING_LAGS_S = (0.1, 0.35)
_REACTIONS_S = (0.06, 0.25)
_SPEEDS = (0.5, 0.9)  # of the fastest in the stretch
_VELOCITY_GAINS = (0.2, 0.65)
_DRIFTS_S = (1.0, 4.0)
_LIMITS = (0.35, 0.75)  # of the angle from the first pose that is asked for
_RESPONSES_S = (0.05, 0.12)  # lag of a limb that follows a wrong target
_JOLT_S = 0.03  # lag of a limb that meets its limit
_PHASES_S = (1.0, 1.6)
_ANGLES = np.radians((25.0, 80.0))
_MIRRORED_BONES = [joint - 1 for joint in MIRRORED_JOINTS[1:]]


def follow_spring(target: FloatArray, lag_s: float, frame_rate: float) -> FloatArray:
    """What a critically damped spring makes of a target (n, ...), starting at rest on it.

    A slow movement comes ``lag_s`` late and as large; a fast one also smaller: the response at angular frequency w is
    ``1 / (1 + j w lag_s / 2) ** 2``. Each step solves ``y'' = s^2 (x - y) - 2 s y'`` with ``s = 2 / lag_s`` exactly
    for the target at the middle of the step.
    """
    stiffness, step = 2.0 / lag_s, 1.0 / frame_rate
    decay = np.exp(-stiffness * step)
    middles = 0.5 * (target[1:] + target[:-1])
    followed = np.empty_like(target)
    place, speed = target[0].copy(), np.zeros_like(target[0])
    followed[0] = place
    for number, middle in enumerate(middles, 1):
        off = place - middle
        drive = (speed + stiffness * off) * step
        place = middle + (off + drive) * decay
        speed = (speed - stiffness * drive) * decay
        followed[number] = place
    return followed


def follow_slowly(target: FloatArray, most: float) -> FloatArray:
    """Unit vectors (n, K, 3) that follow a target by at most ``most`` rad a frame."""
    followed = np.empty_like(target)
    place = followed[0] = target[0]
    for number, goal in enumerate(target[1:], 1):
        angle = np.arccos(np.clip((place * goal).sum(axis=1), -1.0, 1.0))
        share = np.minimum(1.0, most / np.maximum(angle, 1e-9))
        place = followed[number] = slerp(place, goal, share[:, None])
    return followed


def follow_weakly(target: FloatArray, gain: float, drift_s: float, frame_rate: float) -> FloatArray:
    """Vectors (n, K, 3) that make ``gain`` of the target's steps and drift back to it within ``drift_s``."""
    pull = 1.0 / (drift_s * frame_rate)
    followed = np.empty_like(target)
    place = followed[0] = target[0]
    for number, step in enumerate(target[1:] - target[:-1], 1):
        place = followed[number] = place + gain * step + pull * (target[number] - place)
    return followed


def stop_at_limit(target: FloatArray, centre: FloatArray, most: FloatArray) -> FloatArray:
    """Unit vectors (n, K, 3), none further than ``most`` (K,) rad from ``centre`` (K, 3)."""
    angle = np.radians(measure_angles(target, centre[None]))
    share = np.minimum(1.0, most / np.maximum(angle, 1e-9))
    return slerp(np.broadcast_to(centre, target.shape), target, share[..., None])


def _unit(vectors: FloatArray) -> FloatArray:
    unit: FloatArray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
    return unit


def _free(scene: Scene) -> FloatArray:
    """(n, K, 3) heading-free directions of the group's bones."""
    part = slice(scene.stretch.start, scene.stretch.stop)
    return turn(scene.take.body.directions[part][:, scene.group.bones], -scene.heading)


def _finish(scene: Scene, free: FloatArray) -> Draft:
    """Fade from the clean directions to those that a system made (n, K, 3), heading-free."""
    stretch, weight, bones = scene.stretch, scene.stretch.weight, list(scene.group.bones)
    body = scene.take.body.cut(stretch.start, stretch.stop)
    directions = body.directions.copy()
    wrong = turn(_unit(free), scene.heading)
    directions[:, bones] = slerp(directions[:, bones], wrong, weight[:, None, None])
    positions = put_together(Body(body.root, directions, body.lengths))
    return Draft(keep_floor(scene.clean, positions), weight, scene.group)


def _finish_late(scene: Scene, late: Body) -> Draft:
    """Fade from the clean body to one that is late as a whole, place and facing too."""
    stretch, weight = scene.stretch, scene.stretch.weight
    body = scene.take.body.cut(stretch.start, stretch.stop)
    root = body.root + weight[:, None] * (late.root - body.root)
    directions = slerp(body.directions, _unit(late.directions), weight[:, None, None])
    return Draft(put_together(Body(root, directions, body.lengths)), weight, scene.group)


# Late


def _dead_time(late: bool) -> Maker:
    """All is done a fixed time later, or earlier; the fade is between the two poses, not in time."""

    def make(scene: Scene, rng: np.random.Generator) -> Draft | None:
        stretch, take = scene.stretch, scene.take
        delay = float(rng.uniform(*_LAGS_S) * stretch.frame_rate)
        frames = np.arange(stretch.start, stretch.stop, dtype=np.float64)
        frames -= delay if late else -delay
        if frames[0] < 0.0 or frames[-1] > take.n_frames - 1:
            return None
        moved = sample_body(take.body, frames)
        if scene.group.is_whole:
            return _finish_late(scene, moved)
        heading = np.interp(frames, np.arange(take.n_frames), take.heading)
        return _finish(scene, turn(moved.directions[:, scene.group.bones], -heading))

    return make


def _spring(scene: Scene, rng: np.random.Generator) -> Draft:
    lag, rate = float(rng.uniform(*_SPRING_LAGS_S)), scene.stretch.frame_rate
    if not scene.group.is_whole:
        return _finish(scene, follow_spring(_free(scene), lag, rate))
    body = scene.take.body.cut(scene.stretch.start, scene.stretch.stop)
    together = np.concatenate([body.root[:, None], body.directions], axis=1)
    followed = follow_spring(together, lag, rate)
    return _finish_late(scene, Body(followed[:, 0], followed[:, 1:], body.lengths))


def _react(scene: Scene, rng: np.random.Generator) -> FloatArray:
    """What the limb should have done one reaction time ago; at the onset it waits."""
    free = _free(scene)
    delay = round(rng.uniform(*_REACTIONS_S) * scene.stretch.frame_rate)
    return free[np.maximum(np.arange(len(free)) - delay, 0)]


def _react_softly(scene: Scene, rng: np.random.Generator) -> Draft:
    """A reaction time, and then a spring."""
    lag = float(rng.uniform(0.04, 0.14))
    return _finish(scene, follow_spring(_react(scene, rng), lag, scene.stretch.frame_rate))


def _react_slowly(scene: Scene, rng: np.random.Generator) -> Draft:
    """A reaction time, and then no faster than a share of the fastest that is asked for."""
    free = _react(scene, rng)
    fastest = np.radians(np.percentile(measure_angles(free[1:], free[:-1]).max(axis=1), 95))
    return _finish(scene, follow_slowly(free, max(float(rng.uniform(*_SPEEDS) * fastest), 1e-4)))


# Smaller


def _weak(scene: Scene, rng: np.random.Generator) -> Draft:
    gain, drift = rng.uniform(*_VELOCITY_GAINS), rng.uniform(*_DRIFTS_S)
    return _finish(scene, follow_weakly(_free(scene), gain, drift, scene.stretch.frame_rate))


def _blocked(scene: Scene, rng: np.random.Generator) -> Draft:
    """Joints that go no further than a share of what is asked, and meet that limit hard."""
    free = _free(scene)
    centre = _unit(free[: max(len(free) // 10, 1)].mean(axis=0)) if rng.random() < 0.7 else _unit(free.mean(axis=0))
    most = rng.uniform(*_LIMITS) * np.radians(measure_angles(free, centre[None]).max(axis=0))
    stopped = stop_at_limit(free, centre, np.maximum(most, 1e-3))
    return _finish(scene, follow_spring(stopped, _JOLT_S, scene.stretch.frame_rate))


def _sluggish(scene: Scene, rng: np.random.Generator) -> Draft:
    """A spring run to and fro over the stretch: what is fast gets smaller, and nothing comes late."""
    lag, rate, free = rng.uniform(0.25, 0.9), scene.stretch.frame_rate, _free(scene)
    there = follow_spring(free, lag, rate)
    return _finish(scene, follow_spring(there[::-1], lag, rate)[::-1])


# Wrong

_Target = Callable[[Scene, np.random.Generator], FloatArray | None]


def _replace(find_target: _Target) -> Maker:
    """The target is replaced for the stretch; the limb swings to the new one, and back in the fade."""

    def make(scene: Scene, rng: np.random.Generator) -> Draft | None:
        target = find_target(scene, rng)
        if target is None:
            return None
        free = _free(scene)
        rate = scene.stretch.frame_rate
        switch = max(round(min(0.5 * scene.stretch.rise, 0.2 * rate)), 1)
        whole = np.concatenate([free[:switch], target[switch:]])
        return _finish(scene, follow_spring(whole, rng.uniform(*_RESPONSES_S), rate))

    return make


def _frozen(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    free = _free(scene)
    return np.broadcast_to(free[:1], free.shape)


def _donor(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    positions = scene.section(rng)
    if positions is None:
        return None
    heading = find_heading(positions, scene.stretch.frame_rate)
    return turn(take_apart(positions).directions[:, scene.group.bones], -heading)


def _held(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    free = _donor(scene, rng)
    return None if free is None else np.broadcast_to(free[:1], free.shape)


def _other_side(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    part = slice(scene.stretch.start, scene.stretch.stop)
    opposite = [_MIRRORED_BONES[bone] for bone in scene.group.bones]
    return turn(scene.take.body.directions[part][:, opposite], -scene.heading) * (-1.0, 1.0, 1.0)


def _reversed(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    return _free(scene)[::-1]


def _out_of_phase(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    """What is due a second and more before or after."""
    stretch, take = scene.stretch, scene.take
    shift = round(rng.uniform(*_PHASES_S) * stretch.frame_rate) * (1 if rng.random() < 0.5 else -1)
    start, stop = stretch.start + shift, stretch.stop + shift
    if start < 0 or stop > take.n_frames:
        return None
    return turn(take.body.directions[start:stop][:, scene.group.bones], -take.heading[start:stop])


def _rotated(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    """The limb's target turned about a fixed axis that goes along with the body."""
    free = _free(scene)
    axis = rng.standard_normal(3) * (1.0, 0.5, 1.0)
    angle = rng.uniform(*_ANGLES)
    axis /= np.linalg.norm(axis)
    turned = rotate(free, axis, np.full(len(free), angle))
    if len(scene.group.segments) > 2:
        half = len(scene.group.bones) // 2
        mirrored = rotate(free[:, half:], axis * (1.0, -1.0, -1.0), np.full(len(free), angle))
        turned = np.concatenate([turned[:, :half], mirrored], axis=1)
    return turned


def _opposite(scene: Scene, rng: np.random.Generator) -> FloatArray | None:
    """The first pose's steps the other way."""
    free = _free(scene)
    centre = free[:1]
    opposite: FloatArray = 2.0 * (free * centre).sum(axis=2, keepdims=True) * centre - free
    return opposite


RECIPES: tuple[Recipe, ...] = (
    Recipe("shift", "late", _dead_time(True), whole=True),
    Recipe("shift", "early", _dead_time(False), whole=True),
    Recipe("shift", "late", _spring, whole=True),
    Recipe("shift", "limb late", _dead_time(True), whole=False),
    Recipe("shift", "limb early", _dead_time(False), whole=False),
    Recipe("shift", "limb late", _spring, whole=False),
    Recipe("shift", "limb late", _react_softly, whole=False),
    Recipe("shift", "limb late", _react_slowly, whole=False),
    Recipe("incomplete", "stops short", _blocked, whole=True),
    Recipe("incomplete", "body shrunk", _weak, whole=True),
    Recipe("incomplete", "body shrunk", _sluggish, whole=True),
    Recipe("incomplete", "limb stops short", _blocked, whole=False),
    Recipe("incomplete", "limb shrunk", _weak, whole=False),
    Recipe("incomplete", "limb shrunk", _sluggish, whole=False),
    Recipe("partial", "limb from elsewhere", _replace(_donor), whole=False, moving=False, lower=True),
    Recipe("partial", "limb frozen", _replace(_frozen), whole=False, lower=True),
    Recipe("partial", "limb held", _replace(_held), whole=False, moving=False, lower=True),
    Recipe("partial", "limb mirrored", _replace(_other_side), whole=False, moving=False),
    Recipe("partial", "limb reversed", _replace(_reversed), whole=False, lower=True),
    Recipe("partial", "limb out of phase", _replace(_out_of_phase), whole=False, lower=True),
    Recipe("partial", "limb rotated", _replace(_rotated), whole=False, moving=False),
    Recipe("partial", "limb opposite", _replace(_opposite), whole=False),
    Recipe("global", "section from elsewhere", _replace(_donor), whole=True, moving=False),
    Recipe("global", "body mirrored", _replace(_other_side), whole=True, moving=False),
)
"""The ways to go wrong of the generator ``"dynamics"``."""
