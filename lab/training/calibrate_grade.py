"""The numbers behind the grade: measured on people, fitted, and written as data of the package.

    python -m lab.training.calibrate_grade [--data DIR] [--write] [--seed N] [--jobs N]

Trials are another take by the same person, a take by another person, one take with an error of rising size put into
it, and another motion, each against one, three and five takes of one person: gestures, actions and exercises. The
curve of the grade is fitted to all sets, and, for the table, to all but the one that it is tried on; what the distance
is made of was chosen in lab/trials/exercise_measures.py. ``--write`` replaces
``src/dousa/evaluation/grade/grade.toml``. HDM05 actor dg, UTD-MHAD subject 7 and a third of the Bandai-Namco pairs
are not looked at.
"""

from __future__ import annotations

import argparse
import inspect
import re
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from dousa.arrays import FloatArray
from dousa.errors import JointMappingError
from dousa.evaluation.grade.movement import (
    Movement,
    compare_movements,
    describe_movement,
    find_agreement,
    find_coverage,
    find_extent,
    find_parts,
)
from dousa.evaluation.grade.score import GradeModel, compute_grade, load_model
from dousa.evaluation.posture.posture import compute_postures
from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion
from lab.injection.injection import inject

RATE = 30.0
N_REFERENCES = (1, 3, 5)
SIZES = {"shift": (150.0, 300.0, 500.0), "incomplete": (0.3, 0.5, 0.75), "partial": (25.0, 45.0, 75.0)}
VARIANTS = {"shift": "late", "incomplete": "limb shrunk", "partial": "limb rotated"}
SETS = {
    "hdm05": "hdm05",
    "utd": "utd_mhad/skeleton",
    "bandai": "bandai",
    "kinect": "uiprmd/kinect",
    "vicon": "uiprmd/vicon",
}
KINDS = ("same", "other", "different")
EQUAL = np.ones(9)
Group = tuple[str, str]  # motion, person


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A performance measured.

    Parameters
    ----------
    data : set.
    kind : ``"same"`` person, ``"other"`` person, ``"error"``, ``"different"`` motion.
    n_references : takes of the reference.
    size : 0 to 3, of the error.
    series : trials of one number are the same error of rising size.
    distance : from the references.
    parts, extent, coverage : what `compute_grade` takes.
    """

    data: str
    kind: str
    n_references: int
    size: int
    series: int
    distance: float
    parts: FloatArray
    extent: float
    coverage: float


def read_group(path: Path) -> Group | None:
    """Motion and person of a file; None for what is kept out."""
    name = path.stem
    if match := re.fullmatch(r"HDM_(b.)_(.+)_\d+_120", name):
        return match[2], match[1]
    if match := re.fullmatch(r"(a\d+)_(s\d)_t\d", name):
        return None if match[2] == "s7" else (match[1], match[2])
    if match := re.fullmatch(r"(m\d+)_(s\d+)_e\d+", name):  # two people do m02 and m03 with the left
        return (match[1], match[2]) if path.parent.name == "correct" and match[1] not in ("m02", "m03") else None
    pair = re.sub(r"_\d+$", "", name)
    if path.suffix == ".bvh" and zlib.crc32(pair.encode()) % 3:
        return pair, "one"
    return None


def read_set(folder: Path) -> dict[Group, list[CanonicalMotion]]:
    """Takes by motion and person."""
    groups: dict[Group, list[CanonicalMotion]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in (".amc", ".bvh", ".c3d", ".trc") and (group := read_group(path)):
            with suppress(JointMappingError):  # a sensor that lost an arm
                groups[group].append(read_canonical(path)[0])
    return groups


def see(motion: CanonicalMotion) -> Movement:
    """Describe a motion as an assessment does."""
    return describe_movement(compute_postures(motion, RATE))


def make_trials(
    data: str, moves: dict[Group, list[Movement]], takes: list[CanonicalMotion], group: Group, seed: int
) -> list[Trial]:
    """All trials with takes of one motion by one person as references."""
    rng = np.random.default_rng([seed, zlib.crc32("".join((data, *group)).encode())])
    own = moves[group]
    order = rng.permutation(len(own))
    others = [key for key in moves if key[0] == group[0] and key != group]
    elsewhere = [key for key in moves if key[0].rsplit("_", 1)[0] != group[0].rsplit("_", 1)[0]]
    errors = list(make_errors(takes[order[-1]], int(rng.integers(1 << 30))))
    trials = []
    for count in N_REFERENCES:
        if len(own) <= count:
            continue
        references = [own[i] for i in order[:count]]
        agreement = find_agreement([compare_movements(*pair) for pair in combinations(references, 2)])
        tried = [("same", 0, 0, own[i]) for i in order[count:][:2]]
        for key in others:
            tried.append(("other", 0, 0, moves[key][int(rng.integers(len(moves[key])))]))
        for _ in range(2):
            key = elsewhere[int(rng.integers(len(elsewhere)))]
            tried.append(("different", 0, 0, moves[key][int(rng.integers(len(moves[key])))]))
        for kind, size, series, movement in [*tried, *errors]:
            found = [compare_movements(one, movement) for one in references]
            parts, extent = find_parts(found, agreement, EQUAL), find_extent(found, EQUAL)
            distance = load_model().find_distance(parts, extent)
            coverage = find_coverage(found, EQUAL)
            trials.append(Trial(data, kind, count, size, series, distance, parts, extent, coverage))
    return trials


def make_errors(take: CanonicalMotion, seed: int) -> Iterator[tuple[str, int, int, Movement]]:
    """Errors of rising size in one place."""
    for number, (kind, sizes) in enumerate(SIZES.items()):
        yield "error", 0, seed + number, see(take)
        for size, value in enumerate(sizes, start=1):
            wrong = inject(take, kind, seed + number, variant=VARIANTS[kind], size=value)
            if wrong is not None:
                yield "error", size, seed + number, see(wrong.motion)


def find_middle(trials: Sequence[Trial], kind: str, percent: float) -> float:
    """Percentile of the distance, mean over the sets: a large set says no more than a small one."""
    sets: dict[str, list[float]] = defaultdict(list)
    for one in trials:
        if one.kind == kind:
            sets[one.data].append(one.distance)
    return float(np.mean([np.percentile(some, percent) for some in sets.values()]))


def fit_model(trials: Sequence[Trial]) -> GradeModel:
    """Put the grades where they belong: 90 the median of another take, 80 of another person; no other motion any."""
    same, other, low, lowest = (
        find_middle(trials, kind, percent)
        for kind, percent in (("same", 50.0), ("other", 50.0), ("different", 30.0), ("different", 75.0))
    )
    doubt = []
    for count in N_REFERENCES:
        some = [one for one in trials if one.n_references == count]
        doubt.append((find_middle(some, "same", 90.0) - find_middle(some, "same", 10.0)) / 2.56)
    curve = np.array([[0.0, 100.0], [same, 90.0], [other, 80.0], [low, 20.0], [lowest, 0.0]])
    counts = np.array(N_REFERENCES, float)
    return replace(load_model(), curve=curve, n_references=counts, doubt=np.minimum.accumulate(doubt), unlike=low)


def grade(model: GradeModel, trial: Trial) -> float:
    """0 to 100; 0 for another dance."""
    score = compute_grade(trial.parts, trial.extent, trial.coverage, trial.n_references, model=model).score
    return float(np.nan_to_num(score))


def print_table(trials: Sequence[Trial], model: GradeModel, title: str) -> None:
    """Medians by kind, and how often a larger error is graded lower."""
    cells = []
    for kind in KINDS:
        for count in N_REFERENCES:
            grades = [grade(model, one) for one in trials if one.kind == kind and one.n_references == count]
            cells.append(f"{np.median(grades):4.0f}" if grades else "   -")
    errors = [[grade(model, one) for one in trials if one.kind == "error" and one.size == k] for k in range(4)]
    cells += [f"{np.median(some):4.0f}" for some in errors]
    print(f"{title:22s}", *cells, f"{find_order(trials, model):6.2f}")


def find_order(trials: Sequence[Trial], model: GradeModel) -> float:
    """Share of the pairs of one error in two sizes in which the larger has the lower grade, or the same."""
    series = defaultdict(dict)
    for one in trials:
        if one.kind == "error":
            series[one.data, one.n_references, one.series][one.size] = grade(model, one)
    right = [
        some[large] <= some[small] + 0.5
        for some in series.values() for small in some for large in some if small < large
    ]  # fmt: skip
    return float(np.mean(right))


HEAD = f"{'':22s}   same 1/3/5     other 1/3/5    different      error 0/1/2/3       ordered"


def write_model(model: GradeModel, path: Path) -> None:
    """As TOML, few digits."""
    lines = ["# The numbers of the grade, written by lab/training/calibrate_grade.py; see GradeModel in score.py."]
    for field in fields(GradeModel):
        value = np.round(np.asarray(getattr(model, field.name), float), 4)
        lines.append(f"{field.name} = {value.tolist()}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=-1)
    options = parser.parse_args()
    trials: list[Trial] = []
    pool = Parallel(options.jobs)
    for data, folder in SETS.items():
        groups = read_set(options.data / folder)
        moves = dict(zip(groups, pool(delayed(see_all)(takes) for takes in groups.values()), strict=True))
        tasks = (delayed(make_trials)(data, moves, takes, group, options.seed) for group, takes in groups.items())
        trials += [one for some in pool(tasks) for one in some if np.isfinite(one.distance)]
    calibrate(trials, options.write)


def see_all(takes: Sequence[CanonicalMotion]) -> list[Movement]:
    """Describe motions."""
    return [see(take) for take in takes]


def calibrate(trials: Sequence[Trial], write: bool) -> GradeModel:
    """Fit, print the table, and write the numbers."""
    print(HEAD)
    for data in sorted({one.data for one in trials}):
        left = fit_model([one for one in trials if one.data != data])
        print_table([one for one in trials if one.data == data], left, f"{data}, left out")
    model = fit_model(trials)
    print_table(trials, model, "all")
    for field in fields(GradeModel):
        print(field.name, np.round(getattr(model, field.name), 3).tolist())
    if write:
        write_model(model, Path(inspect.getfile(GradeModel)).with_name("grade.toml"))
    return model


if __name__ == "__main__":
    main()
