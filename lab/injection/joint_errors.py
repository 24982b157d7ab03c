"""Errors made joint by joint: each limb in the frame of the part that it hangs on.

Late is a delay that grows (the limb lingers), holds, and is caught up with by moving faster; early the other way
round. Smaller is an angle reduced about a pose, an end of the way that is never reached, or an elbow or knee that
hardly bends. Wrong is another rotation of the same joints. The trunk's own movement carries a wrong limb along.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion import rotations
from lab.injection.composition import Maker, Recipe, Scene, keep_floor
from lab.injection.edits import rotate, slerp
from lab.injection.local_pose import REST, LocalPose, blend, to_local, to_positions
from lab.injection.truth import LOWER_GROUPS, Draft, Group, Stretch

_LAGS_S = (0.1, 0.45)
_LINGER, _HURRY = 1.0, 1.5  # s of lag gained a second, standing still; and lost, at two and a half times the pace
_LONGEST_RAMP_S = 0.8
_HOLD_S = 0.35
_CORNER_S = 0.05  # half width of what rounds the corners of a delay
_GAINS = (0.2, 0.7)
_REACHES = (0.35, 0.75)
_SOFT = 0.06  # of the way: how gradually the end of it is met
_ANGLES = np.radians((25.0, 80.0))
_STRAIGHT = 0.15  # sine below which a bend has no clear direction


def _draw_delay(stretch: Stretch, late: bool, rng: np.random.Generator) -> FloatArray | None:
    """Delay (n,) s: trapezoid with rounded corners, 0 at both ends; None if the stretch is too short."""
    n, rate = stretch.n_frames, stretch.frame_rate
    room = stretch.duration_s - 2.0 * _CORNER_S - _HOLD_S - 1.0 / rate
    most = min(_LAGS_S[1], room / (1.0 / _LINGER + 1.0 / _HURRY))
    if most < _LAGS_S[0]:
        return None
    lag = float(rng.uniform(_LAGS_S[0], most))
    shortest = np.array([lag / _LINGER, lag / _HURRY])
    spare = np.minimum(_LONGEST_RAMP_S - shortest, room - shortest.sum()).clip(0.0)
    ramps = shortest + spare * rng.uniform(0.0, 0.5, 2)
    first, last = ramps if late else ramps[::-1]
    times = np.arange(n) / rate
    end = times[-1] - _CORNER_S
    profile = np.minimum((times - _CORNER_S) / first, (end - times) / last).clip(0.0, 1.0)
    half = int(_CORNER_S * rate)
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return (lag if late else -lag) * np.convolve(profile, kernel, mode="same")


def _delay(late: bool) -> Maker:
    def make(scene: Scene, rng: np.random.Generator) -> Draft | None:
        delay = _draw_delay(scene.stretch, late, rng)
        if delay is None:
            return None
        clean = to_local(scene.clean)
        moved = clean.sampled(np.arange(clean.n_frames) - delay * scene.stretch.frame_rate)
        weight = np.abs(delay) / np.abs(delay).max()
        if scene.group.is_whole:
            return Draft(to_positions(moved), weight, scene.group, delay)
        return _finish(scene, _with_bones(clean, scene.group, moved.bones), weight, scene.group, delay)

    return make


def _with_bones(pose: LocalPose, group: Group, bones: FloatArray) -> LocalPose:
    """The pose with the group's bones from (n, 19, 3)."""
    mixed, chosen = pose.bones.copy(), list(group.bones)
    mixed[:, chosen] = bones[:, chosen]
    return replace(pose, bones=mixed)


def _finish(
    scene: Scene, pose: LocalPose, weight: FloatArray, group: Group | None = None, lag_s: FloatArray | None = None
) -> Draft:
    return Draft(keep_floor(scene.clean, to_positions(pose)), weight, group or scene.group, lag_s)


def _fade(scene: Scene, clean: LocalPose, wrong: LocalPose, group: Group | None = None) -> Draft:
    """From the clean pose to the wrong one and back; of limbs their bones only."""
    group, weight = group or scene.group, scene.stretch.weight
    if group.is_whole:
        mixed = replace(blend(clean, wrong, weight), root=clean.root, lengths=clean.lengths)
        return _finish(scene, mixed, weight, group)
    chosen = list(group.bones)
    bones = clean.bones.copy()
    bones[:, chosen] = slerp(clean.bones[:, chosen], wrong.bones[:, chosen], weight[:, None, None])
    return _finish(scene, replace(clean, bones=bones), weight, group)


