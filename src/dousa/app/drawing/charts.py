"""Charts: places in percent, round ticks, the colours of a map, and a plot whose labels keep their size."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dousa.app.drawing.markup import Svg, element, format_number, trace
from dousa.arrays import FloatArray
from dousa.evaluation.words import format_time

# s: whole parts of the minute, the hour and the day, by definition of these units.
_CLOCK_STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 86400)


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


def time_ticks(duration: float, count: float = 10) -> tuple[float, ...]:
    """Round moments from 0 to the duration, s, about so many."""
    step = next((s for s in _CLOCK_STEPS if duration / s <= count), math.ceil(duration / count))
    return tuple(step * k for k in range(math.floor(duration / step + 1e-9) + 1))


def format_clock(seconds: float) -> str:
    """A tick of time: whole seconds without their tenth."""
    text = format_time(seconds)
    return text.removesuffix(".0")


def x_labels(ticks: tuple[float, ...], high: float) -> str:
    """Times below a plot."""
    spans = [element("span", {"style": f"left:{percent(tick, 0.0, high)}"}, format_clock(tick)) for tick in ticks]
    return element("div", {"class": "x-labels", "aria-hidden": "true"}, inner=spans)


def y_labels(labels: tuple[tuple[float, str], ...], low: float, high: float) -> str:
    """Labels beside a plot, low at the bottom."""
    spans = [element("span", {"style": f"bottom:{percent(value, low, high)}"}, text) for value, text in labels]
    return element("div", {"class": "y-labels", "aria-hidden": "true"}, inner=spans)


def robust_top(*curves: FloatArray, least: float = 0.0) -> float:
    """A top of the axis that shows all finite values."""
    tops = [float(np.max(curve[np.isfinite(curve)])) for curve in curves if np.isfinite(curve).any()]
    return max([least, *(1.08 * top for top in tops)])


# viridis (Smith and van der Walt, CC0) at 17 even places; between them it is straight enough.
_ANCHORS = (
    "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 "
    "fde725"
).split()
_UNKNOWN = 255  # the last index of a palette of 8 bits (W3C, PNG specification): of what is not known, transparent


@lru_cache(maxsize=1)
def viridis_table() -> NDArray[np.uint8]:
    """(255, 3) uint8, dark to light."""
    anchors = np.array([[int(text[i : i + 2], 16) for i in (0, 2, 4)] for text in _ANCHORS], float)
    places = np.linspace(0, len(anchors) - 1, _UNKNOWN)
    columns = [np.interp(places, np.arange(len(anchors)), anchors[:, k]) for k in range(3)]
    return np.asarray(np.rint(np.stack(columns, axis=1)), np.uint8)


def viridis_gradient() -> str:
    """The stops of a CSS gradient, dark to light."""
    return ", ".join(f"#{text}" for text in _ANCHORS)


def encode_map(values: FloatArray, low: float, high: float) -> str:
    """A matrix as a ``data:`` address of a PNG in viridis.

    Parameters
    ----------
    values : (H, W), first row on top; what is not finite becomes transparent.
    low, high : values of the darkest and the lightest colour.
    """
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-12), 0.0, 1.0)
    indices = np.where(known, np.rint(share * (_UNKNOWN - 1)), _UNKNOWN).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(_encode_png(indices)).decode("ascii")


def _encode_png(indices: np.ndarray) -> bytes:
    """PNG (W3C, third edition) of colour indices (H, W)."""
    height, width = indices.shape
    lines = np.zeros((height, width + 1), np.uint8)  # the first byte of a line names its filter: none
    lines[:, 1:] = indices
    palette = np.vstack([viridis_table(), [[0, 0, 0]]]).astype(np.uint8)
    alpha = bytes([255] * _UNKNOWN + [0])
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)),
        (b"PLTE", palette.tobytes()),
        (b"tRNS", alpha),
        (b"IDAT", zlib.compress(lines.tobytes(), 6)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def thin_curve(times: FloatArray, values: FloatArray, n_points: int = 2000) -> tuple[FloatArray, FloatArray]:
    """At most so many points of a curve, with the least and greatest value of every stretch among them.

    Parameters
    ----------
    times : (T,) s.
    values : (T,); nan where there is none.
    n_points : at most so many points come back, 2 or more.

    Returns
    -------
    Times and values (N,); a stretch without any value is one nan.
    """
    if len(values) <= n_points:
        return times, values
    size = -(-len(values) // (n_points // 2))
    n_bins = -(-len(values) // size)
    padded = np.full(n_bins * size, np.nan)
    padded[: len(values)] = values
    table = padded.reshape(n_bins, size)
    known = np.isfinite(table)
    first = np.where(known, table, np.inf).argmin(axis=1)
    last = np.where(known, table, -np.inf).argmax(axis=1)
    picks = np.sort(np.stack([first, last], axis=1), axis=1) + size * np.arange(n_bins)[:, None]
    keep = np.minimum(picks, len(values) - 1).ravel()
    return times[keep], np.where(np.repeat(known.any(axis=1), 2), values[keep], np.nan)


UNITS = 1000.0  # units of a stretched drawing along each side


class Plot:
    """A plot under construction; everything outside of its ranges is drawn at the edge.

    Parameters
    ----------
    across : (low, high) from left to right.
    up : (low, high) from bottom to top.
    label : for screen readers.
    css_class : of the plot.
    """

    def __init__(self, across: tuple[float, float], up: tuple[float, float], label: str, css_class: str = "") -> None:
        self._across, self._up, self._class = across, up, css_class
        self._svg = Svg(UNITS, UNITS, label, "", stretched=True)
        self._marks: list[str] = []

    def curve(self, x: FloatArray, y: FloatArray, css_class: str) -> None:
        """A line through points (N,) and (N,); what is not finite lifts the pen."""
        (left, right), (low, high) = self._across, self._up
        data = trace(UNITS * (x - left) / max(right - left, 1e-9), UNITS * (1.0 - (y - low) / max(high - low, 1e-9)))
        if data:
            self._svg.add("path", {"d": data, "class": css_class})

    def level(self, value: float, css_class: str) -> None:
        """A line from left to right."""
        if math.isfinite(value):
            place = f"bottom:{percent(value, *self._up)}"
            self._marks.append(element("i", {"class": f"level {css_class}", "style": place, "aria-hidden": "true"}))

    def span(self, start: float, end: float, css_class: str, text: str, **attributes: str) -> None:
        """A band from bottom to top with a word in it; with attributes a button."""
        width = max(min(end, self._across[1]) - max(start, self._across[0]), 0.0)
        place = f"left:{percent(start, *self._across)};width:{percent(width, 0.0, self._across[1] - self._across[0])}"
        tag = {"class": f"repetition-span {css_class}", "style": place}
        if attributes:
            shown = {"type": "button", **tag, **{name.replace("_", "-"): value for name, value in attributes.items()}}
            self._marks.append(element("button", shown, text))
        else:
            self._marks.append(element("div", tag, text))

    def bar(self, start: float, end: float, value: float, css_class: str, text: str) -> None:
        """A column from 0, or from the bottom, to a value, with a word above it."""
        if not math.isfinite(value):
            return
        low, high = self._up
        first, last = sorted((min(max(0.0, low), high), min(max(value, low), high)))
        place = f"left:{percent(start, *self._across)};bottom:{percent(first, low, high)}"
        size = f"width:{percent(end - start, 0.0, self._across[1] - self._across[0])}"
        size += f";height:{percent(last - first, 0.0, high - low)}"
        word = element("b", {"class": "below" if value < 0.0 else None}, text)
        self._marks.append(element("i", {"class": f"bar-of {css_class}", "style": f"{place};{size}"}, inner=word))

    def dot(self, x: float, y: float, css_class: str, title: str) -> None:
        """Add a mark at a place; the title shows on hover."""
        place = f"left:{percent(x, *self._across)};bottom:{percent(y, *self._up)}"
        self._marks.append(element("i", {"class": f"dot {css_class}", "style": place, "title": title}))

    def cursor(self) -> None:
        """The line that follows the player."""
        self._marks.append(element("i", {"class": "now", "aria-hidden": "true"}))

    def to_markup(
        self, ticks: Sequence[tuple[float, str]], bottom: str, *, name: str = "", key: Iterable[tuple[str, str]] = ()
    ) -> str:
        """The plot in its frame.

        Parameters
        ----------
        ticks : value and label at the left edge.
        bottom : markup of labels below, such as of `x_labels`.
        name : what is plotted; empty if a heading says it.
        key : class of a line or mark, and what it stands for.
        """
        lines = "".join(element("i", {"class": "level", "style": f"bottom:{percent(v, *self._up)}"}) for v, _ in ticks)
        inner = element("div", {"class": "lines", "aria-hidden": "true"}, inner=lines)
        inner += self._svg.to_markup() + "".join(self._marks)
        area = element("div", "plot-area", inner=inner)
        head = element("div", "plot-name", name) if name else ""
        frame = y_labels(tuple(ticks), *self._up) + area + bottom
        return element("div", f"chart {self._class}", inner=head + frame + build_key(key))


def build_key(key: Iterable[tuple[str, str]]) -> str:
    """What lines and marks stand for: class of each, and a text; empty for none."""
    keys = [
        element("span", None, inner=element("i", f"key-mark {css_class}") + element("span", None, text))
        for css_class, text in key
    ]
    return element("div", "plot-key", inner=keys) if keys else ""


def number_labels(names: Sequence[str], most: int = 24) -> str:
    """Names below places 1, 2, 3 ... of a plot whose range is 0.5 to their number and a half; not too many."""
    step = -(-len(names) // most)
    spans = [
        element("span", {"style": f"left:{percent(number, 0.5, len(names) + 0.5)}"}, name)
        for number, name in enumerate(names, 1)
        if (number - 1) % step == 0
    ]
    return element("div", {"class": "x-labels all", "aria-hidden": "true"}, inner=spans)
