"""Is the joint named that is at fault? Incorrect repetitions of UI-PRMD beside references by other people.

    python -m lab.trials.exercise_faults [--data DIR] [--sensors NAME ...] [--people N ...] [--every N]

``AT_FAULT`` was written down from the description of the incorrect movements alone, before anything was measured:
Vakanski, Jun, Paul, Baker, "A data set of human body movements for physical rehabilitation exercises", Data 3(1), 2,
2018, table of movements. Head and neck are counted with the trunk, the pelvis with the trunk and the hip.

``worst right``: the joint that is furthest off, by tolerances measured on the correct repetitions of the others. All
other columns: the gravest joint that the events of `assess` name. References are by others throughout.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.evaluation import ANGLES, Fault, assess, compute_joint_angles, compute_postures
from dousa.evaluation.errors.faults import (
    DescribedRepetition,
    compare_all,
    describe_repetition,
    drop_side,
    find_faults,
)
from dousa.evaluation.exercises.split import find_reference_repetitions
from dousa.evaluation.grade.assessment import SHORTEST_S
from dousa.formats.motion_files import ReadOptions, read_canonical
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.canonicalise import mirror_canonical

AT_FAULT = {
    "m01": {"trunk", "hip", "knee"},  # deep squat: trunk not upright or bent over 30 deg, not past parallel, valgus
    "m02": {"trunk", "hip"},  # hurdle step: trunk not upright, hip flexion under 89 deg, femur not neutral
    "m03": {"trunk", "knee", "hip"},  # inline lunge: trunk not upright, rear knee, step deviates to the side
    "m04": {"trunk", "knee", "hip"},  # side lunge: valgus, pelvis over 5 deg, trunk over 30 deg, thigh over 45 deg
    "m05": {"trunk", "hip", "knee"},  # sit to stand: trunk not upright, pelvis over 5 deg, weight on one side
    "m06": {"trunk", "hip", "knee"},  # straight leg raise: pelvis over 5 deg, knee bends, hip flexion under 59 deg
    "m07": {"trunk", "shoulder"},  # shoulder abduction: trunk or head not upright, under 160 deg, out of the plane
    "m08": {"trunk", "shoulder"},  # shoulder extension: the same, under 45 deg
    "m09": {"trunk", "shoulder"},  # shoulder rotation: the same, under 60 deg
    "m10": {"trunk", "shoulder"},  # shoulder scaption: the same, under 90 deg
}
"""Movement -> joints at fault in its incorrect repetitions; arms stay straight or bent as told, so no elbow is."""

LEFT = {("m02", 2), ("m03", 2)}
"""Movements that a person does with the other side, by the data's own notes; Kinect's m03 of person 1 as well."""

_MARGIN_S = 0.25  # around a repetition, as `assess_repetitions` keeps it


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One file: the longest repetition in it (the whole file where none is found), described."""

    movement: str
    person: int
    correct: bool
    repetition: DescribedRepetition
    motion: CanonicalMotion


def read(path: Path, sensor: str) -> CanonicalMotion:
    """Read a file, turned to the side that most people use."""
    movement, person = path.stem[:3], int(path.stem[5:7])
    motion = read_canonical(str(path), ReadOptions(), whole=False)[0]
    turned = (movement, person) in LEFT or (sensor == "kinect" and movement == "m03" and person == 1)
    return mirror_canonical(motion) if turned else motion


def describe(motion: CanonicalMotion) -> DescribedRepetition:
    """Describe the longest repetition of a file of one repetition."""
    spans = find_reference_repetitions(motion) or ((0, motion.n_frames),)
    start, end = max(spans, key=lambda span: span[1] - span[0])
    margin = round(_MARGIN_S * motion.frame_rate)
    first, last = max(start - margin, 0), min(end + margin, motion.n_frames)
    return describe_repetition(compute_postures(motion), compute_joint_angles(motion), first, last)


