"""The synthetic dance, and the same dance with errors that are known because they were put in by hand."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from dousa.evaluation.errors.deviations import Deviations, compute_deviations
from dousa.evaluation.errors.evidence import Evidence, gather_evidence
from dousa.evaluation.posture.posture import Working, compute_postures, thin_postures
from dousa.motion import CanonicalMotion, canonicalise
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.joints import MIRRORED_JOINTS
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import draw_performer

ARM = ("shoulder", "elbow", "wrist", "hand")
EVEN = np.ones(9)
TOLERANCE = np.full(9, np.radians(10.0))


@lru_cache
def get_dance(seconds: float = 20.0, frame_rate: float = 30.0, take: int = 0) -> CanonicalMotion:
    """The beginning of the synthetic dance: sway, gather, sway, circles, turn in 18.7 s."""
    motion = canonicalise(make_dance(draw_performer(0), take, frame_rate).motion)
    return choose(motion, np.arange(min(round(seconds * frame_rate), motion.n_frames)))


def choose(motion: CanonicalMotion, frames: np.ndarray) -> CanonicalMotion:
    """Frames of a motion in any order."""
    missing = None if motion.missing is None else motion.missing[frames]
    return replace(motion, positions=np.ascontiguousarray(motion.positions[frames]), missing=missing)


def cut(motion: CanonicalMotion, *spans: tuple[float, float]) -> CanonicalMotion:
    """Stretches in seconds, one after the other."""
    rate = motion.frame_rate
    return choose(motion, np.concatenate([np.arange(round(a * rate), round(b * rate)) for a, b in spans]))


def place(motion: CanonicalMotion, yaw: float, x: float, z: float, stature: float) -> CanonicalMotion:
    """Turned about the vertical, moved, and larger or smaller."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    positions = stature * motion.positions @ turn.T + np.array([x, 0.0, z])
    return replace(motion, positions=positions, height=stature * motion.height)


def mirror(motion: CanonicalMotion) -> CanonicalMotion:
    """In a mirror: left for right."""
    return replace(motion, positions=motion.positions[:, MIRRORED_JOINTS] * np.array([-1.0, 1.0, 1.0]))


def fade(motion: CanonicalMotion, start_s: float, end_s: float, ramp_s: float = 0.3) -> np.ndarray:
    """(T,) 0 outside, 1 inside, smooth between."""
    times = np.arange(motion.n_frames) / motion.frame_rate
    share = np.clip(np.minimum((times - start_s) / ramp_s, (end_s - times) / ramp_s), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def be_late(motion: CanonicalMotion, lag_s: float, start_s: float, end_s: float) -> CanonicalMotion:
    """Late (early if negative) between two times, by a detour of half a second at both ends."""
    delay = lag_s * motion.frame_rate * fade(motion, start_s, end_s, 0.5)
    frames = np.clip(np.arange(motion.n_frames) - delay, 0, motion.n_frames - 1)
    low = np.minimum(frames.astype(int), motion.n_frames - 2)
    share = (frames - low)[:, None, None]
    return replace(motion, positions=motion.positions[low] * (1.0 - share) + motion.positions[low + 1] * share)


def shrink_arm(motion: CanonicalMotion, side: str, gain: float, start_s: float, end_s: float) -> CanonicalMotion:
    """An arm that moves less about the mean of its directions between two times."""
    inside = fade(motion, start_s, end_s)
    positions = motion.positions.copy()
    for near, far in pairwise(J[f"{side}_{joint}"] for joint in ARM):
        bone = motion.positions[:, far] - motion.positions[:, near]
        length = np.linalg.norm(bone, axis=1, keepdims=True)
        unit = bone / length
        middle = unit[inside > 0.0].mean(axis=0)
        moved = middle + (1.0 - (1.0 - gain) * inside[:, None]) * (unit - middle)
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        positions[:, far] = positions[:, near] + moved * length
    return replace(motion, positions=positions)


def turn_limb(
    motion: CanonicalMotion, joints: Sequence[str], degrees: float, start_s: float, end_s: float
) -> CanonicalMotion:
    """What hangs on the first of a chain of joints turned about the front axis between two times."""
    angle = np.radians(degrees) * fade(motion, start_s, end_s)
    root = motion.positions[:, J[joints[0]]]
    positions = motion.positions.copy()
    for joint in joints[1:]:
        x, y, z = (motion.positions[:, J[joint]] - root).T
        cosine, sine = np.cos(angle), np.sin(angle)
        positions[:, J[joint]] = root + np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)
    return replace(motion, positions=positions)


def swap_section(motion: CanonicalMotion, start_s: float, end_s: float, source_s: float) -> CanonicalMotion:
    """Another section, which begins at ``source_s``, danced between two times."""
    share = fade(motion, start_s, end_s, 0.2)[:, None, None]
    moved = np.arange(motion.n_frames) + round((source_s - start_s) * motion.frame_rate)
    other = motion.positions[np.clip(moved, 0, motion.n_frames - 1)]
    return replace(motion, positions=motion.positions * (1.0 - share) + other * share)


def lose(motion: CanonicalMotion, joints: Sequence[str], start_s: float, end_s: float) -> CanonicalMotion:
    """Joints that are not seen between two times: held where they were last, and marked."""
    start, end = round(start_s * motion.frame_rate), round(end_s * motion.frame_rate)
    positions = motion.positions.copy()
    missing = np.zeros(positions.shape[:2], bool)
    for joint in joints:
        positions[start:end, J[joint]] = positions[start, J[joint]]
        missing[start:end, J[joint]] = True
    return replace(motion, positions=positions, missing=missing)


def thin(motion: CanonicalMotion) -> Working:
    """Postures at the rate that is worked with."""
    return thin_postures(compute_postures(motion))


def first_frames(working: Working, count: int) -> Working:
    """The beginning of thinned postures."""
    parts = {name: getattr(working, name)[:count] for name in ("segments", "seen", "heading")}
    return replace(working, **parts)


def compare_dances(performance: CanonicalMotion, reference: CanonicalMotion, weights: np.ndarray = EVEN) -> Deviations:
    """Deviations of a performance that keeps the clock of its reference."""
    theirs, ours = thin(reference), thin(performance)
    return compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), weights)


def gather_dances(performance: CanonicalMotion, reference: CanonicalMotion, weights: np.ndarray = EVEN) -> Evidence:
    """Evidence at a tolerance of 10 degrees and 0.07 s."""
    return gather_evidence(compare_dances(performance, reference, weights), TOLERANCE, 0.07, weights)
