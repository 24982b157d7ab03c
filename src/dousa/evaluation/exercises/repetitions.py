"""A recording of several repetitions against its reference: each graded and measured, with trends and a summary."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError
from dousa.evaluation.exercises.range_of_motion import (
    ANGLE_NAMES,
    ANGLES,
    MOVING_DEG,
    PAIRED_ANGLES,
    RangeOfMotion,
    compute_joint_angles,
    compute_symmetry_index,
    measure_ranges,
)
from dousa.evaluation.exercises.split import Repetition, find_reference_repetitions, find_repetitions
from dousa.evaluation.figures.furi import Furi, find_furi
from dousa.evaluation.grade.assessment import check_importance, check_seen, check_takes, compute_all_postures, judge
from dousa.evaluation.grade.references import ReferenceTakes, prepare_references
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.posture.posture import compute_postures, spread_weights
from dousa.files.json_values import round_number
from dousa.messages import Message
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.canonicalise import mirror_canonical

LEVEL = 0.05
"""Two-sided probability below which a trend is called distinguishable from none: the convention of R. A. Fisher,
"Statistical Methods for Research Workers", 1925."""


@dataclass(frozen=True, slots=True)
class Trend:
    """How one measure changes over the repetitions."""

    slope: float  # per repetition, in the unit of the measure; nan with fewer than two values
    p_value: float  # of Mann and Kendall's test against no trend, two-sided; nan with fewer than two values
    n: int  # number of values
    # the same probability where several measures were tested at once, see `adjust_for_many`
    adjusted_p: float = math.nan

    @property
    def distinguishable(self) -> bool:
        """Whether the trend is distinguishable from none; with four repetitions or fewer it never can."""
        return (self.p_value if math.isnan(self.adjusted_p) else self.adjusted_p) < LEVEL


def estimate_trend(values: ArrayLike) -> Trend:
    """Estimate the median of the slopes between all pairs, and the exact test of it.

    Parameters
    ----------
    values : (N,) of one measure, in order of the repetitions; nan is left out and keeps its place.

    Source: P. K. Sen, "Estimates of the regression coefficient based on Kendall's tau", J. American Statistical
    Association 63, 1379-1389, 1968; H. B. Mann, "Nonparametric tests against trend", Econometrica 13, 245-259, 1945.
    """
    array = np.asarray(values, np.float64)
    places = np.flatnonzero(np.isfinite(array))
    if len(places) < 2:
        return Trend(math.nan, math.nan, len(places))
    pairs = [(array[j] - array[i], j - i) for i, j in itertools.combinations(places.tolist(), 2)]
    slope = float(np.median([rise / run for rise, run in pairs]))
    score = int(sum(np.sign(rise) for rise, _ in pairs))
    return Trend(slope, _compute_p_value(score, array[places]), len(places))


def adjust_for_many(trends: Mapping[str, Trend]) -> dict[str, Trend]:
    """Adjust the probabilities of trends to the number of measures: one chance finding in twenty recordings.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian J. Statistics 6, 65-70,
    1979.
    """
    tested = sorted((name for name in trends if not math.isnan(trends[name].p_value)), key=lambda n: trends[n].p_value)
    adjusted, reached = dict(trends), 0.0
    for place, name in enumerate(tested):
        reached = max(reached, min(1.0, (len(tested) - place) * trends[name].p_value))
        adjusted[name] = dataclasses.replace(trends[name], adjusted_p=reached)
    return adjusted


def _compute_p_value(score: int, values: np.ndarray, *, exact_up_to: int = 40) -> float:
    # exact_up_to: values without ties; of more, and with ties, the normal approximation
    n = len(values)
    ties = np.unique(values, return_counts=True)[1]
    if n <= exact_up_to and ties.max() == 1:
        counts = _count_orders(n)
        total = math.factorial(n)
        most = n * (n - 1) // 2
        # A score of most - 2 d has d pairs out of order.
        tail = sum(counts[: (most - abs(score)) // 2 + 1])
        return min(1.0, 2.0 * tail / total)
    variance = (n * (n - 1) * (2 * n + 5) - float((ties * (ties - 1) * (2 * ties + 5)).sum())) / 18.0
    if variance <= 0:
        return 1.0
    return math.erfc(max(abs(score) - 1, 0) / math.sqrt(2.0 * variance))


@lru_cache
def _count_orders(n: int) -> tuple[int, ...]:
    """Number of orders of n values by how many pairs are out of order."""
    counts = [1]
    for size in range(2, n + 1):
        wider = [0] * (len(counts) + size - 1)
        for place, count in enumerate(counts):
            for more in range(size):
                wider[place + more] += count
        counts = wider
    return tuple(counts)


_NAN = float("nan")


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
    """

    repetition: Repetition
    tempo: float
    score: float
    ranges: tuple[RangeOfMotion, ...]
    symmetry: Mapping[str, float]
    pause_s: float
    assessment: Assessment | None = None
    first_s: float = _NAN

    def get_range(self, angle: str) -> RangeOfMotion:
        """The range of one angle of `ANGLES`."""
        return self.ranges[ANGLES.index(angle)]


