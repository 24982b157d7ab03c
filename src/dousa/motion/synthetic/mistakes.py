"""Mistakes of a pupil: parts of a synthetic dance done late, too small or otherwise, with the true answers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray, IntArray
from dousa.errors import OptionError
from dousa.motion import rotations as rot
from dousa.motion.synthetic.dance import Dance
from dousa.motion.types import Motion

_LIMBS = {
    "left_arm": ("left_shoulder", "left_elbow"),
    "right_arm": ("right_shoulder", "right_elbow"),
}
_SEGMENTS = {"shoulder": "upper_arm", "elbow": "forearm"}
_RAMP_S = 0.3  # s in which a mistake begins and ends


@dataclass(frozen=True, slots=True)
class Mistake:
    """A deliberate mistake.

    Parameters
    ----------
    kind : ``"shift"``, ``"incomplete"``, ``"partial"`` or ``"global"``.
    start_s, end_s : s.
    segments : the segments that move otherwise; none named means the whole body.
    lag_ms : ms late, of a shift.
    shortfall_deg : deg by which the largest turn falls short, of an incomplete movement.
    """

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...] = ()
    lag_ms: float | None = None
    shortfall_deg: float | None = None


def make_mistakes(dance: Dance, seed: int = 0) -> tuple[Motion, tuple[Mistake, ...]]:
    """Make one mistake of each kind in a dance, each in the middle of another figure.

    Returns the dance with mistakes, whose bones keep their lengths, and the mistakes in order of time.

    Parameters
    ----------
    dance : at least four figures, from `make_dance`.
    seed : of the figures and arms.

    Raises
    ------
    OptionError : a negative seed.
    """
    if seed < 0:
        raise OptionError("synthetic.seed", seed=seed)
    rng = np.random.default_rng([0x315, seed])
    motion, mistakes = dance.motion, []
    kinds = ("shift", "incomplete", "partial", "global")
    places = np.sort(rng.choice(np.arange(1, len(dance.figures), 2), len(kinds), replace=False))
    for kind, place in zip(rng.permutation(kinds), places, strict=True):
        figure = dance.figures[place]
        motion, mistake = _put(motion, str(kind), figure.start, figure.end, rng)
        mistakes.append(mistake)
    return motion, tuple(mistakes)


def _put(motion: Motion, kind: str, start: int, end: int, rng: np.random.Generator) -> tuple[Motion, Mistake]:
    """Blend the joints of a mistake into their motion at another time, frame by frame."""
    length = end - start
    first, stop = start + length // 5, end - length // 5
    frames = np.arange(motion.n_frames)
    other, weight = frames.copy(), _window(frames, first, stop, _RAMP_S * motion.frame_rate)
    names = _busiest_arm(motion, first, stop)
    span = first / motion.frame_rate, stop / motion.frame_rate
    segments = tuple(name.replace(joint, part) for name in names for joint, part in _SEGMENTS.items() if joint in name)
    if kind == "shift":
        lag_s = rng.uniform(0.35, 0.5)
        other = frames - round(lag_s * motion.frame_rate)
        mistake = Mistake(kind, *span, segments, lag_ms=1000 * round(lag_s * motion.frame_rate) / motion.frame_rate)
    elif kind == "incomplete":
        other, weight = np.full_like(frames, start), 0.6 * weight
        mistake = Mistake(kind, *span, segments)
    elif kind == "partial":
        other = frames + length
        mistake = Mistake(kind, *span, segments)
    else:
        other, names = frames - length, tuple(name for name in motion.skeleton.names if name != "pelvis")
        mistake = Mistake(kind, *span)
    joints = [motion.skeleton.names.index(name) for name in names]
    before = motion.rotations[:, joints]
    donor = before[np.clip(other, 0, motion.n_frames - 1)]
    changed = motion.rotations.copy()
    changed[:, joints] = rot.slerp(before, donor, weight[:, None])
    if kind == "incomplete":
        turned = rot.to_axis_angle(rot.multiply(rot.conjugate(before), changed[:, joints]))
        mistake = replace(mistake, shortfall_deg=float(np.rad2deg(np.linalg.norm(turned, axis=-1).max())))
    return replace(motion, rotations=changed), mistake


def _window(frames: IntArray, first: int, stop: int, ramp: float) -> FloatArray:
    """Weights (T,) that rise from 0 to 1 after ``first`` and fall to 0 before ``stop``."""
    rise = np.clip(np.minimum(frames - first, stop - 1 - frames) / ramp, 0.0, 1.0)
    smooth: FloatArray = rise * rise * (3.0 - 2.0 * rise)
    return smooth


def _busiest_arm(motion: Motion, first: int, stop: int) -> tuple[str, ...]:
    """Joints of the arm that turns most within some frames."""

    def measure(names: tuple[str, ...]) -> float:
        joints = [motion.skeleton.names.index(name) for name in names]
        turns = motion.rotations[first:stop, joints]
        steps = rot.to_axis_angle(rot.multiply(rot.conjugate(turns[:-1]), turns[1:]))
        return float(np.linalg.norm(steps, axis=-1).sum())

    return max(_LIMBS.values(), key=measure)
