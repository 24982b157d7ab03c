"""A recording of several repetitions against its reference: each graded and measured, and how they develop."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError
from dousa.evaluation.errors.faults import WELL, DescribedRepetition, Fault, describe_repetition, find_faults
from dousa.evaluation.exercises.split import Repetition, find_reference_repetitions, find_repetitions
from dousa.evaluation.exercises.trends import Trend, adjust_for_many, estimate_trend
from dousa.evaluation.figures.furi import Furi, find_furi
from dousa.evaluation.grade.assessment import check_seen, check_takes, compute_all_postures, is_single, judge
from dousa.evaluation.grade.references import ReferenceTakes, prepare_references
from dousa.evaluation.grade.result import Assessment, name_joints
from dousa.evaluation.grade.score import find_well
from dousa.evaluation.posture.posture import PostureSequence, compute_postures, spread_weights
from dousa.evaluation.posture.range_of_motion import (
    ANGLES,
    MOVING_DEG,
    PAIRED_ANGLES,
    RangeOfMotion,
    compute_joint_angles,
    compute_symmetry_index,
    measure_ranges,
)
from dousa.files.json_values import round_number
from dousa.messages import Message
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.canonicalise import mirror_canonical
from dousa.notebooks import Tabular, short_repr

_NAN = float("nan")
FEWEST_FOR_TREND = 6
"""Complete repetitions: of fewer no order is improbable enough for so many measures, by definition of the test."""


@dataclass(frozen=True, slots=True, eq=False)
class AssessedRepetition:
    """One repetition, measured.

    Parameters
    ----------
    repetition : where it is, and whether it is complete.
    tempo : seconds per second of the reference's: 1.2 is slower by a fifth; nan if incomplete.
    score : 0 to 100, `dousa.evaluation.assess` of this repetition alone; nan if incomplete or too short to grade.
    ranges : of all joint angles.
    symmetry : angle of both sides -> symmetry index, percent, see `compute_symmetry_index`; only angles that move on
        both sides in the reference.
    pause_s : from its end to the beginning of the next one; nan for the last.
    assessment : what the grade comes from, its times counted from ``first_s``; None without a grade.
    first_s : s of the recording at which what was graded begins: a moment before the repetition.
    faults : what was wrong, the worst joint first; it stands alone where people who do it well differ by as much.
    """

    repetition: Repetition
    tempo: float
    score: float
    ranges: tuple[RangeOfMotion, ...]
    symmetry: Mapping[str, float]
    pause_s: float
    assessment: Assessment | None = None
    first_s: float = _NAN
    faults: tuple[Fault, ...] = ()

    def get_range(self, angle: str) -> RangeOfMotion:
        """The range of one angle of `ANGLES`."""
        return self.ranges[ANGLES.index(angle)]


@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class RepetitionsAssessment(Tabular):
    """How the repetitions of an exercise went.

    Parameters
    ----------
    repetitions : in order of time; incomplete ones are not graded and do not count.
    angles : joint angles that move in the exercise, by the reference, in the order of `ANGLES`.
    reference_ranges : angle -> range of the reference in degrees, median of its repetitions.
    reference_s : duration of a repetition of the reference, median.
    n_references : repetitions of the reference.
    trends : measure -> trend over the complete repetitions: ``duration_s``, ``score``, ``pause_s``,
        ``extent``, an angle's range in degrees, ``symmetry_...`` of an angle of both sides.
    frame_rate : Hz, of the performance.
    duration_s : of the performance.
    side : ``"mirrored"`` if left and right are the reference's.
    warnings : what a person should know.
    tempo : ``"free"``: being slower than the reference costs nothing; ``"same"``: it does.
    """

    _rows: ClassVar[str] = "repetitions"

    repetitions: tuple[AssessedRepetition, ...]
    angles: tuple[str, ...]
    reference_ranges: Mapping[str, float]
    reference_s: float
    n_references: int
    trends: Mapping[str, Trend]
    frame_rate: float
    duration_s: float
    side: str = "same"
    warnings: tuple[Message, ...] = ()
    tempo: str = "free"

    @property
    def complete(self) -> tuple[AssessedRepetition, ...]:
        """Those that count."""
        return tuple(one for one in self.repetitions if one.repetition.complete)

    @property
    def count(self) -> int:
        """How many count."""
        return len(self.complete)

    def to_json(self, language: str | None = None) -> dict[str, Any]:
        """The answer of ``dousa evaluate --repetitions --json``; what has no value is None."""
        return {
            "count": self.count,
            "n_incomplete": len(self.repetitions) - self.count,
            "repetitions": [_describe(one, number, language) for number, one in enumerate(self.repetitions, 1)],
            "angles": list(self.angles),
            "reference_range_deg": {name: round_number(value, 1) for name, value in self.reference_ranges.items()},
            "reference_s": round_number(self.reference_s, 3),
            "n_references": self.n_references,
            "trends": {
                name: {
                    "slope": round_number(trend.slope, 4),
                    "p_value": round_number(trend.p_value, 4),
                    "adjusted_p": round_number(trend.adjusted_p, 4),
                    "distinguishable": trend.distinguishable,
                    "n": trend.n,
                }
                for name, trend in self.trends.items()
            },
            "frame_rate": round_number(self.frame_rate, 6),
            "duration_s": round_number(self.duration_s, 3),
            "side": self.side,
            "tempo": self.tempo,
            "warnings": [message.render(language) for message in self.warnings],
            "warning_codes": [message.code for message in self.warnings],
        }


def assess_repetitions(
    references: CanonicalMotion | Sequence[CanonicalMotion],
    performance: CanonicalMotion,
    *,
    side: str = "auto",
    tempo: str = "free",
    weights: Mapping[str, float] | None = None,
) -> RepetitionsAssessment:
    """Split a recording into repetitions and measure each against the reference.

    Parameters
    ----------
    references : the exercise done well: one take or several, each of one or several repetitions.
    performance : any frame rate, place, heading and stature; pauses, and walking into place, may come with it.
    side : ``"mirrored"`` for a person who did the reference's mirror image, ``"same"`` for one who did not; ``"auto"``:
        found by itself, and said.
    tempo : ``"free"``: a repetition may be slower or faster than the reference's; the tempo is beside the grade.
        ``"same"``: being late costs points.
    weights : of segments for the grade, as in `dousa.evaluation.assess`.

    Raises
    ------
    InvalidMotionError : no repetition of the exercise, and no part of one, in the performance, no movement in the
        references, a motion shorter than half a second or hardly seen, no reference.
    OptionError : an unknown side, tempo or segment.
    """
    takes = [references] if isinstance(references, CanonicalMotion) else list(references)
    check_takes(takes, performance, "same" if side == "auto" else side, tempo)
    shares = spread_weights(weights)
    for motion in (*takes, performance):
        check_seen(compute_postures(motion), is_reference=motion is not performance)
    examples = [(take, span) for take in takes for span in find_reference_repetitions(take)]
    if not examples:
        raise InvalidMotionError("exercises.still_reference")
    reference_s = _median([_seconds(take, span) for take, span in examples])
    chosen, played, found = _find_side(performance, takes, side)
    if not found:
        raise InvalidMotionError("exercises.no_repetition", duration=played.duration, reference_s=reference_s)
    models = [_cut(take, *span) for take, span in _choose_examples(examples, reference_s)]
    done = _measure(examples, played, found, chosen, _Grading(models, tempo, shares))
    if chosen in (side, "same"):
        return done
    return dataclasses.replace(done, warnings=(*done.warnings, Message("exercises.mirrored")))


def _find_side(
    performance: CanonicalMotion, takes: Sequence[CanonicalMotion], side: str, *, clearly: float = 0.7
) -> tuple[str, CanonicalMotion, tuple[Repetition, ...]]:
    """The side, the performance as it was mirrored, and its repetitions."""
    # clearly: share of the likeness of the mirror image that the performance itself must have, as in `find_side`
    turned = {"same": performance, "mirrored": mirror_canonical(performance)}
    found = {name: find_repetitions(turned[name], takes) for name in (turned if side == "auto" else (side,))}
    chosen = max(found, key=lambda name: found[name].likeness * (1.0 if name == "same" else clearly))
    return chosen, turned[chosen], found[chosen].repetitions


_Example = tuple[CanonicalMotion, tuple[int, int]]


class _Grading:
    """Grades repetitions, as `assess` does, by the same ones of the reference, which are prepared once."""

    def __init__(self, models: Sequence[CanonicalMotion], tempo: str, weights: FloatArray) -> None:
        self.tempo = tempo
        self._models, self._weights = models, weights
        self._ready: tuple[ReferenceTakes, tuple[Furi, ...]] | None = None
        self.well = WELL  # grade from which on a repetition is done well, as soon as one is graded

    def assess(self, cut: CanonicalMotion) -> Assessment | None:
        """Of one repetition; None for one that is too short, or not seen, to be graded."""
        try:
            postures, played = compute_all_postures(self._models, cut, side="same", tempo=self.tempo)
        except InvalidMotionError:
            return None
        if self._ready is None:
            references = prepare_references(postures, self.tempo, self._weights)
            self._ready = references, find_furi(references.postures)
            self.well = find_well(references, self._weights)
        references, figures = self._ready
        return judge(references, figures, played, tempo=self.tempo, weights=self._weights)


def _measure(
    examples: Sequence[_Example],
    played: CanonicalMotion,
    found: Sequence[Repetition],
    side: str,
    grading: _Grading,
) -> RepetitionsAssessment:
    takes = {id(take): _Measured.of(take) for take, _ in examples}
    good = [(takes[id(take)], span) for take, span in examples]
    expected = _measure_ranges(good)
    models = [take.describe(*span) for take, span in good]
    moving = tuple(name for name in ANGLES if expected[name] >= MOVING_DEG)
    reference_s = _median([_seconds(take, span) for take, span in examples])
    measured = _Measured.of(played)
    pairs = _find_pairs(expected)
    assessed = []
    for number, one in enumerate(found):
        ranges = measured.measure(one.start, one.end, expected)
        graded = grading.assess(_cut(played, one.start, one.end)) if one.complete else None
        score = _NAN if graded is None else float(graded.score)
        faults = find_faults(measured.describe(one.start, one.end), models, len(takes), grade=score, well=grading.well)
        first_s = max(one.start - _count_margin(played), 0) / played.frame_rate
        if graded is not None and is_single(graded, grading.well):
            graded = name_joints(graded, [fault.move(-first_s) for fault in faults])
        assessed.append(
            AssessedRepetition(
                repetition=one,
                tempo=one.duration_s / reference_s if one.complete else _NAN,
                score=score,
                ranges=ranges,
                symmetry={name: _compare_sides(ranges, name) for name in pairs},
                pause_s=found[number + 1].start_s - one.end_s if number + 1 < len(found) else _NAN,
                assessment=graded,
                first_s=first_s,
                faults=faults,
            )
        )
    complete = [one for one in assessed if one.repetition.complete]
    return RepetitionsAssessment(
        repetitions=tuple(assessed),
        angles=moving,
        reference_ranges=expected,
        reference_s=reference_s,
        n_references=len(examples),
        trends=_find_trends(complete, moving, pairs),
        frame_rate=played.frame_rate,
        duration_s=played.duration,
        side=side,
        warnings=_warn(complete),
        tempo=grading.tempo,
    )


def _seconds(motion: CanonicalMotion, span: tuple[int, int]) -> float:
    return (span[1] - span[0]) / motion.frame_rate


def _median(values: Sequence[float]) -> float:
    return float(np.median(np.asarray(values, np.float64)))


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """A recording with its postures and joint angles."""

    motion: CanonicalMotion
    postures: PostureSequence
    angles: Mapping[str, FloatArray]

    @classmethod
    def of(cls, motion: CanonicalMotion) -> _Measured:
        return cls(motion, compute_postures(motion), compute_joint_angles(motion))

    def measure(self, start: int, end: int, expected: Mapping[str, float] = {}) -> tuple[RangeOfMotion, ...]:
        return measure_ranges(self.angles, start, end, self.motion.frame_rate, expected)

    def describe(self, start: int, end: int) -> DescribedRepetition:
        margin = _count_margin(self.motion)
        first, last = max(start - margin, 0), min(end + margin, self.motion.n_frames)
        return describe_repetition(self.postures, self.angles, first, last)


def _measure_ranges(examples: Sequence[tuple[_Measured, tuple[int, int]]]) -> dict[str, float]:
    """Range of every angle, median of the repetitions of the reference, degrees."""
    ranges = [[one.range_deg for one in take.measure(*span)] for take, span in examples]
    return {name: _median(values) for name, values in zip(ANGLES, zip(*ranges, strict=True), strict=True)}


def _choose_examples(examples: Sequence[_Example], typical_s: float, *, most_takes: int = 5) -> list[_Example]:
    """At most five, the one of the most typical duration first: it leads."""
    # most_takes: repetitions of the reference that a grade rests on
    ordered = sorted(examples, key=lambda one: abs(_seconds(*one) - typical_s))
    return ordered[:most_takes]


def _cut(motion: CanonicalMotion, start: int, end: int) -> CanonicalMotion:
    """A span of a motion and a moment around it."""
    margin = _count_margin(motion)
    first, last = max(start - margin, 0), min(end + margin, motion.n_frames)
    missing = None if motion.missing is None else motion.missing[first:last]
    return dataclasses.replace(motion, positions=motion.positions[first:last], missing=missing)


def _count_margin(motion: CanonicalMotion, *, margin_s: float = 0.25) -> int:
    # margin_s: kept around a repetition that is graded
    return round(margin_s * motion.frame_rate)


def _find_pairs(expected: Mapping[str, float], *, one_sided: float = 60.0) -> tuple[str, ...]:
    """Angles that move on both sides in the reference, about equally far."""
    # one_sided: percent: a reference whose symmetry index is beyond is an exercise of one side
    pairs = []
    for name in PAIRED_ANGLES:
        left, right = expected[f"left_{name}"], expected[f"right_{name}"]
        if min(left, right) >= MOVING_DEG and abs(compute_symmetry_index(left, right)) <= one_sided:
            pairs.append(name)
    return tuple(pairs)


def _compare_sides(ranges: Sequence[RangeOfMotion], name: str) -> float:
    left, right = (ranges[ANGLES.index(f"{side}_{name}")].range_deg for side in ("left", "right"))
    return compute_symmetry_index(left, right)


def _find_trends(
    complete: Sequence[AssessedRepetition], moving: Sequence[str], pairs: Sequence[str]
) -> dict[str, Trend]:
    measures: dict[str, list[float]] = {
        "duration_s": [one.repetition.duration_s for one in complete],
        "score": [one.score for one in complete],
        "pause_s": [one.pause_s for one in complete[:-1]],
        "extent": [one.repetition.extent for one in complete],
    }
    measures |= {name: [one.get_range(name).range_deg for one in complete] for name in moving}
    measures |= {f"symmetry_{name}": [abs(one.symmetry[name]) for one in complete] for name in pairs}
    return adjust_for_many({name: estimate_trend(values) for name, values in measures.items()})


def _warn(complete: Sequence[AssessedRepetition]) -> tuple[Message, ...]:
    warnings = []
    if 1 < len(complete) < FEWEST_FOR_TREND:  # nobody asks one repetition for a trend
        warnings.append(Message("exercises.few", n=len(complete)))
    ungraded = sum(not math.isfinite(one.score) for one in complete)
    if ungraded:
        warnings.append(Message("exercises.ungraded", n=ungraded))
    return tuple(warnings)


def _describe(one: AssessedRepetition, number: int, language: str | None) -> dict[str, Any]:
    return {
        "number": number,
        "complete": one.repetition.complete,
        "start_s": round_number(one.repetition.start_s, 3),
        "end_s": round_number(one.repetition.end_s, 3),
        "duration_s": round_number(one.repetition.duration_s, 3),
        "pause_s": round_number(one.pause_s, 3),
        "extent": round_number(one.repetition.extent, 3),
        "tempo": round_number(one.tempo, 3),
        "score": round_number(one.score, 1),
        "range_deg": {ranged.angle: round_number(ranged.range_deg, 1) for ranged in one.ranges},
        "least_deg": {ranged.angle: round_number(ranged.least_deg, 1) for ranged in one.ranges},
        "most_deg": {ranged.angle: round_number(ranged.most_deg, 1) for ranged in one.ranges},
        "range_percent": {
            ranged.angle: round_number(ranged.percent, 1) for ranged in one.ranges if math.isfinite(ranged.percent)
        },
        "faults": [fault.to_json(language) for fault in one.faults],
        "symmetry_percent": {name: round_number(value, 1) for name, value in one.symmetry.items()},
    }