@dataclass(frozen=True, slots=True, eq=False)
class RepetitionsAssessment:
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
            "repetitions": [_describe(one, number) for number, one in enumerate(self.repetitions, 1)],
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
    side: str = "same",
    tempo: str = "free",
    weights: Mapping[str, float] | None = None,
    importance: str = "learned",
) -> RepetitionsAssessment:
    """Split a recording into repetitions and measure each against the reference.

    Parameters
    ----------
    references : the exercise done well: one take or several, each of one or several repetitions.
    performance : any frame rate, place, heading and stature; pauses, and walking into place, may come with it.
    side : ``"mirrored"`` for a person who did the reference's mirror image.
    tempo : ``"free"``: a repetition may be slower or faster than the reference's; the tempo is beside the grade.
        ``"same"``: being late costs points.
    weights, importance : of segments for the grade, as in `dousa.evaluation.assess`.

    Raises
    ------
    InvalidMotionError : no repetition of the exercise in the performance, no movement in the references, a motion
        shorter than half a second or hardly seen, no reference.
    OptionError : an unknown side, tempo, importance or segment.
    """
    takes = [references] if isinstance(references, CanonicalMotion) else list(references)
    check_takes(takes, performance, side, tempo)
    check_importance(importance)
    shares = spread_weights(weights)
    for motion in (*takes, performance):
        check_seen(compute_postures(motion), is_reference=motion is not performance)
    played = mirror_canonical(performance) if side == "mirrored" else performance
    examples = [(take, span) for take in takes for span in find_reference_repetitions(take)]
    if not examples:
        raise InvalidMotionError("exercises.still_reference")
    reference_s = _median([_seconds(take, span) for take, span in examples])
    found = find_repetitions(played, takes).repetitions
    if not any(one.complete for one in found):
        raise InvalidMotionError(
            "exercises.no_repetition",
            duration=played.duration,
            reference_s=reference_s,
            n_incomplete=len(found),
        )
    models = [_cut(take, *span) for take, span in _choose_examples(examples, reference_s)]
    return _measure(examples, played, found, side, _Grading(models, tempo, shares, importance))


_Example = tuple[CanonicalMotion, tuple[int, int]]


class _Grading:
    """Grades repetitions, as `assess` does, by the same ones of the reference, which are prepared once."""

    def __init__(self, models: Sequence[CanonicalMotion], tempo: str, weights: FloatArray, importance: str) -> None:
        self.tempo = tempo
        self._models, self._weights, self._importance = models, weights, importance
        self._ready: tuple[ReferenceTakes, tuple[Furi, ...]] | None = None

    def assess(self, cut: CanonicalMotion) -> Assessment | None:
        """Of one repetition; None for one that is too short, or not seen, to be graded."""
        try:
            postures, played = compute_all_postures(self._models, cut, side="same", tempo=self.tempo)
        except InvalidMotionError:
            return None
        if self._ready is None:
            references = prepare_references(postures, self.tempo, self._weights, importance=self._importance)
            self._ready = references, find_furi(references.postures)
        references, figures = self._ready
        return judge(references, figures, played, tempo=self.tempo, weights=self._weights)