def read_all(data: Path, sensor: str, every: int) -> list[Seen]:
    """Read every so manyth repetition of everybody."""
    found = []
    for path in sorted((data / "uiprmd" / sensor).glob("m*/*/*.trc")):
        if int(path.stem[-2:]) % every == 0:
            motion = read(path, sensor)
            correct = path.parent.name == "correct"
            if motion.duration >= SHORTEST_S:
                found.append(Seen(path.stem[:3], int(path.stem[5:7]), correct, describe(motion), motion))
    return found


def draw_others(seen: Sequence[Seen], one: Seen, count: int, draw: int) -> list[Seen]:
    """Draw correct repetitions of the same movement by other people, each by another one where there are enough."""
    rng = np.random.default_rng([draw, one.person, int(one.movement[1:]), count])
    by_person = defaultdict(list)
    for other in seen:
        if other.movement == one.movement and other.correct and other.person != one.person:
            by_person[other.person].append(other)
    people = rng.permutation(sorted(by_person))
    chosen = [by_person[people[number % len(people)]] for number in range(count)]
    return [some[int(rng.integers(len(some)))] for some in chosen]


def measure_tolerances(seen: Sequence[Seen], left_out: int, draws: int) -> dict[str, float]:
    """Degrees by which nine of ten correct repetitions differ at most from three by other people, and two."""
    found: dict[str, list[float]] = defaultdict(list)
    for one in seen:
        for draw in range(draws if one.correct and one.person != left_out else 0):
            others = [other.repetition for other in draw_others(seen, one, 3, draw)]
            differences = compare_all(one.repetition, others)[2].max(axis=0)
            for name, degrees in zip(ANGLES, differences.tolist(), strict=True):
                found[drop_side(name)].append(degrees)
    return {name: float(np.quantile(values, 0.9)) + 2.0 for name, values in found.items()}


def is_right(fault: Fault, movement: str) -> bool:
    """Whether a joint is one of those at fault."""
    return drop_side(fault.angle).split("_")[0] in AT_FAULT[movement]


def main() -> None:
    """Read the command line, and print the table, and what the tolerances would be on correct repetitions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--sensors", nargs="+", default=["kinect", "vicon"])
    parser.add_argument("--references", nargs="+", type=int, default=[1, 3, 5])
    parser.add_argument("--people", nargs="+", type=int, default=[1, 2, 3, 4, 5], help="who is judged")
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--every", type=int, default=5, help="every so many repetitions")
    options = parser.parse_args()
    files = {sensor: read_all(options.data, sensor, options.every) for sensor in options.sensors}
    tolerances = {}
    for person in (0, *options.people):
        each = [measure_tolerances(seen, person, options.draws) for seen in files.values()]
        tolerances[person] = {name: float(np.mean([one[name] for one in each])) for name in each[0]}
    print("tolerances of everybody: " + ", ".join(f"{name} {value:.0f}" for name, value in tolerances[0].items()))
    print(f"{'':8}{'n':>6}{'worst right':>13}{'said':>8}{'said right':>12}{'said of correct':>17}  worst movement")
    for sensor, seen in files.items():
        for count in options.references:
            right: dict[str, list[bool]] = defaultdict(list)
            said, said_right, clean = [], [], []
            for one in seen:
                for draw in range(options.draws if one.person in options.people else 0):
                    others = draw_others(seen, one, count, draw)
                    events = assess([other.motion for other in others], one.motion).events
                    named = sorted((event.fault for event in events if event.fault), key=lambda each: -each.severity)
                    (clean if one.correct else said).append(bool(named))
                    if one.correct:
                        continue
                    described = [other.repetition for other in others]
                    faults = find_faults(one.repetition, described, count, tolerances[one.person])
                    right[one.movement].append(bool(faults) and is_right(faults[0], one.movement))
                    said_right += [is_right(named[0], one.movement)] if named else []
            everything = [value for values in right.values() for value in values]
            shares = {name: float(np.mean(values)) for name, values in right.items()}
            least = min(shares, key=shares.__getitem__)
            print(
                f"{sensor:7}{count:>1}{len(everything):>6}{np.mean(everything):>13.3f}{np.mean(said):>8.3f}"
                f"{np.mean(said_right):>12.3f}{np.mean(clean):>17.3f}  {least} {shares[least]:.2f}"
            )


if __name__ == "__main__":
    main()
