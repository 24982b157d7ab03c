"""The picture of a pupil over time: the grade of each attempt, and below it how many errors of each kind, and how
large."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING

from dousa.app.pictures.canvas import BLUE, FAINT, GREEN, GREY, INK, PURPLE, VERMILLION, new_figure, save_figure, write
from dousa.messages import Message

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from dousa.evaluation import Attempt, Progress

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.7, 0.5, 0.5, 0.6  # inches
_GRADE, _ROW, _BETWEEN = 1.7, 0.75, 0.5
_STEP, _LEAST = 1.5, 5.0  # inches between two attempts, and of the axes
_MOST = 24  # names that are written below
_LETTERS = 18
_LOOK = {"global": (PURPLE, "s"), "partial": (BLUE, "o"), "incomplete": (GREEN, "^"), "shift": (VERMILLION, "D")}


def draw_progress(progress: Progress, path: str | os.PathLike[str]) -> None:
    """Draw the attempts in the language in use.

    Parameters
    ----------
    progress : of `dousa.evaluation.compare_attempts`.
    path : .png, .svg or .pdf.

    Raises
    ------
    OptionError : another suffix.
    MotionWriteError : the picture cannot be written.
    """
    attempts = progress.attempts
    inner = max(_STEP * (len(attempts) - 1), _LEAST)
    width = _LEFT + inner + _RIGHT
    height = _TOP + _GRADE + len(_LOOK) * (_BETWEEN + _ROW) + _BOTTOM
    figure = new_figure(width, height)

    def add_axes(top: float, tall: float) -> Axes:
        return figure.add_axes((_LEFT / width, 1.0 - (top + tall) / height, inner / width, tall / height))

    axes = add_axes(_TOP, _GRADE)
    _draw_grades(axes, attempts)
    for number, kind in enumerate(_LOOK):
        axes = add_axes(_TOP + _GRADE + _BETWEEN + number * (_ROW + _BETWEEN), _ROW)
        _draw_kind(axes, attempts, kind)
    for place in range(len(attempts)) if len(attempts) <= _MOST else ():
        name = attempts[place].name
        short = name if len(name) <= _LETTERS else f"{name[: _LETTERS - 1]}…"
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
    """How many errors of a kind, and beside each number their mean size."""
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
    axes.set_xlim(-0.4, count - 0.6)
    axes.set_ylim(0.0, top)
    axes.set_xticks([])
    axes.set_yticks([])
    write(axes, 0.0, 1.06, title, 10.0, color=colour, transform=axes.transAxes)
    axes.spines["bottom"].set_color(FAINT)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