def _measure(
    examples: Sequence[_Example],
    played: CanonicalMotion,
    found: Sequence[Repetition],
    side: str,
    grading: _Grading,
) -> RepetitionsAssessment:
    expected = _measure_examples(examples)
    moving = tuple(name for name in ANGLES if expected[name] >= MOVING_DEG)
    reference_s = _median([_seconds(take, span) for take, span in examples])
    angles = compute_joint_angles(played)
    pairs = _find_pairs(expected)
    assessed = []
    for number, one in enumerate(found):
        ranges = measure_ranges(angles, one.start, one.end, played.frame_rate, expected)
        graded = grading.assess(_cut(played, one.start, one.end)) if one.complete else None
        assessed.append(
            AssessedRepetition(
                repetition=one,
                tempo=one.duration_s / reference_s if one.complete else _NAN,
                score=_NAN if graded is None else float(graded.score),
                ranges=ranges,
                symmetry={name: _compare_sides(ranges, name) for name in pairs},
                pause_s=found[number + 1].start_s - one.end_s if number + 1 < len(found) else _NAN,
                assessment=graded,
                first_s=max(one.start - _count_margin(played), 0) / played.frame_rate,
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


def _measure_examples(examples: Sequence[_Example]) -> dict[str, float]:
    """Range of every angle, median of the repetitions of the reference, degrees."""
    angles = {id(take): compute_joint_angles(take) for take in {id(take): take for take, _ in examples}.values()}
    found: dict[str, list[float]] = {name: [] for name in ANGLES}
    for take, (start, end) in examples:
        for one in measure_ranges(angles[id(take)], start, end, take.frame_rate):
            found[one.angle].append(one.range_deg)
    return {name: _median(values) for name, values in found.items()}


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


def _warn(complete: Sequence[AssessedRepetition], *, fewest_for_trend: int = 6) -> tuple[Message, ...]:
    # fewest_for_trend: complete repetitions: of fewer, no order is improbable enough for so many measures
    warnings = []
    if len(complete) < fewest_for_trend:
        warnings.append(Message("exercises.few", n=len(complete)))
    ungraded = sum(not math.isfinite(one.score) for one in complete)
    if ungraded:
        warnings.append(Message("exercises.ungraded", n=ungraded))
    return tuple(warnings)


def _describe(one: AssessedRepetition, number: int) -> dict[str, Any]:
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
        "symmetry_percent": {name: round_number(value, 1) for name, value in one.symmetry.items()},
    }


PAIR_NAMES: Mapping[str, Message] = {name: Message(f"exercise_table.{name}") for name in PAIRED_ANGLES}
"""Angle of both sides -> its name."""

SHORT, FAR = 85.0, 120.0
"""Percent of the reference's range: a joint that goes less far, or further, is reported."""
_SLOWER, _FASTER = 1.2, 1 / 1.2  # of the reference's duration
_MOST_ANGLES = 4  # that a table has room for


def choose_angles(assessment: RepetitionsAssessment, most: int = _MOST_ANGLES) -> tuple[str, ...]:
    """Choose the joint angles that move most in the reference, in the order of `ANGLES`: one of each joint.

    A shoulder that is raised has an elevation, a flexion and an abduction; the one that moves most stands for it, the
    same on both sides.
    """
    ranges = {name: value if math.isfinite(value) else 0.0 for name, value in assessment.reference_ranges.items()}
    kinds: dict[str, tuple[float, str]] = {}
    for name in ANGLES:
        kind = _drop_side(name)
        joint = kind.split("_")[0]
        kinds[joint] = max(kinds.get(joint, (-1.0, "")), (ranges[name], kind))
    chosen = {kind for _, kind in kinds.values()}
    mine = [name for name in ANGLES if _drop_side(name) in chosen]
    moving = [name for name in mine if name in assessment.angles] or mine[:1]
    kept = sorted(moving, key=lambda name: -ranges[name])[:most]
    return tuple(name for name in ANGLES if name in kept)


def choose_pair(assessment: RepetitionsAssessment) -> str | None:
    """Choose the angle of both sides that moves most in the reference; None if no angle moves on both."""
    pairs = [name for name in PAIRED_ANGLES if assessment.complete and name in assessment.complete[0].symmetry]
    return max(pairs, key=lambda name: assessment.reference_ranges[f"left_{name}"], default=None)


def describe_exercise(assessment: RepetitionsAssessment) -> tuple[Message, ...]:
    """Describe the repetitions, the most important first; at least one must be complete.

    Returns the grade; what was broken off; the joints that go less than `SHORT` or more than `FAR` percent as far as in
    the reference in the median; tempo and sides where they are clearly different. See `describe_trends` for trends.
    """
    said = [*_say_grade(assessment), *_say_broken_off(assessment), *_say_ranges(assessment)]
    return (*said, *_say_tempo(assessment), *_say_sides(assessment))


def describe_trends(assessment: RepetitionsAssessment, *, uneven_change: float = 0.5) -> tuple[Message, ...]:
    """Describe the trends that are distinguishable from chance, or say that there are none.

    Of the joints those of `choose_angles` and `choose_pair`; all others are in ``assessment.trends``.
    """
    # uneven_change: percent a repetition: a slower change of the sides is of no use
    reported = {"duration_s", "score", "pause_s", "extent", *choose_angles(assessment)}
    pair = choose_pair(assessment)
    uneven = f"symmetry_{pair}"
    found = [
        _say_trend(name, trend)
        for name, trend in assessment.trends.items()
        if trend.distinguishable and (name in reported or (name == uneven and abs(trend.slope) >= uneven_change))
    ]
    return tuple(found) or (Message("exercise_table.no_trend"),)


def compute_median(values: Sequence[float]) -> float:
    """Compute the median of the finite values; nan if there are none."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def _drop_side(angle: str) -> str:
    return angle.removeprefix("left_").removeprefix("right_")


def _say_grade(assessment: RepetitionsAssessment, *, weak: float = 5.0) -> list[Message]:
    # weak: points below the median from which a repetition is named
    graded = [(one.score, number) for number, one in enumerate(assessment.repetitions, 1) if math.isfinite(one.score)]
    if not graded:
        return [Message("exercise_summary.no_grade")]
    scores = [score for score, _ in graded]
    below = compute_median(scores) - min(scores)
    median, low, high = (round_grade(score) for score in (compute_median(scores), min(scores), max(scores)))
    if low == high:
        return [Message("exercise_summary.grade_even", score=median)]
    if below < weak:
        return [Message("exercise_summary.grade", median=median, low=low, high=high)]
    return [Message("exercise_summary.grade_weakest", median=median, low=low, high=high, number=min(graded)[1])]


def _say_broken_off(assessment: RepetitionsAssessment) -> list[Message]:
    broken = [
        (number, 100.0 * one.repetition.extent)
        for number, one in enumerate(assessment.repetitions, 1)
        if not one.repetition.complete
    ]
    if not broken:
        return []
    if len(broken) == 1:
        number, percent = broken[0]
        return [Message("exercise_summary.broken_off", number=number, percent=percent)]
    numbers = [str(number) for number, _ in broken]
    return [Message("exercise_summary.several_broken_off", numbers=numbers, percent=max(one for _, one in broken))]


def _say_ranges(assessment: RepetitionsAssessment) -> list[Message]:
    said = []
    compared = 0
    for name in choose_angles(assessment):
        degrees = compute_median([one.get_range(name).range_deg for one in assessment.complete])
        expected = assessment.reference_ranges[name]
        percent = compute_median([one.get_range(name).percent for one in assessment.complete])
        compared += math.isfinite(percent)
        if percent < SHORT or percent > FAR:
            code = "exercise_summary.short" if percent < SHORT else "exercise_summary.far"
            values = {"degrees": degrees, "expected": expected, "percent": percent}
            said.append(Message(code, angle=ANGLE_NAMES[name], **values))
    if not said and compared:
        return [Message("exercise_summary.full_range", short=SHORT, far=FAR)]
    return said


def _say_tempo(assessment: RepetitionsAssessment) -> list[Message]:
    tempo = compute_median([one.tempo for one in assessment.complete])
    seconds = compute_median([one.repetition.duration_s for one in assessment.complete])
    if tempo >= _SLOWER or tempo <= _FASTER:
        code = "exercise_summary.slower" if tempo >= _SLOWER else "exercise_summary.faster"
        return [Message(code, seconds=seconds, expected=assessment.reference_s)]
    return []


def _say_sides(
    assessment: RepetitionsAssessment, *, unlike_reference: float = 10.0, least_uneven: float = 15.0
) -> list[Message]:
    # least_uneven: percent, symmetry index that is reported
    # unlike_reference: and by how much it must be beyond the reference's own
    pair = choose_pair(assessment)
    if pair is None:
        return []
    uneven = compute_median([one.symmetry[pair] for one in assessment.complete])
    left, right = (assessment.reference_ranges[f"{side}_{pair}"] for side in ("left", "right"))
    own = compute_symmetry_index(left, right)
    if not (abs(uneven) >= least_uneven and abs(uneven - own) >= unlike_reference):
        return []
    code = "exercise_summary.left_further" if uneven > 0 else "exercise_summary.right_further"
    return [Message(code, angle=PAIR_NAMES[pair], percent=abs(uneven))]


def _say_trend(name: str, trend: Trend) -> Message:
    code, slope = "exercise_table.trend_degrees", trend.slope
    if name in ("duration_s", "pause_s"):
        code, what = "exercise_table.trend_seconds", Message(f"exercise_table.measure_{name.removesuffix('_s')}")
    elif name == "score":
        code, what = "exercise_table.trend_points", Message("exercise_table.measure_score")
    elif name == "extent":
        code, what, slope = "exercise_table.trend_percent", Message("exercise_table.measure_extent"), 100 * slope
    elif name.startswith("symmetry_"):
        angle = PAIR_NAMES[name.removeprefix("symmetry_")]
        code, what = "exercise_table.trend_percent", Message("exercise_table.measure_symmetry", angle=angle)
    else:
        what = ANGLE_NAMES[name]
    return Message(code, what=what, slope=slope, p=trend.adjusted_p)
