"""Label a long take over time: which category from when to when, how sure, and where nothing known happens.

Trees say how likely every category, and nothing, is at every moment (`moment_forest`), and the likeliest sequence of
segments is found (`sequence`), which finds the places and the lengths of the actions at once. What is nothing, and what
is not likely enough to be right, is unknown.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import MotionWriteError, OptionError
from dousa.messages import Message
from dousa.retrieval.counting.tallies import TALLIES
from dousa.retrieval.features.posed_motion import PosedMotion, check_motion
from dousa.retrieval.forest.forest_file import check, check_version, pack_arrays, unpack_arrays
from dousa.retrieval.takes.moment_forest import FOREST_ARRAYS, MomentForest, read_moment_forest
from dousa.retrieval.takes.moments import HOP, N_VALUES, chunk_starts, count_moments, describe_chunk
from dousa.retrieval.takes.repetitions import Chosen, count_all
from dousa.retrieval.takes.sequence import N_PHASES, Run, SequenceModel, SequenceWeights, join_phases
from dousa.retrieval.takes.windows import TAKE_RATE

SHORT_GAP = 15
"""Frames between two actions, or at an end, that are shared out among them."""

_WITHOUT_USUAL, _VERSION = 2, 3
_WHAT = Message("stored.labeller")
_NAMES = (
    *("version", "classes", *FOREST_ARRAYS, "log_lengths", "spreads", "weights"),
    *("calibration", "threshold", "held", "held_states"),
)


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of a take.

    Parameters
    ----------
    start, stop : s.
    category : None where it is unknown.
    confidence : 0 to 1, the probability that the category is right; of an unknown one, that none would be.
    repetitions : how often the action is done.
    """

    start: float
    stop: float
    category: str | None
    confidence: float
    repetitions: int = 1

    def to_json(self) -> dict[str, Any]:
        """Plain words and numbers; times in seconds."""
        return {
            "start_s": round(self.start, 3),
            "end_s": round(self.stop, 3),
            "category": self.category,
            "unknown": self.category is None,
            "confidence": round(self.confidence, 4),
            "repetitions": self.repetitions,
        }


