"""What is a segment of a take worth? The constants that combine the labeller's word with that of the clips.

    python benchmarks/segment_confidence.py ../shared/data [--only hdm05 utkinect]

People who did not train: HDM05's and UTD-MHAD's first person, whose clips are joined as they are and seen by a slow and
noisy sensor, with all categories known and with a quarter unknown; all of UTKinect's, learned from the takes of the
others and from their segments as clips. Each set counts the same; within one, the segments of known actions count as
one, those of nothing as many as there are, those of unknown actions at most 0.3. Printed are the constants fitted to
all sets, and what they would say of each set that is left out of the fit: what is said and right on average, the
expected calibration error (ten bins), and the AUROC of right against wrong segments, beside those of either word alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from _disturbed import KINECT_RATE, make_kinect_like
from scipy.optimize import minimize

from dousa.app.pipelines.experiment_clips import read_annotated_takes, read_labelled_clips
from dousa.arrays import FloatArray
from dousa.experiments.annotated.trial import cut_segments, learn_clip_judge
from dousa.formats import ReadOptions
from dousa.motion.annotation import Stretch
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip
from dousa.retrieval.forest.pose_space import compute_auroc
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import join_clips, join_series, shuffle_into_takes
from dousa.retrieval.takes.windows import TAKE_RATE

SETS = {"hdm05": r"name:HDM_(..)_", "utd_mhad/skeleton": r"name:_s(\d+)_", "utkinect": r"name:(s..)_"}
LEAST, STRANGERS = 1e-3, 0.3


@dataclass(frozen=True)
class Row:
    """A segment: what was tried, odds by the labeller and by the clips, whether it is right, and what it shows."""

    trial: str
    odds: tuple[float, float]
    right: bool
    shows: str


def measure(
    clips: Sequence[LabelledClip],
    takes: Sequence[AnnotatedTake],
    asked: Mapping[str, Sequence[AnnotatedTake]],
) -> Iterator[Row]:
    """Learn from clips, or else from takes, and label others."""
    labeller = train_labeller(clips, () if clips else takes)
    judge = learn_clip_judge(clips or cut_segments(takes), 0, None)
    assert judge is not None
    for trial, take in ((name, take) for name, some in asked.items() for take in some):
        sampled = sample_positions(take.positions, take.frame_rate)
        chosen = labeller.choose(labeller.judge(sampled, take.height), len(sampled))
        if not chosen:
            continue
        spans = [(one.start / TAKE_RATE, one.stop / TAKE_RATE) for one in chosen]
        names = [labeller.classes[one.category] for one in chosen]
        seen = judge.judge(take, spans, names)
        sure = labeller.confidence(np.stack([one.evidence for one in chosen]))
        for span, name, own, chance in zip(spans, names, sure, seen.chances, strict=True):
            right, shows = compare(take, span, name, labeller.classes)
            odds = np.clip((own, chance), LEAST, 1 - LEAST)
            yield Row(trial, tuple(np.log(odds / (1 - odds)).tolist()), right, shows)


def compare(take: AnnotatedTake, span: tuple[float, float], name: str, classes: Sequence[str]) -> tuple[bool, str]:
    """Whether a segment overlaps a true one of its category by half, and what it shows most."""
    shares, right = {"known": 0.0, "nothing": 0.0, "strange": 0.0}, False
    for one in take.stretches:
        shared = min(span[1], one.stop) - max(span[0], one.start)
        if shared > 0 and one.counted:
            kind = "nothing" if one.category is None else "known" if one.category in classes else "strange"
            shares[kind] += shared
            right |= one.category == name and 2 * shared >= max(span[1], one.stop) - min(span[0], one.start)
    return right, max(shares, key=lambda key: shares[key])


def try_clips(name: str, clips: list[LabelledClip]) -> Iterator[Row]:
    """The first person's clips, joined."""
    draw = np.random.default_rng(5)
    person = sorted({str(clip.performer) for clip in clips})[0]
    own = [clip for clip in clips if clip.performer == person]
    others = [clip for clip in clips if clip.performer != person]
    names = sorted({clip.category for clip in clips})
    aside = set(draw.permutation(names)[: round(0.25 * len(names))].tolist())
    takes: list[AnnotatedTake] = []
    for group in shuffle_into_takes(own, draw):
        made = join_clips([own[k] for k in group], draw)
        parts = tuple(Stretch(p.start / TAKE_RATE, p.stop / TAKE_RATE, p.category) for p in join_series(made.pieces))
        takes.append(AnnotatedTake(str(len(takes)), person, made.positions, TAKE_RATE, made.height, parts))
    slow = [
        replace(take, positions=make_kinect_like(take.positions, TAKE_RATE, draw), frame_rate=KINECT_RATE)
        for take in takes
    ]
    for which, unknown in (("", set()), (", a quarter unknown", aside)):
        known = [clip for clip in others if clip.category not in unknown]
        yield from measure(known, (), {f"{name}{which}": takes, f"{name}, slow{which}": slow})


