"""Series of repetitions whose count is known, for the benchmarks and for the fit of the counter's weights."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.arrays import FloatArray
from dousa.formats import ReadOptions
from dousa.formats.motion_files import read_canonical
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.made_takes import go_on
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.trials.disturbed import KINECT_RATE, make_kinect_like

__all__ = ["Series", "join_series", "make_series", "make_take", "read_counted_takes", "read_sets"]

# Actions of UTD-MHAD that a clip shows once; of clapping, waving, boxing and walking it shows several cycles.
_UTD_ONCE = (
    "swipe_left swipe_right throw arm_cross basketball_shoot draw_x draw_circle_cw draw_circle_ccw draw_triangle "
    "bowling baseball_swing tennis_swing tennis_serve push catch pickup_throw lunge squat"
).split()
_COUNTS, _CHANCES = (1, 2, 3, 4, 5, 6, 8, 10), (0.12, 0.15, 0.2, 0.2, 0.11, 0.1, 0.08, 0.04)
_ONCE = ("sitDown", "standUp", "pickUp", "throw", "push", "pull")  # of UTKinect's segments: each is one
_FADING = (1.0, 1.0, 0.93, 0.85)  # of a movement from one repetition to the next: people tire
_SWAY = 0.002  # m a frame


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A part of a recording in which one action is done so many times.

    Parameters
    ----------
    source : the set; ``person``, ``category``.
    variant : "clean", or "Kinect-like".
    count : how often.
    sampled : (n, 20, 3) m at 30 Hz.
    height : m.
    before, after : s of a real take from which to which it lasts.
    take : name of that take.
    """

    source: str
    person: str
    category: str
    variant: str
    count: int
    sampled: FloatArray
    height: float
    before: float = 0.0
    after: float = 0.0
    take: str = ""


def read_sets(data: Path) -> dict[str, list[LabelledClip]]:
    """Clips in which an action is done once: HDM05, UTD-MHAD, IntelliRehabDS (correct)."""
    options = ReadOptions()
    sets = {}
    for name, folder, rule in (
        ("HDM05", "hdm05", r"name:HDM_(..)_"),
        ("UTD-MHAD", "utd_mhad/skeleton", r"name:_s(\d+)_"),
    ):
        clips, _ = read_labelled_clips([data / folder], category_from="folder", performer_from=rule, options=options)
        sets[name] = [clip for clip in clips if name != "UTD-MHAD" or clip.category in _UTD_ONCE]
    sets["IntelliRehabDS"] = []
    for file in sorted(data.glob("irds/g*/correct/*.trc")):
        motion = read_canonical(str(file), options)[0]
        category = file.parent.parent.name
        clip = LabelledClip(file.stem, category, "215", motion.positions, motion.frame_rate, motion.height)
        sets["IntelliRehabDS"].append(clip)
    return sets


def join_series(clips: Sequence[LabelledClip], generator: np.random.Generator, *, pauses: bool) -> FloatArray:
    """(n, 20, 3) at 30 Hz: clips of one person one after another, at about one tempo.

    Parameters
    ----------
    clips : at least one.
    generator : draws tempos, blends of 0.2 to 0.6 s and pauses.
    pauses : whether the person rests for 0.2 to 2 s between them.
    """
    tempo = float(generator.uniform(0.75, 1.35))
    fading = float(generator.choice(_FADING))
    extent = 1.0
    parts: list[FloatArray] = []
    for clip in clips:
        own = tempo * float(np.exp(generator.normal(0.0, 0.08)))
        played = sample_positions(clip.positions, clip.frame_rate * own) / clip.height * clips[0].height
        played = played[0] + (played - played[0]) * extent
        extent *= fading
        if parts:
            played = go_on(parts[-1][-1], played)
            if pauses:
                parts.append(_rest(parts[-1][-1], generator.uniform(0.2, 2.0), generator))
            parts.append(_blend(parts[-1][-1], played[0], generator.uniform(0.2, 0.6)))
        parts.append(played)
    return np.concatenate(parts)


