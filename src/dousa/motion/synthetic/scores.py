"""The scores of the synthetic motions, and the smooth curves they stand for.

The first line of a score is the kind of motion: ``cycle`` (goes round, may start anywhere), ``repeat`` (starts and ends
standing) or ``once`` (ends in another pose), the seconds of one round at tempo 1 and, optionally, the number of rounds
(``x2-4``), ``entry`` (the performer first raises the limbs for a cycle) and ``sided`` (left or right is part of the
motion; all others are mirrored for left-handed performers). Every other line is one degree of freedom with
``phase:degrees`` keys. ``both_`` writes the left and the right, ``alternate_`` the left and, half a round later, the
right.

Degrees of freedom, all zero when standing with hanging arms:

========================= ==========================================================================
bend lean twist           trunk forward, to the left, turned to the left
nod look                  head forward, turned to the left
turn                      heading, to the left
flight                    height of the body above the line from take-off to landing, cm
arm_raise arm_side        angle between arm and trunk, raised to the front (side 0) or the side (90)
arm_turn elbow arm_out    upper arm about its own axis, outward; bend of the elbow; arms held off the trunk
thigh spread toe_out      thigh forward of the vertical, sideways off it, turned outward
knee foot                 bend of the knee; pitch of the sole against the floor, toes up
========================= ==========================================================================
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np

from dousa.arrays import FloatArray

_MIDDLE = ("bend", "lean", "twist", "nod", "look", "turn", "flight")
_SIDED = "arm_raise arm_side arm_turn arm_out elbow thigh spread toe_out knee foot".split()

FREEDOMS: tuple[str, ...] = _MIDDLE + tuple(f"{side}_{name}" for side in ("left", "right") for name in _SIDED)

Track = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True)
class Score:
    """One kind of motion: how it runs and the keys of every degree of freedom that moves."""

    kind: str
    seconds: float
    rounds: tuple[int, int]
    entry: bool
    sided: bool
    tracks: dict[str, Track]

    def mirrored(self) -> Score:
        """Return the same motion with left and right swapped."""
        sign = {"lean": -1.0, "twist": -1.0, "look": -1.0, "turn": -1.0}
        tracks = {
            mirror_name(name): (phases, values * sign.get(name, 1.0)) for name, (phases, values) in self.tracks.items()
        }
        return replace(self, tracks=tracks)


def mirror_name(name: str) -> str:
    """Return the degree of freedom of the other side; those of the middle stay."""
    side, _, rest = name.partition("_")
    other = {"left": "right", "right": "left"}.get(side)
    return f"{other}_{rest}" if other else name


def parse_score(text: str) -> Score:
    """Read one score; ValueError for a line that is not in the form of the module's docstring."""
    lines = [line.split() for line in text.strip().splitlines()]
    kind, seconds, *options = lines[0]
    rounds = next((re.fullmatch(r"x(\d+)-(\d+)", word) for word in options if word.startswith("x")), None)
    if kind not in ("cycle", "repeat", "once"):
        raise ValueError(f"expected cycle, repeat or once, got '{kind}'")
    tracks: dict[str, Track] = {}
    for name, *keys in lines[1:]:
        phases, values = np.array([[float(number) for number in key.split(":")] for key in keys]).T
        prefix, _, rest = name.partition("_")
        later = 0.5 if prefix == "alternate" else 0.0
        names = (f"left_{rest}", f"right_{rest}") if prefix in ("both", "alternate") else (name,)
        for number, target in enumerate(names):
            if target not in FREEDOMS:
                raise ValueError(f"expected a degree of freedom, got '{name}'")
            shifted = (phases + later * number) % 1.0 if later else phases
            order = np.argsort(shifted, kind="stable")
            tracks[target] = (shifted[order], values[order])
    limits = (int(rounds[1]), int(rounds[2])) if rounds else (1, 1)
    return Score(kind, float(seconds), limits, "entry" in options, "sided" in options, tracks)


def evaluate_track(track: Track, phases: FloatArray, periodic: bool) -> FloatArray:
    """Compute values (T,) of a smooth curve through the keys that never overshoots them.

    Monotone cubic Hermite interpolation (Fritsch and Butland 1984): between two keys the curve stays between
    their values, so that a knee keyed at 0 is never bent the wrong way.
    """
    keys, values = track
    if periodic:
        # The last key may repeat the first one at phase 1.
        inside = keys < 1.0
        keys, values = keys[inside], values[inside]
        keys = np.concatenate((keys - 1.0, keys, keys + 1.0))
        values = np.tile(values, 3)
        phases = phases % 1.0
    if len(keys) == 1:
        return np.full(phases.shape, values[0])
    steps = np.diff(keys)
    slopes = np.diff(values) / steps
    tangents = np.zeros(len(keys))
    before, after = slopes[:-1], slopes[1:]
    same = before * after > 0
    w1, w2 = 2 * steps[1:] + steps[:-1], steps[1:] + 2 * steps[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        tangents[1:-1] = np.where(same, (w1 + w2) / (w1 / before + w2 / after), 0.0)
    x = np.clip(phases, keys[0], keys[-1])
    k = np.clip(np.searchsorted(keys, x, side="right") - 1, 0, len(steps) - 1)
    u = (x - keys[k]) / steps[k]
    v = 1.0 - u
    return (
        v * v * (1 + 2 * u) * values[k]
        + u * u * (3 - 2 * u) * values[k + 1]
        + steps[k] * u * v * (v * tangents[k] - u * tangents[k + 1])
    )


def load_scores(name: str) -> dict[str, Score]:
    """Return the scores of a TOML file of this folder, by name."""
    texts = tomllib.loads(resources.files(__package__).joinpath(name).read_text(encoding="utf-8"))
    return {name: parse_score(text) for name, text in texts.items()}


SCORES: dict[str, Score] = load_scores("everyday.toml")

for _right, _left in (("kick_right", "kick_left"), ("wave_right", "wave_left")):
    SCORES[_right] = SCORES[_left].mirrored()

SCORES = dict(sorted(SCORES.items()))
