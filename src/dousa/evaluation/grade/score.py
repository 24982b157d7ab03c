"""The grade: 90 is another take by the same person, 80 the same by another competent person.

Each part of `PARTS` is held against what is usual between takes: of the reference where there are some, of people
where there are none. The weighted sum of the logarithms falls on a curve from 100 to 0; what is left out takes its
share off. The few numbers are fitted by lab/training/calibrate_grade.py and lie in grade.toml.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.lines import NO_LIKENESS
from dousa.evaluation.grade.movement import find_coverage
from dousa.evaluation.grade.parts import PARTS
from dousa.evaluation.grade.references import Comparison, ReferenceTakes
from dousa.messages import Message

LEAST_DANCED = 0.1
"""Share of the reference's movement below which there is no grade: a performer who stands, or holds a
pose; measured on lab/exams/exercises."""
_MOSTLY = 1.28  # standard deviations around which four of five lie, by definition of the normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class GradeModel:
    """The numbers of grade.toml."""

    n_references: FloatArray  # (n,) takes of the reference that the rows below are for, ascending
    usual: FloatArray  # (n, 7) of `PARTS`, between takes of one person
    floors: FloatArray  # (7,) added to what is usual: so little is nothing
    strengths: FloatArray  # (7,) of the logarithms
    curve: FloatArray  # (K, 2) sum and grade
    doubt: FloatArray  # (n,) of the sum, standard deviation between takes of one person
    prior_takes: float  # what is usual counts as so many takes
    unlike: float  # deg, mean angle at the best time from which it is another dance
    unlike_mismatch: float  # the same of the mismatch along the lines

    def find_sum(self, parts: FloatArray, takes: FloatArray, n_references: int) -> float:
        """Sum up the distance from the reference, 0 or above; parts (7,) of the performance, takes (n, 7) of others."""
        return float(self.compare_parts(parts, takes, n_references) @ self.strengths)

    def compare_parts(self, parts: FloatArray, takes: FloatArray, n_references: int) -> FloatArray:
        """(7,) logarithms of how many times what is usual each part is."""
        return np.asarray(np.log1p(parts / (self.find_usual(takes, n_references) + self.floors)))

    def find_usual(self, takes: FloatArray, n_references: int) -> FloatArray:
        """(7,) of `PARTS`, what is usual between takes of this reference."""
        people = _interpolate(n_references, self.n_references, self.usual)
        total = self.prior_takes * people + takes.reshape(-1, len(PARTS)).sum(axis=0)
        return np.asarray(total / (self.prior_takes + len(takes)))

    def find_grade(self, total: float) -> float:
        """0 to 100 of a sum."""
        return float(np.interp(total, self.curve[:, 0], self.curve[:, 1]))


def _interpolate(count: int, counts: FloatArray, values: FloatArray) -> FloatArray:
    """Rows between those of some numbers of takes, by 1 / n: the tenth take tells less than the second."""
    place = np.interp(-1.0 / count, -1.0 / counts, np.arange(len(counts)))
    low = min(int(place), len(counts) - 2)
    return np.asarray(values[low] + (place - low) * (values[low + 1] - values[low]))


@cache
def load_model() -> GradeModel:
    """Load the model of the package."""
    table = tomllib.loads(files("dousa.evaluation.grade").joinpath("grade.toml").read_text("utf-8"))
    rows = ("n_references", "usual", "floors", "strengths", "curve", "doubt")
    arrays = {name: np.array(table[name], np.float64) for name in rows}
    numbers = {name: float(table[name]) for name in ("prior_takes", "unlike", "unlike_mismatch")}
    return GradeModel(**arrays, **numbers)  # type: ignore[arg-type]  # each name is of one kind


@dataclass(frozen=True, slots=True)
class Grade:
    """A grade and what it is made of."""

    score: float  # 0 to 100; nan if it is not the same dance, or nothing could be compared
    # (low, high), four of five takes of one quality are graded in it; nan where the score is
    interval: tuple[float, float]
    coverage: float  # share of the reference's motion that was danced, 0 to 1
    formula: Message  # how it came about, with its numbers, or why there is none
    calibrated: bool  # whether takes of the reference tell what is usual: three or more


def round_grade(score: float) -> float:
    """Round a grade as every page, report and table shows it: 76.5 to 77; nan stays nan.

    Answers hold grades with one decimal. Rounded from there, a grade that is read from an answer is shown like the one
    that the answer was made of.
    """
    return math.floor(round(score, 1) + 0.5) if math.isfinite(score) else math.nan


def compute_grade(
    parts: FloatArray,
    coverage: float,
    takes: FloatArray,
    n_references: int,
    *,
    unlike: bool = False,
    hardly: bool = False,
    same_length: float = 0.02,
) -> Grade:
    """Compute the grade of a performance.

    Parameters
    ----------
    parts : (7,) values of `PARTS`; nan if nothing could be compared.
    coverage : share of the reference that was danced, 0 to 1.
    takes : (n, 7) parts of the further takes of the reference, each against the others.
    n_references : takes of the reference.
    unlike : it is not the same dance: no grade.
    hardly : next to nothing of the movement was done: no grade, and nothing was danced.
    same_length : share of the reference that may be missing.
    """
    calibrated = len(takes) >= 2  # further takes tell what is usual
    nothing = float("nan")
    if hardly:
        return Grade(nothing, (nothing, nothing), 0.0, Message("grade.hardly"), calibrated)
    if unlike or not np.isfinite(parts).all():
        why = Message("grade.unlike") if unlike else Message("grade.nothing")
        return Grade(nothing, (nothing, nothing), coverage, why, calibrated)
    model = load_model()
    total = model.find_sum(parts, takes, n_references)
    danced = min(1.0, coverage + same_length)
    doubt = _MOSTLY * float(_interpolate(n_references, model.n_references, model.doubt))
    quality = model.find_grade(total)
    # Rounded, so that rounding errors in angles do not keep the same motion from 100.
    score = round(danced * quality, 3)
    interval = (danced * model.find_grade(total + doubt), danced * model.find_grade(max(total - doubt, 0.0)))
    usual = model.find_usual(takes, n_references)
    values = {
        f"{name}{end}": float(x)
        for end, row in (("", parts), ("_usual", usual))
        for name, x in zip(PARTS, row, strict=True)
    }
    code = "grade.calibrated" if calibrated else "grade.uncalibrated"
    formula = Message(
        code,
        score=round_grade(score),
        quality=round_grade(quality),
        percent=100.0 * danced,
        parts=Message("grade.parts", **values),
        takes=len(takes),
    )
    return Grade(score, interval, coverage, formula, calibrated)


def share_weights(references: ReferenceTakes, weights: FloatArray) -> FloatArray:
    """(9,) what the segments count in the grade, of mean 1 above 0: the user's weights times what matters."""
    shares = weights * references.importance
    return np.asarray(shares / shares[shares > 0.0].mean())


