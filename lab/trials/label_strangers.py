"""Takes of another sensor, studio and style: how many frames `dousa label` names rightly, for sure or perhaps.

    python -m lab.trials.label_strangers ../shared/data [--only hdm05,utkinect] [--takes 4]

All clips of one set train; the clips of each other set are joined to takes with rests, by performers where there are
any. Of the frames of actions that mean something the library knows, by the table of `confidence.py`: how many have the
right name for sure, for sure or perhaps, and with the threshold 0, which says how many could have. Of the frames of all
other actions: how many have a name. The baseline is one threshold on the confidence of segments for all libraries.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.experiments.annotated_takes import learn_clip_judge
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.label import Timeline, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import JoinedTake, join_clips, shuffle_into_takes
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.trials.confidence import SETS, find_meaning, read_clips

THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7)


def make_takes(clips: list[LabelledClip], count: int) -> list[JoinedTake]:
    chance = np.random.default_rng(0)
    known = [clip if clip.performer else replace(clip, performer="somebody") for clip in clips]
    groups = shuffle_into_takes(known, chance)
    chosen = chance.permutation(len(groups))[:count]
    return [join_clips([known[row] for row in groups[number]], chance) for number in chosen]


def count_frames(
    take: JoinedTake, timeline: Timeline, known: set[str], perhaps: bool = False, least: float = 0.0
) -> np.ndarray:
    """Frames that show something known: all, right; of the others: all, named, where that is so sure at least."""
    counts = np.zeros(4, np.int64)
    for piece in take.pieces:
        meaning = find_meaning(piece.category)
        for seconds in np.arange(piece.start, piece.stop) / TAKE_RATE:
            one = next((one for one in timeline.segments if one.start <= seconds < one.stop), None)
            name = None if one is None or one.confidence < least else one.category or (one.guess if perhaps else None)
            if meaning in known:
                counts[:2] += 1, name is not None and find_meaning(name) == meaning
            else:
                counts[2:] += 1, name is not None
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default=",".join(SETS), help="sets, separated by commas")
    parser.add_argument("--takes", type=int, default=4, help="of each set")
    asked = parser.parse_args()
    if not asked.data.exists():
        print(f"skipped: no recordings at {asked.data}")
        return
    clips = {name: read_clips(asked.data, name) for name in asked.only.split(",")}
    takes = {name: make_takes(some, asked.takes) for name, some in clips.items()}
    totals: dict[tuple[str, str, str], np.ndarray] = defaultdict(lambda: np.zeros(4, np.int64))
    for library, some in clips.items():
        labeller, judge = train_labeller(some, n_jobs=1), learn_clip_judge(some, 0, 1)
        known = {find_meaning(clip.category) for clip in some}
        for name, joined in takes.items() if judge is not None else ():
            for take in joined if name != library else ():
                told, said, forced = (
                    label_take(labeller, take, judge=judge, threshold=least) for least in (None, 1e-9, 0)
                )
                for way, perhaps in (("for sure", False), ("for sure or perhaps", True)):
                    totals[library, name, way] += count_frames(take, told, known, perhaps)
                totals[library, name, "threshold 0"] += count_frames(take, forced, known)
                for least in THRESHOLDS:
                    totals[library, name, f"threshold {least}"] += count_frames(take, said, known, least=least)
    shares = defaultdict(list)
    for (library, name, way), (shown, right, others, named) in totals.items():
        row = right / shown if shown else np.nan, named / others if others else np.nan
        shares[way].append(row)
        told_of = f"known {shown:6d}  right {row[0]:.3f}  strange {others:6d}  named {row[1]:.3f}"
        print(f"{library:18s} {name:18s} {way:20s} {told_of}", flush=True)
    for way, rows in shares.items():
        there = np.array(rows)[np.isfinite(np.array(rows)).all(axis=1)]
        right, named = there.mean(axis=0) if len(there) else (np.nan, np.nan)
        print(f"all {way:20s} right {right:.3f}  named {named:.3f}")


if __name__ == "__main__":
    main()
