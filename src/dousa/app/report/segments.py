"""Segment by segment: what each counts in the grade, how far it is off, and what was taken off as another body."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping

import numpy as np

from dousa.app.report.markup import element, format_number
from dousa.arrays import FloatArray
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.evaluation.words import SEGMENT_NAMES

_ALIKE = 0.005  # weights that differ by less are shown alike
_BAR_EM = 5.0  # the longest bar
_COLUMNS = ("counts", "off", "over", "limit", "body")


def build_segments(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """A row for each of the nine segments.

    Parameters
    ----------
    assessment : what is shown.
    words : texts of the page.
    language : of the names of segments.
    """
    head = element("th", {"scope": "col"}, words["col_segment"])
    head += "".join(element("th", {"scope": "col"}, words[f"segments_{name}"]) for name in _COLUMNS)
    off, over = _measure(assessment.residual, assessment.residual_limit)
    most = max(float(np.max(assessment.weights)), 1e-9)
    rows = "".join(_row(assessment, k, (off[k], over[k]), most, language) for k in range(len(SEGMENTS)))
    inner = element("caption", {"class": "sr"}, words["segments_title"])
    inner += element("thead", None, inner=element("tr", None, inner=head)) + element("tbody", None, inner=rows)
    table = element("table", {"class": "segment-table"}, inner=inner)
    alike = bool(np.ptp(assessment.weights) < _ALIKE)
    lead = element("p", {"class": "lead"}, words["segments_alike" if alike else "segments_text"])
    return lead + element("div", {"class": "table-wrap", "tabindex": "0"}, inner=table)


def _measure(residual: FloatArray, limit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(9,) deg, the median angle of each segment; and (9,) percent of the time over its limit; nan where unseen."""
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # a segment that was never seen
        off = np.degrees(np.nanmedian(residual, axis=0))
        known = np.isfinite(residual)
        over = 100.0 * np.nanmean(np.where(known, residual > limit, np.nan), axis=0)
    return off, over


def _row(assessment: Assessment, k: int, measured: tuple[float, float], most: float, language: str) -> str:
    weight = float(assessment.weights[k])
    bar = element("i", {"style": f"width:{_BAR_EM * weight / most:.2f}em", "aria-hidden": "true"})
    counts = element("td", {"class": "counts"}, inner=element("span", None, f"× {weight:.2f}") + bar)
    limit = math.degrees(float(assessment.residual_limit[k]))
    texts = (
        _show(measured[0], "°"),
        _show(measured[1], " %"),
        _show(limit, "°"),
        _show(float(assessment.offset_deg[k]), "°", 1),
    )
    name = element("th", {"scope": "row"}, SEGMENT_NAMES[SEGMENTS[k]].render(language))
    return element("tr", None, inner=name + counts + "".join(element("td", None, text) for text in texts))


def _show(value: float, unit: str, decimals: int = 0) -> str:
    return f"{format_number(value, decimals)}{unit}" if math.isfinite(value) else "–"


def build_counts_row(assessment: Assessment, span: int, words: Mapping[str, str]) -> str:
    """A row for a table that has a column for each segment, after so many others: what each counts."""
    name = element("th", {"scope": "row", "colspan": str(span)}, words["segments_counts"])
    cells = "".join(element("td", None, f"× {float(weight):.2f}") for weight in assessment.weights)
    return element("tr", {"class": "counts-row"}, inner=name + cells)
