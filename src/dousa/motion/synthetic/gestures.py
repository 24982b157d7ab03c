"""Random motions without a name, by random performers.

A gesture moves an arm, both arms in the same or in different ways, or a leg, both knees or the trunk, through one to
four poses within the range of the joints, once or a few times. Together they are examples of other motion.
"""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.synthetic.performers import draw_performer, perform_score
from dousa.motion.synthetic.scores import Score, Track
from dousa.motion.types import Motion

_SEED = 0x6E57
_SIDES = ("left", "right")
_APART = 0.08  # of a round, between two poses
_FIRST_PERFORMER = 5000  # no performer of the other synthetic libraries


def make_gesture(seed: int, frame_rate: float = 30.0) -> Motion:
    """Make a gesture of a random performer, in metres with Y up as by ``make_motion``; the same for the same seed."""
    rng = np.random.default_rng([_SEED, seed])
    return perform_score(draw_score(rng), draw_performer(_FIRST_PERFORMER + seed), rng, frame_rate)


def draw_score(rng: np.random.Generator) -> Score:
    """Draw a random score of keys, degrees."""
    kind = "once" if rng.random() < 1 / 3 else "repeat"
    tracks: dict[str, Track] = {}
    arms = rng.random()
    if arms < 0.4:
        _draw_arm(rng, kind, str(rng.choice(_SIDES)), tracks)
    elif arms < 0.75:
        _draw_arm(rng, kind, "left", tracks)
        if arms < 0.6:
            _copy_left(tracks)
        else:
            _draw_arm(rng, kind, "right", tracks)
    if arms >= 0.75 or rng.random() < 0.2:
        _draw_rest(rng, kind, tracks)
    for name, share, spread in (("bend", 0.4, 20.0), ("twist", 0.4, 25.0), ("lean", 0.3, 12.0)):
        if name not in tracks and rng.random() < share:
            tracks[name] = _draw_keys(rng, kind, rng.normal(0.0, spread, 1))
    seconds, rounds = float(rng.uniform(0.8, 2.6)), int(rng.integers(1, 4))
    return Score(kind, seconds, (1, rounds if kind == "repeat" else 1), False, True, tracks)


def _draw_keys(rng: np.random.Generator, kind: str, values: FloatArray) -> Track:
    """Draw poses and their times, from standing and back to it unless the motion ends elsewhere."""
    while True:
        phases = np.sort(rng.uniform(0.15, 0.85, len(values)))
        if len(values) == 1 or np.diff(phases).min() >= _APART:
            break
    if kind == "once":
        return np.concatenate([[0.0, 0.05], phases]), np.concatenate([[0.0, 0.0], values])
    return np.concatenate([[0.0], phases, [1.0]]), np.concatenate([[0.0], values, [0.0]])


def _draw_arm(rng: np.random.Generator, kind: str, side: str, tracks: dict[str, Track]) -> None:
    count = int(rng.integers(1, 4))
    raised = rng.uniform(25.0, 165.0) + rng.normal(0.0, 25.0, count)
    aside = rng.uniform(-20.0, 95.0)
    bent = rng.uniform(0.0, 120.0) + rng.normal(0.0, 35.0, int(rng.integers(1, 5)))
    tracks[f"{side}_arm_raise"] = _draw_keys(rng, kind, np.clip(raised, -30.0, 175.0))
    if rng.random() < 0.6:
        tracks[f"{side}_arm_side"] = np.array([0.0]), np.array([aside])
    else:
        turned = np.clip(aside + rng.normal(0.0, 35.0, count), -30.0, 110.0)
        tracks[f"{side}_arm_side"] = _draw_keys(rng, kind, turned)
    tracks[f"{side}_elbow"] = _draw_keys(rng, kind, np.clip(bent, 0.0, 145.0))
    tracks[f"{side}_arm_turn"] = _draw_keys(rng, kind, rng.normal(0.0, 35.0, 1))


def _copy_left(tracks: dict[str, Track]) -> None:
    left = [name for name in tracks if name.startswith("left_")]
    tracks.update({name.replace("left_", "right_"): tracks[name] for name in left})


def _draw_rest(rng: np.random.Generator, kind: str, tracks: dict[str, Track]) -> None:
    """Draw the keys of a leg, both knees, or the trunk."""
    which, count = rng.random(), int(rng.integers(1, 3))
    if which < 0.35:
        side = str(rng.choice(_SIDES))
        tracks[f"{side}_thigh"] = _draw_keys(rng, kind, rng.uniform(-25.0, 95.0, count))
        tracks[f"{side}_knee"] = _draw_keys(rng, kind, rng.uniform(0.0, 110.0, count))
    elif which < 0.65:
        phases, bent = _draw_keys(rng, kind, rng.uniform(30.0, 125.0, count))
        raised = bent * rng.uniform(0.4, 0.8)
        tracks.update({f"{side}_knee": (phases, bent) for side in _SIDES})
        tracks.update({f"{side}_thigh": (phases, raised) for side in _SIDES})
    else:
        tracks["bend"] = _draw_keys(rng, kind, rng.uniform(-10.0, 80.0, count))
