"""Counting repetitions: with a reference, without one, and by the peaks of the first principal component.

Single repetitions of HDM05 (actors bd and bk), IntelliRehabDS and the synthetic performers are joined to recordings of
three to eight, with pauses of 0.2 to 2 s, at 0.7 to 1.4 times their tempo; every other recording is walked into and
out of, every third one has a repetition that is broken off half-way. The constants were first chosen on bd and the
synthetic performers; later changes were made with the rows of bk and IntelliRehabDS in sight.

    python -m lab.trials.count_repetitions ../shared/data
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dousa.evaluation import find_repetitions
from dousa.evaluation.posture.posture import compute_segments
from dousa.formats.motion_files import ReadOptions, read_canonical
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories
from dousa.motion.synthetic import Performer, draw_performer, make_motion
from dousa.motion.synthetic.scores import SCORES
from lab.trials.exercise_sets import ExerciseSet, join_repetitions

_EXERCISES = (
    "squat1Reps",
    "kickLFront1Reps",
    "elbowToKnee1RepsLelbowStart",
    "rotateArmsBothBackward1Reps",
    "hopBothLegs1hops",
    "grabHighR",
    "depositFloorR",
    "throwBasketball",
)
_WALKS = "sneak2StepsLStart"
_SYNTHETIC = ("bow", "lunge", "pick_up", "kick_left", "raise_hands", "throw", "squat", "jump")
_SESSION = 6
Span = tuple[float, float]


@dataclass
class Group:
    """One exercise of one person: clips of a repetition each, and a walk."""

    name: str
    clips: list[CanonicalMotion]
    walk: CanonicalMotion


@dataclass
class Score:
    """What one system found in the recordings of one set."""

    exact: int = 0
    within_one: int = 0
    total: int = 0
    expected: int = 0
    matched: int = 0
    found: int = 0
    halves: int = 0
    halves_found: int = 0
    errors_ms: list[float] = field(default_factory=list)


def read_hdm05(data: Path, actor: str) -> Iterator[Group]:
    """The exercises of one actor."""

    def read(name: str) -> list[CanonicalMotion]:
        files = sorted(data.glob(f"hdm05/{name}/HDM_{actor}_*"))
        return [read_canonical(str(file), ReadOptions())[0] for file in files]

    walks = read(_WALKS) or [make_synthetic("walk", Performer(), 0)]
    for name in _EXERCISES:
        clips = read(name)
        # Neighbours come from one session; between sessions the exercise changes (arms, depth).
        for start in range(0, len(clips) - 2, _SESSION):
            yield Group(name, clips[start : start + _SESSION], walks[start // _SESSION % len(walks)])


def read_irds(data: Path) -> Iterator[Group]:
    """The exercises of subject 215, those that a physiotherapist called correct."""
    for folder in sorted(data.glob("irds/g*/correct")):
        clips = [read_canonical(str(file), ReadOptions())[0] for file in sorted(folder.glob("*.trc"))]
        if len(clips) >= 2:
            yield Group(folder.parent.name, clips, make_synthetic("walk", Performer(), 0))


def make_synthetic(category: str, performer: Performer, take: int) -> CanonicalMotion:
    """A take of a synthetic performer."""
    return canonicalise(compute_trajectories(make_motion(category, performer, take)))


def read_synthetic() -> Iterator[Group]:
    """Exercises of three made-up people."""
    for seed in (301, 302, 303):
        performer = draw_performer(seed)
        for category in _SYNTHETIC:
            takes = (make_synthetic(category, performer, take) for take in range(16))
            # A take has one to three rounds; those this short have one.
            clips = [take for take in takes if take.duration * performer.tempo < 1.8 * SCORES[category].seconds][:6]
            yield Group(f"{category} {seed}", clips, make_synthetic("walk", performer, 0))


def make_sets(group: Group, repeats: int, seed: int) -> Iterator[tuple[ExerciseSet, CanonicalMotion]]:
    """Recordings of one exercise, and for each a reference repetition that is not in it."""
    for number in range(repeats):
        rng = np.random.default_rng([seed, number, sum(map(ord, group.name))])
        order = rng.permutation(len(group.clips))
        reference, rest = group.clips[order[0]], order[1:]
        count = int(rng.integers(3, 9))
        chosen = [group.clips[int(rng.choice(rest))] for _ in range(count)]
        half = [int(rng.integers(0, count))] if number % 3 == 2 else []
        walk = group.walk if number % 2 else None
        yield join_repetitions(chosen, rng, broken_off=half, before=walk, after=walk), reference


def count_peaks(motion: CanonicalMotion) -> tuple[list[Span], list[Span]]:
    """The plain baseline: peaks of the first principal component, of a prominence of half its range."""
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks

    segments = compute_segments(motion.positions).reshape(motion.n_frames, -1)
    moved = segments - segments.mean(axis=0)
    axis = np.linalg.svd(moved, full_matrices=False)[2][0]
    curve = gaussian_filter1d(moved @ axis, 0.1 * motion.frame_rate)
    if np.median(curve) > 0.5 * (curve.min() + curve.max()):
        curve = -curve
    low, high = np.quantile(curve, [0.05, 0.95])
    peaks, info = find_peaks(curve, prominence=0.5 * (high - low), distance=round(0.4 * motion.frame_rate))
    spans = []
    for peak, left, right in zip(peaks, info["left_bases"], info["right_bases"], strict=True):
        level = max(curve[left], curve[right]) + 0.1 * (curve[peak] - max(curve[left], curve[right]))
        start = peak - int(np.argmax(curve[peak::-1] <= level))
        end = peak + int(np.argmax(curve[peak:] <= level))
        spans.append((start / motion.frame_rate, end / motion.frame_rate))
    return spans, []


def count_guided(motion: CanonicalMotion, reference: CanonicalMotion) -> tuple[list[Span], list[Span]]:
    """Ours with a reference repetition: complete ones, and incomplete ones."""
    return _to_spans(find_repetitions(motion, [reference]).repetitions)


def count_alone(motion: CanonicalMotion) -> tuple[list[Span], list[Span]]:
    """Ours without a reference."""
    return _to_spans(find_repetitions(motion).repetitions)


def _to_spans(found: Sequence[object]) -> tuple[list[Span], list[Span]]:
    spans: dict[bool, list[Span]] = {True: [], False: []}
    for one in found:
        spans[one.complete].append((one.start_s, one.end_s))  # type: ignore[attr-defined]
    return spans[True], spans[False]


def judge(score: Score, truth: ExerciseSet, found: Sequence[Span], halves: Sequence[Span]) -> None:
    """Add one recording: a repetition is found if two spans share half of the time that they take together."""
    score.total += 1
    score.exact += len(found) == len(truth.spans)
    score.within_one += abs(len(found) - len(truth.spans)) <= 1
    score.expected += len(truth.spans)
    score.found += len(found)
    for span in truth.spans:
        near = max(found, key=lambda other: overlap(span, other), default=None)
        if near is not None and overlap(span, near) >= 0.5:
            score.matched += 1
            score.errors_ms += [1000 * abs(near[0] - span[0]), 1000 * abs(near[1] - span[1])]
    score.halves += len(truth.broken_off)
    score.halves_found += sum(any(overlap(span, other) > 0.3 for other in halves) for span in truth.broken_off)


def overlap(a: Span, b: Span) -> float:
    """Shared time as a share of the time that both take together."""
    shared = max(0.0, min(a[1], b[1]) - max(a[0], b[0]))
    return shared / max(max(a[1], b[1]) - min(a[0], b[0]), 1e-9)


def describe(name: str, system: str, score: Score) -> str:
    """One row of the table."""
    precision, recall = score.matched / max(score.found, 1), score.matched / max(score.expected, 1)
    f_value = 2 * precision * recall / max(precision + recall, 1e-9)
    errors = np.array(score.errors_ms or [np.nan])
    halves = f"{score.halves_found}/{score.halves}"
    return (
        f"{name:<18}{system:<12}{score.total:>5}{100 * score.exact / score.total:>8.0f}"
        f"{100 * score.within_one / score.total:>9.0f}{f_value:>8.3f}{np.median(errors):>9.0f}"
        f"{np.quantile(errors, 0.9):>8.0f}{halves:>10}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder with hdm05 and irds")
    parser.add_argument("--repeats", type=int, default=6, help="recordings of each exercise of each person")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="regular expression: which sets")
    parser.add_argument("--each", action="store_true", help="a row for each exercise")
    options = parser.parse_args()
    sets = {
        "synthetic": read_synthetic,
        "HDM05 bd": lambda: read_hdm05(options.data, "bd"),
        "HDM05 bk": lambda: read_hdm05(options.data, "bk"),
        "IntelliRehabDS": lambda: read_irds(options.data),
    }
    print(f"{'':<18}{'':<12}{'n':>5}{'exact %':>8}{'+-1 %':>9}{'F':>8}{'ms p50':>9}{'p90':>8}{'halves':>10}")
    for name, read in sets.items():
        if not re.search(options.only, name):
            continue
        scores: dict[tuple[str, str], Score] = {}
        for group in read():
            for truth, reference in make_sets(group, options.repeats, options.seed):
                answers = {
                    "reference": count_guided(truth.motion, reference),
                    "alone": count_alone(truth.motion),
                    "peaks": count_peaks(truth.motion),
                }
                for system, answer in answers.items():
                    for row in {name, f" {group.name}"[:17]} if options.each else {name}:
                        judge(scores.setdefault((row, system), Score()), truth, *answer)
        for (row, system), score in sorted(scores.items()):
            print(describe(row, system, score), flush=True)


if __name__ == "__main__":
    main()
