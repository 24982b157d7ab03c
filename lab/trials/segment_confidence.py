"""What is a segment of a take worth? The constants that weigh the labeller's word and that of the clips.

    python -m lab.trials.segment_confidence ../shared/data [--only hdm05 utkinect]

People who did not train: HDM05's and UTD-MHAD's first person and a half of Bandai's clips, joined as they are and with
rests, with all categories known and with a quarter unknown; and all of UTKinect's takes, learned from the takes of the
others and from their segments as clips. The constants are fitted to takes as recorded, disturbed as in training, by
errors that drift and by a rough sensor, and tried on takes by a sensor that no fit has seen, too (`make_kinect_like`).
The sets count the same, but UTKinect a seventh: it is the only real one, but differs most. Within a set,
the segments of known actions count as one, those of nothing as many as there are, those of unknown actions at most 0.3.

A segment is right if an action is where it is, which the labeller has learned to tell in such takes, and if it has the
right name. Printed are the constants fitted to all sets: what weighs in the odds of the categories (the labeller's
share, the votes), and in those that the name is right, given an action (offset, the lead of the name, how typical the
poses are, how unsteady the bones). Then what those fitted without a set say of it: of the segments that are in the
place of a known action, how many are named right by the labeller, by the votes, and by both; what is said and right on
average, the expected calibration error (ten bins), and the AUROC of right against wrong segments. Last the error of
others: of the labeller's word alone; of what was said before (one logistic curve over all evidence, whose constants are
fitted in the same way); of one temperature for the votes; and of an isotonic fit of the votes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit, logsumexp
from sklearn.isotonic import IsotonicRegression

from dousa.app.pipelines.experiment_clips import read_annotated_takes, read_labelled_clips
from dousa.arrays import FloatArray
from dousa.experiments.annotated_takes import cut_segments, learn_clip_judge
from dousa.formats import ReadOptions
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip
from dousa.retrieval.forest.pose_space import compute_auroc
from dousa.retrieval.forest.stretches import StretchJudge, cut_stretch
from dousa.retrieval.takes.label import TakeLabeller
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import (
    JoinedTake,
    disturb,
    join_clips,
    join_series,
    join_with_rests,
    shuffle_into_takes,
)
from dousa.retrieval.takes.windows import TAKE_RATE
from lab.trials.disturbed import KINECT_RATE, make_drifting, make_kinect_like, make_rough

SETS = {"hdm05": r"name:HDM_(..)_", "utd_mhad/skeleton": r"name:_s(\d+)_", "bandai": None, "utkinect": r"name:(s..)_"}
LEAST, LEAST_SHARE, STRANGERS, REAL = 1e-3, 0.02, 0.3, 1 / 7
UNSEEN = "Kinect-like"  # no fit sees it
Disturb = Callable[[JoinedTake, np.random.Generator], JoinedTake]


def make_worse(take: JoinedTake, draw: np.random.Generator) -> JoinedTake:
    """By a rough sensor."""
    return replace(take, positions=make_rough(take.positions, take.frame_rate, draw), frame_rate=KINECT_RATE)


KINDS: dict[str, Disturb] = {
    "recorded": lambda take, draw: take,
    "disturbed": disturb,
    "drifting": lambda take, draw: replace(take, positions=make_drifting(take.positions, draw)),
    "rough": lambda take, draw: make_worse(disturb(take, draw), draw),
    UNSEEN: lambda take, draw: replace(
        take, positions=make_kinect_like(take.positions, TAKE_RATE, draw), frame_rate=KINECT_RATE
    ),
}


@dataclass(frozen=True)
class Row:
    """A segment.

    Parameters
    ----------
    trial, kind : what was tried, and how the take was seen.
    evidence : (3,) lead of the name, typical, unsteady.
    placed : probability that an action is there, by the labeller.
    sure : that the labeller's name is right, by the labeller.
    share : of the votes for the name.
    there : whether an action is there.
    right : whether its name is, too.
    shows : known, nothing or strange, most of the time.
    shares : (C, 2) logarithms of the labeller's shares and of those of the votes.
    found, true : numbers of the labeller's category, and of the one that it overlaps by half; the latter -1 for none.
    """

    trial: str
    kind: str
    evidence: tuple[float, ...]
    placed: float
    sure: float
    share: float
    there: bool
    right: bool
    shows: str
    shares: FloatArray
    found: int
    true: int


def measure(
    clips: Sequence[LabelledClip], takes: Sequence[AnnotatedTake], asked: Sequence[JoinedTake], trial: str
) -> Iterator[Row]:
    """Learn from clips, or else from takes, and label others, seen in every way."""
    labeller = train_labeller(clips, () if clips else takes)
    judge = learn_clip_judge(clips or cut_segments(takes), 0, None)
    assert judge is not None
    for number, take in enumerate(asked):
        for kind, change in KINDS.items():
            yield from ask(labeller, judge, change(take, np.random.default_rng([number, 5])), trial, kind)


def ask(labeller: TakeLabeller, judge: StretchJudge, take: JoinedTake, trial: str, kind: str) -> Iterator[Row]:
    """What is said of a take."""
    sampled = sample_positions(take.positions, take.frame_rate)
    chosen = labeller.choose(labeller.judge(sampled, take.height), len(sampled))
    if not chosen:
        return
    classes = list(labeller.classes)
    spans = [(one.start / TAKE_RATE, one.stop / TAKE_RATE) for one in chosen]
    found, shares = [classes[one.category] for one in chosen], np.stack([one.shares for one in chosen])
    seen = judge.judge(take, spans, found, shares, classes)
    features = np.stack([judge.feature_set.compute(cut_stretch(take, *span)) for span in spans])
    forest = judge.assessor.forest
    votes = forest.histograms_of(forest.apply(features).astype(np.int64))
    assert [str(name) for name in forest.classes_] == classes
    described = np.stack([one.evidence for one in chosen])
    sure, placed = labeller.confidence(described), labeller.place(described)
    for k, one in enumerate(chosen):
        true, shows, there = compare(take, spans[k], classes)
        named = classes.index(seen.names[k])
        logs = np.log(np.stack([shares[k], votes[k]], axis=1) + LEAST_SHARE)
        yield Row(
            trial, kind, (float(seen.leads[k]), float(seen.typical[k]), float(seen.unsteady[k])),
            float(placed[k]), float(sure[k]), float(votes[k, named]), there, true == named, shows, logs,
            one.category, true,
        )  # fmt: skip


def compare(take: JoinedTake, span: tuple[float, float], classes: Sequence[str]) -> tuple[int, str, bool]:
    """The category that a segment overlaps by half, what it shows most, and whether it overlaps any action by half."""
    shares, true, there = {"known": 0.0, "nothing": 0.0, "strange": 0.0}, -1, False
    for one in join_series(take.pieces):
        start, stop = one.start / TAKE_RATE, one.stop / TAKE_RATE
        shared = min(span[1], stop) - max(span[0], start)
        if shared > 0 and one.counted:
            kind = "nothing" if one.category is None else "known" if one.category in classes else "strange"
            shares[kind] += shared
            if kind != "nothing" and 2 * shared >= max(span[1], stop) - min(span[0], start):
                true, there = classes.index(str(one.category)) if kind == "known" else true, True
    return true, max(shares, key=lambda key: shares[key]), there


def try_clips(name: str, clips: list[LabelledClip]) -> Iterator[Row]:
    """The first person's clips, or every other one, joined."""
    draw = np.random.default_rng(5)
    person = sorted({str(clip.performer) for clip in clips})[0]
    own = [clip for k, clip in enumerate(clips) if (clip.performer == person if clip.performer else k % 2)]
    others = [clip for k, clip in enumerate(clips) if not (clip.performer == person if clip.performer else k % 2)]
    names = sorted({clip.category for clip in clips})
    aside = set(draw.permutation(names)[: round(0.25 * len(names))].tolist())
    groups = [[own[k] for k in group] for group in shuffle_into_takes(own, draw)]
    takes = [join(group, draw) for join in (join_clips, join_with_rests) for group in groups]
    for which, unknown in (("", set()), (", a quarter unknown", aside)):
        yield from measure([clip for clip in others if clip.category not in unknown], (), takes, f"{name}{which}")


