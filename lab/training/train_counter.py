"""How often an action is done: what a segment of a take says, given its true bounds, and found by the labeller.

Single repetitions of HDM05, UTD-MHAD (18 actions that a clip shows once) and IntelliRehabDS are joined to series of one
to ten, at one tempo or so, in one go and with pauses of 0.2 to 2 s; clean, and at 15 Hz with noise of 3 cm along each
axis and 5 % of the joints missing. Series of many kinds, and of two sets more (Bandai's raised hands, the synthetic
performers), are made by another generator (``_repeated.py``): quick and slow, fading, hastening, with pauses, with left
and right in turns, seen at 10 to 120 Hz. So are those that are done where a limb is first brought to (``_held.py``), to
which no weights are fitted. The segments of UTKinect are counted by hand (``utkinect_counts.csv``; written before
anything was chosen). Compared are the peaks of the first principal component with a prominence of half its range, the
period at which it resembles itself most, ours knowing nothing of the category, ours knowing the clips of the category
by other people (IntelliRehabDS: by the same one), and, end to end, the segment that `dousa label` finds between four
other actions, learned from other people: of its category, and sharing half of the time that both take together; without
one there is no answer. Summed are the repetitions of all segments of its category that lie in it by half: two
repetitions may be two segments.
The weights that count a set are fitted to the others, those of UTKinect to other people.
The takes of UTKinect themselves are labelled by what the other people's takes teach: what is counted there is the
segment of the category that shares most with the true one.

    python -m lab.training.train_counter ../shared/data
    python -m lab.training.train_counter ../shared/data --write      # fits them to all sets, into the package
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

import dousa.retrieval.counting
from dousa.app.pipelines.experiment_clips import read_annotated_takes
from dousa.arrays import FloatArray
from dousa.formats import ReadOptions
from dousa.retrieval.counting.counter import (
    choose_count,
    describe_counts,
    find_usual,
    measure_tallies,
    name_evidence,
    use_weights,
)
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.stretches import StretchJudge
from dousa.retrieval.takes.label import TakeLabeller
from lab.training.held_series import HELD, make_held, read_held
from lab.training.repeated_series import SYNTHETIC, make_repeated, make_synthetic_repeated, read_cycles, read_synthetic
from lab.training.series import Series, join_series, make_series, make_take, read_counted_takes
from lab.trials.disturbed import KINECT_RATE, make_kinect_like

_SEEDS = (11, 12)
_TEST_SEEDS = (1, 2, 3)
_MANY_SEEDS, _MANY_TEST_SEEDS = (11, 12), (3, 4)
_MODELS, _FITTED, _TESTED = 1301, 301, 501  # first synthetic performers: who shows what is usual, who is counted
_PENALTY = 3.0
_REAL = 6  # times as much as made series that real takes count for: there are few
_FILE = Path(dousa.retrieval.counting.__file__).with_name("weights.toml")
Weights = Mapping[str, FloatArray]


class Counted:
    """A series with its tallies, and what one repetition of its category comes to by others."""

    def __init__(self, series: Series, usual: Sequence[FloatArray], kind: str = "") -> None:
        self.series, self.kind = series, kind
        self.tallies = measure_tallies(series.sampled, series.height)
        self.others = usual


def _draw_component(series: Series) -> FloatArray:
    """(n,) the first principal component of the joints about the pelvis."""
    from scipy.ndimage import gaussian_filter1d

    joints = (series.sampled - series.sampled[:, :1]).reshape(len(series.sampled), -1)
    moved = gaussian_filter1d(joints - joints.mean(axis=0), 3.0, axis=0)
    curve: FloatArray = moved @ np.linalg.svd(moved, full_matrices=False)[2][0]
    return curve


def count_periods(series: Series) -> int:
    """A plain counter: the period at which the first principal component resembles itself most."""
    curve = _draw_component(series)
    n = len(curve)
    products = np.correlate(curve, curve, "full")[n - 1 :] / np.arange(n, 0, -1)
    likeness = products[: int(0.75 * n)] / max(products[0], 1e-12)
    peaks = 1 + np.flatnonzero((likeness[1:-1] >= likeness[:-2]) & (likeness[1:-1] > likeness[2:]))
    peaks = peaks[peaks >= 10]
    if not len(peaks) or likeness[peaks].max() < 0.2:
        return 1
    return max(round(n / int(peaks[likeness[peaks].argmax()])), 1)


def count_peaks(series: Series) -> int:
    """The plainest counter: peaks of the first principal component of the joints about the pelvis."""
    from scipy.signal import find_peaks

    curve = _draw_component(series)
    if np.median(curve) > 0.5 * (curve.min() + curve.max()):
        curve = -curve
    low, high = np.quantile(curve, (0.05, 0.95))
    padded = np.concatenate([[curve.min()], curve, [curve.min()]])
    return max(len(find_peaks(padded, prominence=0.5 * (high - low), distance=12)[0]), 1)


def tally_clips(clips: Iterable[LabelledClip]) -> dict[tuple[str, str], list[FloatArray]]:
    """Tallies of all clips by person and category."""
    found: dict[tuple[str, str], list[FloatArray]] = {}
    for clip in clips:
        sampled = sample_positions(clip.positions, clip.frame_rate)
        found.setdefault((clip.performer or "", clip.category), []).append(measure_tallies(sampled, clip.height))
    return found


def list_others(tallies: Mapping[tuple[str, str], list[FloatArray]], person: str, category: str) -> list[FloatArray]:
    """Tallies of a category by other people; by the same one where there is nobody else."""
    others = [one for (who, what), some in tallies.items() if what == category and who != person for one in some]
    return others or tallies.get((person, category), [])


def gather(sets: Mapping[str, list[LabelledClip]], seed: int, *, loose: bool) -> list[Counted]:
    """Series of all sets."""
    found = []
    for name, clips in sets.items():
        tallies = tally_clips(clips)
        for one in make_series(name, clips, seed, loose=loose):
            found.append(Counted(one, list_others(tallies, one.person, one.category)))
    return found


def gather_many(cycles: Mapping[str, list[LabelledClip]], seed: int, first: int, people: int) -> list[Counted]:
    """Series of many kinds of all sets, and of so many synthetic performers from ``first`` on."""
    found = []
    for name, clips in cycles.items():
        tallies = tally_clips(clips)
        for kind, one in make_repeated(name, clips, seed):
            found.append(Counted(one, list_others(tallies, one.person, one.category), kind))
    tallies = tally_clips(read_synthetic(_MODELS))
    for kind, one in make_synthetic_repeated(seed, first, people):
        usual = [each for (_, category), some in tallies.items() if category == one.category for each in some]
        found.append(Counted(one, usual, kind))
    return found


def gather_held(seed: int, first: int, people: int) -> list[Counted]:
    """Series that are done where a limb is first brought to, by so many synthetic performers from ``first`` on."""
    tallies = tally_clips(read_held(_MODELS))
    return [
        Counted(one, list_others(tallies, one.person, one.category), kind)
        for kind, one in make_held(seed, first, people)
    ]


def gather_real(data: Path) -> list[Counted]:
    """Segments of real takes, with what segments of their category by other people come to."""
    found = [Counted(one, []) for one in read_counted_takes(data)]
    tallies: dict[tuple[str, str], list[FloatArray]] = {}
    for one in found:
        tallies.setdefault((one.series.person, one.series.category), []).append(one.tallies)
    for one in found:
        one.others = list_others(tallies, one.series.person, one.series.category)
    return found


def fit_weights(material: Sequence[Counted]) -> dict[str, FloatArray]:
    """Weights by conditional logistic regression, the first ones without and the second with what is usual."""
    # Left and right in turns: one pair or two, only the clips of a category can say.
    weights = {"alone": _fit([(one, None) for one in material if one.kind != "sides"])}
    with use_weights(weights):
        made = [(one, find_usual(one.others)) for one in material if one.others]
    return {**weights, "known": _fit(made)}


def _fit(material: Sequence[tuple[Counted, FloatArray | None]]) -> FloatArray:
    from scipy.optimize import minimize

    rows, right, groups = [], [], []
    for number, (one, usual) in enumerate(material):
        counts = np.arange(1, 16)
        rows.append(describe_counts(one.tallies, counts, usual))
        right.append(counts == one.series.count)
        groups.append(np.full(len(counts), number))
    evidence, truth, group = np.concatenate(rows), np.concatenate(right), np.concatenate(groups)
    starts = np.flatnonzero(np.diff(group, prepend=-1))

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        scores = evidence @ weights
        scores = np.exp(scores - np.maximum.reduceat(scores, starts)[group])
        shares = scores / np.add.reduceat(scores, starts)[group]
        value = -float(np.log(np.maximum(shares[truth], 1e-12)).sum()) + 0.5 * _PENALTY * float(weights @ weights)
        return value, evidence.T @ (shares - truth) + _PENALTY * weights

    # No tally speaks against the count that it comes to, which keeps sense beyond the longest series that is fitted.
    bounds = [(None, None)] * 2 + [(0.0, None)] * (evidence.shape[1] - 2)
    return np.asarray(minimize(loss, np.zeros(len(bounds)), jac=True, method="L-BFGS-B", bounds=bounds).x)


def write_weights(weights: Weights) -> None:
    """Write ``weights.toml``."""
    lines = ["# Written by lab/training/train_counter.py --write: what speaks for a count, and how much."]
    for name in ("alone", "known"):
        groups: dict[str, list[str]] = {}
        for (group, kind), weight in zip(name_evidence(name == "known"), weights[name], strict=True):
            groups.setdefault(group, []).append(f"{kind} = {weight:.3f}")
        lines += ["", f"[{name}]", *(f"{group} = {{ {', '.join(some)} }}" for group, some in groups.items())]
    _FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


class Row:
    """Answers of one system in one set: how many, and how far off; None is no answer."""

    def __init__(self) -> None:
        self.off: list[int | None] = []

    def add(self, count: int | None, truth: int) -> None:
        self.off.append(None if count is None else count - truth)

    def describe(self, name: str, variant: str, system: str) -> str:
        exact = np.mean([off == 0 for off in self.off])
        near = np.mean([off is not None and abs(off) <= 1 for off in self.off])
        none = np.mean([off is None for off in self.off])
        few = np.mean([off is not None and off < 0 for off in self.off])
        shares = f"{exact:>8.2f}{near:>12.2f}{few:>9.2f}{none:>11.2f}"
        return f"{name:<16}{variant:<13}{system:<22}{len(self.off):>5}{shares}"


def count_given(test: Sequence[Counted], rows: dict[tuple[str, str, str], Row]) -> None:
    """Counts of segments whose bounds are true."""
    for one in test:
        series = one.series
        answers = {
            "peaks": count_peaks(series),
            "periods": count_periods(series),
            "given, alone": choose_count(one.tallies),
        }
        if one.others:
            answers["given, known"] = choose_count(one.tallies, find_usual(one.others))
        names = [(series.source, "many kinds" if one.kind else series.variant)]
        names += [("all sets", one.kind), ("all sets", "many kinds")] if one.kind else []
        for system, count in answers.items():
            for name, variant in names:
                rows.setdefault((name, variant, system), Row()).add(count, series.count)


def count_labelled(
    name: str, clips: Sequence[LabelledClip], rows: dict[tuple[str, str, str], Row], folds: int, repeats: int
) -> None:
    """Counts of the segments that a labeller finds, learned from other people."""
    from dousa.experiments.annotated.trial import learn_clip_judge
    from dousa.retrieval.takes.labeller_training import train_labeller

    for person in sorted({clip.performer or "" for clip in clips})[:folds]:
        own = [clip for clip in clips if clip.performer == person]
        by_others = [clip for clip in clips if clip.performer != person]
        learned = train_labeller(by_others, n_jobs=1), learn_clip_judge(by_others, 0, None)
        for category in sorted({clip.category for clip in own}):
            chosen = [clip for clip in own if clip.category == category]
            others = [clip for clip in own if clip.category != category]
            for number in range(repeats):
                generator = np.random.default_rng([5, *map(ord, name + person + category), number])
                count = int(generator.integers(2, 8))
                picked = [chosen[int(generator.integers(len(chosen)))] for _ in range(count)]
                series = join_series(picked, generator, pauses=number % 2 == 1)
                around = [others[int(k)] for k in generator.permutation(len(others))[:4]]
                take, start, stop = make_take(series, around, generator)
                rough = make_kinect_like(take, 30.0, generator)
                for variant, points, rate in (("clean", take, 30.0), ("Kinect-like", rough, KINECT_RATE)):
                    answers = _label(learned, points, rate, (category, start, stop), picked[0].height)
                    for system, answer in zip(("end to end", "end to end, summed"), answers, strict=True):
                        rows.setdefault((name, variant, system), Row()).add(answer, count)


def _label(
    learned: tuple[TakeLabeller, StretchJudge | None],
    points: FloatArray,
    rate: float,
    wanted: tuple[str, float, float],
    height: float,
) -> tuple[int | None, int | None]:
    """What the segment says that is the series, and what all segments of its category say that lie in it."""
    from dousa.retrieval.takes.label import label_take

    labeller, judge = learned
    category, start, stop = wanted
    timeline = label_take(labeller, LabelledClip("take", "", None, points, rate, height), judge=judge)
    whole, parts = None, []
    for one in timeline.segments:
        shared = min(stop, one.stop) - max(start, one.start)
        if one.category == category and 2 * shared >= one.stop - one.start:
            parts.append(one.repetitions)
            if 2 * shared >= max(stop, one.stop) - min(start, one.start):
                whole = one.repetitions
    return whole, sum(parts) or None


def count_takes(data: Path, person: str, real: Sequence[Counted], rows: dict[tuple[str, str, str], Row]) -> None:
    """Counts of the segments of somebody's real takes, learned from the takes of the others."""
    from dousa.experiments.annotated.trial import cut_segments, learn_clip_judge
    from dousa.retrieval.takes.label import label_take
    from dousa.retrieval.takes.labeller_training import train_labeller

    takes, _ = read_annotated_takes([data / "utkinect"], "beside", performer_from="name:(s..)_", options=ReadOptions())
    by_others = [take for take in takes if take.performer != person]
    labeller = train_labeller([], by_others, n_jobs=1)
    judge = learn_clip_judge(cut_segments(by_others), 0, None)
    for take in takes:
        if take.performer != person:
            continue
        segments = label_take(labeller, take, judge=judge).segments
        for one in real:
            series = one.series
            if series.take == Path(take.name).stem:
                same = [each for each in segments if each.category == series.category]
                shared = [min(series.after, each.stop) - max(series.before, each.start) for each in same]
                best = int(np.argmax(shared)) if shared and max(shared) > 0.0 else None
                count = None if best is None else same[best].repetitions
                rows.setdefault((series.source, series.variant, "end to end"), Row()).add(count, series.count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder with hdm05, utd_mhad, irds and utkinect")
    parser.add_argument("--folds", type=int, default=1, help="people left out in turn for the rows end to end; 0: none")
    parser.add_argument("--repeats", type=int, default=2, help="takes of a category for the rows end to end")
    parser.add_argument("--only", default="", help="regular expression: which sets")
    parser.add_argument("--quick", action="store_true", help="one drawing of each generator, of one made performer")
    parser.add_argument("--write", action="store_true", help="fit the weights to all sets and write them")
    options = parser.parse_args()
    cycles = read_cycles(options.data)
    sets = {name: clips for name, clips in cycles.items() if name != "Bandai"}
    real = gather_real(options.data)
    n, people = (1, 1) if options.quick else (None, 3)
    material = [one for seed in _SEEDS[:n] for loose in (False, True) for one in gather(sets, seed, loose=loose)]
    material += [one for seed in _MANY_SEEDS[:n] for one in gather_many(cycles, seed, _FITTED + 10 * seed, people)]
    if options.write:
        write_weights(fit_weights([*material, *real * _REAL]))
        return
    wanted = list(filter(re.compile(options.only).search, (*cycles, SYNTHETIC, HELD)))
    test = [one for seed in _TEST_SEEDS[:n] for one in gather(sets, seed, loose=False)]
    test += [one for seed in _MANY_TEST_SEEDS[:n] for one in gather_many(cycles, seed, _TESTED + 10 * seed, people)]
    test += [one for seed in _MANY_TEST_SEEDS[:n] for one in gather_held(seed, _TESTED + 10 * seed, people)]
    rows: dict[tuple[str, str, str], Row] = {}
    for person in sorted({one.series.person for one in real if re.search(options.only, "UTKinect")}):
        others = [one for one in real if one.series.person != person]
        with use_weights(fit_weights([*material, *others * _REAL])):
            count_given([one for one in real if one.series.person == person], rows)
            if options.folds:
                count_takes(options.data, person, real, rows)
    for name in wanted:
        learned = [one for one in material if one.series.source != name]
        with use_weights(fit_weights([*learned, *real * _REAL])):
            count_given([one for one in test if one.series.source == name], rows)
            if options.folds and name in ("HDM05", "UTD-MHAD"):
                count_labelled(name, sets[name], rows, options.folds, options.repeats)
    print(f"{'':<16}{'':<13}{'':<22}{'n':>5}{'exact':>8}{'within one':>12}{'too few':>9}{'no answer':>11}")
    for (name, variant, system), row in sorted(rows.items()):
        print(row.describe(name, variant, system))


if __name__ == "__main__":
    main()
