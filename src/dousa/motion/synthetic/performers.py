"""Synthetic people with everyday motions: data for trying things out.

Every motion is a short score of keys on named degrees of freedom (`scores`); a `Performer` plays it with a body, tempo,
amplitude, timing, posture and unsteadiness. The same seeds give the same motion. The feet carry the body and so
determine its path. Metres, Y up; performers face +Z.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.motion.synthetic.body import build_skeleton, compose_motion
from dousa.motion.synthetic.scores import FREEDOMS, SCORES, Score, Track, evaluate_track, mirror_name
from dousa.motion.types import Motion, Skeleton

# Directions and headings: a livelier performer does not turn further round or raise the arms more sideways.
_UNSCALED = ("turn", "arm_side", "arm_turn", "toe_out", "arm_out")


@dataclass(frozen=True, slots=True)
class Plan:
    """Of every frame (T,): the time in s, the phase in rounds, how far the stance is left (0 to 1)."""

    times: FloatArray
    phases: FloatArray
    weights: FloatArray


def _posture(performer: Performer) -> dict[str, float]:
    side = {"arm_out": performer.arm_out, "elbow": performer.elbow, "toe_out": performer.toe_out}
    side |= {"arm_side": 12.0, "arm_raise": 2.0, "knee": 3.0, "thigh": 1.0, "spread": 1.5}
    stance = {f"{hand}_{name}": value for hand in ("left", "right") for name, value in side.items()}
    # The working shoulder hangs lower and its elbow is bent a little more.
    stance |= {"bend": performer.stoop, "nod": 0.6 * performer.stoop, "lean": -performer.tilt}
    stance["right_elbow"] += 4.0 * performer.tilt / 2
    if performer.left_handed:
        stance = {mirror_name(name): value for name, value in stance.items()}
        stance["lean"] = performer.tilt
    return stance


def play_score(score: Score, performer: Performer, plan: Plan, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Degrees (T,) of every degree of freedom."""
    stance = _posture(performer)
    hinges = {"elbow": (0.0, 150.0), "knee": (0.0, 150.0), "arm_raise": (-75.0, 178.0)}
    periodic = score.kind != "once"
    own = np.random.default_rng([performer.seed, 1])
    habits: dict[str, float] = {}
    phases, weights = plan.phases, plan.weights
    pose = {}
    for name in FREEDOMS:
        kind = name.partition("_")[2] or name
        # The two sides are similar, not equal.
        habit = habits.setdefault(kind, own.normal(1.0, 0.06) * rng.normal(1.0, 0.03))
        gain = performer.amplitude * habit * own.normal(1.0, 0.02)
        gain = 1.0 + 0.1 * (gain - 1.0) if kind in _UNSCALED else gain
        values = np.zeros(len(phases))
        rest = np.full(len(phases), stance.get(name, 0.0))
        if name in score.tracks:
            late = performer.lag if kind.startswith(("arm", "elbow")) and periodic else 0.0
            values = gain * evaluate_track(score.tracks[name], phases - late, periodic)
            # The score moves the arm; of the stance only its slack remains.
            rest = rest * (1.0 - weights) if kind == "arm_side" else rest
        if kind not in ("flight", "turn"):
            rest = rest + _unsteadiness(plan.times, performer.noise * (0.4 if kind == "foot" else 1.0), rng)
        values = weights * values + rest
        low, high = hinges.get(kind, (-np.inf, np.inf))
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


CATEGORIES: tuple[str, ...] = tuple(SCORES)
"""The kinds of motion of `make_motion`."""


@dataclass(frozen=True, slots=True)
class Performer:
    """A body and a manner of moving.

    Parameters
    ----------
    name : for file names.
    seed : of the differences from take to take.
    stature : m.
    legs, arms, width : limb lengths and breadth as shares of the average ones.
    tempo, amplitude : speed and extent of motions as shares of the score's.
    timing : -0.5 to 0.5, how much of each round is hurried (first half if positive).
    lag : share of a round by which the arms come late.
    noise : degrees, slow unsteadiness of every joint.
    left_handed : mirrors the posture, and the motions that can be done either way.
    stoop, tilt, arm_out, elbow, toe_out : degrees, posture.
    """

    name: str = "average"
    seed: int = 0
    stature: float = 1.72
    legs: float = 1.0
    arms: float = 1.0
    width: float = 1.0
    tempo: float = 1.0
    amplitude: float = 1.0
    timing: float = 0.0
    lag: float = 0.0
    noise: float = 1.0
    left_handed: bool = False
    stoop: float = 2.0
    tilt: float = 0.0
    arm_out: float = 7.0
    elbow: float = 8.0
    toe_out: float = 7.0


def draw_performer(seed: int, name: str | None = None) -> Performer:
    """Draw a random performer, the same for the same seed; the name is ``performerNN`` with the seed by default."""
    rng = np.random.default_rng([0x0D05A, _checked_seed(seed)])

    def near(mean: float, spread: float, low: float, high: float) -> float:
        return float(np.clip(rng.normal(mean, spread), low, high))

    return Performer(
        name=f"performer{seed:02d}" if name is None else name,
        seed=seed,
        stature=near(1.70, 0.10, 1.45, 1.95),
        legs=near(1.0, 0.035, 0.92, 1.08),
        arms=near(1.0, 0.035, 0.92, 1.08),
        width=near(1.0, 0.06, 0.86, 1.16),
        tempo=float(rng.uniform(0.78, 1.3)),
        amplitude=near(0.97, 0.11, 0.72, 1.15),
        timing=near(0.0, 0.18, -0.4, 0.4),
        lag=near(0.0, 0.025, -0.05, 0.05),
        noise=float(rng.uniform(0.8, 2.4)),
        left_handed=bool(rng.random() < 0.3),
        stoop=near(2.0, 3.0, -4.0, 10.0),
        tilt=near(1.5, 1.5, -1.0, 5.0),
        arm_out=near(8.0, 3.0, 4.0, 16.0),
        elbow=near(9.0, 4.0, 1.0, 22.0),
        toe_out=near(7.0, 3.0, 0.0, 15.0),
    )