def read_rows(data: Path, name: str) -> Iterator[Row]:
    """All trials of a set."""
    options, rule = ReadOptions(), SETS[name]
    if name != "utkinect":
        clips, _ = read_labelled_clips([data / name], category_from="folder", performer_from=rule, options=options)
        yield from try_clips(name, clips)
        return
    takes, _ = read_annotated_takes([data / name], "beside", performer_from=rule, options=options)
    for person in sorted({str(take.performer) for take in takes}):
        others = [take for take in takes if take.performer != person]
        asked = [to_joined(take) for take in takes if take.performer == person]
        yield from measure((), others, asked, f"{name}, from takes")
        yield from measure(cut_segments(others), (), asked, f"{name}, from clips")


def to_joined(take: AnnotatedTake) -> JoinedTake:
    """A take as the made ones are."""
    from dousa.retrieval.takes.made_takes import Piece

    pieces = tuple(
        Piece(one.start * TAKE_RATE, one.stop * TAKE_RATE, one.category, one.counted) for one in take.stretches
    )
    return JoinedTake(sample_positions(take.positions, take.frame_rate), take.height, pieces)


def weigh(rows: Sequence[Row]) -> FloatArray:
    """What each segment counts within its set."""
    weights = np.zeros(len(rows))
    for trial in {(row.trial, row.kind) for row in rows}:
        own = {
            kind: [k for k, row in enumerate(rows) if (row.trial, row.kind, row.shows) == (*trial, kind)]
            for kind in ("known", "nothing", "strange")
        }
        count = max(len(own["known"]), 1)
        weights[own["known"]] = 1 / count
        weights[own["nothing"]] = min(1.0, len(own["nothing"]) / count) / max(len(own["nothing"]), 1)
        weights[own["strange"]] = min(STRANGERS, len(own["strange"]) / count) / max(len(own["strange"]), 1)
    total: FloatArray = weights / weights.sum()
    return total