def read_rows(data: Path, name: str) -> Iterator[Row]:
    """All trials of a set."""
    options = ReadOptions()
    if name != "utkinect":
        yield from try_clips(
            name,
            read_labelled_clips([data / name], category_from="folder", performer_from=SETS[name], options=options)[0],
        )
        return
    takes, _ = read_annotated_takes([data / name], "beside", performer_from=SETS[name], options=options)
    for person in sorted({str(take.performer) for take in takes}):
        others = [take for take in takes if take.performer != person]
        asked = [take for take in takes if take.performer == person]
        yield from measure((), others, {f"{name}, from takes": asked})
        yield from measure(cut_segments(others), (), {f"{name}, from clips": asked})


def weigh(rows: Sequence[Row]) -> FloatArray:
    """What each segment counts within its set."""
    weights = np.zeros(len(rows))
    for trial in {row.trial for row in rows}:
        own = {
            kind: [k for k, row in enumerate(rows) if (row.trial, row.shows) == (trial, kind)]
            for kind in ("known", "nothing", "strange")
        }
        count = max(len(own["known"]), 1)
        weights[own["known"]] = 1 / count
        weights[own["nothing"]] = min(1.0, len(own["nothing"]) / count) / max(len(own["nothing"]), 1)
        weights[own["strange"]] = min(STRANGERS, len(own["strange"]) / count) / max(len(own["strange"]), 1)
    total: FloatArray = weights / weights.sum()
    return total


def fit(sets: Sequence[Sequence[Row]]) -> FloatArray:
    """(3,) offset and weights of the odds, the latter not below 0."""
    weights = np.concatenate([weigh(rows) for rows in sets]) / len(sets)
    odds = np.array([(1.0, *row.odds) for rows in sets for row in rows])
    right = np.array([row.right for rows in sets for row in rows], np.float64)

    def loss(b: FloatArray) -> float:
        return float(weights @ (np.logaddexp(0.0, odds @ b) - right * (odds @ b)) + 1e-3 * b[1:] @ b[1:])

    return np.asarray(minimize(loss, np.zeros(3), method="L-BFGS-B", bounds=[(None, None), (0, None), (0, None)]).x)


def describe(said: FloatArray, right: FloatArray) -> str:
    """What is said, the error, and the AUROC."""
    bins = np.minimum((said * 10).astype(int), 9)
    error = sum(abs(said[bins == k].sum() - right[bins == k].sum()) for k in range(10)) / len(said)
    return f"{said.mean():.2f} {error:.3f} {compute_auroc(said, right > 0):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="+", default=list(SETS), choices=list(SETS))
    options = parser.parse_args()
    sets = {name: list(read_rows(options.data, name)) for name in options.only}
    print("constants, fitted to all:", np.round(fit(list(sets.values())), 2))
    print("trial: segments, right; says, error and AUROC without its set in the fit | by the labeller | as clips")
    for name, rows in sets.items():
        others = [own for other, own in sets.items() if other != name] or [rows]
        constants = fit(others)
        for trial in sorted({row.trial for row in rows}):
            own = [row for row in rows if row.trial == trial]
            odds, right = np.array([row.odds for row in own]), np.array([row.right for row in own], np.float64)
            said = [constants[0] + odds @ constants[1:], odds[:, 0], odds[:, 1]]
            print(
                f"{trial}: {len(own)}, {right.mean():.2f};",
                " | ".join(describe(1 / (1 + np.exp(-z)), right) for z in said),
            )


if __name__ == "__main__":
    main()