@dataclass(frozen=True, slots=True)
class Timeline:
    """A take from beginning to end.

    Parameters
    ----------
    segments : one after another without gaps, in the order of time; none for a take of no length.
    duration : s.
    threshold : confidence below which a stretch is unknown.
    """

    segments: tuple[Segment, ...]
    duration: float
    threshold: float

    def category_at(self, seconds: float) -> str | None:
        """The category at a moment; None where it is unknown or outside the take."""
        for segment in self.segments:
            if segment.start <= seconds < segment.stop:
                return segment.category
        return None

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings, ready for ``json.dumps``."""
        return {
            "duration_s": round(self.duration, 3),
            "threshold": round(self.threshold, 4),
            "segments": [segment.to_json() for segment in self.segments],
        }


def write_timeline_csv(timeline: Timeline, path: str | os.PathLike[str]) -> None:
    """Write a row a segment: start_s, end_s, category (empty where unknown), confidence, repetitions.

    Raises
    ------
    MotionWriteError : the file cannot be written.
    """
    try:
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("start_s", "end_s", "category", "confidence", "repetitions"))
            writer.writerows(
                (f"{one.start:.3f}", f"{one.stop:.3f}", one.category or "", f"{one.confidence:.4f}", one.repetitions)
                for one in timeline.segments
            )
    except OSError as error:
        raise MotionWriteError(path, "labeller.unwritable", reason=error) from error


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """What single examples add to the probabilities.

    Parameters
    ----------
    leaves : (K, n_trees) that moments of the examples, and moments that are held, reach.
    additions : (K, S) what a moment with all the same leaves gets more of each state.
    """

    leaves: NDArray[np.int32]
    additions: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class TakeLabeller:
    """What is learned to label takes with.

    Parameters
    ----------
    classes : (C,) the categories.
    forest : of moments; what it tells apart are three phases of each class (but those only taught), and nothing.
    sequence : how states follow one another.
    calibration : (3,) the log odds that a segment is right: offset, weight of the log of the mean probability of its
        category, weight of the lead over the second.
    threshold : confidence from which a category is said.
    held : (H, n_trees) leaves of some moments that trained, of which the same is said when an example is taught.
    held_states : (H,) what they are, as the forest counts: 3 c + phase, 3 C for nothing.
    usual : (C', 18) what one repetition of a category comes to in each tally (`find_usual`); NaN where that is not
        known. C' is C without the categories only taught, or 0.
    taught : of examples.
    """

    classes: tuple[str, ...]
    forest: MomentForest
    sequence: SequenceModel
    calibration: tuple[float, float, float]
    threshold: float
    held: NDArray[np.int32]
    held_states: NDArray[np.int32]
    usual: FloatArray = field(default_factory=lambda: np.empty((0, len(TALLIES))))
    taught: Taught | None = None

    def judge(self, sampled: FloatArray, height: float, n_jobs: int | None = None) -> NDArray[np.float32]:
        """How likely each phase of each category, and nothing, is at the moments of a recording.

        Parameters
        ----------
        sampled : (n, 20, 3) m at ``TAKE_RATE``.
        height : m.
        n_jobs : threads; None for one. The result does not depend on it.

        Returns
        -------
        (M, 3 C + 1)
        """
        import joblib

        firsts = chunk_starts(len(sampled))
        shares = np.empty((count_moments(len(sampled)), N_PHASES * len(self.classes) + 1), np.float32)

        def fill(first: int) -> None:
            rows, values = describe_chunk(sampled, height, first)
            shares[rows] = self.judge_leaves(self.forest.apply(self.forest.scale.encode(values)))

        # One chunk alone is not worth the threads.
        joblib.Parallel(n_jobs=n_jobs if len(firsts) > 1 else 1, prefer="threads")(
            joblib.delayed(fill)(first) for first in firsts
        )
        return shares

    def judge_leaves(self, leaves: NDArray[np.int32]) -> NDArray[np.float32]:
        """(M, 3 C + 1) probabilities of the phases of the categories, and of nothing, from leaves (M, n_trees)."""
        shares = self.forest.judge(leaves)
        if self.taught is None:
            return shares
        from dousa.retrieval.takes.window_kernels import compare_leaves

        wider = np.zeros((len(shares), N_PHASES * len(self.classes) + 1), np.float32)
        wider[:, : shares.shape[1] - 1], wider[:, -1] = shares[:, :-1], shares[:, -1]
        same = np.empty((len(self.taught.leaves), len(leaves)))
        for row, known in zip(same, self.taught.leaves, strict=True):
            compare_leaves(leaves, known, row)
        wider += same.T.astype(np.float32) @ self.taught.additions
        wider = np.maximum(wider, 0.0)
        judged: NDArray[np.float32] = wider / np.maximum(wider.sum(axis=1, keepdims=True), 1e-6)
        return judged

    def choose(self, shares: NDArray[np.float32], n_frames: int, *, never_unknown: bool = False) -> list[Chosen]:
        """The actions of a recording, in the order of time, from the probabilities (M, 3 C + 1) at its moments."""
        runs = self.sequence.find_runs(shares, never_nothing=never_unknown)
        return [
            Chosen(run.start * HOP, min(run.stop * HOP, n_frames), run.state, mean_scores(shares, run))
            for run in runs
            if run.state < len(self.classes)
        ]

    def confidence(self, scores: NDArray[np.float32]) -> FloatArray:
        """(K,) probability that the best category of segments is right, from mean probabilities (K, C)."""
        offset, by_score, by_lead = self.calibration
        evidence = describe_scores(scores) @ (by_score, by_lead) + offset
        sure: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(evidence, -50, 50)))
        return sure

    def to_bytes(self) -> bytes:
        """The bytes of an .npz file (no pickle); the same labeller gives the same bytes. Nothing taught is in them."""
        weights = self.sequence.weights
        return pack_arrays(
            {
                "version": np.array(_VERSION, np.int64),
                "classes": np.array(self.classes, dtype=np.str_),
                **self.forest.to_arrays(),
                "log_lengths": self.sequence.log_lengths,
                "spreads": self.sequence.spreads,
                "weights": np.array([weights.evidence, weights.nothing, weights.edges], np.float64),
                "calibration": np.array(self.calibration, np.float64),
                "threshold": np.array(self.threshold, np.float64),
                "held": self.held,
                "held_states": self.held_states,
                "usual": self.usual,
            }
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> TakeLabeller:
        """The labeller that ``to_bytes`` wrote; DousaError for damaged, other or newer bytes."""
        arrays = unpack_arrays(data, _NAMES, _WHAT, optional=("usual",))
        check_version(arrays, _WHAT, (_WITHOUT_USUAL, _VERSION))
        classes = arrays["classes"]
        check(classes.ndim == 1 and len(classes) > 0 and classes.dtype.kind == "U", _WHAT, "bad categories")
        check(len(np.unique(classes)) == len(classes), _WHAT, "a category occurs twice")
        states = len(classes) + 1
        forest = read_moment_forest(arrays, N_PHASES * len(classes) + 1, N_VALUES, _WHAT)
        numbers = {name: arrays[name] for name in ("log_lengths", "spreads", "weights", "calibration", "threshold")}
        shapes = {"log_lengths": (states,), "spreads": (states,), "weights": (3,), "calibration": (3,), "threshold": ()}
        for name, array in numbers.items():
            right = array.dtype == np.float64 and array.shape == shapes[name]
            check(right and bool(np.isfinite(array).all()), _WHAT, f"bad {name}")
        means, spreads, weights = numbers["log_lengths"], numbers["spreads"], numbers["weights"]
        check(bool((np.abs(means) < 20).all() and (spreads > 1e-3).all()), _WHAT, "bad lengths")
        check(bool((np.abs(weights) < 1e6).all()) and 0 <= float(numbers["threshold"]) <= 1, _WHAT, "bad threshold")
        held, of = arrays["held"], arrays["held_states"]
        right = held.dtype == np.int32 and held.ndim == 2 and held.shape[1] == len(forest.roots)
        right = right and of.dtype == np.int32 and of.shape == (len(held),)
        check(right and held.flags.c_contiguous, _WHAT, "bad held moments")
        check(not len(held) or bool(held.min() >= 0 and held.max() < len(forest.leaf_starts) - 1), _WHAT, "bad leaves")
        usual = arrays.get("usual", np.empty((0, len(TALLIES))))
        right = usual.dtype == np.float64 and usual.shape in ((len(classes), len(TALLIES)), (0, len(TALLIES)))
        check(right and bool((np.isnan(usual) | ((usual > 1e-3) & (usual < 1e6))).all()), _WHAT, "bad repetitions")
        return cls(
            tuple(map(str, classes)),
            forest,
            SequenceModel(means, spreads, SequenceWeights(*map(float, weights))),
            (float(numbers["calibration"][0]), float(numbers["calibration"][1]), float(numbers["calibration"][2])),
            float(numbers["threshold"]),
            held,
            of,
            usual,
        )


def mean_scores(shares: NDArray[np.float32], run: Run) -> NDArray[np.float32]:
    """(C,) mean probabilities of the categories during a run, from those of the phases (M, 3 C + 1) at all moments."""
    scores: NDArray[np.float32] = join_phases(shares[run.start : run.stop])[:, :-1].mean(axis=0)
    return scores


def describe_scores(scores: NDArray[np.float32]) -> FloatArray:
    """(W, 2) log of the best score, and its lead over the second as a share of it."""
    if scores.shape[1] == 1:
        best, second = scores[:, 0].astype(np.float64), np.zeros(len(scores))
    else:
        second, best = np.partition(scores, -2, axis=1)[:, -2:].T.astype(np.float64)
    best = np.maximum(best, 1e-3)
    return np.stack([np.log(best), 1.0 - np.maximum(second, 0.0) / best], axis=1)


def label_take(
    labeller: TakeLabeller, motion: PosedMotion, *, threshold: float | None = None, n_jobs: int | None = None
) -> Timeline:
    """Label a take from beginning to end.

    Parameters
    ----------
    labeller : what was learned.
    motion : of any length and frame rate.
    threshold : confidence from which a category is said, 0 to 1; None for the labeller's own. With 0 nothing is
        unknown.
    n_jobs : threads; None for one. The result does not depend on it.

    Raises
    ------
    OptionError : a threshold outside 0 to 1.
    InvalidMotionError : another shape than (n, 20, 3), positions that are not finite, no body height.
    """
    from dousa.retrieval.features.channels import sample_positions

    limit = labeller.threshold if threshold is None else threshold
    if not 0 <= limit <= 1:
        raise OptionError("labeller.threshold", found=limit)
    points = check_motion(motion)
    sampled = sample_positions(points, motion.frame_rate)
    shares = labeller.judge(sampled, motion.height, n_jobs)
    chosen = labeller.choose(shares, len(sampled), never_unknown=limit == 0)
    chosen = count_all(chosen, sampled, motion.height, labeller.usual)
    sure = labeller.confidence(np.stack([one.scores for one in chosen])) if chosen else np.zeros(0)
    return make_timeline(chosen, sure, labeller.classes, len(points) / motion.frame_rate, limit)


def make_timeline(
    chosen: Sequence[Chosen], sure: FloatArray, classes: Sequence[str], duration: float, threshold: float
) -> Timeline:
    """Segments without gaps from chosen windows and how sure each is."""
    n_frames = duration * TAKE_RATE
    spans = _share_gaps([(float(one.start), float(one.stop)) for one in chosen], n_frames)
    parts: list[Segment] = []
    reached = 0.0
    for one, (start, stop), confidence in zip(chosen, spans, sure, strict=True):
        if start > reached:
            parts.append(Segment(reached / TAKE_RATE, start / TAKE_RATE, None, 1.0))
        known = bool(confidence >= threshold)
        category, sureness = (
            classes[one.category] if known else None,
            confidence if known else 1.0 - confidence,
        )
        often = one.repetitions if known else 1
        parts.append(Segment(start / TAKE_RATE, stop / TAKE_RATE, category, float(sureness), often))
        reached = stop
    if reached < n_frames:
        parts.append(Segment(reached / TAKE_RATE, duration, None, 1.0))
    return Timeline(_merge_unknown(parts), duration, threshold)


def _share_gaps(spans: list[tuple[float, float]], n_frames: float) -> list[tuple[float, float]]:
    """Overlaps and short gaps between neighbours end in the middle; short gaps at the ends go to the outermost."""
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
    """Neighbouring stretches that are unknown become one, as sure as their mean over time."""
    merged: list[Segment] = []
    for part in parts:
        before = merged[-1] if merged else None
        if before is not None and before.category is None and part.category is None:
            sure, more = (each.confidence * (each.stop - each.start) for each in (before, part))
            mean = (sure + more) / (part.stop - before.start)
            merged[-1] = Segment(before.start, part.stop, None, mean)
        else:
            merged.append(part)
    return tuple(merged)
