"""A synthetic dance of six figures of eight counts, several of them danced more than once, and a pupil's mistakes.

Figures are scores in the language of `scores`, with counts of the music instead of phases. They are joined key by key
into one long score, so that every degree of freedom stays smooth, and played by a `Performer`. All performers keep
the tempo of the music. The same seeds give the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray, IntArray
from dousa.errors import OptionError
from dousa.motion import rotations as rot
from dousa.motion.synthetic.body import compose_motion
from dousa.motion.synthetic.performers import Performer, Plan, make_skeleton, play_score
from dousa.motion.synthetic.scores import FREEDOMS, Score, Track, load_scores
from dousa.motion.types import Motion

CHOREOGRAPHY: tuple[str, ...] = tuple("sway gather sway circles turn gather point kick sway circles".split())
"""Names of the figures in the order in which they are danced."""

# By definition of this dance: s of a count (133 a minute), counts of a figure, counts before and after the dance.
_COUNT, _COUNTS, _STANDING = 0.45, 8.0, 1.5

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
    if not (np.isfinite(frame_rate) and 0 < frame_rate * counts * _COUNT <= 1_000_000):
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


def _drift(times: FloatArray, rng: np.random.Generator, slack: float = 0.03) -> FloatArray:
    """How early the dancer is at each time (T,) in s; ``slack`` : s, how far off the beat a dancer drifts."""
    offsets = rng.uniform(0.0, 2 * np.pi, (3, 1))
    sizes = rng.normal(0.0, slack / np.sqrt(1.5), (3, 1))
    drift: FloatArray = (sizes * np.sin(2 * np.pi * np.array([[0.11], [0.23], [0.41]]) * times + offsets)).sum(axis=0)
    return np.clip(drift, -2 * slack, 2 * slack)


def _join() -> Score:
    """All figures one after the other as one score whose phases are counts."""
    total = 2 * _STANDING + _COUNTS * len(CHOREOGRAPHY)
    tracks = {name: _join_track(name, total) for name in FREEDOMS}
    return Score("once", total * _COUNT, (1, 1), False, True, tracks)


def _join_track(freedom: str, total: float, back: float = 0.8) -> Track:
    """One freedom in all figures; where a figure does not use it, it comes back to rest within ``back`` counts."""
    keys: dict[float, float] = {0.0: 0.0}
    heading = 0.0
    for number, name in enumerate(CHOREOGRAPHY):
        start = _STANDING + _COUNTS * number
        rest = (np.array([back, _COUNTS - back]), np.zeros(2))
        counts, values = _FIGURES[name].tracks.get(freedom, rest)
        for count, value in zip(counts, values, strict=True):
            keys[start + float(count)] = heading + float(value)
        if freedom == "turn" and freedom in _FIGURES[name].tracks:
            heading += float(values[-1])
    keys[total] = heading
    places = sorted(keys)
    return np.array(places), np.array([keys[place] for place in places])


_LIMBS = {
    "left_arm": ("left_shoulder", "left_elbow"),
    "right_arm": ("right_shoulder", "right_elbow"),
}
_SEGMENTS = {"shoulder": "upper_arm", "elbow": "forearm"}


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


def make_mistakes(
    dance: Dance,
    seed: int = 0,
    *,
    ramp_s: float = 0.3,
    lag_s: tuple[float, float] = (0.35, 0.5),
    shortfall: float = 0.6,
) -> tuple[Motion, tuple[Mistake, ...]]:
    """Make one mistake of each kind in a dance, each in the middle of another figure.

    Returns the dance with mistakes, whose bones keep their lengths, and the mistakes in order of time.

    Parameters
    ----------
    dance : at least four figures, from `make_dance`.
    seed : of the figures and arms.
    ramp_s : s in which a mistake begins and ends.
    lag_s : s, least and most, by which a shifted part is late.
    shortfall : share of the way back to the pose at the start of the figure, of an incomplete movement.

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
        late = rng.uniform(*lag_s) if kind == "shift" else 0.0
        motion, mistake = _put(motion, str(kind), figure.start, figure.end, ramp_s, late, shortfall)
        mistakes.append(mistake)
    return motion, tuple(mistakes)


def _put(
    motion: Motion, kind: str, start: int, end: int, ramp_s: float, lag_s: float, shortfall: float
) -> tuple[Motion, Mistake]:
    """Blend the joints of a mistake into their motion at another time, frame by frame."""
    length = end - start
    first, stop = start + length // 5, end - length // 5
    frames = np.arange(motion.n_frames)
    other, weight = frames.copy(), _window(frames, first, stop, ramp_s * motion.frame_rate)
    names = _busiest_arm(motion, first, stop)
    span = first / motion.frame_rate, stop / motion.frame_rate
    segments = tuple(name.replace(joint, part) for name in names for joint, part in _SEGMENTS.items() if joint in name)
    if kind == "shift":
        other = frames - round(lag_s * motion.frame_rate)
        mistake = Mistake(kind, *span, segments, lag_ms=1000 * round(lag_s * motion.frame_rate) / motion.frame_rate)
    elif kind == "incomplete":
        other, weight = np.full_like(frames, start), shortfall * weight
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