def fit_odds(evidence: FloatArray, right: FloatArray, weights: FloatArray) -> FloatArray:
    """(1 + K,) what of evidence (N, K) weighs in the log odds of being right, nothing but the offset below 0."""
    columns = np.column_stack([np.ones(len(evidence)), evidence])
    scale = np.append(1.0, evidence.std(axis=0))

    def lose(b: FloatArray) -> float:
        odds = (columns / scale) @ b
        return float(weights @ (np.logaddexp(0.0, odds) - right * odds) / weights.sum() + 1e-3 * b[1:] @ b[1:])

    bounds = [(None, None)] + [(0.0, None)] * evidence.shape[1]
    return np.asarray(minimize(lose, np.zeros(len(scale)), method="L-BFGS-B", bounds=bounds).x / scale)


def gather(sets: Mapping[str, Sequence[Row]]) -> tuple[list[Row], FloatArray]:
    """The segments that constants are fitted to, and what each counts."""
    kept = {name: [row for row in rows if row.kind != UNSEEN] for name, rows in sets.items()}
    weights = np.concatenate([weigh(rows) * (REAL if name == "utkinect" else 1.0) for name, rows in kept.items()])
    return [row for own in kept.values() for row in own], weights / weights.sum()


def fit(sets: Mapping[str, Sequence[Row]]) -> tuple[FloatArray, FloatArray]:
    """(2,) what weighs in the odds of the categories, and (4,) in those that the name of what is there is right."""
    rows, weights = gather(sets)
    some = [k for k, row in enumerate(rows) if row.there]
    right = np.array([rows[k].right for k in some], np.float64)
    sure = fit_odds(np.array([rows[k].evidence for k in some]), right, weights[some])
    placed = [k for k, row in enumerate(rows) if row.true >= 0]
    true, counts = np.array([rows[k].true for k in placed]), weights[placed]
    logs = np.zeros((len(placed), max(len(rows[k].shares) for k in placed), 2))
    none = np.full(logs.shape[:2], -np.inf)
    for place, k in enumerate(placed):
        logs[place, : len(rows[k].shares)], none[place, : len(rows[k].shares)] = rows[k].shares, 0.0

    def lose_names(b: FloatArray) -> float:
        odds = logs @ b + none
        return float(counts @ (logsumexp(odds, axis=1) - odds[np.arange(len(odds)), true]) + 1e-3 * b @ b)

    return np.asarray(minimize(lose_names, np.ones(2), method="L-BFGS-B", bounds=[(0.0, None)] * 2).x), sure


