"""Plots over time or number: a frame with labels that keep their size, a drawing that fills it, and marks on it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from dousa.app.report.markup import Svg, element, trace
from dousa.app.report.timeline import percent, y_labels
from dousa.arrays import FloatArray

_UNITS = 1000.0  # of the drawing along each side


class Plot:
    """A plot under construction; everything outside of its ranges is drawn at the edge.

    Parameters
    ----------
    across : (low, high) from left to right.
    up : (low, high) from bottom to top.
    label : what a screen reader says.
    css_class : of the plot.
    """

    def __init__(self, across: tuple[float, float], up: tuple[float, float], label: str, css_class: str = "") -> None:
        self._across, self._up, self._class = across, up, css_class
        self._svg = Svg(_UNITS, _UNITS, label, "", stretched=True)
        self._marks: list[str] = []

    def curve(self, x: FloatArray, y: FloatArray, css_class: str) -> None:
        """A line through points (N,) and (N,); what is not finite lifts the pen."""
        (left, right), (low, high) = self._across, self._up
        data = trace(_UNITS * (x - left) / max(right - left, 1e-9), _UNITS * (1.0 - (y - low) / max(high - low, 1e-9)))
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
        """A mark at a place, with words for who points at it."""
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
        area = element("div", {"class": "plot-area"}, inner=inner)
        head = element("div", {"class": "plot-name"}, name) if name else ""
        keys = "".join(
            element("span", None, inner=element("i", {"class": f"key-mark {css_class}"}) + element("span", None, text))
            for css_class, text in key
        )
        foot = element("div", {"class": "plot-key"}, inner=keys) if keys else ""
        frame = y_labels(tuple(ticks), *self._up) + area + bottom
        return element("div", {"class": f"chart {self._class}"}, inner=head + frame + foot)


def number_labels(names: Sequence[str], most: int = 24) -> str:
    """Names below places 1, 2, 3 ... of a plot whose range is 0.5 to their number and a half; not too many."""
    step = -(-len(names) // most)
    spans = [
        element("span", {"style": f"left:{percent(number, 0.5, len(names) + 0.5)}"}, name)
        for number, name in enumerate(names, 1)
        if (number - 1) % step == 0
    ]
    return element("div", {"class": "x-labels all", "aria-hidden": "true"}, inner="".join(spans))
