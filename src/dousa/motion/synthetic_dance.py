"""A synthetic dance: six figures of eight counts, several of them danced more than once, as in real dances.

Figures are scores in the language of `_synthetic_scores`, with counts of the music instead of phases. They are
joined key by key into one long score, so that every degree of freedom stays smooth from figure to figure, and a
`Performer` plays it with a body, extent, posture and unsteadiness of their own. All performers keep the tempo of
the music. The same seeds give the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.errors import OptionError
from dousa.motion._synthetic_body import compose_motion
from dousa.motion._synthetic_playing import Plan, play_score
from dousa.motion._synthetic_scores import FREEDOMS, Score, Track, parse_score
from dousa.motion._types import FloatArray, Motion
from dousa.motion.synthetic import Performer, make_skeleton

__all__ = ["CHOREOGRAPHY", "Dance", "DanceFigure", "make_dance"]

CHOREOGRAPHY: tuple[str, ...] = (
    "sway",
    "gather",
    "sway",
    "circles",
    "turn",
    "gather",
    "point",
    "kick",
    "sway",
    "circles",
)
"""Names of the figures in the order in which they are danced."""

_COUNT = 0.45  # s; 133 counts a minute
_COUNTS = 8.0  # of a figure
_STANDING = 1.5  # counts, before and after the dance
_SLACK = 0.03  # s, how far off the beat a dancer drifts
_WANDERING = np.array([[0.11], [0.23], [0.41]])  # Hz, of that drift
_MAX_FRAMES = 1_000_000
_RETURN = 0.8  # counts within which a freedom that a figure does not use comes back to rest

_TEXTS = {
    "sway": """
        once 8
        left_spread     0:2 1:19 2:12 3:4 4:3 5:6 6:12 7:3 8:2
        right_spread    0:2 1:6 2:12 3:3 4:3 5:19 6:12 7:4 8:2
        left_thigh      0:2 .6:24 1.2:6 2:18 3:3 6:6 6.6:22 7.3:4 8:2
        left_knee       0:4 .6:42 1.2:10 2:30 3:6 6:8 6.6:38 7.3:6 8:4
        right_thigh     0:2 2:6 2.6:22 3.3:4 4:2 4.6:24 5.2:6 6:18 7:3 8:2
        right_knee      0:4 2:8 2.6:38 3.3:6 4:4 4.6:42 5.2:10 6:30 7:6 8:4
        left_arm_raise  0:18 2:124 4:26 6:72 8:18
        left_arm_side   0:60 2:86 4:40 6:-24 8:60
        left_elbow      0:20 2:12 4:28 6:46 8:20
        right_arm_raise 0:18 2:72 4:26 6:124 8:18
        right_arm_side  0:60 2:-24 4:40 6:86 8:60
        right_elbow     0:20 2:46 4:28 6:12 8:20
        lean            0:0 2:9 4:0 6:-9 8:0
        look            0:0 2:26 4:0 6:-26 8:0
    """,
    "gather": """
        once 8
        left_thigh      0:0 .6:34 1.3:20 2.4:-10 3:0 4:0 5.6:8 6.4:-12 7.4:0
        left_knee       0:3 .5:44 1.3:14 2.4:18 3:4 4:4 5.6:14 6.4:34 7.4:3
        left_foot       .8:8 1.3:0 2:-8 2.6:-26 3.2:0 6:-20 6.5:-36 7.4:0
        right_thigh     1.2:-6 1.7:-8 2.4:12 3:0 4:0 4.6:34 5.3:20 6.4:-2 7.4:0
        right_knee      1.2:12 1.7:34 2.4:10 3:4 4:4 4.5:44 5.3:14 6.4:8 7.4:3
        right_foot      1.2:-12 1.8:-32 2.6:0 4.8:8 5.3:0 7.4:0
        bend            0:0 1.5:12 3:2 4:2 5.5:12 7:2 8:0
        both_arm_raise  0:18 1.5:58 3:92 4:34 5.5:58 7:152 8:18
        both_arm_side   0:60 1.5:74 3:10 4:52 5.5:78 7:52 8:60
        both_elbow      0:20 1.5:18 3:72 4:30 5.5:20 7:14 8:20
        both_arm_turn   1.5:0 3:-30 4:0
        nod             0:0 1.5:14 3:0 4:0 5.5:14 7:-20 8:0
    """,
    "circles": """
        once 8
        both_spread     0:4 2:10 6:10 8:2
        both_toe_out    1:8 7:8
        both_thigh      0:2 1:4 2:44 3:4 4:3 5:4 6:44 7:4 8:2
        both_knee       0:4 1:6 2:62 3:6 4:5 5:6 6:62 7:6 8:4
        bend            1:0 2:15 3:0 5:0 6:15 7:0
        left_arm_raise  0:18 1:66 2:120 3:150 4:84 5:48 6:90 7:132 8:18
        right_arm_raise 0:18 1:66 2:120 3:150 4:84 5:48 6:90 7:132 8:18
        both_arm_side   0:60 1:34 2:62 3:92 4:104 5:80 6:46 7:84 8:60
        both_elbow      0:20 1:8 7:8 8:20
        both_arm_turn   1:10 7:10
    """,
    "turn": """
        once 8
        turn            .3:0 4:185 7.7:360
        look            .3:0 1:28 6.5:24 7.7:0
        twist           .3:0 1.2:12 6.5:10 7.7:0
        left_thigh      0:2 .5:28 1:4 2:2 2.5:28 3:4 4:2 4.5:28 5:4 6:2 6.5:26 7:4 8:2
        left_knee       0:4 .5:46 1:8 2:4 2.5:46 3:8 4:4 4.5:46 5:8 6:4 6.5:42 7:8 8:4
        right_thigh     0:2 1:2 1.5:28 2:4 3:2 3.5:28 4:4 5:2 5.5:28 6:4 7:2 7.5:22 8:2
        right_knee      0:4 1:4 1.5:46 2:8 3:4 3.5:46 4:8 5:4 5.5:46 6:8 7:4 7.5:36 8:4
        left_arm_raise  0:18 1.5:84 6.5:84 8:18
        left_arm_side   0:60 1.5:84 6.5:84 8:60
        right_arm_raise 0:18 1.5:146 6.5:146 8:18
        right_arm_side  0:60 1.5:74 6.5:74 8:60
        both_elbow      0:20 1.5:16 6.5:16 8:20
    """,
    "point": """
        once 8
        left_thigh      0:2 .6:44 1.3:38 2:58 3:46 3.6:34 4:2 5.4:-18 6:-14 7:-16 8:2
        left_knee       0:4 .6:54 1.3:30 2:62 3:48 3.6:48 4:4 5.4:20 6:30 7:22 8:4
        left_foot       .6:-8 1.1:6 1.4:0 3.2:0 3.6:-16 4:0 4.8:0 5.4:-28 6.4:-36 7.4:-24 8:0
        right_thigh     0:2 1.3:-18 2:-14 3:-16 4:2 4.6:44 5.3:38 6:58 7:46 7.6:34 8:2
        right_knee      0:4 1.3:20 2:30 3:22 4:4 4.6:54 5.3:30 6:62 7:48 7.6:48 8:4
        right_foot      .8:0 1.4:-28 2.4:-36 3.4:-24 4:0 4.6:-8 5.1:6 5.4:0 7.2:0 7.6:-16 8:0
        right_arm_raise 0:18 1.8:138 2.8:138 4:22 5.8:56 6.8:56 8:18
        right_arm_side  0:60 1.8:20 2.8:20 4:60 5.8:98 6.8:98 8:60
        right_elbow     0:20 1.8:4 2.8:4 4:24 5.8:30 6.8:30 8:20
        left_arm_raise  0:18 1.8:56 2.8:56 4:22 5.8:138 6.8:138 8:18
        left_arm_side   0:60 1.8:98 2.8:98 4:60 5.8:20 6.8:20 8:60
        left_elbow      0:20 1.8:30 2.8:30 4:24 5.8:4 6.8:4 8:20
        bend            0:0 2:-6 4:0 6:-6 8:0
        nod             0:0 2:-18 4:0 6:-18 8:0
        look            0:0 2:-14 4:0 6:14 8:0
    """,
    "kick": """
        once 8
        left_thigh      0:2 1:-16 2:72 2.4:68 3:24 3.7:2 4:2 6:4 8:2
        left_knee       0:4 .6:34 1.1:62 2:12 2.4:16 3:46 3.7:4 6:12 8:4
        left_foot       .2:0 .7:-36 1.2:-70 2:40 2.4:36 3.1:-14 3.6:0
        right_thigh     0:2 2:4 4:2 5:-16 6:72 6.4:68 7:24 7.7:2 8:2
        right_knee      0:4 2:12 4:4 4.6:34 5.1:62 6:12 6.4:16 7:46 7.7:4 8:4
        right_foot      4.2:0 4.7:-36 5.2:-70 6:40 6.4:36 7.1:-14 7.6:0
        bend            0:0 1:8 2:-10 3:0 5:8 6:-10 7:0 8:0
        both_arm_raise  0:18 1.2:56 2:82 3:50 4:40 5.2:56 6:82 7:50 8:18
        both_arm_side   0:60 1:86 7:86 8:60
        both_elbow      0:20 1.2:64 2:8 3:52 4:60 5.2:64 6:8 7:52 8:20
        both_arm_turn   .6:0 1.2:40 2:0 3:20 5.2:40 6:0 7:20 7.6:0
    """,
}

_FIGURES: dict[str, Score] = {name: parse_score(text) for name, text in _TEXTS.items()}


@dataclass(frozen=True, slots=True)
class DanceFigure:
    """Where a figure is danced.

    Parameters
    ----------
    name : the same for every time that this figure is danced.
    start, end : frames, the end not included.
    """

    name: str
    start: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class Dance:
    """A danced choreography and the truth about where its figures are.

    Parameters
    ----------
    motion : the dance.
    figures : in order of time; before the first and after the last the dancer stands.
    """

    motion: Motion
    figures: tuple[DanceFigure, ...]


def make_dance(performer: Performer, seed: int = 0, frame_rate: float = 30.0) -> Dance:
    """One take of the synthetic dance, about 37 s.

    Parameters
    ----------
    performer : who dances; the tempo is that of the music, not the performer's.
    seed : number of the take; the timing within the beat and the unsteadiness differ from take to take.
    frame_rate : Hz.

    Returns
    -------
    Dance in metres, Y up, which begins near the origin and faces about +Z, with the cuts of its figures.

    Raises
    ------
    OptionError : a negative seed, a frame rate that is not above 0.
    """
    if seed < 0:
        raise OptionError(f"expected a seed of 0 or more, got {seed}")
    counts = 2 * _STANDING + _COUNTS * len(CHOREOGRAPHY)
    if not (np.isfinite(frame_rate) and 0 < frame_rate * counts * _COUNT <= _MAX_FRAMES):
        raise OptionError(f"expected a frame rate in Hz above 0 and below 25,000, got {frame_rate}")
    rng = np.random.default_rng([performer.seed, 0xDA9CE, seed])
    times = np.arange(max(round(counts * _COUNT * frame_rate), 2)) / frame_rate
    phases = (times + _drift(times, rng)) / _COUNT
    pose = play_score(_join(), performer, Plan(times, phases, np.ones(len(times))), rng)
    motion = compose_motion(make_skeleton(performer), pose, frame_rate, performer.stature)
    cuts = np.round((_STANDING + _COUNTS * np.arange(len(CHOREOGRAPHY) + 1)) * _COUNT * frame_rate)
    figures = tuple(
        DanceFigure(name, int(start), int(end))
        for name, start, end in zip(CHOREOGRAPHY, cuts, cuts[1:], strict=False)
    )
    return Dance(motion, figures)


def _drift(times: FloatArray, rng: np.random.Generator) -> FloatArray:
    """How early the dancer is at each time (T,) in s."""
    offsets = rng.uniform(0.0, 2 * np.pi, (3, 1))
    sizes = rng.normal(0.0, _SLACK / np.sqrt(1.5), (3, 1))
    drift: FloatArray = (sizes * np.sin(2 * np.pi * _WANDERING * times + offsets)).sum(axis=0)
    return np.clip(drift, -2 * _SLACK, 2 * _SLACK)


def _join() -> Score:
    """All figures one after the other as one score whose phases are counts."""
    total = 2 * _STANDING + _COUNTS * len(CHOREOGRAPHY)
    tracks = {name: _join_track(name, total) for name in FREEDOMS}
    return Score("once", total * _COUNT, (1, 1), False, True, tracks)


def _join_track(freedom: str, total: float) -> Track:
    keys: dict[float, float] = {0.0: 0.0}
    heading = 0.0
    for number, name in enumerate(CHOREOGRAPHY):
        start = _STANDING + _COUNTS * number
        rest = (np.array([_RETURN, _COUNTS - _RETURN]), np.zeros(2))
        counts, values = _FIGURES[name].tracks.get(freedom, rest)
        for count, value in zip(counts, values, strict=True):
            keys[start + float(count)] = heading + float(value)
        if freedom == "turn" and freedom in _FIGURES[name].tracks:
            heading += float(values[-1])
    keys[total] = heading
    places = sorted(keys)
    return np.array(places), np.array([keys[place] for place in places])
