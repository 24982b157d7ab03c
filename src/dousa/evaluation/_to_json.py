"""An assessment as plain dictionaries, lists, numbers and strings: strict JSON, null where there is no value."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.evaluation.posture import SEGMENTS

if TYPE_CHECKING:
    from dousa.evaluation._types import Assessment, ErrorEvent, FuriAssessment, Lapse
    from dousa.motion._types import FloatArray

__all__ = ["describe_assessment"]

# Digits after the point: a millisecond, a tenth of a degree; finer than anything that was measured.
_SECONDS, _DEGREES, _SHARES = 3, 1, 4


def describe_assessment(assessment: Assessment) -> dict[str, Any]:
    """The answer of ``dousa evaluate --json``.

    Parameters
    ----------
    assessment : what `assess` returns.

    Returns
    -------
    A dictionary for ``json.dumps``, without nan: what has no value (the times of a furi that the performance
    never reaches, the lag of an error that is no shift) is None. Times are seconds of the performance unless
    the key begins with ``reference``; lags are positive where the performance is late.
    """
    return {
        "score": _number(assessment.score, 1),
        "calibrated": bool(assessment.calibrated),
        "furi": [_describe_furi(furi) for furi in assessment.furi],
        "events": [_describe_event(event) for event in assessment.events],
        "lag_ms": _summarise_lag(assessment.lag),
        "frame_rate": _number(assessment.frame_rate, 6),
        "n_references": int(assessment.n_references),
        "score_formula": assessment.score_formula,
        "side": assessment.side,
        "tempo": _number(assessment.tempo, _SHARES),
        "facing_deg": _summarise_facing(assessment.facing),
        "lapses": [_describe_lapse(lapse) for lapse in assessment.lapses],
        "gaps": [
            {"start_s": _number(start, _SECONDS), "end_s": _number(end, _SECONDS), "segment": segment}
            for start, end, segment in assessment.gaps
        ],
        "warnings": list(assessment.warnings),
    }


def _describe_furi(furi: FuriAssessment) -> dict[str, Any]:
    return {
        "start_s": _number(furi.start_s, _SECONDS),
        "end_s": _number(furi.end_s, _SECONDS),
        "n_dims": int(furi.n_dims),
        "contribution": _number(furi.contribution, _SHARES),
        "label": furi.label,
        "reference_start_s": _number(furi.reference_start_s, _SECONDS),
        "reference_end_s": _number(furi.reference_end_s, _SECONDS),
        "score": _number(furi.score, 1),
        "lag_ms": _number(1000 * furi.lag_s, 1),
        "gain": {name: _number(gain, 3) for name, gain in zip(SEGMENTS, furi.gain, strict=True)},
    }


def _describe_event(event: ErrorEvent) -> dict[str, Any]:
    return {
        "kind": event.kind,
        "start_s": _number(event.start_s, _SECONDS),
        "end_s": _number(event.end_s, _SECONDS),
        "segments": list(event.segments),
        "lag_ms": _number(event.lag_ms, 1),
        "shortfall_deg": _number(event.shortfall_deg, _DEGREES),
        "shortfall_percent": _number(event.shortfall_percent, 1),
        "severity": _number(event.severity, 2),
        "says": event.says,
        "deviation_deg": _number(event.deviation_deg, _DEGREES),
        "facing_deg": _number(event.facing_deg, _DEGREES),
        "worst_s": _number(event.worst_s, _SECONDS),
        "reference_s": _number(event.reference_s, _SECONDS),
        "furi": None if event.furi is None else int(event.furi),
    }


def _describe_lapse(lapse: Lapse) -> dict[str, Any]:
    return {
        "kind": lapse.kind,
        "start_s": _number(lapse.start_s, _SECONDS),
        "end_s": _number(lapse.end_s, _SECONDS),
        "reference_start_s": _number(lapse.reference_start_s, _SECONDS),
        "reference_end_s": _number(lapse.reference_end_s, _SECONDS),
        "says": lapse.says,
    }


def _summarise_lag(lag: FloatArray) -> dict[str, float | None]:
    """Of all frames that have one, in ms; the most late and the most early ones are max and min."""
    known = 1000 * np.asarray(lag, np.float64)
    known = known[np.isfinite(known)]
    if not len(known):
        return {"median": None, "mean_abs": None, "max": None, "min": None}
    return {
        "median": _number(np.median(known), 1),
        "mean_abs": _number(np.abs(known).mean(), 1),
        "max": _number(known.max(), 1),
        "min": _number(known.min(), 1),
    }


def _summarise_facing(facing: FloatArray) -> dict[str, float | None]:
    """Sizes of the facing error, whichever way it goes."""
    sizes = np.degrees(np.abs(np.asarray(facing, np.float64)))
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes):
        return {"median": None, "max": None}
    return {"median": _number(np.median(sizes), _DEGREES), "max": _number(sizes.max(), _DEGREES)}


def _number(value: float | None, digits: int) -> float | None:
    """Rounded; None for what is no finite number, and never -0.0."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), digits) + 0.0
