"""What the plots share: places in percent, round ticks, and labels as text that keeps its size when a plot grows."""

from __future__ import annotations

import math

import numpy as np

from dousa.app.report._svg import element, format_number
from dousa.evaluation.words import format_time
from dousa.motion._types import FloatArray

__all__ = ["choose_ticks", "format_clock", "percent", "robust_top", "time_ticks", "x_labels", "y_labels"]

_CLOCK_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600)


def percent(value: float, low: float, high: float) -> str:
    """Where a value lies between two others, as a CSS length."""
    share = (value - low) / (high - low) if high > low else 0.0
    return f"{format_number(100.0 * min(max(share, 0.0), 1.0), 3)}%"


def choose_ticks(low: float, high: float, count: int = 4) -> tuple[float, ...]:
    """Round numbers from low to high, about so many."""
    span = high - low
    if not math.isfinite(span) or span <= 0:
        return (low,) if math.isfinite(low) else ()
    raw = span / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1, 2, 2.5, 5, 10) if k * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return tuple(k * step for k in range(first, last + 1))


def time_ticks(duration: float, count: int = 10) -> tuple[float, ...]:
    """Round moments from 0 to the duration, s, about so many."""
    step = next((s for s in _CLOCK_STEPS if duration / s <= count), math.ceil(duration / count))
    return tuple(step * k for k in range(math.floor(duration / step + 1e-9) + 1))


def format_clock(seconds: float) -> str:
    """A tick of time: whole seconds without their tenth."""
    text = format_time(seconds)
    return text.removesuffix(".0")


def x_labels(ticks: tuple[float, ...], high: float) -> str:
    """Times below a plot."""
    spans = [
        element("span", {"style": f"left:{percent(tick, 0.0, high)}"}, format_clock(tick)) for tick in ticks
    ]
    return element("div", {"class": "x-labels", "aria-hidden": "true"}, inner="".join(spans))


def y_labels(labels: tuple[tuple[float, str], ...], low: float, high: float) -> str:
    """Labels beside a plot, low at the bottom."""
    spans = [
        element("span", {"style": f"bottom:{percent(value, low, high)}"}, text) for value, text in labels
    ]
    return element("div", {"class": "y-labels", "aria-hidden": "true"}, inner="".join(spans))


def robust_top(*curves: FloatArray, least: float = 0.0) -> float:
    """A top of the axis that shows all finite values."""
    tops = [float(np.max(curve[np.isfinite(curve)])) for curve in curves if np.isfinite(curve).any()]
    return max([least, *(1.08 * top for top in tops)])