Say = Callable[[Sequence[Row]], FloatArray]


def say(rows: Sequence[Row], sure: FloatArray) -> FloatArray:
    """How likely segments are right, as `label` says it."""
    odds = np.array([(1.0, *row.evidence) for row in rows]) @ sure
    said: FloatArray = np.array([row.placed for row in rows]) * expit(odds)
    return said


def fit_others(sets: Mapping[str, Sequence[Row]]) -> dict[str, Say]:
    """What others would say, fitted to the same segments."""
    rows, weights = gather(sets)
    right = np.array([row.right for row in rows], np.float64)

    def before(some: Sequence[Row]) -> FloatArray:
        return np.array([(float(logit(np.clip(row.sure, LEAST, 1 - LEAST))), *row.evidence) for row in some])

    def votes(some: Sequence[Row]) -> FloatArray:
        return np.array([row.share for row in some])

    def heat(some: Sequence[Row]) -> FloatArray:
        return np.array([logit(np.clip(row.share, LEAST, 1 - LEAST)) for row in some])[:, None]

    one, temperature = fit_odds(before(rows), right, weights), fit_odds(heat(rows), right, weights)[1]
    curve = IsotonicRegression(out_of_bounds="clip", y_min=0, y_max=1).fit(votes(rows), right, weights)
    return {
        "labeller": lambda some: np.array([row.sure for row in some]),
        "one curve": lambda some: expit(one[0] + before(some) @ one[1:]),
        "temperature": lambda some: expit(temperature * heat(some)[:, 0]),
        "isotonic": lambda some: np.asarray(curve.predict(votes(some))),
    }


def describe(said: FloatArray, right: FloatArray) -> str:
    """What is said and right, the error, and the AUROC."""
    return f"{said.mean():.2f} {right.mean():.2f} {measure_error(said, right):.3f} {compute_auroc(said, right > 0):.3f}"


def measure_error(said: FloatArray, right: FloatArray) -> float:
    """The expected calibration error."""
    bins = np.minimum((said * 10).astype(int), 9)
    return float(sum(abs(said[bins == k].sum() - right[bins == k].sum()) for k in range(10)) / len(said))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="+", default=list(SETS), choices=list(SETS))
    options = parser.parse_args()
    sets = {name: list(read_rows(options.data, name)) for name in options.only}
    names, sure = fit(sets)
    print("fitted to all: categories", np.round(names, 2), "the name", np.round(sure, 2))
    print(
        "without its set in the fit: segments, named right by the labeller, the votes, both; says, right, error, AUROC"
    )
    for name, rows in sets.items():
        without = {other: own for other, own in sets.items() if other != name} or sets
        names, sure = fit(without)
        others = fit_others(without)
        print(name, np.round(names, 2), np.round(sure, 2))
        for trial, kind in dict.fromkeys((row.trial, row.kind) for row in rows):
            own = [row for row in rows if (row.trial, row.kind) == (trial, kind)]
            placed = [row for row in own if row.true >= 0]
            called = (
                np.mean([row.found == row.true for row in placed]),
                np.mean([row.shares[:, 1].argmax() == row.true for row in placed]),
                np.mean([(row.shares @ names).argmax() == row.true for row in placed]),
            )
            right = np.array([row.right for row in own], np.float64)
            print(
                f"{trial}, {kind}: {len(own)},",
                " ".join(f"{share:.3f}" for share in called) + ";",
                describe(say(own, sure), right) + "; others",
                " ".join(f"{title} {measure_error(other(own), right):.3f}" for title, other in others.items()),
                flush=True,
            )


if __name__ == "__main__":
    main()
