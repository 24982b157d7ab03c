"""Which plain measure agrees with therapists? Repetitions of UI-PRMD beside references by other people.

    python -m lab.trials.exercise_measures [--data DIR] [--sensors NAME ...] [--references N ...] [--draws N]

Prints for each measure the area under the ROC curve of correct against incorrect repetitions, of all people together,
as the mean of the ten movements and the worst one, and for own references. People 1 to 5; a repetition is never beside
references by its own person, but for the column "own". Nothing is fitted. Lateral movements are held against the
mirror image too, as two people do some with the left.

Joints are centred, turned to face one way, of unit height. ``rms``: evenly in time; ``DTW``: along the path of dynamic
time warping. ``displacement``: from the own first pose; ``centred``: from the own mean pose. ``lines``: of directions
of twelve parts of the body along the path, with the mean difference taken off: as root mean square of the parts, as
mean, and as mean logarithm above what the sensor trembles by (``dousa.evaluation.grade.movement``), alone and with
range and posture. References are pooled by the least, the mean or, part by part, the median.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation import compute_joint_angles, compute_postures
from dousa.evaluation.grade.movement import (
    STILL_DEG,
    Difference,
    Movement,
    compare_movements,
    describe_movement,
    find_agreement,
    find_distances,
)
from dousa.motion import CanonicalMotion, mirror_canonical
from lab.exams.exercises.baselines import measure_warping, normalise_joints
from lab.exams.exercises.material import MOVEMENTS, SENSORS, draw_others, draw_own, find_area, read_uiprmd

EQUAL = np.ones(9)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the measures need of one motion."""

    joints: FloatArray
    ranges: FloatArray
    movement: Movement


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """A repetition against one reference: the plain distances, and the difference of the movements."""

    plain: dict[str, float]
    difference: Difference


def see(motion: CanonicalMotion) -> Seen:
    """Prepare a motion."""
    angles = compute_joint_angles(motion).values()
    ranges = np.array([np.ptp(one[np.isfinite(one)]) if np.isfinite(one).any() else 0.0 for one in angles])
    return Seen(normalise_joints(motion), ranges, describe_movement(compute_postures(motion)))


def compare(one: Seen, reference: Seen) -> Pair:
    """All plain distances of two motions."""
    a, b = one.joints, reference.joints
    plain = {"joints rms": float(np.sqrt(np.nanmean((a - b) ** 2))), "joints DTW": measure_warping(a, b)}
    plain["displacement rms"] = float(np.sqrt(np.nanmean((a - a[:3].mean(0) - b + b[:3].mean(0)) ** 2)))
    plain["displacement DTW"] = measure_warping(a - a[:3].mean(axis=0), b - b[:3].mean(axis=0))
    plain["centred DTW"] = measure_warping(a - a.mean(axis=0), b - b.mean(axis=0))
    plain["ranges"] = float(np.abs(one.ranges - reference.ranges).mean())
    plain["ranges, what is missing"] = float(np.maximum(reference.ranges - one.ranges, 0.0).mean())
    plain["ranges, what is too much"] = float(np.maximum(one.ranges - reference.ranges, 0.0).mean())
    return Pair(plain, compare_movements(reference.movement, one.movement))


def _get_rms(one: Difference) -> FloatArray:
    return np.sqrt(np.nanmean(one.path**2, axis=0))


Measure = Callable[[Sequence[Pair], FloatArray], float]