def is_unlike(comparison: Comparison, weights: FloatArray, *, hardly_shown: float = 0.3) -> bool:
    """Whether it is not the same dance.

    Even at the best times hardly any pose is like the reference's, or no line can be followed and next to nothing of
    the reference is shown.
    """
    # hardly_shown: share of the reference
    model = load_model()
    lost = comparison.alignment.mismatch > NO_LIKENESS and comparison.measured.find_coverage(weights) < hardly_shown
    shape = comparison.measured.find_parts(weights)[PARTS.index("shape")]
    return bool(lost or comparison.alignment.mismatch > model.unlike_mismatch or shape > model.unlike)


def grade_performance(
    references: ReferenceTakes,
    comparison: Comparison,
    weights: FloatArray,
    frames: NDArray[np.bool_] | None = None,
) -> Grade:
    """Grade a performance, or some of its working frames (T,): a furi.

    Parameters
    ----------
    references, comparison : what was compared.
    weights : (9,) of `share_weights`.
    frames : where only a part is graded; what is left out does not count then, nor does the range.
    """
    parts = comparison.measured.find_parts(weights, frames)
    coverage = comparison.measured.find_coverage(weights) if frames is None else 1.0
    takes = np.array([one.find_parts(weights) for one in references.measured]).reshape(-1, len(PARTS))
    takes = takes[np.isfinite(takes).all(axis=1)]
    unlike = frames is None and is_unlike(comparison, weights)
    hardly = frames is None and find_coverage(comparison.movement, weights) < LEAST_DANCED
    return compute_grade(parts, coverage, takes, len(references.working), unlike=unlike, hardly=hardly)
