"""A body that moves so that its accents are known: each movement of least jerk arrives when it should."""

from collections.abc import Mapping, Sequence

import numpy as np
from oracles.standing import standing

from dousa.arrays import FloatArray
from dousa.motion import CanonicalMotion, Trajectories, canonicalise
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX

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
    positions = np.repeat(standing(), n_frames, axis=0)
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
