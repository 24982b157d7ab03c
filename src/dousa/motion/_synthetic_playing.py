"""How a performer plays a score: posture, habits, extent and unsteadiness of every degree of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dousa.motion._synthetic_scores import FREEDOMS, Score, evaluate_track, mirror_name
from dousa.motion._types import FloatArray

if TYPE_CHECKING:
    from dousa.motion.synthetic import Performer

__all__ = ["Plan", "play_score"]

# Directions and headings: a livelier performer does not turn further round or raise the arms more sideways.
_UNSCALED = ("turn", "arm_side", "arm_turn", "toe_out", "arm_out")
_HINGES = {"elbow": (0.0, 150.0), "knee": (0.0, 150.0), "arm_raise": (-75.0, 178.0)}
_STANCE = {"arm_side": 12.0, "arm_raise": 2.0, "knee": 3.0, "thigh": 1.0, "spread": 1.5}


@dataclass(frozen=True, slots=True)
class Plan:
    """Of every frame (T,): the time in s, the phase in rounds, how far the stance is left (0 to 1)."""

    times: FloatArray
    phases: FloatArray
    weights: FloatArray


def _posture(performer: Performer) -> dict[str, float]:
    """Degrees of freedom of the performer who stands."""
    side = {"arm_out": performer.arm_out, "elbow": performer.elbow, "toe_out": performer.toe_out, **_STANCE}
    stance = {f"{hand}_{name}": value for hand in ("left", "right") for name, value in side.items()}
    # The working shoulder hangs lower and its elbow is bent a little more.
    stance |= {"bend": performer.stoop, "nod": 0.6 * performer.stoop, "lean": -performer.tilt}
    stance["right_elbow"] += 4.0 * performer.tilt / 2
    if performer.left_handed:
        stance = {mirror_name(name): value for name, value in stance.items()}
        stance["lean"] = performer.tilt
    return stance


def play_score(
    score: Score, performer: Performer, plan: Plan, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """Degrees (T,) of every degree of freedom."""
    stance = _posture(performer)
    periodic = score.kind != "once"
    own = np.random.default_rng([performer.seed, 1])
    habits: dict[str, float] = {}
    phases, weights = plan.phases, plan.weights
    pose = {}
    for name in FREEDOMS:
        kind = name.partition("_")[2] or name
        # The two sides are alike, but not equal.
        habit = habits.setdefault(kind, own.normal(1.0, 0.06) * rng.normal(1.0, 0.03))
        gain = performer.amplitude * habit * own.normal(1.0, 0.02)
        gain = 1.0 + 0.1 * (gain - 1.0) if kind in _UNSCALED else gain
        values = np.zeros(len(phases))
        rest = np.full(len(phases), stance.get(name, 0.0))
        if name in score.tracks:
            late = performer.lag if kind.startswith(("arm", "elbow")) and periodic else 0.0
            values = gain * evaluate_track(score.tracks[name], phases - late, periodic)
            # The score says where the arm goes; of the stance only its slack remains.
            rest = rest * (1.0 - weights) if kind == "arm_side" else rest
        if kind not in ("flight", "turn"):
            rest = rest + _unsteadiness(plan.times, performer.noise * (0.4 if kind == "foot" else 1.0), rng)
        values = weights * values + rest
        low, high = _HINGES.get(kind, (-np.inf, np.inf))
        pose[name] = np.clip(values, low, high)
    pose["turn"] = pose["turn"] + rng.normal(0.0, 5.0)
    return pose


def _unsteadiness(times: FloatArray, degrees: float, rng: np.random.Generator) -> FloatArray:
    """Slow random drift (T,) of about that many degrees: three sines of 0.3 to 2.5 Hz."""
    frequencies = rng.uniform(0.3, 2.5, (3, 1))
    offsets = rng.uniform(0.0, 2 * np.pi, (3, 1))
    sizes = rng.normal(0.0, degrees / np.sqrt(1.5), (3, 1)) / np.sqrt(1.0 + frequencies**2)
    drift: FloatArray = (sizes * np.sin(2 * np.pi * frequencies * times + offsets)).sum(axis=0)
    return drift