# Smaller


def _find_centre(pose: LocalPose, at_start: bool) -> LocalPose:
    """One pose (1, ...): the first, or the mean."""
    if at_start:
        return pose.take(slice(0, 1))
    bones = pose.bones.mean(axis=0, keepdims=True)
    bones /= np.maximum(np.linalg.norm(bones, axis=2, keepdims=True), 1e-9)
    return LocalPose(pose.root[:1], _mean_rotation(pose.pelvis), _mean_rotation(pose.chest), bones, pose.lengths[:1])


def _mean_rotation(quaternions: FloatArray) -> FloatArray:
    near = np.where((quaternions @ quaternions[0] < 0.0)[:, None], -quaternions, quaternions)
    return rotations.normalise(near.mean(axis=0, keepdims=True))


def _toward(pose: LocalPose, centre: LocalPose, share: FloatArray) -> LocalPose:
    """The pose drawn toward one pose by ``share`` (n,)."""
    return blend(pose, centre.take(np.zeros(pose.n_frames, dtype=np.intp)), share)


def _shrink(scene: Scene, rng: np.random.Generator) -> Draft:
    """Joint angles reduced about the first or the mean pose."""
    free = to_local(scene.clean).turned(-scene.heading)
    share = np.full(free.n_frames, 1.0 - rng.uniform(*_GAINS))
    wrong = _toward(free, _find_centre(free, rng.random() < 0.5), share)
    return _fade(scene, free.turned(scene.heading), wrong.turned(scene.heading))