def make_measures() -> dict[str, Measure]:
    """Name -> distance of a repetition from its references (pairs, agreement of the references)."""

    def pool(name: str, find: Callable) -> Measure:
        return lambda pairs, _: float(find([one.plain[name] for one in pairs]))

    names = ("joints rms", "joints DTW", "displacement rms", "displacement DTW", "centred DTW", "ranges")
    measures = {f"{name}, {how.__name__}": pool(name, how) for name in names for how in (min, np.mean, np.median)}
    for name in ("ranges, what is missing", "ranges, what is too much"):
        measures[f"{name}, mean"] = pool(name, np.mean)

    def by_part(find: Callable[[Difference], FloatArray], mean: Callable) -> Measure:
        return lambda pairs, _: float(mean(np.nanmedian([find(one.difference) for one in pairs], axis=0)))

    root = lambda x: np.sqrt(np.nanmean(x**2))  # noqa: E731
    still = np.radians(STILL_DEG)
    measures["lines, rms of the parts"] = by_part(_get_rms, root)
    measures["lines, mean of the parts"] = by_part(_get_rms, np.nanmean)
    measures["lines, trunk alone"] = by_part(lambda one: _get_rms(one)[:1], np.nanmean)
    measures["lines, mean logarithm"] = by_part(lambda one: np.log1p(_get_rms(one) / still), np.nanmean)
    above = lambda one: np.log1p(_get_rms(one) / one.scale)  # noqa: E731
    measures["above trembling"] = by_part(above, np.nanmean)
    measures["above trembling, nine segments"] = by_part(lambda one: above(one)[:9], np.nanmean)
    measures["range alone"] = by_part(lambda one: one.ranges, np.nanmean)
    measures["above trembling + range"] = by_part(lambda one: above(one) + 0.5 * one.ranges, np.nanmean)

    def all_three(pairs: Sequence[Pair], agreement: FloatArray) -> float:
        found = find_distances([one.difference for one in pairs], agreement, EQUAL)
        return float(np.log1p(found / [STILL_DEG, 1.0, 1.0]) @ [1.0, 0.5, 0.3])

    measures["above trembling + range + posture"] = all_three
    return measures


def examine(options: argparse.Namespace, sensor: str, count: int, own: bool) -> dict[str, list[float]]:
    """Measure -> AUROC of each movement, the mean of the draws."""
    measures = make_measures()
    areas: dict[str, list[float]] = {name: [] for name in measures}
    for movement in MOVEMENTS:
        repetitions = read_uiprmd(options.data, sensor, movement, 1)
        seen = {id(one): see(one.motion) for one in repetitions}
        turned = {id(one): see(mirror_canonical(one.motion)) for one in repetitions if movement in ("m02", "m03")}
        found: dict[str, list[float]] = {name: [] for name in measures}
        for draw in range(options.draws):
            values = {name: ([], []) for name in measures}
            for number, one in enumerate(repetitions):
                if own:
                    references = draw_own(repetitions, one.person, movement, count, draw)
                else:
                    references = draw_others(repetitions, one.person, count, draw)
                if number % options.every or any(one is other for other in references):
                    continue
                pairs = [compare(seen[id(one)], seen[id(other)]) for other in references]
                for place, other in enumerate(references if turned else ()):
                    mirrored = compare(turned[id(one)], seen[id(other)])
                    if mirrored.plain["centred DTW"] < pairs[place].plain["centred DTW"]:
                        pairs[place] = mirrored
                apart = [
                    compare_movements(seen[id(a)].movement, seen[id(b)].movement)
                    for a in references for b in references if a is not b
                ]  # fmt: skip
                agreement = find_agreement(apart)
                for name, measure in measures.items():
                    values[name][not one.correct].append(-measure(pairs, agreement))
            for name in measures:
                found[name].append(find_area(*values[name]))
        for name in measures:
            areas[name].append(float(np.mean(found[name])))
    return areas


def main() -> None:
    """Read the command line, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--sensors", nargs="+", choices=SENSORS, default=list(SENSORS))
    parser.add_argument("--references", nargs="+", type=int, default=[1, 3, 5])
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--every", type=int, default=2, help="every so many repetitions are judged")
    options = parser.parse_args()
    columns = {}
    for sensor in options.sensors:
        for count, own in [*((count, False) for count in options.references), (3, True)]:
            columns[f"{sensor} {'own ' if own else ''}{count}"] = examine(options, sensor, count, own)
    print(f"{'':36}" + "".join(f"{name:>14}" for name in columns))
    for name in make_measures():
        cells = (f"{np.mean(one[name]):.3f} / {np.min(one[name]):.2f}" for one in columns.values())
        print(f"{name:36}" + "".join(f"{cell:>14}" for cell in cells))
    for title, one in columns.items():
        best = one["above trembling + range + posture"]
        print(f"{title}: " + ", ".join(f"{m} {area:.2f}" for m, area in zip(MOVEMENTS, best, strict=True)))


if __name__ == "__main__":
    main()
