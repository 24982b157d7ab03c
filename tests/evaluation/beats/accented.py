"""A body that moves so that its accents are known: each movement of least jerk arrives when it should."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion import CanonicalMotion, Trajectories, canonicalise
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX

_STANDING = {
    "pelvis": (0.0, 0.95, 0.0),
    "spine": (0.0, 1.15, 0.0),
    "neck": (0.0, 1.45, 0.0),
    "head": (0.0, 1.60, 0.0),
    "left_shoulder": (0.18, 1.42, 0.0),
    "left_elbow": (0.22, 1.14, 0.0),
    "left_wrist": (0.24, 0.90, 0.05),
    "left_hand": (0.24, 0.80, 0.05),
    "left_hip": (0.09, 0.93, 0.0),
    "left_knee": (0.10, 0.50, 0.0),
    "left_ankle": (0.10, 0.08, 0.0),
    "left_toe": (0.10, 0.03, 0.15),
}
_CARRIED = {"hand": ("wrist", "hand"), "foot": ("ankle", "toe")}

Moves = Sequence[tuple[float, float, Sequence[float]]]
"""(arrival s, duration s, displacement x y z in m), in order; (), from the place that the last one reached."""


def move(times: FloatArray, moves: Moves) -> FloatArray:
    """(T, 3) displacement of a limb."""
    path = np.zeros((len(times), 3))
    for arrival, duration, far in moves:
        u = np.clip((times - arrival) / duration + 1.0, 0.0, 1.0)
        path += (u**3 * (10.0 - 15.0 * u + 6.0 * u * u))[:, None] * np.asarray(far)
    return path


def make_body(
    paths: Mapping[str, FloatArray], rate: float, noise_m: float = 0.0, missing: slice | None = None
) -> CanonicalMotion:
    """A standing person whose limbs (``left_hand``, ``right_foot``...) are displaced by (T, 3) m."""
    n_frames = len(next(iter(paths.values())))
    right = {n.replace("left", "right"): (-x, y, z) for n, (x, y, z) in _STANDING.items() if n.startswith("left")}
    places = _STANDING | right
    positions = np.tile(np.array([places[name] for name in CANONICAL_JOINTS]), (n_frames, 1, 1))
    for limb, path in paths.items():
        side, _, what = limb.partition("_")
        for joint in _CARRIED[what]:
            positions[:, JOINT_INDEX[f"{side}_{joint}"]] += path
    positions += np.random.default_rng(1).normal(0.0, noise_m, positions.shape)
    if missing is not None:
        positions[missing, JOINT_INDEX["left_wrist"]] = np.nan
    return canonicalise(Trajectories(CANONICAL_JOINTS, positions, rate))


def wave(arrivals: Sequence[float], rate: float, *, far: float = 0.5, duration: float = 0.3, after: float = 1.0):
    """(T, 3) path of a hand that goes up and down, to rest at each arrival."""
    times = np.arange(round((arrivals[-1] + after) * rate)) / rate
    return move(times, [(at, duration, (0.0, far * (-1) ** k, 0.0)) for k, at in enumerate(arrivals)])
