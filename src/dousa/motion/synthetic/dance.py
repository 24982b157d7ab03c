"""A synthetic dance: six figures of eight counts, several of them danced more than once, as in real dances.

Figures are scores in the language of `scores`, with counts of the music instead of phases. They are joined key by key
into one long score, so that every degree of freedom stays smooth, and played by a `Performer`. All performers keep
the tempo of the music. The same seeds give the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.motion.synthetic.body import compose_motion
from dousa.motion.synthetic.performers import Performer, Plan, make_skeleton, play_score
from dousa.motion.synthetic.scores import FREEDOMS, Score, Track, load_scores
from dousa.motion.types import Motion

CHOREOGRAPHY: tuple[str, ...] = tuple("sway gather sway circles turn gather point kick sway circles".split())
"""Names of the figures in the order in which they are danced."""

_COUNT = 0.45  # s; 133 counts a minute
_COUNTS = 8.0  # of a figure
_STANDING = 1.5  # counts, before and after the dance
_SLACK = 0.03  # s, how far off the beat a dancer drifts
_WANDERING = np.array([[0.11], [0.23], [0.41]])  # Hz, of that drift
_MAX_FRAMES = 1_000_000
_RETURN = 0.8  # counts within which a freedom that a figure does not use comes back to rest

_FIGURES: dict[str, Score] = load_scores("dance.toml")


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
    """Make one take of the synthetic dance, about 37 s.

    The dance is in metres, Y up, begins near the origin and faces about +Z.

    Parameters
    ----------
    performer : the dancer; the tempo is that of the music, not the performer's.
    seed : number of the take; the timing within the beat and the unsteadiness differ from take to take.
    frame_rate : Hz.

    Raises
    ------
    OptionError : a negative seed, a frame rate that is not above 0.
    """
    if seed < 0:
        raise OptionError("synthetic.seed", seed=seed)
    counts = 2 * _STANDING + _COUNTS * len(CHOREOGRAPHY)
    if not (np.isfinite(frame_rate) and 0 < frame_rate * counts * _COUNT <= _MAX_FRAMES):
        raise OptionError("synthetic.dance_rate", rate=frame_rate)
    rng = np.random.default_rng([performer.seed, 0xDA9CE, seed])
    times = np.arange(max(round(counts * _COUNT * frame_rate), 2)) / frame_rate
    phases = (times + _drift(times, rng)) / _COUNT
    pose = play_score(_join(), performer, Plan(times, phases, np.ones(len(times))), rng)
    motion = compose_motion(make_skeleton(performer), pose, frame_rate, performer.stature)
    cuts = np.round((_STANDING + _COUNTS * np.arange(len(CHOREOGRAPHY) + 1)) * _COUNT * frame_rate)
    figures = tuple(
        DanceFigure(name, int(start), int(end)) for name, start, end in zip(CHOREOGRAPHY, cuts, cuts[1:], strict=False)
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
