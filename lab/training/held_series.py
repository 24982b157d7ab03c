"""Repetitions that are done where a limb is first brought to, and from where it is taken back: waving, clapping.

Synthetic performers do those of the scores that begin so, and some drawn at random: one arm or both go to a place, and
there an elbow, the arm's turn or its height swings, by far less than the way there or by as much. As in ``_repeated``
each series is in a manner of its own, between rests of up to a second or cut a little short, and seen by some sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic import draw_performer, make_skeleton
from dousa.motion.synthetic.body import compose_motion
from dousa.motion.synthetic.performers import Plan, play_score
from dousa.motion.synthetic.scores import SCORES, Score, Track
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.training.repeated_series import KINDS, draw_manner, see
from lab.training.series import Series

__all__ = ["HELD", "make_held", "read_held"]

HELD = "held"
_MANNERS = tuple(kind for kind in KINDS if kind not in ("pauses", "sides"))
_KNOWN = tuple(name for name, score in SCORES.items() if score.entry)
_DRAWN = 8  # scores
_ROUNDS = (1, 12)
_OF_CLIPS = (1, 5)  # what somebody shows of such an action is rarely a single round
_SHORTEST = 0.35  # s of a round


def draw_held(seed: int) -> Score:
    """A score drawn at random, degrees."""
    rng = np.random.default_rng([31, seed])
    sides = [("left",), ("right",), ("left", "right")][int(rng.integers(3))]
    place = {"raise": rng.uniform(30.0, 150.0), "side": rng.uniform(-10.0, 90.0), "turn": rng.normal(0.0, 35.0)}
    bent, swung = rng.uniform(10.0, 110.0), rng.choice(("elbow", "turn", "raise"), size=int(rng.integers(1, 3)))
    values = {**{f"arm_{name}": value for name, value in place.items()}, "elbow": bent}
    tracks: dict[str, Track] = {}
    for side, (name, value) in product(sides, values.items()):
        far = rng.uniform(15.0, 60.0) if name.removeprefix("arm_") in swung else 0.0
        keys = np.array([value, value + (far if value < 90.0 else -far)])
        tracks[f"{side}_{name}"] = np.array([0.0, 0.5]), np.clip(keys, -60.0, 170.0)
    return Score("cycle", float(rng.uniform(0.5, 1.6)), _ROUNDS, True, True, tracks)


def read_held(first: int, n_performers: int = 3, n_clips: int = 3) -> list[LabelledClip]:
    """Clips of performers, from number ``first`` on, who show a few rounds of every score."""
    clips = []
    for performer, (name, score), number in product(
        range(first, first + n_performers), list_scores().items(), range(n_clips)
    ):
        rng = np.random.default_rng([33, performer, number, *map(ord, name)])
        points, height = _play(score, performer, int(rng.integers(*_OF_CLIPS)), "steady", rng)
        clips.append(LabelledClip(f"{name} {number}", name, str(performer), points, TAKE_RATE, height))
    return clips


def make_held(seed: int, first: int, n_performers: int = 3) -> Iterator[tuple[str, Series]]:
    """For some performers and every score two series, with the name of the kind."""
    for performer, (name, score), number in product(
        range(first, first + n_performers), list_scores().items(), range(2)
    ):
        rng = np.random.default_rng([35, seed, performer, number, *map(ord, name)])
        count, manner = int(rng.integers(_ROUNDS[0], _ROUNDS[1] + 1)), str(rng.choice(_MANNERS))
        points, height = _play(score, performer, count, manner, rng)
        yield HELD, see(HELD, str(performer), name, count, points, height, rng)


def list_scores() -> dict[str, Score]:
    """The scores that begin so, and some drawn at random, by name."""
    return {name: SCORES[name] for name in _KNOWN} | {f"drawn {number}": draw_held(number) for number in range(_DRAWN)}


def _play(
    score: Score, performer_seed: int, count: int, kind: str, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """(n, 20, 3) m at 30 Hz: there, so many rounds, and back; and the height, m."""
    performer, manner = draw_performer(performer_seed), draw_manner(kind, count, rng)
    phases, weights = list[FloatArray](), list[FloatArray]()
    for number in range(count):
        frames = max(round(max(score.seconds / manner.tempos[number], _SHORTEST) * TAKE_RATE), 6)
        phases.append(number + np.arange(frames) / frames)
        weights.append(np.ones(frames))
    for place, seconds in ((0, rng.uniform(0.25, 0.9)), (None, rng.uniform(0.25, 0.9))):
        ramp = np.linspace(0.0, 1.0, max(round(seconds * TAKE_RATE), 4), endpoint=False)
        ramp = ramp * ramp * (3.0 - 2.0 * ramp)
        where = 0 if place == 0 else len(phases)
        phases.insert(where, np.full(len(ramp), 0.0 if place == 0 else float(count)))
        weights.insert(where, ramp if place == 0 else ramp[::-1])
    phase = np.concatenate(phases)
    plan = Plan(np.arange(len(phase)) / TAKE_RATE, phase, np.concatenate(weights))
    pose = play_score(score, performer, plan, rng)
    motion = compose_motion(make_skeleton(performer), pose, TAKE_RATE, performer.stature)
    figure = canonicalise(compute_trajectories(motion))
    return sample_positions(figure.positions, TAKE_RATE), figure.height
