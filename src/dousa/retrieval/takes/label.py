"""Label a long take over time: categories with start, stop and confidence, and unknown stretches.

Discriminants give the probability of every category, and of nothing, at every moment (`moment_model`), from which the
likeliest sequence of segments follows (`sequence`). Each segment is then judged as a clip by the forest
(`StretchJudge`); both together give its name and confidence. Doubtful segments are unknown, with a guess where a clip
would have one.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.files.disk import atomic_write
from dousa.messages import Message
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.motion.runs import find_equal_runs
from dousa.notebooks import Tabular, short_repr
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import PlainMotion, PosedMotion, check_motion
from dousa.retrieval.forest.forest_file import check, check_version, pack_arrays, unpack_arrays
from dousa.retrieval.forest.stretches import StretchJudge, StretchOpinions
from dousa.retrieval.takes.moment_model import (
    HOP,
    MODEL_ARRAYS,
    N_VALUES,
    Codes,
    MomentModel,
    are_mirrored,
    chunk_starts,
    count_moments,
    describe_chunk,
    mirror_moments,
    read_moment_model,
    sharpen,
)
from dousa.retrieval.takes.repetitions import Chosen, count_all, is_clearer, lay_mirrored
from dousa.retrieval.takes.sequence import FLOOR, N_PHASES, Run, SequenceModel, SequenceWeights, join_phases
from dousa.retrieval.takes.windows import TAKE_RATE
from dousa.workers.threads import map_pieces

SHORT_GAP = 15
"""Frames, the longest gap between two actions, or at an end, that is added to them: half a second (docs/takes.md)."""

_VERSION = 8  # of the stored form, by definition
_WHAT = Message("stored.labeller")
_NAMES = (
    *("version", "classes", *MODEL_ARRAYS, "log_lengths", "spreads", "weights"),
    *("calibration", "threshold", "held", "held_states", "phases", "placing"),
)


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of a take.

    Parameters
    ----------
    start, stop : s.
    category : None where it is unknown.
    confidence : 0 to 1, the probability that the category, or else the guess, is right; with neither, that none is.
    repetitions : how often the action is done.
    mirrored : whether the action is mirrored; never if the labeller distinguishes sides.
    guess : a category too doubtful for ``category``; else None.
    """

    start: float
    stop: float
    category: str | None
    confidence: float
    repetitions: int = 1
    mirrored: bool = False
    guess: str | None = None

    @property
    def perhaps(self) -> bool:
        """Return whether the segment has a guess in place of a category."""
        return self.guess is not None

    def to_json(self) -> dict[str, Any]:
        """Return plain words and numbers; times in seconds."""
        return {
            "start_s": round(self.start, 3),
            "end_s": round(self.stop, 3),
            "category": self.category,
            "unknown": self.category is None,
            "perhaps": self.perhaps,
            "guess": self.guess,
            "confidence": round(self.confidence, 4),
            "repetitions": self.repetitions,
            "mirrored": self.mirrored,
        }


@short_repr
@dataclass(frozen=True, slots=True)
class Timeline(Tabular):
    """A take of ``duration`` s as ``segments`` in the order of time without gaps; unknown below the ``threshold``."""

    _rows: ClassVar[str] = "segments"

    segments: tuple[Segment, ...]
    duration: float
    threshold: float

    def category_at(self, seconds: float) -> str | None:
        """Return the category at a moment; None where it is unknown or outside the take."""
        for segment in self.segments:
            if segment.start <= seconds < segment.stop:
                return segment.category
        return None

    def to_json(self) -> dict[str, Any]:
        """Return plain dictionaries, lists, numbers and strings for ``json.dumps``."""
        return {
            "duration_s": round(self.duration, 3),
            "threshold": round(self.threshold, 4),
            "segments": [segment.to_json() for segment in self.segments],
        }


