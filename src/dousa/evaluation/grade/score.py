"""The grade: 90 is another take by the same person, 80 the same by another competent person.

The logarithms of `PARTS` are summed, and held against how much moves in the reference; that falls on a curve from 100
to 0, and what is left out takes its share off. The few numbers are measured by lab/training/calibrate_grade.py and lie
in grade.toml.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.errors.faults import AGREE, WELL
from dousa.evaluation.grade.movement import (
    PARTS,
    Difference,
    compare_movements,
    find_agreement,
    find_coverage,
    find_extent,
    find_parts,
    find_seen,
)
from dousa.evaluation.grade.references import ReferenceTakes
from dousa.messages import Message

LEAST_DANCED = 0.1
"""Share of the reference's movement below which there is no grade: a performer who stands, or holds a
pose; measured on UI-PRMD, docs/evaluation.md."""
LEAST_SEEN = 0.5
"""Share of the reference's movement in parts of the body that are seen, below which there is no grade: most of what it
would be about is unknown, by definition."""
_MOSTLY = 1.28  # standard deviations around which four of five lie, by definition of the normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class GradeModel:
    """The numbers of grade.toml."""

    floors: FloatArray  # (5,) of `PARTS`: so little is nothing
    strengths: FloatArray  # (5,) of the logarithms
    curve: FloatArray  # (K, 2) distance and grade, from 100 to 0
    n_references: FloatArray  # (n,) takes of the reference that ``doubt`` is for, ascending
    doubt: FloatArray  # (n,) of the distance, standard deviation between takes of one quality
    unlike: float  # distance from which it is another motion

    def find_distance(self, parts: FloatArray, extent: float) -> float:
        """Distance from the reference, 0 or above; parts (5,), extent of `find_extent`."""
        return float(np.log1p(parts / self.floors) @ self.strengths) / extent

    def find_doubt(self, count: int) -> float:
        """Doubt with so many takes, by 1 / n: the tenth take tells less than the second."""
        return float(np.interp(-1.0 / count, -1.0 / self.n_references, self.doubt))

    def find_grade(self, distance: float) -> float:
        """0 to 100 of a distance."""
        return float(np.interp(distance, self.curve[:, 0], self.curve[:, 1]))


@cache
def load_model() -> GradeModel:
    """Load the model of the package."""
    table = tomllib.loads(files("dousa.evaluation.grade").joinpath("grade.toml").read_text("utf-8"))
    unlike = float(table.pop("unlike"))
    return GradeModel(**{name: np.array(row, np.float64) for name, row in table.items()}, unlike=unlike)


@dataclass(frozen=True, slots=True)
class Grade:
    """A grade and what it is made of."""

    score: float  # 0 to 100; nan if it is not the same dance, or nothing could be compared
    # (low, high), four of five takes of one quality are graded in it; nan where the score is
    interval: tuple[float, float]
    coverage: float  # share of the reference's motion that was danced, 0 to 1
    formula: Message  # how it came about, with its numbers, or why there is none
    calibrated: bool  # whether there are several takes of the reference: three or more


def round_grade(score: float) -> float:
    """Round a grade as every page, report and table shows it: 76.5 to 77; nan stays nan.

    Answers hold grades with one decimal. Rounded from there, a grade that is read from an answer is shown like the one
    that the answer was made of.
    """
    return math.floor(round(score, 1) + 0.5) if math.isfinite(score) else math.nan


def compute_grade(
    parts: FloatArray,
    extent: float,
    coverage: float,
    n_references: int,
    *,
    seen: float = 1.0,
    model: GradeModel | None = None,
    same_length: float = 0.05,
    least: float = 10.0,
) -> Grade:
    """Compute the grade of a performance.

    Parameters
    ----------
    parts : (5,) values of `PARTS`; nan if nothing could be compared.
    extent : how much moves in the reference, of `find_extent`.
    coverage : share of the reference's movement that was danced, 0 to 1.
    n_references : takes of the reference.
    seen : share of the reference's movement in parts that are seen, of `find_seen`.
    model : other numbers than those of the package.
    same_length : share of the reference that may be missing.
    least : grade below which it is another motion.
    """
    calibrated = n_references >= 3
    model = model or load_model()
    distance = model.find_distance(parts, extent)
    danced = min(1.0, coverage + same_length)
    quality = model.find_grade(distance)
    why = None
    if not math.isfinite(distance):
        why = Message("grade.nothing")
    elif seen < LEAST_SEEN:
        why = Message("grade.unseen", percent=100.0 * seen)
    elif coverage < LEAST_DANCED:
        why, coverage = Message("grade.hardly"), 0.0
    elif distance > model.unlike or danced * quality < least:
        why = Message("grade.unlike")
    if why is not None:
        return Grade(math.nan, (math.nan, math.nan), coverage, why, calibrated)
    doubt = _MOSTLY * model.find_doubt(n_references)
    # Rounded, so that rounding errors in angles do not keep the same motion from 100.
    score = round(danced * quality, 3)
    interval = (danced * model.find_grade(distance + doubt), danced * model.find_grade(max(distance - doubt, 0.0)))
    formula = Message(
        "grade.calibrated" if calibrated else "grade.uncalibrated",
        score=round_grade(score),
        quality=round_grade(quality),
        percent=100.0 * danced,
        parts=Message("grade.parts", **dict(zip(PARTS, parts.tolist(), strict=True)), extent=extent),
        takes=n_references,
    )
    return Grade(score, interval, coverage, formula, calibrated)


def grade_performance(
    references: ReferenceTakes,
    differences: Sequence[Difference],
    weights: FloatArray,
    frames: NDArray[np.bool_] | None = None,
) -> Grade:
    """Grade a performance, or some of its working frames (T,): a furi.

    Parameters
    ----------
    references : what is right.
    differences : from each of them.
    weights : (9,) of the segments, those above 0 of mean 1.
    frames : where only a part is graded; what is left out does not count then, nor does the posture.
    """
    parts = find_parts(differences, references.agreement, weights, frames, tempo=references.tempo)
    coverage = find_coverage(differences, weights) if frames is None else 1.0
    extent, seen = find_extent(differences, weights), find_seen(differences, weights)
    return compute_grade(parts, extent, coverage, len(references.working), seen=seen)


def find_well(references: ReferenceTakes, weights: FloatArray) -> float:
    """Find the grade from which on a single movement is done well: `WELL`, or, where that is less, the one that three
    quarters of the takes of the reference get at least from the others (interpolated: a single odd one of three still
    lowers it by half of its distance from the next).

    Parameters
    ----------
    references : one take or several.
    weights : (9,) of the segments, those above 0 of mean 1.
    """
    takes = range(len(references.movements))
    apart = {
        (i, k): compare_movements(references.movements[i], references.movements[k]) for i, k in permutations(takes, 2)
    }
    scores = []
    for k in takes if apart else ():
        others = [i for i in takes if i != k]
        among = replace(references, agreement=find_agreement([apart[pair] for pair in combinations(others, 2)]))
        scores.append(grade_performance(among, [apart[i, k] for i in others], weights).score)
    known = [score for score in scores if math.isfinite(score)]
    return min(WELL, float(np.quantile(known, AGREE))) if known else WELL