def make_skeleton(performer: Performer) -> Skeleton:
    """Build the performer's skeleton: the 20 canonical joints by name and 5 end sites, facing +Z, arms hanging."""
    return build_skeleton(performer.stature, performer.legs, performer.arms, performer.width)


def make_motion(category: str, performer: Performer, seed: int = 0, frame_rate: float = 30.0) -> Motion:
    """Make one take of one kind of motion.

    It is in metres, Y up, begins near the origin and faces about +Z; feet stay on the floor y = 0 except for jumps.

    Parameters
    ----------
    category : one of `CATEGORIES`.
    performer : the performer.
    seed : number of the take; tempo, rounds, start and unsteadiness differ from take to take.
    frame_rate : Hz.

    Raises
    ------
    OptionError : an unknown category, a negative seed, a frame rate that is not above 0.
    """
    if category not in SCORES:
        raise OptionError("synthetic.category", category=category, known=CATEGORIES)
    if not (np.isfinite(frame_rate) and frame_rate > 0):
        raise OptionError("synthetic.rate", rate=frame_rate)
    rng = np.random.default_rng([performer.seed, zlib.crc32(category.encode()), _checked_seed(seed)])
    return perform_score(SCORES[category], performer, rng, frame_rate)


def perform_score(score: Score, performer: Performer, rng: np.random.Generator, frame_rate: float = 30.0) -> Motion:
    """Make one take of a score, as by ``make_motion``; ``rng`` draws the differences from take to take."""
    if performer.left_handed and not score.sided:
        score = score.mirrored()
    plan = _plan(score, performer, frame_rate, rng)
    pose = play_score(score, performer, plan, rng)
    return compose_motion(make_skeleton(performer), pose, frame_rate, performer.stature)


def make_library(
    n_performers: int = 10,
    takes: int = 1,
    seed: int = 0,
    categories: Sequence[str] = CATEGORIES,
    frame_rate: float = 30.0,
) -> Iterator[tuple[str, Performer, int, Motion]]:
    """Yield all motions of a synthetic library: category, performer, number of the take from 0, motion.

    Parameters
    ----------
    n_performers, takes : how many people, and how often each performs each category.
    seed : performer p of library s is drawn from seed 1000 s + p.
    categories : which kinds of motion.
    frame_rate : Hz.
    """
    if n_performers < 1 or takes < 1:
        raise OptionError("synthetic.none", performers=n_performers, takes=takes)
    performers = [
        draw_performer(1000 * _checked_seed(seed) + number, f"performer{number:02d}") for number in range(n_performers)
    ]
    for category in categories:
        for performer in performers:
            for take in range(takes):
                yield category, performer, take, make_motion(category, performer, take, frame_rate)


def _checked_seed(seed: int) -> int:
    if seed < 0:
        raise OptionError("synthetic.seed", seed=seed)
    return int(seed)


def _plan(score: Score, performer: Performer, frame_rate: float, rng: np.random.Generator) -> Plan:
    """How one take runs: tempo, rounds, start, hurry, and whether it begins and ends standing."""
    seconds = score.seconds / (performer.tempo * rng.uniform(0.94, 1.06))
    low, high = score.rounds
    rounds = float(rng.integers(low, high + 1))
    before, after = rng.uniform(0.05, 0.3, 2) * seconds
    start = 0.0
    if score.kind == "cycle":
        rounds += rng.uniform(-0.3, 0.3)
        start = rng.uniform(0.0, 1.0)
        before = after = 0.0
    total = before + rounds * seconds + after
    frames = max(round(total * frame_rate), 2)
    if frames > 1_000_000:
        raise OptionError("synthetic.too_long", most=1_000_000, frames=frames)
    times = np.arange(frames) / frame_rate
    phases = start + np.clip((times - before) / seconds, 0.0, rounds)
    hurry = np.clip(performer.timing + rng.normal(0.0, 0.06), -0.5, 0.5)
    phases = phases + hurry * (1 - np.cos(2 * np.pi * phases)) / (2 * np.pi)
    weights = np.ones(frames)
    if score.entry and rng.random() < 0.6:
        rise, fall = rng.uniform(0.25, 0.5, 2) / performer.tempo
        ramp = np.minimum(times / rise, (times[-1] - times) / fall).clip(0.0, 1.0)
        weights = ramp * ramp * (3 - 2 * ramp)
    return Plan(times, phases, weights)


_SIDES = ("left", "right")


def make_gesture(seed: int, frame_rate: float = 30.0) -> Motion:
    """Make a gesture of a random performer, in metres with Y up as by ``make_motion``; the same for the same seed."""
    rng = np.random.default_rng([0x6E57, seed])
    performer = draw_performer(5000 + seed)  # no performer of the other synthetic libraries
    return perform_score(draw_score(rng), performer, rng, frame_rate)


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


def _draw_keys(rng: np.random.Generator, kind: str, values: FloatArray, apart: float = 0.08) -> Track:
    """Draw poses and their times, from standing and back to it unless the motion ends elsewhere.

    ``apart`` : least share of a round between two poses.
    """
    while True:
        phases = np.sort(rng.uniform(0.15, 0.85, len(values)))
        if len(values) == 1 or np.diff(phases).min() >= apart:
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
