"""The scores of the synthetic motions, and the smooth curves they stand for.

A score is a small text. Its first line says how the motion runs: ``cycle`` (goes round, may start anywhere),
``repeat`` (starts and ends standing) or ``once`` (ends in another pose), the seconds of one round at tempo 1
and, optionally, how many rounds (``x2-4``), ``entry`` (a cycle that the performer first raises the limbs for)
and ``sided`` (the motion itself says left or right; all others are mirrored for left-handed performers).
Every other line is one degree of freedom with ``phase:degrees`` keys. ``both_`` writes the left and the
right, ``alternate_`` the left and, half a round later, the right.

Degrees of freedom, all zero in a person who stands with hanging arms:

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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.motion._types import FloatArray

__all__ = ["FREEDOMS", "SCORES", "Score", "evaluate_track", "mirror_name", "parse_score"]

_MIDDLE = ("bend", "lean", "twist", "nod", "look", "turn", "flight")
_SIDED = (
    "arm_raise",
    "arm_side",
    "arm_turn",
    "arm_out",
    "elbow",
    "thigh",
    "spread",
    "toe_out",
    "knee",
    "foot",
)

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
        """The same motion with left and right changed."""
        sign = {"lean": -1.0, "twist": -1.0, "look": -1.0, "turn": -1.0}
        tracks = {
            mirror_name(name): (phases, values * sign.get(name, 1.0))
            for name, (phases, values) in self.tracks.items()
        }
        return Score(self.kind, self.seconds, self.rounds, self.entry, self.sided, tracks)


def mirror_name(name: str) -> str:
    """The degree of freedom of the other side; those of the middle stay."""
    side, _, rest = name.partition("_")
    other = {"left": "right", "right": "left"}.get(side)
    return f"{other}_{rest}" if other else name


def parse_score(text: str) -> Score:
    """Read one score.

    Raises
    ------
    ValueError : a line that is not written as the module's docstring says.
    """
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


def evaluate_track(track: Track, phases: NDArray[np.float64], periodic: bool) -> FloatArray:
    """Values (T,) of a smooth curve through the keys that never overshoots them.

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


