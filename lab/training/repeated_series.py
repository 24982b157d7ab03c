"""Repetitions of many kinds whose count is known: another generator than that of ``_series``.

Single cycles of recorded clips, cut where the movement begins and ends, follow one another with short blends; the
synthetic performers go on by themselves, with a tempo and an extent of their own in every round. Each series is of one
of the ``KINDS``, lies between rests of up to a second or is cut a little short, and is seen by a sensor of 10 to 120 Hz
with noise of up to 3.5 cm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.formats import ReadOptions
from dousa.formats.motion_files import read_canonical
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.motion.synthetic import draw_performer, make_skeleton
from dousa.motion.synthetic.body import compose_motion
from dousa.motion.synthetic.performers import Plan, play_score
from dousa.motion.synthetic.scores import SCORES
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.made_takes import go_on
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.training.series import Series, read_sets

__all__ = [
    "KINDS",
    "SYNTHETIC",
    "draw_manner",
    "make_repeated",
    "make_synthetic_repeated",
    "read_cycles",
    "read_synthetic",
    "see",
]

SYNTHETIC = "synthetic"
KINDS = ("steady", "quick", "slow", "pauses", "fading", "growing", "hastening", "tiring", "uneven", "sides")
"""At one tempo; 1.5 to 2.3 times as fast; half as fast; with pauses of 0.3 to 3 s; ever less far, down to two fifths;
ever farther; ever faster, up to twice; ever slower; each by chance; left and right in turns."""

_RATES = (10.0, 15.0, 20.0, 25.0, 30.0, 50.0, 60.0, 100.0, 120.0)
_NOISES = (0.0, 0.0, 0.005, 0.015, 0.025, 0.035)  # m along each axis
_SCORES = (
    *("squat", "lunge", "bow", "pick_up", "jump", "kick_left", "raise_hands", "throw", "side_step"),
    *("jumping_jack", "wave_left", "clap", "arm_circles", "side_bend"),
)
_SIDED = ("kick_left", "lunge", "wave_left", "throw")
_MOVING = 0.12  # share of the speed (95 %) from which a clip moves
_FEWEST, _MOST = 1, 12
_SHORTEST = 0.35  # s of a cycle


@dataclass(frozen=True, slots=True)
class Manner:
    """How a series is done: of each repetition (N,) the tempo, the extent and the pause after it, s."""

    tempos: FloatArray
    extents: FloatArray
    pauses: FloatArray
    sides: bool = False


def draw_manner(kind: str, count: int, generator: np.random.Generator) -> Manner:
    """Tempo, extent and pauses of so many repetitions."""
    uneven = 0.25 if kind == "uneven" else 0.07
    tempo = {"quick": generator.uniform(1.5, 2.3), "slow": generator.uniform(0.4, 0.65)}.get(
        kind, generator.uniform(0.85, 1.25)
    )
    tempos = tempo * np.exp(generator.normal(0.0, uneven, count))
    extents = np.exp(generator.normal(0.0, uneven, count))
    pauses = np.zeros(count)
    ramp = np.linspace(0.0, 1.0, count) if count > 1 else np.zeros(1)
    if kind == "pauses":
        pauses = generator.uniform(0.3, 3.0, count)
    elif kind == "fading":
        extents *= 1.0 - generator.uniform(0.35, 0.6) * ramp
    elif kind == "growing":
        extents *= 1.0 - generator.uniform(0.35, 0.6) * ramp[::-1]
    elif kind == "hastening":
        tempos *= generator.uniform(1.5, 2.0) ** ramp
    elif kind == "tiring":
        tempos *= generator.uniform(1.5, 2.0) ** -ramp
    return Manner(tempos, np.clip(extents, 0.3, 1.3), pauses, kind == "sides")


def read_cycles(data: Path) -> dict[str, list[LabelledClip]]:
    """Clips of one repetition each; those of ``read_sets``, and the raised hands of Bandai."""
    sets = read_sets(data)
    sets["Bandai"] = [
        LabelledClip(
            file.stem, file.parents[1].name, file.parent.name, motion.positions, motion.frame_rate, motion.height
        )
        for file in sorted(data.glob("bandai/raise-up-*/*/*.bvh"))[::2]
        for motion in [read_canonical(str(file), ReadOptions())[0]]
    ]
    return sets


def make_repeated(source: str, clips: Sequence[LabelledClip], seed: int) -> Iterator[tuple[str, Series]]:
    """For every person and category a series of every kind, with the name of the kind."""
    for person in sorted({clip.performer or "" for clip in clips}):
        for category in sorted({clip.category for clip in clips if (clip.performer or "") == person}):
            own = [clip for clip in clips if (clip.performer or "") == person and clip.category == category]
            for number, kind in enumerate(KINDS):
                generator = np.random.default_rng([7, seed, number, *map(ord, source + person + category)])
                count = int(generator.integers(_FEWEST, _MOST + 1))
                if kind == "sides" and category.startswith(("jog", "sneak")):
                    continue  # which are done to both sides as it is
                picked = [own[int(k)] for k in generator.integers(len(own), size=count)]
                whole = _join(picked, draw_manner(kind, count, generator), generator)
                yield kind, see(source, person, category, count, whole, picked[0].height, generator)


def _join(clips: Sequence[LabelledClip], manner: Manner, generator: np.random.Generator) -> FloatArray:
    parts: list[FloatArray] = []
    for number, clip in enumerate(clips):
        core = _cut_rests(sample_positions(clip.positions, clip.frame_rate) / clip.height * clips[0].height)
        tempo = min(manner.tempos[number], len(core) / TAKE_RATE / _SHORTEST)
        count = max(round(len(core) / tempo), 4)
        places = np.linspace(0.0, len(core) - 1.0, count)
        played = _interpolate(core, places)
        floor = played[:, :1] * (1.0, 0.0, 1.0)  # below the pelvis
        posed = played - floor
        played = floor + posed[:1] + manner.extents[number] * (posed - posed[:1])
        if manner.sides and number % 2:
            played = mirror_positions(played)
        if parts:
            played = go_on(parts[-1][-1], played)
            last = parts[-1][-1]
            if manner.pauses[number]:
                parts.append(_stand(last, manner.pauses[number], generator))
            gap = np.abs(played[0] - last).max()
            seconds = min(max(gap / (2.0 * manner.tempos[number]), 0.07), 0.6)  # as quick as hands are
            parts.append(_ease(last, played[0], seconds))
        parts.append(played)
    return np.concatenate(parts)


def _cut_rests(points: FloatArray) -> FloatArray:
    """The frames (n, 20, 3) from where the movement begins to where it ends."""
    joints = points - points[:, :1]
    speeds = np.linalg.norm(np.gradient(joints, axis=0), axis=2).mean(axis=1)
    wide = np.convolve(speeds, np.full(5, 0.2), "same")
    moving = np.flatnonzero(wide > _MOVING * np.quantile(wide, 0.95))
    if len(moving) < 10:
        return points
    return points[moving[0] : moving[-1] + 1]


def _interpolate(points: FloatArray, places: FloatArray) -> FloatArray:
    low = np.clip(places.astype(np.intp), 0, len(points) - 2)
    share = (places - low)[:, None, None]
    return np.asarray(points[low] * (1.0 - share) + points[low + 1] * share)


def _ease(pose: FloatArray, following: FloatArray, seconds: float) -> FloatArray:
    count = max(round(seconds * TAKE_RATE), 1)
    share = (0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / (count + 1)))[:, None, None]
    return np.asarray(pose * (1.0 - share) + following * share)


def _stand(pose: FloatArray, seconds: float, generator: np.random.Generator) -> FloatArray:
    """Standing still, but not quite: two slow sines for every joint and axis, that are gone at both ends."""
    count = max(round(seconds * TAKE_RATE), 1)
    times = np.arange(count)[:, None, None] / TAKE_RATE
    sway = np.zeros((count, *pose.shape))
    for rate in generator.uniform(0.2, 0.9, 2):
        sway += generator.normal(0.0, 0.005, pose.shape) * np.sin(2 * np.pi * (rate * times + generator.random()))
    sway *= np.sin(np.pi * (np.arange(count) + 0.5) / count)[:, None, None]
    return np.asarray(pose + sway)


def read_synthetic(first: int, n_performers: int = 3, n_clips: int = 3) -> list[LabelledClip]:
    """Clips of one round each of synthetic performers."""
    clips = []
    for performer in range(first, first + n_performers):
        for category in _SCORES:
            for number in range(n_clips):
                points, height = _play_rounds(category, performer, "steady", 1, [3, number])
                name = f"{category} {number}"
                clips.append(LabelledClip(name, category, str(performer), points, TAKE_RATE, height))
    return clips


def _play_rounds(
    category: str, performer_seed: int, kind: str, count: int, seed: Sequence[int]
) -> tuple[FloatArray, float]:
    """(n, 20, 3) m at 30 Hz: so many rounds of a synthetic performer, and the height, m."""
    performer, score = draw_performer(performer_seed), SCORES[category]
    generator = np.random.default_rng([*seed, performer_seed, count, *map(ord, category + kind)])
    manner = draw_manner(kind, count, generator)
    phases, extents = list[FloatArray](), list[FloatArray]()
    for number in range(count):
        seconds = max(score.seconds / manner.tempos[number] / performer.tempo, _SHORTEST)
        frames = max(round(seconds * TAKE_RATE), 6)
        rest = round(manner.pauses[number] * TAKE_RATE)
        phases += [number + np.arange(frames) / frames, np.full(rest, number + 1.0 - 1e-6)]
        extents.append(np.full(frames + rest, manner.extents[number]))
    phase, extent = np.concatenate(phases), _spread(np.concatenate(extents), 6)
    plan = Plan(np.arange(len(phase)) / TAKE_RATE, phase, extent)
    pose = play_score(score, performer, plan, generator)
    if manner.sides:  # every other round is one of the mirrored score
        other = play_score(score.mirrored(), performer, plan, generator)
        share = _spread((phase.astype(np.int64) % 2).astype(np.float64), 2)
        pose = {name: (1.0 - share) * pose[name] + share * other[name] for name in pose}
    motion = compose_motion(make_skeleton(performer), pose, TAKE_RATE, performer.stature)
    figure = canonicalise(compute_trajectories(motion))
    return sample_positions(figure.positions, TAKE_RATE), figure.height


def _spread(values: FloatArray, frames: int) -> FloatArray:
    """Means (n,) over so many frames on either side."""
    return np.convolve(np.pad(values, frames, "edge"), np.full(2 * frames + 1, 1.0 / (2 * frames + 1)), "valid")


def make_synthetic_repeated(seed: int, first: int, n_performers: int = 3) -> Iterator[tuple[str, Series]]:
    """For some performers and every category a series of every kind, with the name of the kind."""
    for performer in range(first, first + n_performers):
        for category in _SCORES:
            for number, kind in enumerate(KINDS):
                if kind == "sides" and category not in _SIDED:
                    continue
                generator = np.random.default_rng([9, seed, number, performer, *map(ord, category)])
                count = int(generator.integers(_FEWEST, _MOST + 1))
                whole, height = _play_rounds(category, performer, kind, count, [seed, number])
                yield kind, see(SYNTHETIC, str(performer), category, count, whole, height, generator)


def see(
    source: str,
    person: str,
    category: str,
    count: int,
    whole: FloatArray,
    height: float,
    generator: np.random.Generator,
) -> Series:
    """As a sensor sees it, a little early and late, or cut short."""
    before, after = generator.uniform(-0.15, 1.0, 2)
    parts = [whole]
    for end, seconds in ((0, before), (-1, after)):
        if seconds > 0:
            rest = _stand(whole[end], seconds, generator)
            parts = [rest, *parts] if end == 0 else [*parts, rest]
    points = np.concatenate(parts)
    first, last = (round(max(-seconds, 0.0) * TAKE_RATE) for seconds in (before, after))
    points = points[first : len(points) - last]
    rate = float(generator.choice(_RATES))
    noise = float(generator.choice(_NOISES))
    seen = _interpolate(points, np.arange(0.0, len(points) - 1.0, TAKE_RATE / rate))
    seen = seen + noise * generator.normal(size=seen.shape)
    variant = f"{noise:g}"
    return Series(source, person, category, variant, count, sample_positions(seen, rate), height)
