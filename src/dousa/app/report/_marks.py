"""Marks of the kinds of error, those of the player: each has its own letter and shape, so that no colour is needed."""

from __future__ import annotations

from collections.abc import Mapping

from dousa.app.report._svg import element

__all__ = ["draw_mark"]

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
