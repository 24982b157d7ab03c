"""Takes made of clips of people left out, clean and disturbed: dousa and a nearest-neighbour baseline, in one run.

Clips of the one left out are joined to takes of about twelve (`join_clips`), and labelled with what was learned from
the others: clean; at 15 Hz with noise of 3 cm along each axis and 5 % of the joints missing; with every action 0.5 to 2
times as fast; and both. Three clips or more of one category in a row are one action. The baseline calls every frame by
the five most similar frames of the clips, seen as the mean and the spread of the joints over the second and a half
around them; the most frequent name of the second around a frame is its name, and what lasts less than half a second is
what went before.

    python -m lab.trials.label_disturbed ../shared/data                # one person of each set, some minutes
    python -m lab.trials.label_disturbed ../shared/data --folds 9      # everybody in turn
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from sklearn.neighbors import KNeighborsClassifier

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.experiments.annotated_takes import learn_clip_judge
from dousa.experiments.metrics import TimelineCounts, TrueSegment, add_counts, compare_timeline
from dousa.formats import ReadOptions
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip
from dousa.retrieval.takes.label import Segment, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import JoinedTake, join_clips, join_series, shuffle_into_takes
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.trials.disturbed import KINECT_RATE, make_kinect_like
from lab.trials.label_takes import describe

SETS = {"HDM05": ("hdm05", r"name:HDM_(..)_"), "UTD-MHAD": ("utd_mhad/skeleton", r"name:_s(\d+)_")}
KINDS = ("clean", "Kinect-like", "tempo", "both")
SHORTEST, AROUND = 15, 15  # frames
Label = Callable[[JoinedTake], Sequence[Segment]]


def make_takes(clips: Sequence[LabelledClip], kind: str, seed: int) -> Iterator[JoinedTake]:
    """Takes of one performer; the same actions in the same order for every kind."""
    groups = shuffle_into_takes(clips, np.random.default_rng(seed))
    for number, group in enumerate(groups):
        generator = np.random.default_rng([seed, number])
        tempos = np.exp(generator.uniform(np.log(0.5), np.log(2.0), len(group))).tolist()
        take = join_clips([clips[k] for k in group], generator, tempos=tempos if kind in ("tempo", "both") else None)
        if kind in ("Kinect-like", "both"):
            take = replace(
                take, positions=make_kinect_like(take.positions, TAKE_RATE, generator), frame_rate=KINECT_RATE
            )
        yield take


# The baseline, from here ...
def learn_frames(clips: Sequence[LabelledClip]) -> Label:
    """Frames of clips, and the names of those that are most like a frame."""
    rows, names = [], []
    for clip in clips:
        seen = describe(AnnotatedTake(clip.name, clip.performer, clip.positions, clip.frame_rate, clip.height, ()))
        rows.append(seen[::2])
        names += [clip.category] * len(seen[::2])
    frames = np.concatenate(rows)
    scale = np.maximum(frames.std(axis=0), 1e-3)
    nearest = KNeighborsClassifier(5, weights="distance").fit(frames / scale, names)

    def label(take: JoinedTake) -> Sequence[Segment]:
        seen = describe(AnnotatedTake("take", None, take.positions, take.frame_rate, take.height, ())) / scale
        shares = np.pad(nearest.predict_proba(seen), ((AROUND + 1, AROUND), (0, 0)), "edge").cumsum(axis=0)
        best = (shares[2 * AROUND + 1 :] - shares[: -2 * AROUND - 1]).argmax(axis=1)
        edges = [0, *(np.flatnonzero(np.diff(best)) + 1).tolist(), len(best)]
        kept: list[tuple[int, int, int]] = []
        for start, stop in pairwise(edges):
            if kept and (stop - start < SHORTEST or kept[-1][2] == best[start]):
                kept[-1] = (kept[-1][0], stop, kept[-1][2])
            else:
                kept.append((start, stop, int(best[start])))
        return [Segment(a / TAKE_RATE, b / TAKE_RATE, str(nearest.classes_[c]), 1.0) for a, b, c in kept]

    return label


# ... to here.


def learn_ours(clips: Sequence[LabelledClip], threshold: float | None = None) -> Label:
    """The labeller of `dousa train`."""
    labeller, judge = train_labeller(clips, n_jobs=2), learn_clip_judge(clips, 0, 2)

    def label(take: JoinedTake) -> Sequence[Segment]:
        return label_take(labeller, take, judge=judge, threshold=threshold).segments

    return label


def count_take(take: JoinedTake, segments: Sequence[Segment]) -> TimelineCounts:
    """What is right of a take."""
    truth = [TrueSegment(one.start / TAKE_RATE, one.stop / TAKE_RATE, one.category) for one in join_series(take.pieces)]
    return compare_timeline(segments, truth, len(take.positions) / take.frame_rate)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder with hdm05 and utd_mhad")
    parser.add_argument("--folds", type=int, default=1, help="people left out in turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="regular expression: which sets")
    options = parser.parse_args()
    print(f"{'':<10}{'':<13}{'':<20}{'frames right':>13}{'precision':>11}{'recall':>8}{'F':>7}")
    for name in filter(re.compile(options.only).search, SETS):
        folder, rule = SETS[name]
        clips, _ = read_labelled_clips(
            [options.data / folder], category_from="folder", performer_from=rule, options=ReadOptions()
        )
        counts: dict[tuple[str, str], list[TimelineCounts]] = {}
        for person in sorted({clip.performer or "" for clip in clips})[: options.folds]:
            learned = [clip for clip in clips if clip.performer != person]
            own = [clip for clip in clips if clip.performer == person]
            for system, label in (("dousa", learn_ours(learned)), ("nearest neighbours", learn_frames(learned))):
                for kind in KINDS:
                    for take in make_takes(own, kind, options.seed):
                        counts.setdefault((kind, system), []).append(count_take(take, label(take)))
        for kind in KINDS:
            for system in ("dousa", "nearest neighbours"):
                one = add_counts(counts[kind, system]).scores()
                print(
                    f"{name:<10}{kind:<13}{system:<20}{one.frame_accuracy:>13.3f}"
                    f"{one.precision:>11.3f}{one.recall:>8.3f}{one.f_measure:>7.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