_TEXTS = {
    "walk": """
        cycle 1.1 x2-3
        alternate_thigh      0:27 .12:23 .5:-18 .6:-6 .75:22 .88:30
        alternate_knee       0:4 .13:16 .38:5 .5:18 .72:60 .93:6
        alternate_foot       0:16 .1:0 .38:0 .5:-28 .6:-58 .75:-22 .92:14
        alternate_arm_raise  0:-20 .5:24
        alternate_elbow      0:12 .5:32
        twist                0:5 .5:-5
        bend                 0:4
    """,
    "run": """
        cycle .74 x3-4
        alternate_thigh      0:34 .08:30 .34:-18 .42:-14 .7:46 .85:52
        alternate_knee       0:16 .12:42 .34:14 .6:104 .75:85 .92:22
        alternate_foot       0:6 .06:0 .2:0 .34:-52 .6:-82 .75:-40 .92:8
        flight               0:0 .34:0 .42:4 .5:0 .84:0 .92:4
        alternate_arm_raise  0:-42 .5:34
        both_elbow           0:88
        both_arm_turn        0:-12
        twist                0:10 .5:-10
        bend                 0:13
    """,
    "march": """
        cycle 1.05 x2-4
        alternate_thigh      0:0 .04:0 .25:84 .46:0
        alternate_knee       0:3 .04:3 .25:88 .46:3
        alternate_foot       0:0 .04:0 .14:-30 .25:-22 .38:-12 .46:0
        alternate_arm_raise  .25:-30 .75:52
        both_elbow           0:14
    """,
    "side_step": """
        repeat 1.15 x2-3
        left_spread    0:1 .25:24 .5:15 .75:7 1:1
        right_spread   0:1 .25:6 .5:15 .75:14 1:1
        left_thigh     0:2 .22:22 .45:5 1:2
        left_knee      0:4 .22:38 .45:8 1:4
        right_thigh    0:2 .52:5 .75:22 .95:2
        right_knee     0:4 .52:8 .75:38 .95:4
        both_arm_raise 0:6 .4:26 .6:26 1:6
        both_arm_side  0:80
        lean           0:0 .25:-5 .7:5 1:0
    """,
    "turn_around": """
        once 2.0
        turn           0:0 .08:0 .5:88 .92:180 1:180
        look           0:0 .1:26 .8:20 1:0
        twist          0:0 .15:14 .8:10 1:0
        left_thigh     0:0 .1:0 .2:26 .3:0 .5:0 .6:24 .7:0
        left_knee      0:3 .1:3 .2:46 .3:3 .5:3 .6:44 .7:3
        right_thigh    .3:0 .4:26 .5:0 .7:0 .8:24 .9:0
        right_knee     .3:3 .4:46 .5:3 .7:3 .8:44 .9:3
        both_arm_raise 0:2 .5:13 1:2
        both_arm_side  0:60
    """,
    "squat": """
        repeat 2.0 x1-3
        both_thigh     .04:0 .45:90 .55:90 .96:0
        both_knee      .04:3 .45:118 .55:118 .96:3
        both_spread    0:7
        both_toe_out   0:12
        bend           .04:0 .45:44 .55:44 .96:0
        nod            .04:0 .45:-26 .55:-26 .96:0
        both_arm_raise .04:3 .4:102 .6:102 .96:3
        both_elbow     0:8
    """,
    "lunge": """
        repeat 2.3 x1-2
        left_thigh     0:0 .18:52 .32:36 .5:84 .62:62 .8:42 1:0
        left_knee      0:3 .18:60 .32:30 .5:94 .62:62 .8:62 1:3
        left_foot      0:0 .12:-18 .26:8 .34:0 .66:0 .72:-14 .8:-10 .97:0
        right_thigh    0:0 .18:2 .32:-22 .5:-8 .62:-20 .8:0
        right_knee     0:3 .18:3 .32:14 .5:86 .62:26 .8:4
        right_foot     .14:0 .32:-32 .5:-66 .62:-38 .8:0
        bend           0:0 .5:7 1:0
        both_arm_out   0:6 .4:26 .6:26 1:6
        both_elbow     0:10 .4:74 .6:74 1:10
        both_arm_turn  0:0 .4:-34 .6:-34 1:0
    """,
    "sit_down": """
        once 2.3
        both_thigh     .1:0 .85:86
        both_knee      .1:3 .85:92
        both_spread    0:5
        bend           .1:0 .5:42 .75:38 1:4
        nod            .1:0 .5:-20 1:0
        both_arm_raise .1:2 .5:30 1:26
        both_elbow     .1:10 1:56
        both_arm_turn  .1:0 1:-12
    """,
    "bow": """
        repeat 2.6 x1-2
        bend           .04:0 .4:62 .58:62 .96:0
        nod            .04:0 .4:22 .58:22 .96:0
        both_thigh     .04:0 .4:10 .58:10 .96:0
        both_knee      0:2
        both_arm_raise .04:2 .4:24 .58:24 .96:2
        both_elbow     0:8
    """,
    "pick_up": """
        repeat 2.6 x1-2
        bend           .04:0 .35:70 .5:70 .75:12 .96:0
        nod            .04:0 .35:-14 .5:-14 .96:0
        both_thigh     .04:0 .35:74 .5:74 .75:4 .96:0
        both_knee      .04:3 .35:94 .5:94 .75:6 .96:3
        both_spread    0:5
        both_arm_raise .04:2 .35:66 .5:66 .75:44 .85:30 .96:2
        both_elbow     .04:8 .35:10 .5:14 .75:82 .85:70 .96:8
        both_arm_turn  0:0 .75:-16 .96:0
    """,
    "jump": """
        repeat 1.7 x1-3
        both_thigh     0:0 .22:60 .42:2 .54:12 .66:16 .78:48 1:0
        both_knee      0:3 .22:90 .42:4 .54:26 .66:20 .78:74 1:3
        both_foot      .26:0 .34:-14 .42:-40 .54:-34 .66:-14 .7:0
        bend           0:0 .22:42 .42:4 .66:8 .78:30 1:0
        flight         .41:0 .44:9 .48:18 .54:23 .6:18 .64:9 .67:0
        both_arm_raise 0:3 .2:-46 .42:136 .55:126 .72:42 1:3
        both_elbow     0:10 .22:16 .42:30 .7:24 1:10
    """,
    "jumping_jack": """
        cycle 1.05 x2-4
        both_arm_side  0:92
        both_arm_raise 0:8 .5:164
        both_arm_turn  0:0 .5:40
        both_elbow     0:12 .5:22
        both_spread    0:2 .13:2 .38:25 .63:25 .88:2
        both_toe_out   0:8
        both_thigh     0:10 .1:6 .25:2 .42:4 .5:11 .6:6 .75:2 .92:4
        both_knee      0:24 .1:10 .25:5 .42:8 .5:22 .6:10 .75:5 .92:8
        both_foot      .08:0 .14:-12 .25:-16 .36:-10 .42:0 .58:0 .64:-12 .75:-16 .86:-10 .92:0
        flight         .1:0 .15:6 .25:12 .36:6 .41:0 .6:0 .65:6 .75:12 .86:6 .91:0
    """,
    "kick_left": """
        repeat 1.5 x1-2 sided
        left_thigh      0:0 .24:-24 .48:84 .56:80 .7:36 .92:0
        left_knee       0:3 .12:52 .26:80 .34:74 .48:10 .56:14 .68:60 .8:44 .92:3
        left_foot       .02:0 .12:-50 .26:-90 .36:-52 .48:52 .56:44 .7:-24 .82:-10 .92:0
        right_knee      0:5 .5:12 1:5
        right_thigh     0:2 .5:2 1:2
        bend            0:0 .24:10 .5:-12 1:0
        right_arm_raise 0:4 .24:-20 .5:48 1:4
        left_arm_raise  0:4 .24:30 .5:-32 1:4
        both_elbow      0:18 .5:32 1:18
        both_arm_out    0:6 .5:26 1:6
    """,
    "wave_left": """
        cycle .62 x3-5 entry sided
        left_arm_side  0:84
        left_arm_raise 0:86 .5:94
        left_arm_turn  0:92
        left_elbow     0:52 .5:112
        lean           0:-2
    """,
    "raise_hands": """
        repeat 2.4 x1-2
        both_arm_side  0:30
        both_arm_raise .04:3 .36:166 .64:166 .96:3
        both_elbow     .04:10 .2:28 .36:6 .64:6 .8:28 .96:10
        bend           .04:0 .4:-6 .6:-6 .96:0
        nod            .04:0 .4:-16 .6:-16 .96:0
    """,
    "clap": """
        cycle .58 x3-5 entry
        both_arm_raise 0:42
        both_arm_side  0:12
        both_elbow     0:84 .5:78
        both_arm_turn  0:-38 .5:14
        nod            0:6
    """,
    "punch": """
        cycle 1.1 x2-3 entry
        left_thigh      0:20
        left_knee       0:18
        right_thigh     0:-10
        right_knee      0:18
        right_foot      0:-14 .3:-30 .6:-14
        both_toe_out    0:14
        bend            0:8 .3:14 .6:8
        twist           0:-16 .3:30 .6:-16
        right_arm_raise 0:34 .1:34 .3:94 .36:92 .6:34
        right_elbow     0:124 .1:126 .3:6 .36:10 .6:124
        right_arm_turn  0:-14 .3:-6 .6:-14
        right_arm_side  0:26 .3:-22 .6:26
        left_arm_raise  0:44
        left_elbow      0:116
        left_arm_turn   0:-22
        left_arm_side   0:22
        nod             0:6
    """,
    "throw": """
        repeat 1.9 x1-2
        twist           .04:0 .34:-42 .42:-38 .58:36 .72:34 .98:0
        bend            .04:0 .34:-12 .58:22 .72:28 .98:0
        lean            .04:0 .34:-6 .58:8 .98:0
        left_thigh      .04:0 .26:44 .44:30 .58:32 .76:30 .88:24 .98:0
        left_knee       .04:3 .26:52 .44:14 .58:30 .76:30 .88:42 .98:3
        left_foot       .04:0 .26:-12 .4:10 .46:0 .8:0 .88:-10 .98:0
        right_thigh     .04:0 .26:4 .44:-20 .6:-16 .76:-14 .98:0
        right_knee      .04:3 .26:14 .44:14 .6:34 .76:34 .98:3
        right_foot      .26:0 .44:-22 .6:-52 .76:-46 .96:0
        right_arm_side  .04:40 .34:94 .44:94 .56:58 .68:-16 .98:40
        right_arm_raise .04:3 .34:92 .44:96 .56:108 .68:50 .98:3
        right_arm_turn  .04:0 .34:86 .46:92 .56:20 .98:0
        right_elbow     .04:10 .34:92 .46:88 .56:14 .68:26 .98:10
        left_arm_raise  .04:3 .34:66 .44:60 .6:-6 .72:-10 .98:3
        left_arm_side   0:40
        left_elbow      .04:10 .34:24 .6:64 .98:10
        look            .04:0 .34:34 .42:32 .58:-20 .98:0
    """,
    "arm_circles": """
        cycle 1.25 x2-3 entry
        both_arm_raise 0:88 .25:132 .5:88 .75:44
        both_arm_side  0:58 .25:86 .5:116 .75:86
        both_elbow     0:6
        both_arm_turn  0:10
    """,
    "side_bend": """
        cycle 2.6 x1-2 entry
        lean           0:34 .5:-34
        both_arm_side  0:82
        both_arm_raise 0:158
        both_arm_turn  0:56
        both_elbow     0:34
        both_spread    0:12
    """,
}

SCORES: dict[str, Score] = {name: parse_score(text) for name, text in _TEXTS.items()}
for _right, _left in (("kick_right", "kick_left"), ("wave_right", "wave_left")):
    SCORES[_right] = SCORES[_left].mirrored()
SCORES = dict(sorted(SCORES.items()))
