"""How often something is done: in real films, in takes counted by hand, and in series of single repetitions.

Real films: the shared half of Countix (Dwibedi et al. 2020), of which every other film ("chosen on") was looked at when
the counter's three constants were chosen, and the rest ("left out") was only read. The segments of UTKinect are counted
by hand (``utkinect_counts.csv``; written before anything was chosen). Single repetitions of HDM05, UTD-MHAD (18
actions that a clip shows once), IntelliRehabDS, Bandai's raised hands and the synthetic performers are joined to series
of many kinds (``lab/training/repeated_series.py``): quick and slow, fading, hastening, with pauses, with left and right
in turns, seen at 10 to 120 Hz; and to series that are done where a limb is first brought to (``held_series.py``).
Compared are the peaks of the first principal component with a prominence of half its range, the period at which it
resembles itself most, ours, ours knowing by other people's clips how many cycles one repetition is, and, end to end,
the segment that `dousa label` finds between four other actions, learned from other people: of its category, and sharing
half of the time that both take together; without one there is no answer. Summed are the repetitions of all segments of
its category that lie in it by half. The takes of UTKinect are labelled by what the other people's takes teach.

    python -m lab.trials.count_series ../shared/data
"""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from dousa.app.pipelines.experiment_clips import read_annotated_takes
from dousa.arrays import FloatArray
from dousa.formats import ReadOptions
from dousa.formats.motion_files import read_canonical
from dousa.motion.repetitions import count_repetitions
from dousa.motion.resampling import fill_gaps
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.stretches import StretchJudge
from dousa.retrieval.takes.label import TakeLabeller
from dousa.retrieval.takes.repetitions import count_part, divide_cycles, find_phases
from lab.training.held_series import make_held, read_held
from lab.training.repeated_series import make_repeated, make_synthetic_repeated, read_cycles, read_synthetic
from lab.training.series import Series, join_series, make_series, make_take, read_counted_takes
from lab.trials.disturbed import KINECT_RATE, make_kinect_like

_SEEDS = (3, 4)
_MODELS, _TESTED = 1301, 501  # first synthetic performers: who shows what is usual, who is counted


class Counted:
    """A series, and how many cycles the clips of its category by others show."""

    def __init__(self, series: Series, others: Sequence[int], kind: str = "") -> None:
        self.series, self.others, self.kind = series, others, kind


def _draw_component(sampled: FloatArray) -> FloatArray:
    """(n,) the first principal component of the joints (n, 20, 3) about the pelvis."""
    from scipy.ndimage import gaussian_filter1d

    joints = np.nan_to_num(sampled - sampled[:, :1]).reshape(len(sampled), -1)
    moved = gaussian_filter1d(joints - joints.mean(axis=0), 3.0, axis=0)
    curve: FloatArray = moved @ np.linalg.svd(moved, full_matrices=False)[2][0]
    return curve


def count_periods(sampled: FloatArray) -> int:
    """A plain counter: the period at which the first principal component resembles itself most."""
    curve = _draw_component(sampled)
    n = len(curve)
    products = np.correlate(curve, curve, "full")[n - 1 :] / np.arange(n, 0, -1)
    likeness = products[: int(0.75 * n)] / max(products[0], 1e-12)
    peaks = 1 + np.flatnonzero((likeness[1:-1] >= likeness[:-2]) & (likeness[1:-1] > likeness[2:]))
    peaks = peaks[peaks >= 10]
    if not len(peaks) or likeness[peaks].max() < 0.2:
        return 1
    return max(round(n / int(peaks[likeness[peaks].argmax()])), 1)


def count_peaks(sampled: FloatArray) -> int:
    """The plainest counter: peaks of the first principal component of the joints about the pelvis."""
    from scipy.signal import find_peaks

    curve = _draw_component(sampled)
    if np.median(curve) > 0.5 * (curve.min() + curve.max()):
        curve = -curve
    low, high = np.quantile(curve, (0.05, 0.95))
    padded = np.concatenate([[curve.min()], curve, [curve.min()]])
    return max(len(find_peaks(padded, prominence=0.5 * (high - low), distance=12)[0]), 1)


def count_clips(clips: Iterable[LabelledClip]) -> dict[tuple[str, str], list[int]]:
    """Cycles of all clips by person and category."""
    found: dict[tuple[str, str], list[int]] = {}
    for clip in clips:
        cycles = count_part(sample_positions(clip.positions, clip.frame_rate))
        found.setdefault((clip.performer or "", clip.category), []).append(cycles)
    return found


def list_others(cycles: Mapping[tuple[str, str], list[int]], person: str, category: str) -> list[int]:
    """Cycles of a category by other people; by the same one where there is nobody else."""
    others = [one for (who, what), some in cycles.items() if what == category and who != person for one in some]
    return others or cycles.get((person, category), [])


def gather(cycles: Mapping[str, list[LabelledClip]], seed: int, people: int) -> list[Counted]:
    """Series of many kinds of all sets, and of so many synthetic performers."""
    found = []
    for name, clips in cycles.items():
        shown = count_clips(clips)
        for one in make_series(name, clips, seed) if name != "Bandai" else ():
            found.append(Counted(one, list_others(shown, one.person, one.category)))
        for kind, one in make_repeated(name, clips, seed):
            found.append(Counted(one, list_others(shown, one.person, one.category), kind))
    first = _TESTED + 10 * seed
    shown = count_clips(read_synthetic(_MODELS))
    for kind, one in make_synthetic_repeated(seed, first, people):
        found.append(Counted(one, list_others(shown, "", one.category), kind))
    shown = count_clips(read_held(_MODELS))
    for kind, one in make_held(seed, first, people):
        found.append(Counted(one, list_others(shown, one.person, one.category), kind))
    return found


