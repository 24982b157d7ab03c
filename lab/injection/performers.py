"""A person who performs a motion, made otherwise than by `injection.simulate_performer`.

Here the joints differ, not the bones' directions in the world: another posture of shoulders, elbows, trunk, hips and
knees, which drifts over the performance and trembles a little; tempo comes and goes in smooth waves; the sensor is
tilted; at times it is a cheap one, whose joints jitter and drop out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion import rotations
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from lab.injection.edits import LIMB_BONES, TRUNK_BONES, find_bones, find_heading, rotate, smooth_noise
from lab.injection.local_pose import LocalPose, to_local, to_positions

_ARM_OFFSETS = np.radians((0.0, 12.0))  # another resting posture, drawn for each person
_LEG_OFFSETS = np.radians((0.0, 5.0))
_TRUNK_OFFSETS = np.radians((0.0, 7.0))
_ALIKE = 0.7  # of an offset is the same on both sides
_DRIFTS_DEG, _DRIFT_S = (0.5, 2.5), (12.0, 60.0)  # periods
_TREMORS_DEG, _TREMOR_S = (0.5, 2.5), (0.3, 1.2)
_TRUNK_STEADIER = 0.4
_TEMPO_S = (0.01, 0.04)
_WAVES_S = (1.5, 9.0)
_N_WAVES = 4
_TILT = np.radians(3.0)
_STATURES = (0.87, 1.13)
_LIMB_SPREAD = 0.12
_PLACE_M = 2.0
_CHEAP = 0.4  # chance of a cheap sensor
_JITTER_M, _JITTER_S = (0.003, 0.012), 0.04
_DROPOUTS_A_MINUTE = 8.0
_DROPOUT_S = (0.08, 0.4)
_MARKED = 0.5  # chance that a sensor says what it did not see
_END_JOINTS = tuple(bone + 1 for name in LIMB_BONES for bone in LIMB_BONES[name][1:])


@dataclass(frozen=True, slots=True)
class Variation:
    """How much a performer varies; 0 is none, 1 what people do.

    Parameters
    ----------
    posture : constant offsets of up to 12 deg in shoulders and elbows, 7 in the trunk, 5 in hips and knees.
    unsteadiness : drift and tremor of the joints, 0.5 to 2.5 deg root mean square each.
    tempo : 10 to 40 ms root mean square.
    tilt : of the sensor, up to 3 deg.
    build : stature 0.87 to 1.13, limbs up to 12 % longer or shorter.
    facing : any heading and a place within 2 m, if not 0.
    sensor : jitter of 3 to 12 mm and short dropouts, for two in five performers.
    """

    posture: float = 1.0
    unsteadiness: float = 1.0
    tempo: float = 1.0
    tilt: float = 1.0
    build: float = 1.0
    facing: float = 1.0
    sensor: float = 1.0


def vary_performer(
    motion: CanonicalMotion, rng: np.random.Generator | int, variation: Variation | None = None
) -> CanonicalMotion:
    """The same motion by another person.

    Parameters
    ----------
    motion : what is performed.
    rng : generator or seed.
    variation : how much of what; all of it if None.

    Returns
    -------
    A motion of the same length and frame rate; ``missing`` marks dropouts if the sensor says so.
    """
    rng, much = np.random.default_rng(rng), variation or Variation()
    clean = np.asarray(motion.positions, dtype=np.float64)
    n, rate = motion.n_frames, motion.frame_rate
    frames = _draw_tempo(n, rate, rng, much.tempo)
    pose = to_local(clean).sampled(frames)
    heading = np.interp(frames, np.arange(n), find_heading(clean, rate)) if n > 1 else np.zeros(n)
    pose = _change_posture(pose, heading, rate, rng, much)
    stature = 1.0 + much.build * (float(rng.uniform(*_STATURES)) - 1.0)
    lengths = pose.lengths * stature * (1.0 + much.build * _draw_build(rng))
    positions = to_positions(replace(pose, root=pose.root * stature, lengths=lengths))
    # The feet stay on the floor of the original, however long the legs.
    positions[..., 1] += clean[..., 1].min() - np.percentile(positions[..., 1].min(axis=1), 1.0)
    positions = _set_up(positions, rng, much)
    positions, unseen = _sense(positions, rate, rng, much.sensor)
    missing = motion.missing
    if unseen is not None:
        missing = unseen if missing is None else missing | unseen
        missing.flags.writeable = False
    positions.flags.writeable = False
    return replace(motion, positions=positions, height=motion.height * stature, missing=missing)


def _draw_tempo(n: int, rate: float, rng: np.random.Generator, much: float) -> FloatArray:
    """Frames (n,) of the original that are danced at each moment: a few slow waves, never backwards."""
    times = np.arange(n) / rate
    periods, phases = rng.uniform(*_WAVES_S, _N_WAVES), rng.uniform(0.0, 2.0 * np.pi, _N_WAVES)
    sizes = rng.uniform(0.2, 1.0, _N_WAVES)
    sizes *= much * rng.uniform(*_TEMPO_S) / np.sqrt(0.5 * (sizes**2).sum())
    wave = (sizes * np.sin(2.0 * np.pi * times[:, None] / periods + phases)).sum(axis=1)
    frames: FloatArray = np.clip(np.maximum.accumulate(np.arange(n) + wave * rate), 0.0, n - 1.0)
    return frames


def _change_posture(
    pose: LocalPose, heading: FloatArray, rate: float, rng: np.random.Generator, much: Variation
) -> LocalPose:
    n, bones = pose.n_frames, pose.bones.copy()
    offsets = much.posture * _draw_offsets(rng)
    drift = much.unsteadiness * np.radians(rng.uniform(*_DRIFTS_DEG)) / np.sqrt(2.0)
    tremor = much.unsteadiness * np.radians(rng.uniform(*_TREMORS_DEG)) / np.sqrt(2.0)
    shape = (bones.shape[1] + 2, 3)
    turns = np.arange(n)[:, None, None] / rate / rng.uniform(*_DRIFT_S, shape) + rng.uniform(0.0, 1.0, shape)
    moving = drift * np.sqrt(2.0) * np.sin(2.0 * np.pi * turns)
    moving += tremor * smooth_noise(n, shape, rng.uniform(*_TREMOR_S) * rate, rng)
    limbs = [bone for name in LIMB_BONES for bone in LIMB_BONES[name]]
    turned = rotations.from_axis_angle(moving[:, limbs] + offsets[limbs])
    bones[:, limbs] = rotations.rotate(turned, bones[:, limbs])
    lean = much.posture * rng.uniform(-1.0, 1.0, (2, 3)) * _TRUNK_OFFSETS[1] * (1.0, 0.4, 0.5)
    swaying = lean + _TRUNK_STEADIER * moving[:, -2:]
    chest = rotations.multiply(rotations.from_axis_angle(swaying[:, 0]), pose.chest)
    free = pose.turned(-heading)
    pelvis = rotations.multiply(rotations.from_axis_angle(0.5 * swaying[:, 1]), free.pelvis)
    return replace(replace(free, pelvis=pelvis).turned(heading), chest=chest, bones=bones)


def _draw_offsets(rng: np.random.Generator) -> FloatArray:
    """(19, 3) rotation vectors of joints, mostly the same on both sides."""
    offsets = np.zeros((len(CANONICAL_JOINTS) - 1, 3))
    for limb, most in (("arm", _ARM_OFFSETS), ("leg", _LEG_OFFSETS)):
        size = rng.uniform(*most)  # of the person, so that some stand as the teacher does
        for left, right in zip(LIMB_BONES[f"left_{limb}"], LIMB_BONES[f"right_{limb}"], strict=True):
            own = rng.standard_normal((3, 3))
            own *= size * rng.uniform(0.3, 1.0) / np.linalg.norm(own, axis=1, keepdims=True)
            offsets[left] = _ALIKE * own[0] + (1.0 - _ALIKE) * own[1]
            # A rotation mirrored in x = 0.
            offsets[right] = _ALIKE * own[0] * (1.0, -1.0, -1.0) + (1.0 - _ALIKE) * own[2]
    return offsets


def _draw_build(rng: np.random.Generator) -> FloatArray:
    """(19,) by which bones are longer, left as right; shoulders and hips have their own widths."""
    longer = np.zeros(len(CANONICAL_JOINTS) - 1)
    longer[list(TRUNK_BONES)] = rng.uniform(-_LIMB_SPREAD, _LIMB_SPREAD)
    for pair in ("shoulder", "hip", "elbow", "wrist", "knee", "ankle"):
        longer[list(find_bones(f"left_{pair}", f"right_{pair}"))] = rng.uniform(-_LIMB_SPREAD, _LIMB_SPREAD)
    return longer


def _set_up(positions: FloatArray, rng: np.random.Generator, much: Variation) -> FloatArray:
    """Tilt of the sensor, heading and place."""
    middle = positions[:, 0].mean(axis=0) * (1.0, 0.0, 1.0)
    way, tilt = rng.uniform(0.0, 2.0 * np.pi), much.tilt * rng.uniform(0.0, _TILT)
    yaw, (x, z) = rng.uniform(-np.pi, np.pi), rng.uniform(-_PLACE_M, _PLACE_M, 2)
    n = len(positions)
    moved = rotate(positions - middle, np.array([np.cos(way), 0.0, np.sin(way)]), np.full(n, tilt))
    moved = rotate(moved, np.array([0.0, 1.0, 0.0]), np.full(n, much.facing * yaw))
    placed: FloatArray = moved + middle + much.facing * np.array([x, 0.0, z])
    return placed


def _sense(
    positions: FloatArray, rate: float, rng: np.random.Generator, much: float
) -> tuple[FloatArray, BoolArray | None]:
    """Jitter and dropouts of a cheap sensor, and (T, 20) what it says that it did not see."""
    if rng.random() >= _CHEAP * min(much, 1.0):
        return positions, None
    n, n_joints = positions.shape[:2]
    spread = np.full(n_joints, 0.5)
    spread[list(_END_JOINTS)] = 1.0
    jitter = smooth_noise(n, (n_joints, 3), _JITTER_S * rate, rng)
    noisy = positions + much * rng.uniform(*_JITTER_M) * spread[:, None] * jitter
    unseen = np.zeros((n, n_joints), dtype=np.bool_)
    for _ in range(rng.poisson(_DROPOUTS_A_MINUTE * n / rate / 60.0)):
        joint = int(rng.choice(_END_JOINTS))
        length = max(round(rng.uniform(*_DROPOUT_S) * rate), 1)
        first = int(rng.integers(0, max(n - length, 1)))
        gap = np.arange(first, min(first + length, n))
        unseen[gap, joint] = True
        ends = [max(first - 1, 0), min(first + length, n - 1)]
        if rng.random() < 0.5:  # it stays where it was last seen, or is bridged
            noisy[gap, joint] = noisy[ends[0], joint]
        else:
            share = ((gap - ends[0]) / max(ends[1] - ends[0], 1))[:, None]
            noisy[gap, joint] = (1.0 - share) * noisy[ends[0], joint] + share * noisy[ends[1], joint]
    return noisy, unseen if rng.random() < _MARKED and unseen.any() else None