def write_timeline_csv(timeline: Timeline, path: str | os.PathLike[str]) -> None:
    """Write a row per segment: start_s, end_s, category (empty if unknown), confidence, repetitions, perhaps (guess).

    MotionWriteError : the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(("start_s", "end_s", "category", "confidence", "repetitions", "perhaps"))
    for one in timeline.segments:
        sure = f"{one.confidence:.4f}", one.repetitions
        writer.writerow((f"{one.start:.3f}", f"{one.stop:.3f}", one.category or "", *sure, one.guess or ""))
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


@dataclass(frozen=True, slots=True, eq=False)
class TakeLabeller:
    """A trained labeller of takes.

    Parameters
    ----------
    classes : (C,) the categories.
    model : of moments; its states are three phases of each class, and nothing.
    sequence : order and lengths of the states.
    calibration : (1 + K,) offset and evidence weights (`describe_run`) of the log odds that a segment is right.
    threshold : least confidence of a category.
    held : (H, F) bytes of some training moments, whose states are kept when examples are taught.
    held_states : (H,) their states: 3 c + phase, 3 C for nothing.
    phases : (C',) how many cycles one repetition of a category is (`find_phases`). C' is C without the categories only
        taught.
    placing : (1 + K,) as ``calibration``, of lying where any action is.
    """

    classes: tuple[str, ...]
    model: MomentModel
    sequence: SequenceModel
    calibration: tuple[float, ...]
    threshold: float
    held: Codes
    held_states: NDArray[np.int32]
    phases: tuple[int, ...]
    placing: tuple[float, ...]

    def judge(self, sampled: FloatArray, height: float, n_jobs: int | None = None) -> NDArray[np.float32]:
        """Compute the discriminants of a recording ``sampled`` (n, 20, 3) m at ``TAKE_RATE``, of a body ``height`` m.

        Returns (M, 3 C + 1) of the phases and of nothing, at its moments: about 1 if shown, else about 0. The result
        does not depend on ``n_jobs``, threads; None for one.
        """
        return self.judge_views(sampled, height, n_jobs, (self.model.judge,))[0]

    def judge_views(
        self,
        sampled: FloatArray,
        height: float,
        n_jobs: int | None,
        views: Sequence[Callable[[NDArray[np.float32]], NDArray[np.float32]]],
    ) -> list[NDArray[np.float32]]:
        """Compute ``judge`` by several ``views``, which return discriminants of the values of moments."""
        firsts = chunk_starts(len(sampled))
        shape = count_moments(len(sampled)), N_PHASES * len(self.classes) + 1
        scores = [np.empty(shape, np.float32) for _ in views]

        def fill(first: int) -> None:
            rows, values = describe_chunk(sampled, height, first)
            for some, view in zip(scores, views, strict=True):
                some[rows] = view(values)

        map_pieces(fill, firsts, n_jobs, at_a_time=1)
        return scores

    @property
    def tells_sides(self) -> bool:
        """Return whether one category mirrors another, as waves of the left and of the right hand."""
        return _tells_sides(self)

    def choose(self, scores: NDArray[np.float32], n_frames: int, *, never_unknown: bool = False) -> list[Chosen]:
        """Return the actions of a recording, in the order of time, from its (M, 3 C + 1) discriminants."""
        shares = sharpen(scores, self.model.sharpness)
        joined = join_phases(shares)
        chosen: list[Chosen] = []
        for run in self.sequence.find_runs(shares, never_nothing=never_unknown):
            if run.state == len(self.classes):
                continue
            means = np.asarray(joined[run.start : run.stop].mean(axis=0), np.float64)
            evidence = describe_run(shares, run, self.sequence, means)
            parts = tuple(
                (one.start * HOP, min(one.stop * HOP, n_frames)) for one in self.sequence.cut_repetitions(shares, run)
            )
            start, stop = run.start * HOP, min(run.stop * HOP, n_frames)
            chosen.append(Chosen(start, stop, run.state, evidence, shares=means[:-1], parts=parts))
        return chosen

    def confidence(self, evidence: FloatArray) -> FloatArray:
        """Return the (W,) probability that segments are right, from their evidence (W, K)."""
        return _weigh_evidence(evidence, self.calibration)

    def place(self, evidence: FloatArray) -> FloatArray:
        """Return the (W,) probability that segments lie where some action is, from their evidence (W, K)."""
        return _weigh_evidence(evidence, self.placing)

    def find_most(self, evidence: FloatArray) -> FloatArray:
        """Return the (W,) larger of ``place`` and ``confidence``, from evidence (W, K)."""
        return np.maximum(self.place(evidence), self.confidence(evidence))

    def to_bytes(self) -> bytes:
        """Return the bytes of an .npz file (no pickle); the same labeller gives the same bytes."""
        weights = self.sequence.weights
        return pack_arrays(
            {
                "version": np.array(_VERSION, np.int64),
                "classes": np.array(self.classes, dtype=np.str_),
                **self.model.to_arrays(),
                "log_lengths": self.sequence.log_lengths,
                "spreads": self.sequence.spreads,
                "weights": np.array([weights.evidence, weights.nothing, weights.edges], np.float64),
                "calibration": np.array(self.calibration, np.float64),
                "threshold": np.array(self.threshold, np.float64),
                "held": self.held,
                "held_states": self.held_states,
                "phases": np.array(self.phases, np.int64),
                "placing": np.array(self.placing, np.float64),
            }
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> TakeLabeller:
        """Read the bytes of ``to_bytes``; DousaError for damaged, other or newer bytes."""
        arrays = unpack_arrays(data, _NAMES, _WHAT)
        check_version(arrays, _WHAT, _VERSION)
        classes = arrays["classes"]
        check(classes.ndim == 1 and len(classes) > 0 and classes.dtype.kind == "U", _WHAT, "bad categories")
        check(len(np.unique(classes)) == len(classes), _WHAT, "a category occurs twice")
        states = len(classes) + 1
        model = read_moment_model(arrays, N_PHASES * len(classes) + 1, N_VALUES, _WHAT)
        names = ("log_lengths", "spreads", "weights", "calibration", "threshold", "placing")
        numbers = {name: arrays[name] for name in names}
        shapes = {"log_lengths": (states,), "spreads": (states,), "weights": (3,), "threshold": ()}
        shapes["calibration"] = shapes["placing"] = (7,)  # 1 + K of `describe_run`
        for name, array in numbers.items():
            right = array.dtype == np.float64 and array.shape == shapes[name]
            check(right and bool(np.isfinite(array).all()), _WHAT, f"bad {name}")
        means, spreads, weights = numbers["log_lengths"], numbers["spreads"], numbers["weights"]
        check(bool((np.abs(means) < 20).all() and (spreads > 1e-3).all()), _WHAT, "bad lengths")
        check(bool((np.abs(weights) < 1e6).all()) and 0 <= float(numbers["threshold"]) <= 1, _WHAT, "bad threshold")
        held, of = arrays["held"], arrays["held_states"]
        right = held.dtype == np.uint8 and held.ndim == 2 and held.shape[1] == N_VALUES
        check(right and of.dtype == np.int32 and of.shape == (len(held),), _WHAT, "bad held moments")
        phases = arrays["phases"]
        right = phases.dtype == np.int64 and phases.ndim == 1 and len(phases) <= len(classes)
        check(right and bool(((phases > 0) & (phases < 100)).all()), _WHAT, "bad repetitions")
        return cls(
            tuple(map(str, classes)),
            model,
            SequenceModel(means, spreads, SequenceWeights(*map(float, weights))),
            tuple(map(float, numbers["calibration"])),
            float(numbers["threshold"]),
            held,
            of,
            tuple(phases.tolist()),
            tuple(map(float, numbers["placing"])),
        )


@lru_cache(maxsize=4)
def _tells_sides(labeller: TakeLabeller) -> bool:
    rows = np.flatnonzero(labeller.held_states < N_PHASES * len(labeller.classes))
    scale = labeller.model.scale
    values = (labeller.held[rows] / scale.scales + scale.lows).astype(np.float32)
    return are_mirrored(scale, values, mirror_moments(values), labeller.held_states[rows] // N_PHASES)


def _weigh_evidence(evidence: FloatArray, curve: Sequence[float]) -> FloatArray:
    offset, *weights = curve
    chances: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(evidence @ np.array(weights) + offset, -50, 50)))
    return chances


def average_shares(shares: NDArray[np.float32], run: Run) -> FloatArray:
    """Return the (C + 1,) mean share of each category, and of nothing, in a run, from shares (M, 3 C + 1)."""
    return np.asarray(join_phases(shares[run.start : run.stop]).mean(axis=0), np.float64)


def describe_run(
    shares: NDArray[np.float32], run: Run, sequence: SequenceModel, means: FloatArray | None = None
) -> FloatArray:
    """Return the (K,) evidence for a run of a category, from the probabilities (M, 3 C + 1) at all moments.

    The log of the mean probability of its category, the lead over the second as a share of it, how usual its length is,
    the log of that length, and the log odds of its beginning and its end. ``means`` (C + 1,) are those of
    `average_shares`, if known.
    """
    means = average_shares(shares, run) if means is None else means
    own = max(float(means[run.state]), 1e-3)
    others = means[:-1].copy()
    others[run.state] = 0.0
    second = float(others.max())
    length = np.log((run.stop - run.start) * HOP)
    usual = -0.5 * ((length - sequence.log_lengths[run.state]) / sequence.spreads[run.state]) ** 2
    edges = []
    for moment, phase in ((run.start, 0), (run.stop - 1, N_PHASES - 1)):
        phases = shares[moment, N_PHASES * run.state : N_PHASES * (run.state + 1)]
        edges.append(np.log((phases[phase] + FLOOR) / (phases.sum() - phases[phase] + FLOOR)))
    evidence = (np.log(own), 1.0 - second / own, max(usual, -8.0), length, *edges)
    return np.array(evidence, np.float64)


# Weights of the log odds that the name of an action is right: of its log odds against all other names, of how typical
# its poses are, and of how unsteady the bones are, as a noisy sensor makes all less typical. Fitted to segments of
# people who did not train, as recorded and disturbed, with and without unknown actions: joined clips of HDM05, UTD-MHAD
# and Bandai, each counting the same (lab/trials/segment_confidence.py, docs/takes.md).
_OFFSET, _BY_LEAD, _BY_TYPICAL, _BY_UNSTEADINESS = -0.97, 0.76, 2.97, 8.65
_EVEN = 0.5  # by definition as likely right as wrong


def weigh_chosen(
    labeller: TakeLabeller,
    chosen: Sequence[Chosen],
    motion: PosedMotion,
    judge: StretchJudge | None,
    n_jobs: int | None = None,
) -> list[Chosen]:
    """Set the confidence and the name of actions of a motion from the labeller and the judge of clips.

    The labeller alone decides if the judge is None or does not know a category. ``n_jobs`` threads; None for one.
    """
    if not chosen:
        return []
    evidence = np.stack([one.evidence for one in chosen])
    sure = labeller.confidence(evidence).tolist()

    def believe(k: int) -> Chosen:
        return replace(chosen[k], confidence=sure[k], likely=sure[k] >= labeller.threshold)

    if judge is None:
        return [believe(k) for k in range(len(chosen))]
    names = labeller.classes
    whole, spans = _divide(chosen)
    shares = np.stack([chosen[k].shares for k in whole])
    found = [names[chosen[k].category] for k in whole]
    seen = _gather(judge.judge(motion, spans, found, shares, names, n_jobs), whole)
    placed = labeller.place(evidence)
    chances = combine_chances(placed, seen)
    said = []
    for k, judged in enumerate(seen.judged.tolist()):
        if not judged:
            said.append(believe(k))
            continue
        # The sequence decided that it is an action; the judge decides whether it has a name.
        likely = bool(seen.sure[k] or chances[k] >= _EVEN * placed[k])
        category, possible = names.index(seen.names[k]), bool(likely or seen.possible[k])
        chance = float(chances[k])
        said.append(replace(chosen[k], category=category, confidence=chance, likely=likely, possible=possible))
    return said


def _divide(chosen: Sequence[Chosen], most: int = 6) -> tuple[NDArray[np.intp], list[tuple[float, float]]]:
    """Return the spans (P,) of at most ``most`` parts of each action, s, and the action of each (docs/takes.md).

    An action repeated without a rest is much longer than its clips; its parts are as long as they are.
    """
    whole: list[int] = []
    spans: list[tuple[float, float]] = []
    for k, one in enumerate(chosen):
        parts = one.parts or ((one.start, one.stop),)
        parts = parts[:: -(-len(parts) // most)]
        whole += [k] * len(parts)
        spans += [(start / TAKE_RATE, stop / TAKE_RATE) for start, stop in parts]
    return np.array(whole, np.intp), spans


def _gather(seen: StretchOpinions, whole: NDArray[np.intp]) -> StretchOpinions:
    """Combine opinions on parts into those on N actions: the name with most support, and the means."""
    if len(whole) == whole.max() + 1:
        return seen
    names, leads, sure, possible = [], [], [], []
    for k in range(int(whole.max()) + 1):
        parts = np.flatnonzero(whole == k)
        votes: dict[str, float] = {}
        for part in parts.tolist():
            votes[seen.names[part]] = votes.get(seen.names[part], 0.0) + max(float(seen.leads[part]), 0.0) + 1e-9
        names.append(max(votes, key=lambda name: votes[name]))
        same = np.array([seen.names[part] == names[-1] for part in parts])
        leads.append(float(np.where(same, seen.leads[parts], -np.abs(seen.leads[parts])).mean()))
        sure.append(bool((seen.sure[parts] & same).mean() >= _EVEN))
        possible.append(bool((seen.possible[parts] & same).mean() >= _EVEN))
    count = np.bincount(whole)
    typical, unsteady = (np.bincount(whole, values) / count for values in (seen.typical, seen.unsteady))
    firsts = find_equal_runs(whole)[:, 0]
    return StretchOpinions(
        seen.judged[firsts], tuple(names), np.array(leads), typical, unsteady, np.array(sure), np.array(possible)
    )


def combine_chances(placed: FloatArray, seen: StretchOpinions) -> FloatArray:
    """Return the (N,) probabilities that segments are right: that they lie where an action is, and have the right name.

    ``placed`` (N,) are the probabilities of the first.
    """
    odds = _OFFSET + _BY_LEAD * seen.leads + _BY_TYPICAL * seen.typical + _BY_UNSTEADINESS * seen.unsteady
    chances: FloatArray = placed / (1.0 + np.exp(-odds))
    return chances


def label_take(
    labeller: TakeLabeller,
    motion: PosedMotion,
    *,
    judge: StretchJudge | None = None,
    threshold: float | None = None,
    n_jobs: int | None = None,
) -> Timeline:
    """Label a take from beginning to end.

    Parameters
    ----------
    labeller : trained.
    motion : of any length and frame rate.
    judge : the forest that judges segments as clips; None for the labeller alone.
    threshold : least confidence of a category, 0 to 1; 0 leaves nothing unknown. None: more likely right than wrong, as
        a clip or all in all; without a judge, the threshold of the labeller.
    n_jobs : threads; None for one. The result does not depend on it.

    Raises
    ------
    OptionError : a threshold outside 0 to 1.
    InvalidMotionError : another shape than (n, 20, 3), positions that are not finite, no body height.
    """
    check_threshold(threshold)
    points = check_motion(motion)
    sampled = sample_positions(points, motion.frame_rate)

    def choose(scores: NDArray[np.float32]) -> list[Chosen]:
        return labeller.choose(scores, len(sampled), never_unknown=threshold == 0)

    if labeller.tells_sides:
        chosen = weigh_chosen(labeller, choose(labeller.judge(sampled, motion.height, n_jobs)), motion, judge, n_jobs)
    else:
        views = labeller.model.judge, labeller.model.judge_mirrored
        scores = labeller.judge_views(sampled, motion.height, n_jobs, views)
        own, mirrored = map_pieces(choose, scores, n_jobs, at_a_time=1)
        chosen = weigh_chosen(labeller, own, motion, judge, n_jobs)
        # Clips never make an action likelier than its place.
        most = labeller.find_most(np.stack([one.evidence for one in mirrored])) if mirrored else np.empty(0)
        possible = [
            one
            for one, chance in zip(mirrored, most.tolist(), strict=True)
            if is_clearer(replace(one, confidence=chance), chosen)
        ]
        image = PlainMotion(mirror_positions(points), motion.frame_rate, motion.height)
        chosen = lay_mirrored(chosen, weigh_chosen(labeller, possible, image, judge, n_jobs), SHORT_GAP)
    chosen = count_all(chosen, sampled, labeller.phases)
    usual = labeller.threshold if judge is None else _EVEN
    limit = usual if threshold is None else threshold
    said = [one.likely if threshold is None else one.confidence >= threshold for one in chosen]
    return make_timeline(chosen, said, labeller.classes, len(points) / motion.frame_rate, limit)


def check_threshold(threshold: float | None) -> None:
    """Raise OptionError for a probability outside 0 to 1."""
    if threshold is not None and not 0 <= threshold <= 1:
        raise OptionError("labeller.threshold", found=threshold)


def make_timeline(
    chosen: Sequence[Chosen], said: Sequence[bool], classes: Sequence[str], duration: float, threshold: float
) -> Timeline:
    """Make segments without gaps from actions and whether each is named."""
    n_frames = duration * TAKE_RATE
    spans = _share_gaps([(float(one.start), float(one.stop)) for one in chosen], n_frames)
    parts: list[Segment] = []
    reached = 0.0
    for one, (start, stop), known in zip(chosen, spans, said, strict=True):
        if start > reached:
            parts.append(Segment(reached / TAKE_RATE, start / TAKE_RATE, None, 1.0))
        parts.append(make_segment(one, (start / TAKE_RATE, stop / TAKE_RATE), classes[one.category], said=known))
        reached = stop
    if reached < n_frames:
        parts.append(Segment(reached / TAKE_RATE, duration, None, 1.0))
    return Timeline(_merge_unknown(parts), duration, threshold)


def make_segment(one: Chosen, span: tuple[float, float], name: str, *, said: bool) -> Segment:
    """Make a segment of an action: with its category, a guess, or neither."""
    if not said and not one.possible:
        return Segment(*span, None, 1.0 - one.confidence)
    named = (name, None) if said else (None, name)
    return Segment(*span, named[0], one.confidence, one.repetitions, one.mirrored, named[1])


def _share_gaps(spans: list[tuple[float, float]], n_frames: float) -> list[tuple[float, float]]:
    if not spans:
        return []
    starts, stops = (list(edges) for edges in zip(*spans, strict=True))
    for k in range(len(spans) - 1):
        if starts[k + 1] - stops[k] <= SHORT_GAP:
            middle = 0.5 * (stops[k] + starts[k + 1])
            stops[k] = starts[k + 1] = min(max(middle, starts[k] + 1), max(stops[k + 1] - 1, starts[k] + 1))
    if starts[0] <= SHORT_GAP:
        starts[0] = 0.0
    if n_frames - stops[-1] <= SHORT_GAP:
        stops[-1] = n_frames
    return list(zip(starts, stops, strict=True))


def _merge_unknown(parts: Sequence[Segment]) -> tuple[Segment, ...]:
    merged: list[Segment] = []
    for part in parts:
        before = merged[-1] if merged else None
        if before is not None and not any(one.category or one.perhaps for one in (before, part)):
            sure, more = (each.confidence * (each.stop - each.start) for each in (before, part))
            mean = (sure + more) / (part.stop - before.start)
            merged[-1] = Segment(before.start, part.stop, None, mean)
        else:
            merged.append(part)
    return tuple(merged)
