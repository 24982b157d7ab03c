"""How much a labeller learns from one correction: a motion that the library does not know is named once.

    python -m lab.trials.label_corrections [FOLDER] [--performer-from RULE] [--trials N] [--quick]

Each trial leaves out one performer and one category, trains on the rest, and joins a take of the performer's clips
and three of the unknown category, by different people where there are some. The first of the three is corrected. Told
are the shares of frames of the other two that get the new name, and of all other frames that are right, and the time.
Ours teaches the labeller the example; the peer learns the labeller anew, with the example among the clips.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.experiments.annotated_takes import learn_clip_judge
from dousa.retrieval import TakeLabeller, label_take, train_labeller
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.stretches import StretchJudge
from dousa.retrieval.takes.labeller_training import Example, teach_labeller
from dousa.retrieval.takes.made_takes import JoinedTake, join_clips
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.benchmarks.take_material import read_or_make_clips
from lab.benchmarks.timing import timed

PLACES = 3  # of the unknown category in a take
MOST_OTHERS = 12  # clips of known categories in a take


@dataclass(frozen=True, slots=True)
class Score:
    """Shares of frames with the right name, 0 to 1: of the unknown category, of all others; and s to learn."""

    named: float
    others: float
    seconds: float


def choose_take(clips: list[LabelledClip], strange: str, performer: str, generator: np.random.Generator) -> JoinedTake:
    """A take of one performer with three motions of a category, the first by him or her if there is one."""
    own = [clip for clip in clips if clip.performer == performer and clip.category != strange]
    shown = sorted((clip for clip in clips if clip.category == strange), key=lambda clip: clip.performer != performer)
    chosen = [own[k] for k in generator.permutation(len(own))[:MOST_OTHERS]]
    for number, clip in enumerate(shown[:PLACES]):
        chosen.insert(min((number * (len(chosen) + 1)) // PLACES + 1, len(chosen)), clip)
    return join_clips(chosen, generator)


def score(
    system: tuple[TakeLabeller, StretchJudge | None], take: JoinedTake, strange: str, skipped: int, seconds: float
) -> Score:
    """How well a take is labelled, without the piece that was corrected."""
    timeline = label_take(system[0], take, judge=system[1], n_jobs=2)
    named, others = [], []
    for number, piece in enumerate(take.pieces):
        for frame in np.arange(piece.start, piece.stop) if number != skipped else ():
            right = timeline.category_at(float(frame) / TAKE_RATE) == piece.category
            (named if piece.category == strange else others).append(right)
    return Score(float(np.mean(named)), float(np.mean(others)), seconds)


def run_trial(clips: list[LabelledClip], strange: str, performer: str, generator: np.random.Generator) -> list[Score]:
    """Before the correction, ours, the peer."""
    known = [clip for clip in clips if clip.category != strange and clip.performer != performer]
    take = choose_take(clips, strange, performer, generator)
    labeller = train_labeller(known, n_jobs=2)
    number = next(k for k, piece in enumerate(take.pieces) if piece.category == strange)
    start, stop = round(take.pieces[number].start), round(take.pieces[number].stop)
    part = LabelledClip("part", strange, None, take.positions[start:stop], take.frame_rate, take.height)
    took, taught = timed(lambda: teach_labeller(labeller, [Example(part, strange)]))
    took_anew, anew = timed(lambda: train_labeller([*known, part], n_jobs=2))
    judge = learn_clip_judge(known, 0, 2)
    sparing = None if judge is None else judge.sparing(frozenset([strange]))  # as the library does
    return [
        score((labeller, judge), take, strange, number, 0.0),
        score((taught, sparing), take, strange, number, took),
        score((anew, sparing), take, strange, number, took_anew),
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from")
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="two trials of six performers")
    options = parser.parse_args()
    clips = read_or_make_clips(options.folder, options.performer_from)
    performers = sorted({str(clip.performer) for clip in clips})
    if options.quick:
        performers, options.trials = performers[:6], 2
        clips = [clip for clip in clips if clip.performer in performers]
    usable = sorted({c.category for c in clips if sum(d.category == c.category for d in clips) >= PLACES})
    generator = np.random.default_rng(0)
    names = generator.permutation(usable)[: options.trials]
    trials = [
        run_trial(clips, str(name), performers[number % len(performers)], generator)
        for number, name in enumerate(names)
    ]
    print(f"{len(clips)} clips, {len(performers)} performers, {len(trials)} trials; means over the trials")
    print(f"{'':28}{'named':>8}{'others':>8}{'seconds':>9}")
    for title, column in zip(
        ("before the correction", "ours: taught one example", "peer: added, learned anew"),
        zip(*trials, strict=True),
        strict=True,
    ):
        means = [np.mean([getattr(one, field) for one in column]) for field in ("named", "others", "seconds")]
        print(f"{title:28}{means[0]:8.2f}{means[1]:8.3f}{means[2]:9.2f}")
    ours, peer = (np.mean([trial[k].seconds for trial in trials]) for k in (1, 2))
    print(f"ratio of the times: {peer / ours:.0f}")


if __name__ == "__main__":
    main()
