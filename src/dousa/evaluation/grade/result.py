"""What an assessment is made of: errors, figures and the whole, and how it is written as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.errors.lapses import Lapse
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.posture.posture import SEGMENTS, PostureSequence
from dousa.evaluation.words import date, describe_event
from dousa.files.json_values import round_number, to_json_value
from dousa.messages import Message

# Digits after the point: a millisecond, a tenth of a degree; finer than anything that was measured.
_SECONDS, _DEGREES, _SHARES = 3, 1, 4


@dataclass(frozen=True, slots=True)
class ErrorEvent:
    """One error of the performance.

    Parameters
    ----------
    kind : ``"global"``, ``"partial"``, ``"incomplete"`` or ``"shift"``.
    start_s, end_s : in the performance's own seconds.
    segments : names of the segments that are wrong; all nine for an error of the whole body.
    lag_ms : how late (positive) or early (negative), of a shift.
    shortfall_deg, shortfall_percent : how much of the range of motion is missing, of an incomplete motion; negative
        for a limb (a partial error) that goes further than the reference.
    severity : size in multiples of what is tolerated, 1 or above.
    worst_s : moment of the largest deviation, performance seconds.
    reference_s : moment of the reference that belongs to it.
    furi : number of the furi, from 0; None outside all.
    deviation_deg : largest lasting angle of a wrong segment from the reference's at the same time.
    facing_deg : median heading against the reference's while it lasts; positive is turned to the own left.
    """

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None
    shortfall_deg: float | None
    shortfall_percent: float | None
    severity: float
    worst_s: float
    reference_s: float
    furi: int | None
    deviation_deg: float | None = None
    facing_deg: float | None = None

    @property
    def message(self) -> Message:
        """What is wrong: ``"whole body: 180 ms late"``."""
        return describe_event(
            self.kind,
            self.segments,
            lag_ms=self.lag_ms,
            shortfall_deg=self.shortfall_deg,
            shortfall_percent=self.shortfall_percent,
            deviation_deg=self.deviation_deg,
        )

    @property
    def says_in_furi(self) -> Message:
        """What is wrong, and in which furi."""
        if self.furi is None:
            return self.message
        return Message("error_event.in_furi", what=self.message, number=self.furi + 1)

    @property
    def says(self) -> Message:
        """When, what is wrong, and in which furi: ``"0:31.0, whole body: 180 ms late (furi 3)"``."""
        return date(self.says_in_furi, self.start_s)


@dataclass(frozen=True, slots=True, eq=False)
class FuriAssessment:
    """One furi (figure) of the dance and how it went.

    Parameters
    ----------
    start_s, end_s : in the performance's seconds; nan if the performance does not reach it.
    reference_start_s, reference_end_s : in the reference's seconds.
    label : equal furi have the same label and share one eigenspace.
    eigenspace : of the reference.
    gain : (9,) range of each segment as a share of the reference's; nan where the reference hardly moves.
    lag_s : median lag, s; nan if not reached.
    score : 0 to 100.
    """

    start_s: float
    end_s: float
    reference_start_s: float
    reference_end_s: float
    label: str
    eigenspace: Eigenspace
    gain: FloatArray
    lag_s: float
    score: float

    @property
    def n_dims(self) -> int:
        """Dimensions of the eigenspace."""
        return self.eigenspace.n_dims

    @property
    def contribution(self) -> float:
        """Share of the variance that they hold."""
        return self.eigenspace.contribution


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """How a performance differs from its reference: curves over the performance's frames, and events.

    All arrays have one row a frame of the performance; nan where there is nothing to compare (outside the
    reference, gaps).

    Parameters
    ----------
    frame_rate : Hz, of the performance; the reference is resampled to it.
    reference, performance : postures at that rate. The performance is mirrored already, if it was asked for.
    same_time : (T,) s, reference time that belongs to each frame if the tempo is kept (straight line).
    matched_time : (T,) s, reference time that each frame resembles (curve).
    lag : (T,) s, how late the performance is against the straight line; positive is late.
    facing : (T,) rad, heading of the performance against the reference's, its median taken off.
    d_space : (T,) d#, distance from the furi's eigenspace (eq. 10, 11).
    d_within : (T,) d*, distance inside it at the same time (eq. 12-14).
    d_path : (T,) distance to the reference trajectory, any time of the furi: wrong, though in the space.
    d_space_limit, d_within_limit : (T,) what the takes, or a steady performer, keep below. Drawn for orientation:
        the events come from deviations and lags.
    residual : (T, 9) rad, angle between each segment and the reference's at the same time.
    residual_limit : (9,) rad.
    path : (K, 2) frames of performance and reference that correspond, for the picture of the matrix.
    furi : figures in order of the reference.
    events : errors in order of time.
    lapses : in order of time, see `Lapse`.
    score : 0 to 100; nan if it is not the same dance.
    score_formula : how the score came about, with its numbers.
    calibrated : whether the grade rests on three takes of the reference or more.
    n_references : takes of the reference that were used; those left out are not counted.
    tempo : performance seconds per reference second.
    gaps : (start_s, end_s, segment name) of spans that were not seen and not judged.
    warnings : what a person should know before believing the grade.
    side : ``"mirrored"`` if the performance was mirrored first: left and right are the reference's, then.
    coverage : share of the reference's motion that was danced, 0 to 1.
    score_interval : (low, high); four of five takes of one quality are graded in it. nan where the score is.
    weights : (9,) what the segments count in the grade.
    offset_deg : (9,) what was taken off as another body, see `dousa.evaluation.posture.offset`.
    not_judged : names of the segments that could not be compared: one of both bodies lacks them, or holds them in
        another position throughout.
    """

    frame_rate: float
    reference: PostureSequence
    performance: PostureSequence
    same_time: FloatArray
    matched_time: FloatArray
    lag: FloatArray
    facing: FloatArray
    d_space: FloatArray
    d_within: FloatArray
    d_path: FloatArray
    d_space_limit: FloatArray
    d_within_limit: FloatArray
    residual: FloatArray
    residual_limit: FloatArray
    path: IndexArray
    furi: tuple[FuriAssessment, ...]
    events: tuple[ErrorEvent, ...]
    lapses: tuple[Lapse, ...]
    score: float
    score_formula: Message
    calibrated: bool
    n_references: int
    tempo: float
    gaps: tuple[tuple[float, float, str], ...] = ()
    warnings: tuple[Message, ...] = ()
    side: str = "same"
    coverage: float = 1.0
    score_interval: tuple[float, float] = (math.nan, math.nan)
    weights: FloatArray = field(default_factory=lambda: np.ones(len(SEGMENTS)))
    offset_deg: FloatArray = field(default_factory=lambda: np.zeros(len(SEGMENTS)))
    not_judged: tuple[str, ...] = ()

    @property
    def is_other_dance(self) -> bool:
        """Whether it is hardly the same dance: there is no grade, and no praise either."""
        return any(warning.code == "assessment.unlike" for warning in self.warnings)

    @property
    def times(self) -> FloatArray:
        """(T,) s, of the frames of the performance."""
        return np.arange(self.performance.n_frames) / self.frame_rate

    def to_json(self, language: str | None = None) -> dict[str, Any]:
        """The answer of ``dousa evaluate --json``, see `describe_assessment`."""
        return describe_assessment(self, language)


def describe_assessment(assessment: Assessment, language: str | None = None) -> dict[str, Any]:
    """The answer of ``dousa evaluate --json``.

    Parameters
    ----------
    assessment : what `assess` returns.
    language : of the sentences, of `dousa.messages.LANGUAGES`; None for the one in use.

    Returns
    -------
    A dictionary for ``json.dumps``, without nan: what has no value (the times of a furi that the performance
    never reaches, the lag of an error that is no shift) is None. Times are seconds of the performance unless
    the key begins with ``reference``; lags are positive where the performance is late.
    """
    return {
        "score": round_number(assessment.score, 1),
        "calibrated": bool(assessment.calibrated),
        "furi": [_describe_furi(furi) for furi in assessment.furi],
        "events": [_describe(event, _EVENT, language) for event in assessment.events],
        "lag_ms": _summarise_lag(assessment.lag),
        "frame_rate": round_number(assessment.frame_rate, 6),
        "n_references": int(assessment.n_references),
        "score_formula": assessment.score_formula.render(language),
        "side": assessment.side,
        "tempo": round_number(assessment.tempo, _SHARES),
        "facing_deg": _summarise_facing(assessment.facing),
        "lapses": [_describe(lapse, _LAPSE, language) for lapse in assessment.lapses],
        "gaps": [
            {"start_s": round_number(start, _SECONDS), "end_s": round_number(end, _SECONDS), "segment": segment}
            for start, end, segment in assessment.gaps
        ],
        "coverage": round_number(assessment.coverage, 3),
        "not_judged": list(assessment.not_judged),
        "score_interval": [round_number(value, 1) for value in assessment.score_interval],
        "segment_weights": _by_segment(assessment.weights, 2),
        "posture_offsets": _by_segment(assessment.offset_deg, _DEGREES),
        "warnings": [message.render(language) for message in assessment.warnings],
        "warning_codes": [message.code for message in assessment.warnings],
    }


# What is written of a furi, an error and a lapse, and the digits of its numbers.
_FURI = "start_s end_s n_dims contribution label reference_start_s reference_end_s score"
_EVENT = (
    "kind start_s end_s segments lag_ms shortfall_deg shortfall_percent severity says deviation_deg facing_deg "
    "worst_s reference_s furi"
)
_LAPSE = "kind start_s end_s reference_start_s reference_end_s says"
_DIGITS = {"contribution": _SHARES, "severity": 2}
_DIGITS |= dict.fromkeys(("shortfall_deg", "deviation_deg", "facing_deg"), _DEGREES)
_DIGITS |= dict.fromkeys(("score", "lag_ms", "shortfall_percent"), 1)


def _describe(what: object, names: str, language: str | None = None) -> dict[str, Any]:
    return {name: _write(name, getattr(what, name), language) for name in names.split()}


def _write(name: str, value: Any, language: str | None) -> Any:
    if isinstance(value, Message):
        return value.render(language)
    digits = _SECONDS if name.endswith("_s") else _DIGITS.get(name)
    return to_json_value(value) if digits is None else round_number(value, digits)


def _by_segment(values: FloatArray, digits: int) -> dict[str, float | None]:
    return {name: round_number(value, digits) for name, value in zip(SEGMENTS, values, strict=True)}


def _describe_furi(furi: FuriAssessment) -> dict[str, Any]:
    gain = _by_segment(furi.gain, 3)
    return {**_describe(furi, _FURI), "lag_ms": round_number(1000 * furi.lag_s, 1), "gain": gain}


def _summarise_lag(lag: FloatArray) -> dict[str, float | None]:
    """Of all frames that have one, in ms; the most late and the most early ones are max and min."""
    known = 1000 * np.asarray(lag, np.float64)
    known = known[np.isfinite(known)]
    if not len(known):
        return {"median": None, "mean_abs": None, "max": None, "min": None}
    return {
        "median": round_number(np.median(known), 1),
        "mean_abs": round_number(np.abs(known).mean(), 1),
        "max": round_number(known.max(), 1),
        "min": round_number(known.min(), 1),
    }


def _summarise_facing(facing: FloatArray) -> dict[str, float | None]:
    """Sizes of the facing error, whichever way it goes."""
    sizes = np.degrees(np.abs(np.asarray(facing, np.float64)))
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes):
        return {"median": None, "max": None}
    return {"median": round_number(np.median(sizes), _DEGREES), "max": round_number(sizes.max(), _DEGREES)}
