"""A real uncut take with a written truth: what is labelled, and what is right.

    python -m lab.trials.label_annotated TAKE TRUTH FOLDER... [--same ACTION=CATEGORY ...]

TRUTH is CMU's `mocap.txt`: after a line with the numbers of subject and take, a line an action: its name and three
frames, the earliest, likely and latest end. FOLDER holds labelled clips, which train. An action of the truth whose name
is not said to be the same as a category is unknown to the library; frames between the earliest and the latest end do
not count.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from dousa.experiments.annotated_takes import learn_clip_judge
from dousa.experiments.metrics import TrueSegment, compare_timeline
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise
from dousa.retrieval.takes.label import Timeline, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.benchmarks.take_material import read_or_make_clips


def read_truth(path: Path, take: str, frame_rate: float, same: dict[str, str]) -> list[TrueSegment]:
    """The pieces of a take; `take` is subject and number, as in 86_01."""
    wanted = [str(int(part)) for part in take.split("_")]
    truth: list[TrueSegment] = []
    inside, begin = False, 0.0
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if len(words) == 2:
            inside = [str(int(word)) for word in words] == wanted
        elif inside and len(words) == 4:
            earliest, _, latest = (int(word) / frame_rate for word in words[1:])
            truth.append(TrueSegment(begin, earliest, same.get(words[0])))
            if latest > earliest:
                truth.append(TrueSegment(earliest, latest, None, counted=False))
            begin = latest
    return truth


def print_doubtful(timeline: Timeline, truth: list[TrueSegment]) -> None:
    """The same with what is perhaps so; and how much of the rest has a name, for sure or perhaps."""
    shown: list[bool] = []
    rest: list[tuple[bool, bool]] = []
    for piece in truth:
        for seconds in np.arange(piece.start, piece.stop, 1.0 / TAKE_RATE) if piece.counted else ():
            one = next((one for one in timeline.segments if one.start <= seconds < one.stop), None)
            named = None if one is None else one.category
            perhaps = None if one is None else one.guess
            if piece.category is not None:
                shown.append((named or perhaps) == piece.category)
            else:
                rest.append((named is not None, perhaps is not None))
    sure, doubtful = np.mean(rest or [(np.nan, np.nan)], axis=0)
    print(f"  {np.mean(shown or [np.nan]):.3f} of those with what is perhaps so; the rest: named {sure:.3f}, ", end="")
    print(f"perhaps {doubtful:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("take", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--same", action="append", default=[], metavar="ACTION=CATEGORY")
    parser.add_argument("--performer-from", default=None)
    options = parser.parse_args()
    clips = [clip for folder in options.folders for clip in read_or_make_clips(folder, options.performer_from)]
    labeller, judge = train_labeller(clips, n_jobs=2), learn_clip_judge(clips, 0, 2)
    motion = canonicalise(read_motion(options.take))
    same = dict(pair.split("=", 1) for pair in options.same)
    truth = read_truth(options.truth, options.take.stem, motion.frame_rate, same)
    for name, threshold in (("with unknown", None), ("all said", 0.0)):
        timeline = label_take(labeller, motion, judge=judge, threshold=threshold)
        scores = compare_timeline(timeline.segments, truth, timeline.duration).scores()
        print(f"{name}: {scores.frame_accuracy:.3f} of {scores.n_frames} frames right")
        shared = [
            timeline.category_at(seconds) == piece.category
            for piece in truth
            if piece.category is not None
            for seconds in np.arange(piece.start, piece.stop, 1.0 / TAKE_RATE)
        ]
        print(f"  {np.mean(shared or [np.nan]):.3f} of those {len(shared)} that show a category")
        print_doubtful(timeline, truth)
        for one in timeline.segments:
            side = " mirrored" if one.mirrored else ""
            said = one.category or (f"perhaps {one.guess}" if one.guess else "unknown")
            print(f"  {one.start:6.1f} {one.stop:6.1f}  {said:40} {one.confidence:.2f}{side}")
    print("truth:")
    for piece in truth:
        if piece.counted:
            print(f"  {piece.start:6.1f} {piece.stop:6.1f}  {piece.category or 'no such category'}")


if __name__ == "__main__":
    main()