def _stop_short(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """On the way from the first pose to the farthest one, the last part is not done; all joints stop together."""
    free, group = to_local(scene.clean).turned(-scene.heading), scene.group
    chosen = list(group.bones)
    chords = np.linalg.norm(free.bones[:, chosen] - free.bones[:1, chosen], axis=2)
    angles = 2.0 * np.arcsin(np.clip(0.5 * chords, 0.0, 1.0))
    way = np.sqrt((angles**2).mean(axis=1))
    farthest = float(way.max())
    if farthest < 0.1:
        return None
    # The limb leaves the way where a share of it is done and comes back to it there.
    way, soft = way / farthest, _SOFT
    reach = rng.uniform(*_REACHES)
    stopped = -soft * np.logaddexp(-way / soft, -reach / soft) + soft * np.logaddexp(0.0, -reach / soft)
    share = 1.0 - np.clip(stopped / np.maximum(way, 1e-6), 0.0, 1.0)
    wrong = _toward(free, free.take(slice(0, 1)), share)
    return _fade(scene, free.turned(scene.heading), wrong.turned(scene.heading))


def _stiffen(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """An elbow or knee bends and stretches less than it should."""
    limb = scene.group.name
    if limb not in LOWER_GROUPS:
        return None
    clean, group = to_local(scene.clean), LOWER_GROUPS[limb]
    hinge = group.bones[0]
    straight, direction = REST[hinge], clean.bones[:, hinge]
    cosine = direction @ straight
    across = direction - cosine[:, None] * straight
    sine = np.linalg.norm(across, axis=1)
    bend = np.arctan2(sine, cosine)
    usual = across.mean(axis=0)
    usual /= max(float(np.linalg.norm(usual)), 1e-9)
    across += usual * np.clip(_STRAIGHT - sine, 0.0, None)[:, None]
    across -= (across @ straight)[:, None] * straight
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    about = bend[0] if rng.random() < 0.3 else bend.mean()
    less = about + rng.uniform(0.0, 0.5) * (bend - about)
    bones = clean.bones.copy()
    bones[:, hinge] = np.cos(less)[:, None] * straight + np.sin(less)[:, None] * across
    return _fade(scene, clean, replace(clean, bones=bones), group)


# Wrong


def _from_section(scene: Scene, rng: np.random.Generator) -> LocalPose | None:
    """Poses from elsewhere, facing as the carrier does."""
    positions = scene.section(rng)
    if positions is None:
        return None
    pose = to_local(positions)
    return pose.turned(_face(pose, scene.heading))


def _face(pose: LocalPose, heading: FloatArray) -> FloatArray:
    """(n,) rad that turn a pose to a heading, its own turns left out."""
    front = rotations.rotate(pose.pelvis, np.array([0.0, 0.0, 1.0]))
    facing: FloatArray = heading - np.unwrap(np.arctan2(front[:, 0], front[:, 2]))
    return facing


def _elsewhere(scene: Scene, rng: np.random.Generator) -> Draft | None:
    wrong = _from_section(scene, rng)
    return None if wrong is None else _fade(scene, to_local(scene.clean), wrong)


def _freeze(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """The limb stays as it was when the error set in."""
    clean = to_local(scene.clean)
    first = np.full(clean.n_frames, min(int(0.5 * scene.stretch.rise), clean.n_frames - 1), dtype=np.intp)
    return _fade(scene, clean, _with_bones(clean, scene.group, clean.bones[first]))


def _hold_other(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """A pose from elsewhere, held."""
    section = _from_section(scene, rng)
    if section is None:
        return None
    still = np.zeros(section.n_frames, dtype=np.intp)
    return _fade(scene, to_local(scene.clean), section.take(still))


def _mirror(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """The limb, or the body, does what its mirror image should."""
    free = to_local(scene.clean).turned(-scene.heading)
    return _fade(scene, free.turned(scene.heading), free.mirrored().turned(scene.heading))


def _offset(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """The shoulder or hip is turned by a constant rotation; what hangs on it follows."""
    clean = to_local(scene.clean)
    bones = clean.bones.copy()
    angle = rng.uniform(*_ANGLES) * (1.0 if rng.random() < 0.5 else -1.0)
    tilt = rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(tilt), 0.3 * rng.standard_normal(), np.sin(tilt)])
    axis /= np.linalg.norm(axis)
    for place in range(0, len(scene.group.bones), 3):
        top = scene.group.bones[place]
        # Both arms go out, or up, together.
        mirrored = axis * (1.0, -1.0, -1.0) if place else axis
        bones[:, [top]] = rotate(bones[:, [top]], mirrored, np.full(clean.n_frames, angle))
    return _fade(scene, clean, replace(clean, bones=bones))


def _oppose(scene: Scene, rng: np.random.Generator) -> Draft | None:
    """Every joint goes as far the other way from the mean pose, or from the first one."""
    clean = to_local(scene.clean)
    centre = _find_centre(clean, rng.random() < 0.5).bones
    bones = 2.0 * (clean.bones * centre).sum(axis=2, keepdims=True) * centre - clean.bones
    return _fade(scene, clean, replace(clean, bones=bones))


RECIPES: tuple[Recipe, ...] = (
    Recipe("shift", "late", _delay(True), whole=True),
    Recipe("shift", "early", _delay(False), whole=True),
    Recipe("shift", "limb late", _delay(True), whole=False),
    Recipe("shift", "limb early", _delay(False), whole=False),
    Recipe("incomplete", "stops short", _stop_short, whole=True),
    Recipe("incomplete", "body shrunk", _shrink, whole=True),
    Recipe("incomplete", "limb stops short", _stop_short, whole=False),
    Recipe("incomplete", "limb shrunk", _shrink, whole=False),
    Recipe("incomplete", "limb stiff", _stiffen, whole=False),
    Recipe("partial", "limb from elsewhere", _elsewhere, whole=False, moving=False, lower=True),
    Recipe("partial", "limb frozen", _freeze, whole=False, lower=True),
    Recipe("partial", "limb held", _hold_other, whole=False, moving=False, lower=True),
    Recipe("partial", "limb mirrored", _mirror, whole=False, moving=False),
    Recipe("partial", "limb rotated", _offset, whole=False, moving=False),
    Recipe("partial", "limb opposite", _oppose, whole=False),
    Recipe("global", "section from elsewhere", _elsewhere, whole=True, moving=False),
    Recipe("global", "body mirrored", _mirror, whole=True, moving=False),
)
"""The ways to go wrong of the generator ``"joints"``."""
