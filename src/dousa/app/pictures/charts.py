"""Charts: a map of clips, a pupil over time, places of cameras."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pictures.canvas import BLUE, FAINT, GREEN, GREY, INK, PURPLE, VERMILLION, new_figure, save_figure, write
from dousa.messages import Message

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from dousa.arrays import FloatArray
    from dousa.estimation import Calibration
    from dousa.evaluation import Attempt, Progress
    from dousa.library import ClipMap


# Tol's "muted" colours and shapes besides: ten categories are distinct, also without colours.
_MAP_COLOURS = "#332288 #117733 #CC6677 #88CCEE #999933 #882255 #44AA99 #AA4499 #DDCC77 #0072B2".split()
_MAP_SHAPES = "os^DvPX<>p"
_MAP_WIDTH, _MAP_HEIGHT, _MAP_LEGEND = 10.0, 8.0, 2.4  # inches
_LEGEND_TOP, _LEGEND_STEP = 0.93, 0.032  # of the height: first line of the legend, and from line to line


def draw_clip_map(found: ClipMap, categories: Sequence[str | None], path: str | os.PathLike[str]) -> None:
    """Draw a map; the categories of the most clips have colours and shapes of their own.

    Parameters
    ----------
    found : the map.
    categories : of its clips, None where there is none.
    path : .png, .svg or .pdf; errors as of `save_figure`.
    """
    figure = new_figure(_MAP_WIDTH, _MAP_HEIGHT)
    from matplotlib.lines import Line2D

    axes = figure.add_axes((0.01, 0.01, 1 - _MAP_LEGEND / _MAP_WIDTH - 0.02, 0.98))
    axes.set(xlim=(-1.04, 1.04), ylim=(-1.04, 1.04), aspect="equal")
    axes.axis("off")
    size = float(np.clip(9000 / max(len(categories), 1), 3, 36))
    left = 1 - _MAP_LEGEND / _MAP_WIDTH
    write(figure, left, _LEGEND_TOP + 0.02, str(Message("library_map.title", n=len(categories))), 11, weight="bold")
    named = Counter(name for name in categories if name is not None).most_common()
    rows = np.array(["" if name is None else name for name in categories], dtype=np.str_)
    legend: list[tuple[str, dict[str, Any], np.ndarray]] = []
    for (name, _), colour, shape in zip(named, _MAP_COLOURS, _MAP_SHAPES, strict=False):
        legend.append((name, {"color": colour, "marker": shape}, rows == name))
    rest = [name for name, _ in named[len(_MAP_COLOURS) :]]
    legend.append((str(Message("library_map.others")), {"color": GREY, "marker": "."}, np.isin(rows, rest)))
    legend.append((str(Message("library_map.no_label")), {"color": FAINT, "marker": "."}, rows == ""))
    for line, (name, style, chosen) in enumerate(entry for entry in legend if entry[2].any()):
        above = 2 if style["marker"] == "." else 3
        x, y = found.points[chosen].T
        axes.scatter(x, y, s=size, linewidths=0, alpha=0.85, zorder=above, **style)
        height = _LEGEND_TOP - _LEGEND_STEP * (line + 1)
        place = [left + 0.01], [height + 0.008]
        figure.add_artist(Line2D(*place, linestyle="none", markersize=7, markeredgewidth=0, **style))
        short = name if len(name) <= 26 else f"{name[:12]}…{name[-13:]}"
        write(figure, left + 0.03, height, f"{short} ({int(chosen.sum())})", 9, color=INK)
    save_figure(figure, path)


_LEFT, _RIGHT, _HEAD, _BOTTOM = 0.7, 0.5, 0.5, 0.6  # inches
_GRADE, _ROW, _BETWEEN = 1.7, 0.75, 0.5
_ATTEMPT, _LEAST = 1.5, 5.0  # inches between two attempts, and of the axes
_LOOK = {"global": (PURPLE, "s"), "partial": (BLUE, "o"), "incomplete": (GREEN, "^"), "shift": (VERMILLION, "D")}


def draw_progress(progress: Progress, path: str | os.PathLike[str]) -> None:
    """Draw the attempts in the language in use.

    Parameters
    ----------
    progress : of `dousa.evaluation.compare_attempts`.
    path : .png, .svg or .pdf; errors as of `save_figure`.
    """
    attempts = progress.attempts
    inner = max(_ATTEMPT * (len(attempts) - 1), _LEAST)
    width = _LEFT + inner + _RIGHT
    height = _HEAD + _GRADE + len(_LOOK) * (_BETWEEN + _ROW) + _BOTTOM
    figure = new_figure(width, height)

    def add_axes(top: float, tall: float) -> Axes:
        return figure.add_axes((_LEFT / width, 1.0 - (top + tall) / height, inner / width, tall / height))

    axes = add_axes(_HEAD, _GRADE)
    _draw_grades(axes, attempts)
    for number, kind in enumerate(_LOOK):
        axes = add_axes(_HEAD + _GRADE + _BETWEEN + number * (_ROW + _BETWEEN), _ROW)
        _draw_kind(axes, attempts, kind)
    for place in range(len(attempts)) if len(attempts) <= 24 else ():  # more names have no room
        name = attempts[place].name
        short = name if len(name) <= 18 else f"{name[:17]}…"
        write(axes, place, -0.2, short, 8.0, ha="center", va="top", transform=axes.get_xaxis_transform())
    save_figure(figure, path)


def _draw_grades(axes: Axes, attempts: tuple[Attempt, ...]) -> None:
    from dousa.evaluation.grade.score import round_grade

    scores = [math.nan if one.score is None else one.score for one in attempts]
    axes.plot(range(len(attempts)), scores, color=INK, marker="o", linewidth=2.0)
    for place, score in enumerate(scores):
        if math.isfinite(score):
            write(axes, place, score + 6.0, f"{round_grade(score):.0f}", 10.0, ha="center")
    _dress(axes, len(attempts), 115.0, str(Message("progress.grade")), INK)


def _draw_kind(axes: Axes, attempts: tuple[Attempt, ...], kind: str) -> None:
    from dousa.evaluation.advice.progress import describe_errors
    from dousa.evaluation.words import KINDS

    colour, mark = _LOOK[kind]
    counts = [one.counts[kind] for one in attempts]
    most = max(1, *counts)
    axes.plot(range(len(counts)), counts, color=colour, marker=mark, linewidth=1.8, clip_on=False)
    for place, one in enumerate(attempts):
        text = str(describe_errors(kind, one))
        write(axes, place, counts[place] + 0.2 * most, text, 8.0, ha="center", color=GREY)
    _dress(axes, len(counts), 1.45 * most, str(KINDS[kind]), colour)


def _dress(axes: Axes, count: int, top: float, title: str, colour: str) -> None:
    axes.set(xlim=(-0.4, count - 0.6), ylim=(0.0, top), xticks=[], yticks=[])
    write(axes, 0.0, 1.06, title, 10.0, color=colour, transform=axes.transAxes)
    axes.spines["bottom"].set_color(FAINT)
    axes.spines[["top", "right", "left"]].set_visible(False)


def draw_cameras(found: Calibration, path: str | os.PathLike[str]) -> None:
    """Draw where cameras stand, in the language in use.

    Parameters
    ----------
    found : of `calibrate_from_person` or `calibrate_from_board`.
    path : .png, .svg or .pdf; errors as of `save_figure`.
    """
    figure = new_figure(10.0, 5.2)  # inches
    n_moments = min(24, len(found.points))
    points = found.points[np.linspace(0, len(found.points) - 1, n_moments).round().astype(int)]
    for number, (code, across, along) in enumerate(
        (("camera_picture.above", (0, 2), (1.0, -1.0)), ("camera_picture.side", (0, 1), (1.0, 1.0)))
    ):
        axes = figure.add_axes((0.06 + 0.49 * number, 0.1, 0.43, 0.78))
        write(axes, 0.0, 1.03, str(Message(code)), 10.0, transform=axes.transAxes)
        axes.tick_params(labelsize=8, colors=GREY)
        axes.grid(color=FAINT, linewidth=0.6)
        flat = points.reshape(-1, 3)[:, across] * along
        axes.plot(flat[:, 0], flat[:, 1], ".", color=GREY, markersize=2.0)
        for camera in found.cameras:
            _draw_camera(axes, camera, list(across), np.array(along))
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.12)
    save_figure(figure, path)


def _draw_camera(axes: Any, camera: Any, across: list[int], along: FloatArray) -> None:
    corners = np.array(((0.0, (camera.height - 1) / 2), (camera.width - 1.0, (camera.height - 1) / 2)))
    if across[1] == 1:
        corners = np.array((((camera.width - 1) / 2, 0.0), ((camera.width - 1) / 2, camera.height - 1.0)))
    _, directions = camera.compute_rays(corners)
    place = camera.position[across] * along
    for direction in np.nan_to_num(directions):
        end = (camera.position + 0.8 * direction)[across] * along
        axes.plot((place[0], end[0]), (place[1], end[1]), color=BLUE, linewidth=1.2)
    axes.plot(place[0], place[1], "o", color=VERMILLION, markersize=5)
    write(axes, float(place[0]) + 0.08, float(place[1]) + 0.08, camera.name[:24], 8.5)
