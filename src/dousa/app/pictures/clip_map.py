"""The picture of a map of all clips: a point each, coloured by category."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pictures.canvas import FAINT, GREY, INK, new_figure, save_figure, write
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.library import ClipMap

# Tol's "muted" colours and shapes besides: ten categories are told apart, also without colours.
_COLOURS = "#332288 #117733 #CC6677 #88CCEE #999933 #882255 #44AA99 #AA4499 #DDCC77 #0072B2".split()
_SHAPES = "os^DvPX<>p"
_WIDTH, _HEIGHT, _LEGEND = 10.0, 8.0, 2.4  # inches
_TOP, _STEP = 0.93, 0.032  # of the height: first line of the legend, and from line to line
_NEAR_FULL = 1.04


def draw_clip_map(found: ClipMap, categories: Sequence[str | None], path: str | os.PathLike[str]) -> None:
    """Draw a map; the categories of the most clips have colours and shapes of their own.

    Parameters
    ----------
    found : the map.
    categories : of its clips, None where there is none.
    path : .png, .svg or .pdf.

    Raises
    ------
    OptionError : another suffix.
    MotionWriteError : the picture cannot be written.
    """
    figure = new_figure(_WIDTH, _HEIGHT)
    axes = figure.add_axes((0.01, 0.01, 1 - _LEGEND / _WIDTH - 0.02, 0.98))
    axes.set(xlim=(-_NEAR_FULL, _NEAR_FULL), ylim=(-_NEAR_FULL, _NEAR_FULL), aspect="equal")
    axes.axis("off")
    size = float(np.clip(9000 / max(len(categories), 1), 3, 36))
    left = 1 - _LEGEND / _WIDTH
    write(figure, left, _TOP + 0.02, str(Message("library_map.title", n=len(categories))), 11, weight="bold")
    named = Counter(name for name in categories if name is not None).most_common()
    rows = np.array(["" if name is None else name for name in categories], dtype=np.str_)
    legend: list[tuple[str, dict[str, Any], np.ndarray]] = []
    for (name, _), colour, shape in zip(named, _COLOURS, _SHAPES, strict=False):
        legend.append((name, {"color": colour, "marker": shape}, rows == name))
    rest = [name for name, _ in named[len(_COLOURS) :]]
    legend.append((str(Message("library_map.others")), {"color": GREY, "marker": "."}, np.isin(rows, rest)))
    legend.append((str(Message("library_map.no_label")), {"color": FAINT, "marker": "."}, rows == ""))
    for line, (name, style, chosen) in enumerate(entry for entry in legend if entry[2].any()):
        above = 2 if style["marker"] == "." else 3
        x, y = found.points[chosen].T
        axes.scatter(x, y, s=size, linewidths=0, alpha=0.85, zorder=above, **style)
        height = _TOP - _STEP * (line + 1)
        _draw_mark(figure, left + 0.01, height + 0.008, style)
        write(figure, left + 0.03, height, f"{_shorten(name)} ({int(chosen.sum())})", 9, color=INK)
    save_figure(figure, path)


def _draw_mark(figure: Any, x: float, y: float, style: dict[str, Any]) -> None:
    from matplotlib.lines import Line2D

    figure.add_artist(Line2D([x], [y], linestyle="none", markersize=7, markeredgewidth=0, **style))


def _shorten(name: str) -> str:
    return name if len(name) <= 26 else f"{name[:12]}…{name[-13:]}"