def gather_real(data: Path) -> list[Counted]:
    """Segments of real takes, with what segments of their category by other people show."""
    found = [Counted(one, []) for one in read_counted_takes(data)]
    cycles: dict[tuple[str, str], list[int]] = {}
    for one in found:
        cycles.setdefault((one.series.person, one.series.category), []).append(count_part(one.series.sampled))
    for one in found:
        one.others = list_others(cycles, one.series.person, one.series.category)
    return found


class Row:
    """Answers of one system in one set, None for none, and the true counts."""

    def __init__(self) -> None:
        self.answers: list[tuple[int | None, int]] = []

    def add(self, count: int | None, truth: int) -> None:
        self.answers.append((count, truth))

    def describe(self, name: str, variant: str, system: str) -> str:
        off = [(abs(count - truth), count < truth, truth) for count, truth in self.answers if count is not None]
        n = len(self.answers)
        exact, near, few = (sum(some) / n for some in zip(*((o == 0, o <= 1, less) for o, less, _ in off), strict=True))
        shares = f"{exact:>8.2f}{near:>12.2f}{np.mean([o / truth for o, _, truth in off]):>10.2f}{few:>9.2f}"
        return f"{name:<16}{variant:<13}{system:<22}{n:>5}{shares}{1.0 - len(off) / n:>11.2f}"


Rows = dict[tuple[str, str, str], Row]


def count_given(test: Sequence[Counted], rows: Rows) -> None:
    """Counts of segments whose bounds are true."""
    for one in test:
        series, cycles = one.series, count_part(one.series.sampled)
        answers = {
            "peaks": count_peaks(series.sampled),
            "periods": count_periods(series.sampled),
            "given, alone": cycles,
            "given, known": divide_cycles(cycles, find_phases(one.others)),
        }
        names = [(series.source, "many kinds" if one.kind else series.variant)]
        names += [("all sets", one.kind), ("all sets", "many kinds")] if one.kind else []
        for system, count in answers.items():
            for name, variant in names:
                rows.setdefault((name, variant, system), Row()).add(count, series.count)


def count_films(data: Path, rows: Rows) -> None:
    """Counts of the films of Countix: all, those chosen on, those left out, and those of which the count is certain."""
    with (data / "countix" / "counts.csv").open(encoding="utf-8") as file:
        films = list(csv.DictReader(file))
    for number, film in enumerate(films):
        path = data / "countix" / film["exercise"] / f"{film['film']}.npy"
        motion = read_canonical(path, ReadOptions(frame_rate=30.0))[0]
        found, truth = count_repetitions(motion), int(film["count"])
        positions = fill_gaps(motion.positions)
        answers = {
            "count": found.count,
            "peaks": count_peaks(positions),
            "periods": count_periods(positions),
        }
        variants = ["all", "left out" if number % 2 else "chosen on"]
        variants += ["certain" if found.certainty >= 0.85 else "uncertain"]
        for variant in variants:
            for system, count in answers.items():
                rows.setdefault(("Countix", variant, system), Row()).add(count, truth)


def count_labelled(name: str, clips: Sequence[LabelledClip], rows: Rows, folds: int, repeats: int) -> None:
    """Counts of the segments that a labeller finds, learned from other people."""
    from dousa.experiments.annotated_takes import learn_clip_judge
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


def count_takes(data: Path, person: str, real: Sequence[Counted], rows: Rows) -> None:
    """Counts of the segments of somebody's real takes, learned from the takes of the others."""
    from dousa.experiments.annotated_takes import cut_segments, learn_clip_judge
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
    parser.add_argument("data", type=Path, help="folder with countix, hdm05, utd_mhad, irds, bandai and utkinect")
    parser.add_argument("--folds", type=int, default=1, help="people left out in turn for the rows end to end; 0: none")
    parser.add_argument("--repeats", type=int, default=2, help="takes of a category for the rows end to end")
    parser.add_argument("--only", default="", help="regular expression: which sets")
    parser.add_argument("--quick", action="store_true", help="one drawing of each generator, of one made performer")
    options = parser.parse_args()
    wanted = re.compile(options.only).search
    rows: Rows = {}
    if wanted("Countix"):
        count_films(options.data, rows)
    if wanted("UTKinect"):
        real = gather_real(options.data)
        count_given(real, rows)
        for person in sorted({one.series.person for one in real}) if options.folds else ():
            count_takes(options.data, person, [one for one in real if one.series.person == person], rows)
    cycles = {name: clips for name, clips in read_cycles(options.data).items() if wanted(name)}
    test = [
        one
        for seed in _SEEDS[: 1 if options.quick else None]
        for one in gather(cycles, seed, 1 if options.quick else 3)
    ]
    count_given([one for one in test if wanted(one.series.source)], rows)
    for name in ("HDM05", "UTD-MHAD") if options.folds else ():
        if name in cycles:
            count_labelled(name, cycles[name], rows, options.folds, options.repeats)
    print(
        f"{'':<16}{'':<13}{'':<22}{'n':>5}{'exact':>8}{'within one':>12}{'relative':>10}{'too few':>9}{'no answer':>11}"
    )
    for (name, variant, system), row in sorted(rows.items()):
        print(row.describe(name, variant, system))


if __name__ == "__main__":
    main()
