"""The time-series correlation matrix as a picture, with the path that the assessment took through it.

Source: Yamane and Shakunaga, figure 4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dousa.app.report._plots import choose_ticks, format_clock, percent, time_ticks, x_labels, y_labels
from dousa.app.report._png import encode_map, viridis_gradient
from dousa.app.report._svg import Svg, element, format_number, trace
from dousa.evaluation._types import Assessment
from dousa.evaluation.correlation import compute_correlation_matrix
from dousa.motion._types import FloatArray

__all__ = ["draw_matrix"]

_MOST_PIXELS = 560
_MANY_FURI = 30
_UNITS = 1000.0  # of the drawing along each side


def _thin(segments: FloatArray) -> FloatArray:
    step = -(-len(segments) // _MOST_PIXELS)
    return np.ascontiguousarray(segments[step // 2 :: step] if len(segments) > step // 2 else segments)


def draw_matrix(assessment: Assessment, words: Mapping[str, str]) -> str:
    """Performance across, reference up, similarity as colour, with path, straight line and furi cuts."""
    performance, reference = assessment.performance, assessment.reference
    width, height = max(performance.duration, 1e-6), max(reference.duration, 1e-6)
    values = compute_correlation_matrix(_thin(reference.segments), _thin(performance.segments))
    low = min(math.floor(20.0 * float(np.percentile(values, 2.0))) / 20.0, 0.95) if values.size else 0.0
    picture = element(
        "img", {"src": encode_map(np.asarray(values, float)[::-1], low, 1.0), "alt": words["matrix_label"]}
    ).replace("</img>", "")
    plot = element(
        "div", {"class": "matrix-plot"}, inner=picture + _overlay(assessment, width, height, words)
    )
    up = y_labels(tuple((tick, format_clock(tick)) for tick in time_ticks(height, 8)), 0.0, height)
    ramp = element(
        "div", {"class": "ramp", "style": f"background-image:linear-gradient(0deg,{viridis_gradient()})"}
    )
    ticks = tuple((v, format_number(v)) for v in choose_ticks(low, 1.0, 5))
    bar = element("div", {"class": "matrix-bar"}, inner=ramp + y_labels(ticks, low, 1.0))
    ratio = min(max(height / width, 0.4), 1.6)
    return element(
        "div",
        {"class": "matrix", "style": f"--ratio:{format_number(ratio, 3)}"},
        inner=element("div", {"class": "y-title"}, words["matrix_y"])
        + up
        + plot
        + bar
        + x_labels(time_ticks(width, 8), width)
        + element("div", {"class": "x-title"}, words["matrix_x"])
        + element("div", {"class": "bar-title"}, words["matrix_bar"]),
    )


def _overlay(assessment: Assessment, width: float, height: float, words: Mapping[str, str]) -> str:
    svg = Svg(_UNITS, _UNITS, words["matrix_lines"], "", stretched=True)
    # Many lines across would hide the picture: then the cuts are marks at its edge.
    reach = _UNITS if len(assessment.furi) <= _MANY_FURI else 0.03 * _UNITS
    for furi in assessment.furi:
        for seconds in (furi.reference_start_s, furi.reference_end_s):
            if 0.0 < seconds < height - 1e-6:
                y = _UNITS * (1.0 - seconds / height)
                svg.line([(0.0, y), (reach, y)], "cut")
    times = assessment.times
    straight = np.where(
        (assessment.same_time >= 0) & (assessment.same_time <= height), assessment.same_time, np.nan
    )
    path = assessment.path
    step = max(-(-len(path) // 2000), 1)
    curves = [("straight", _thin_pair(times, straight))]
    if len(path):
        rate = assessment.frame_rate
        curves.append(("path", (path[::step, 0] / rate, path[::step, 1] / rate)))
    for css_class, (across, up) in curves:
        data = trace(_UNITS * across / width, _UNITS * (1.0 - up / height))
        if css_class == "path":
            svg.add("path", {"d": data, "class": "path-edge"})
        svg.add("path", {"d": data, "class": css_class})
    cursor = element(
        "i", {"class": "matrix-cursor", "id": "matrix-cursor", "style": f"left:{percent(0, 0, 1)}"}
    )
    return svg.to_markup() + cursor


def _thin_pair(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    step = max(-(-len(x) // 1000), 1)
    return x[::step], y[::step]
