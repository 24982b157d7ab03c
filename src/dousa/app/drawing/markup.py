"""Writing SVG and HTML: every text and attribute is escaped here and nowhere else."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping

from dousa.arrays import FloatArray
from dousa.evaluation.grade.score import round_grade


def escape(text: object) -> str:
    """Escape a text for use between tags and inside quotes."""
    return html.escape(str(text), quote=True)


def format_number(value: float, decimals: int = 2) -> str:
    """The shortest decimal of so many places; a dash if it is not finite."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{decimals}f}"
    if decimals:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def format_grade(score: float) -> str:
    """Format a grade as all outputs show it; a dash if there is none."""
    return format_number(round_grade(score), 0)


def _format_attribute(value: object) -> str:
    return format_number(value) if isinstance(value, float) else escape(value)


def element(
    tag: str, attributes: str | Mapping[str, object] | None = None, text: str = "", inner: str | Iterable[str] = ""
) -> str:
    """One element.

    Parameters
    ----------
    tag : its name.
    attributes : name -> value; None leaves the attribute out, True writes its bare name. A text is the class.
    text : content, escaped here.
    inner : content that is markup already, or its parts, after the text.
    """
    parts = [tag]
    for name, value in ({"class": attributes} if isinstance(attributes, str) else attributes or {}).items():
        if value is True:
            parts.append(name)
        elif value is not None and value is not False:
            parts.append(f'{name}="{_format_attribute(value)}"')
    return f"<{' '.join(parts)}>{escape(text)}{''.join(inner)}</{tag}>"


def build_terms(pairs: Iterable[tuple[str, str]], attributes: str | Mapping[str, object]) -> str:
    """A list of (term, description) in markup."""
    rows = (
        element("div", None, inner=element("dt", None, inner=term) + element("dd", None, inner=text))
        for term, text in pairs
    )
    return element("dl", attributes, inner=rows)


def build_list(items: Iterable[str], attributes: str | Mapping[str, object] | None = None, tag: str = "ul") -> str:
    """A list of items in markup."""
    return element(tag, attributes, inner=(element("li", None, inner=item) for item in items))


def build_warnings(title: str, warnings: Iterable[str]) -> str:
    """Warnings in plain text below their title; empty where there are none."""
    items = [escape(text) for text in warnings]
    return element("aside", "warnings", inner=element("h2", None, title) + build_list(items)) if items else ""


def frame_table(caption: str, head: Iterable[str], body: Iterable[str], css_class: str | None = None) -> str:
    """A table of rows in markup that scrolls where it is too wide; its caption is for screen readers."""
    inner = element("caption", "sr", caption)
    inner += element("thead", None, inner=(element("tr", None, inner=row) for row in head))
    inner += element("tbody", None, inner=body)
    table = element("table", {"class": css_class}, inner=inner)
    return element("div", {"class": "table-wrap", "tabindex": "0"}, inner=table)


def build_heads(names: Iterable[str], **attributes: str) -> str:
    """Headings of columns."""
    return "".join(element("th", {"scope": "col", **attributes}, name) for name in names)


def build_cells(texts: Iterable[str]) -> str:
    """Cells of a row."""
    return "".join(element("td", None, text) for text in texts)


def trace(x: FloatArray, y: FloatArray, decimals: int = 1) -> str:
    """Path data through the points (N,) and (N,); a value that is not finite lifts the pen."""
    parts: list[str] = []
    pen = "M"
    for across, up in zip(x.tolist(), y.tolist(), strict=True):
        if math.isfinite(across) and math.isfinite(up):
            parts.append(f"{pen}{format_number(across, decimals)} {format_number(up, decimals)}")
            pen = "L"
        else:
            pen = "M"
    return "".join(parts)


class Svg:
    """A drawing under construction.

    Parameters
    ----------
    width, height : of the view box; the page's style sheet gives it its size.
    label : what a screen reader says.
    css_class : of the element.
    stretched : whether the drawing fills its box in both directions; lines keep their width then.
    """

    def __init__(
        self, width: float, height: float, label: str, css_class: str = "", *, stretched: bool = False
    ) -> None:
        self._open = {
            "viewBox": f"0 0 {format_number(width)} {format_number(height)}",
            "class": css_class or None,
            "role": "img",
            "aria-label": label,
            "preserveAspectRatio": "none" if stretched else None,
        }
        self._parts: list[str] = []

    def add(self, tag: str, attributes: Mapping[str, object], text: str = "") -> None:
        """Append a shape."""
        self._parts.append(element(tag, attributes, text))

    def line(self, points: Iterable[tuple[float, float]], css_class: str) -> None:
        """Append a line through points; points that are not finite are left out."""
        seen = [(x, y) for x, y in points if math.isfinite(x) and math.isfinite(y)]
        if len(seen) > 1:
            data = "M" + "L".join(f"{format_number(x, 1)} {format_number(y, 1)}" for x, y in seen)
            self._parts.append(element("path", {"d": data, "class": css_class}))

    def to_markup(self) -> str:
        """The drawing as an inline element."""
        return element("svg", self._open, inner="".join(self._parts))


_SHAPES = {
    "global": "M2 2H22V22H2Z",
    "partial": "M12 1A11 11 0 1 1 12 23A11 11 0 1 1 12 1Z",
    "incomplete": "M12 1L23.5 22.5H0.5Z",
    "shift": "M12 0L24 12L12 24L0 12Z",
    "lapse": "M7 1.5H17L22.5 12L17 22.5H7L1.5 12Z",
}


def draw_mark(kind: str, words: Mapping[str, str]) -> str:
    """The mark of a kind of error or of a lapse, as markup; screen readers skip it, the words stand beside it."""
    shape = element("path", {"d": _SHAPES[kind]})
    y = "18.5" if kind == "incomplete" else "16.6"
    letter = element("text", {"x": "12", "y": y, "text-anchor": "middle"}, words[f"letter_{kind}"])
    return element(
        "svg", {"viewBox": "0 0 24 24", "class": f"mark {kind}", "aria-hidden": "true"}, inner=shape + letter
    )
