"""The numbers behind the grade: measured on people, fitted, and written as data of the package.

    python -m lab.training.calibrate_grade [--data DIR] [--write] [--seed N] [--jobs N]

Trials are another take by the same person, a take by another person, one take with an error of rising size put into
it, and another motion, each against one, three and five takes of one person. The grade's weights and its curve are
fitted to all sets, and, for the table, to all but the one that they are tried on. ``--write`` replaces
``src/dousa/evaluation/grade/grade.toml``. HDM05 actor dg, UTD-MHAD subject 7 and a third of the Bandai-Namco pairs
are not looked at.
"""

from __future__ import annotations

import argparse
import inspect
import re
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from scipy.optimize import nnls

from dousa.arrays import FloatArray
from dousa.evaluation.grade.references import ReferenceTakes, compare, prepare_references
from dousa.evaluation.grade.score import GradeModel
from dousa.evaluation.posture.posture import compute_postures, thin_postures
from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion
from lab.injection.injection import inject

RATE = 30.0
N_REFERENCES = (1, 3, 5)
SIZES = {"shift": (150.0, 300.0, 500.0), "incomplete": (0.3, 0.5, 0.75), "partial": (25.0, 45.0, 75.0)}
VARIANTS = {"shift": "late", "incomplete": "limb shrunk", "partial": "limb rotated"}
SETS = {"hdm05": "hdm05", "utd": "utd_mhad/skeleton", "bandai": "bandai"}
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
    values : parts and what is left out; (8,).
    takes : (n, 8) of the further takes of the reference against the others.
    """

    data: str
    kind: str
    n_references: int
    size: int
    series: int
    values: FloatArray
    takes: FloatArray
    mismatch: float


def read_group(path: Path) -> Group | None:
    """Motion and person of a file; None for what is kept out."""
    name = path.stem
    if match := re.fullmatch(r"HDM_(b.)_(.+)_\d+_120", name):
        return match[2], match[1]
    if match := re.fullmatch(r"(a\d+)_(s\d)_t\d", name):
        return None if match[2] == "s7" else (match[1], match[2])
    pair = re.sub(r"_\d+$", "", name)
    if path.suffix == ".bvh" and zlib.crc32(pair.encode()) % 3:
        return pair, "one"
    return None


def read_set(folder: Path) -> dict[Group, list[CanonicalMotion]]:
    """Takes by motion and person."""
    groups: dict[Group, list[CanonicalMotion]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in (".amc", ".bvh", ".c3d") and (group := read_group(path)):
            groups[group].append(read_canonical(path)[0])
    return groups


def make_trials(data: str, groups: dict[Group, list[CanonicalMotion]], group: Group, seed: int) -> list[Trial]:
    """All trials with takes of one motion by one person as references."""
    rng = np.random.default_rng([seed, zlib.crc32("".join((data, *group)).encode())])
    takes = groups[group]
    others = [key for key in groups if key[0] == group[0] and key != group]
    elsewhere = [key for key in groups if key[0].rsplit("_", 1)[0] != group[0].rsplit("_", 1)[0]]
    trials = []
    for count in N_REFERENCES:
        if len(takes) <= count:
            continue
        order = rng.permutation(len(takes))
        chosen, left = [takes[i] for i in order[:count]], [takes[i] for i in order[count:]]
        references = prepare_references([compute_postures(take, RATE) for take in chosen], "same", EQUAL)
        tried = [("same", 0, 0, take) for take in left[:2]]
        for key in others:
            tried.append(("other", 0, 0, groups[key][int(rng.integers(len(groups[key])))]))
        for _ in range(2):
            key = elsewhere[int(rng.integers(len(elsewhere)))]
            tried.append(("different", 0, 0, groups[key][int(rng.integers(len(groups[key])))]))
        tried += make_errors(left[0], int(rng.integers(1 << 30)))
        for kind, size, series, motion in tried:
            trials.append(measure(data, kind, size, series, references, motion))
    return trials


def make_errors(take: CanonicalMotion, seed: int) -> Iterator[tuple[str, int, int, CanonicalMotion]]:
    """Errors of rising size in one place."""
    for number, (kind, sizes) in enumerate(SIZES.items()):
        yield "error", 0, seed + number, take
        for size, value in enumerate(sizes, start=1):
            wrong = inject(take, kind, seed + number, variant=VARIANTS[kind], size=value)
            if wrong is not None:
                yield "error", size, seed + number, wrong.motion


def measure(data: str, kind: str, size: int, series: int, references: ReferenceTakes, motion: CanonicalMotion) -> Trial:
    """One performance against its references."""
    weights = references.importance
    working = thin_postures(compute_postures(motion, RATE))
    found = compare(references.working, working, "same", EQUAL, references.between)
    values = np.append(found.measured.find_parts(weights), 1.0 - found.measured.find_coverage(weights))
    takes = np.array(
        [np.append(one.find_parts(weights), 1.0 - one.find_coverage(weights)) for one in references.measured]
    ).reshape(-1, len(values))
    count = len(references.working)
    return Trial(data, kind, count, size, series, values, takes, found.alignment.mismatch)


TARGETS = {"same": 0.1, "other": 0.22, "different": 2.3}
"""-log(grade / 100) that the sum is fitted to; an error counts between these by its size."""
ERROR_TARGETS = (0.1, 0.25, 0.35, 0.5)
LEAST = 0.003
"""Strength of every part: each counts, whether the sum needs it or not."""
PRIORS = (1.0, 2.0, 4.0, 8.0)
LEFT_OUT = 7  # column of what is left out


def find_target(trial: Trial) -> float:
    """What the sum should be."""
    return ERROR_TARGETS[trial.size] if trial.kind == "error" else TARGETS[trial.kind]


def average_sets(trials: Sequence[Trial], find: Callable[[list[Trial]], FloatArray]) -> FloatArray:
    """Mean over the sets of something of each: a large set says no more than a small one."""
    sets = sorted({one.data for one in trials})
    return np.mean([find([one for one in trials if one.data == data]) for data in sets], axis=0)


def fit_model(trials: Sequence[Trial], prior_takes: float) -> GradeModel:
    """The numbers of the grade from measured trials."""
    usual = []
    for count in N_REFERENCES:
        same = [one for one in trials if one.kind == "same" and one.n_references == count]
        usual.append(average_sets(same, lambda some: np.median([one.values[:LEFT_OUT] for one in some], axis=0)))
    alone = [one for one in trials if one.kind == "same" and one.n_references == 1]
    far = average_sets(alone, lambda some: np.percentile([one.values[:LEFT_OUT] for one in some], 90, axis=0))
    empty = np.zeros(len(N_REFERENCES))
    model = GradeModel(
        np.array(N_REFERENCES, float), np.array(usual), 0.25 * far, np.ones(LEFT_OUT), np.zeros((2, 2)), empty,
        prior_takes, np.inf, np.inf,
    )  # fmt: skip
    rows = np.array([describe(model, one) for one in trials])
    targets = np.array([find_target(one) for one in trials])
    keys = [(one.data, one.kind, one.size) for one in trials]
    share = np.array([1.0 / np.sqrt(keys.count(key)) for key in keys]) / targets
    least = np.full(LEFT_OUT, LEAST)
    more = nnls(rows * share[:, None], (targets - rows @ least) * share)[0]
    model = replace(model, strengths=least + more)
    return fit_curve(model, trials)


def describe(model: GradeModel, trial: Trial) -> FloatArray:
    """(7,) what the sum is made of."""
    return model.compare_parts(trial.values[:LEFT_OUT], trial.takes[:, :LEFT_OUT], trial.n_references)


def fit_curve(model: GradeModel, trials: Sequence[Trial]) -> GradeModel:
    """Put the grades where they belong: 90 the median of another take, 80 of another person, 0 another motion."""
    sums = {kind: [] for kind in TARGETS}
    for one in trials:
        if one.kind in sums:
            sums[one.kind].append((one.data, float(describe(model, one) @ model.strengths), one))

    def middle(kind: str, percent: float) -> float:
        sets = sorted({data for data, _, _ in sums[kind]})
        return float(
            np.mean([np.percentile([x for data, x, _ in sums[kind] if data == name], percent) for name in sets])
        )

    same, other = middle("same", 50.0), middle("other", 50.0)
    other = max(other, 1.05 * same)
    low, lowest = max(middle("different", 50.0), 1.5 * other), max(middle("different", 90.0), 2.0 * other)
    curve = np.array([[0.0, 100.0], [same, 90.0], [other, 80.0], [low, 20.0], [lowest, 0.0]])
    doubt = []
    for count in N_REFERENCES:
        own = [x for _, x, one in sums["same"] if one.n_references == count]
        doubt.append((np.percentile(own, 90) - np.percentile(own, 10)) / 2.56)
    likely = [one for one in trials if one.kind in ("same", "other")]
    return replace(
        model, curve=curve, doubt=np.minimum.accumulate(doubt),
        unlike=1.2 * float(np.percentile([one.values[1] for one in likely], 99.5)),
        unlike_mismatch=float(max(0.85, np.percentile([one.mismatch for one in likely], 99.8))),
    )  # fmt: skip


def grade(model: GradeModel, trial: Trial) -> float:
    """0 to 100, the dance left out aside; 0 for another dance."""
    if trial.values[1] > model.unlike or trial.mismatch > model.unlike_mismatch:
        return 0.0
    danced = min(1.0, 1.02 - trial.values[LEFT_OUT])
    return danced * model.find_grade(float(describe(model, trial) @ model.strengths))


def print_table(trials: Sequence[Trial], model: GradeModel, title: str) -> None:
    """Medians by kind, and how often a larger error is graded lower."""
    cells = []
    for kind in ("same", "other", "different"):
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
    for data, folder in SETS.items():
        groups = read_set(options.data / folder)
        tasks = (delayed(make_trials)(data, groups, group, options.seed) for group in groups)
        trials += [one for some in Parallel(options.jobs)(tasks) for one in some if np.isfinite(one.values).all()]
    calibrate(trials, options.write)


def calibrate(trials: Sequence[Trial], write: bool) -> GradeModel:
    """Fit, print the table, and write the numbers."""
    sets = sorted({one.data for one in trials})
    print(HEAD)
    best = max(PRIORS, key=lambda prior: np.mean([find_order(trials, fit_model(trials, prior))]))
    for data in sets:
        left = fit_model([one for one in trials if one.data != data], best)
        print_table([one for one in trials if one.data == data], left, f"{data}, left out")
    model = fit_model(trials, best)
    print_table(trials, model, "all")
    for field in fields(GradeModel):
        print(field.name, np.round(getattr(model, field.name), 3).tolist())
    if write:
        write_model(model, Path(inspect.getfile(GradeModel)).with_name("grade.toml"))
    return model


if __name__ == "__main__":
    main()