def _rest(pose: FloatArray, seconds: float, generator: np.random.Generator) -> FloatArray:
    count = max(round(seconds * TAKE_RATE), 1)
    drift = np.cumsum(generator.normal(0.0, _SWAY, (count, *pose.shape)), axis=0)
    drift *= (np.linspace(0.0, 1.0, count) * np.linspace(1.0, 0.0, count))[:, None, None]
    return np.asarray(pose + drift)


def _blend(pose: FloatArray, following: FloatArray, seconds: float) -> FloatArray:
    count = max(round(seconds * TAKE_RATE), 1)
    share = (np.arange(1, count + 1) / (count + 1))[:, None, None]
    ease = share * share * (3.0 - 2.0 * share)
    return np.asarray(pose * (1.0 - ease) + following * ease)


def make_series(source: str, clips: Sequence[LabelledClip], seed: int) -> Iterator[Series]:
    """For every person and category a series in one go and one with pauses, each clean and Kinect-like.

    Parameters
    ----------
    source : name of the set.
    clips : of which each shows an action once.
    seed : of everything that is drawn.
    """
    for person in sorted({clip.performer or "" for clip in clips}):
        for category in sorted({clip.category for clip in clips if clip.performer == person}):
            own = [clip for clip in clips if clip.performer == person and clip.category == category]
            for pauses in (False, True):
                generator = np.random.default_rng([seed, *map(ord, source + person + category), pauses])
                count = int(generator.choice(_COUNTS, p=_CHANCES))
                picked = [own[k] for k in _draw(len(own), count, generator)]
                whole = join_series(picked, generator, pauses=pauses)
                height = picked[0].height
                yield Series(source, person, category, "clean", count, whole, height)
                rough = sample_positions(make_kinect_like(whole, TAKE_RATE, generator), KINECT_RATE)
                yield Series(source, person, category, "Kinect-like", count, rough, height)


def _draw(n: int, count: int, generator: np.random.Generator) -> list[int]:
    """So many of n numbers, all different as long as there are enough."""
    order = generator.permutation(n).tolist() if count <= n else generator.integers(n, size=count).tolist()
    return [int(k) for k in order[:count]]


def make_take(
    series: FloatArray, others: Sequence[LabelledClip], generator: np.random.Generator
) -> tuple[FloatArray, float, float]:
    """A take (n, 20, 3) at 30 Hz in which a series stands between other actions; s from which to which it lasts."""
    half = len(others) // 2
    parts: list[FloatArray] = []
    start = stop = 0
    for number in range(len(others) + 1):
        if number == half:
            piece = series
        else:
            clip = others[number - (number > half)]
            piece = sample_positions(clip.positions, clip.frame_rate)
        if parts:
            piece = go_on(parts[-1][-1], piece)
            parts.append(_rest(parts[-1][-1], generator.uniform(0.1, 1.5), generator))
            parts.append(_blend(parts[-1][-1], piece[0], generator.uniform(0.3, 0.6)))
        if number == half:
            start = sum(map(len, parts))
            stop = start + len(piece)
        parts.append(piece)
    return np.concatenate(parts), start / TAKE_RATE, stop / TAKE_RATE


def read_counted_takes(data: Path) -> list[Series]:
    """Segments of UTKinect whose repetitions were counted by hand (``utkinect_counts.csv``), and those done once."""
    with (Path(__file__).with_name("utkinect_counts.csv")).open(encoding="utf-8", newline="") as file:
        counted = {(row["take"], row["category"]): row["count"] for row in csv.DictReader(file)}
    series = []
    for file_name in sorted((data / "utkinect").glob("*.trc")):
        motion = read_canonical(str(file_name), ReadOptions())[0]
        sampled = sample_positions(motion.positions, motion.frame_rate)
        with file_name.with_suffix(".labels.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            found = counted.get((file_name.stem, row["category"]), "1" if row["category"] in _ONCE else "")
            if found:
                start, stop = float(row["start_s"]), float(row["end_s"])
                part = sampled[round(start * TAKE_RATE) : round(stop * TAKE_RATE)]
                source = "UTKinect, once" if row["category"] in _ONCE else "UTKinect"
                person = file_name.stem[:3]
                one = Series(
                    *(source, person, row["category"], "real", int(found)),
                    *(part, motion.height, start, stop, file_name.stem),
                )
                series.append(one)
    return series
