"""The picture of a labelled take: which category when, how sure, and what the body looked like then.

Every category has a row of its own with its name beside it, so nothing hangs on colour. A bar is as high as its
confidence; what is perhaps of a category is pale, dotted and in its row, with a dashed frame and a question mark; what
is unknown is grey and hatched, in the last row.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.drawing.body import THREE_QUARTER, Figurine, extent, to_figurine
from dousa.app.drawing.charts import time_ticks
from dousa.app.pictures.canvas import (
    BLUE,
    FAINT,
    GREY,
    INK,
    count_noun,
    drawable,
    new_figure,
    save_figure,
    shorten,
    write,
)
from dousa.app.pictures.sheets import draw_key, draw_row

if TYPE_CHECKING:
    from dousa.app.drawing.body import Drawable
    from dousa.retrieval.takes.label import Segment, Timeline


_UNKNOWN = "unknown"
_WIDTH, _MARGIN = 13.0, 0.25  # inches
_HEAD, _NAMES, _TOTALS, _TICKS, _GAP = 0.85, 2.3, 0.75, 0.5, 0.14  # inches; the gap is above the rows
_ROW, _BAR = 0.3, 0.8  # inches; share of a row that a bar of full confidence fills
_TALLEST_POSE, _MOST_POSES = 1.3, 18


def draw_timeline(
    timeline: Timeline, path: str | os.PathLike[str], motion: Drawable | None = None, title: str = "take"
) -> None:
    """Draw the categories of a take over time.

    Parameters
    ----------
    timeline : what was recognised.
    path : .png, .svg or .pdf; errors as of `save_figure`.
    motion : the take; its poses are drawn above their times.
    title : of the take.
    """
    segments, seconds = timeline.segments, timeline.duration
    if motion is not None:
        frames = motion.translations if hasattr(motion, "translations") else motion.positions
        seconds = max(seconds, len(frames) / motion.frame_rate)  # the poses stand above their times
    rows = _list_rows(segments)
    figurine = None if motion is None else to_figurine(motion)
    poses = 0.0 if figurine is None else _TALLEST_POSE + _GAP
    height = _HEAD + poses + max(len(rows), 1) * _ROW + _TICKS + _MARGIN
    figure = new_figure(_WIDTH, height)
    if figurine is not None:
        _draw_thumbnails(figure, figurine, height - _HEAD - poses + _GAP)
    _draw_rows(figure, segments, rows, seconds)
    _draw_head(figure, title, segments, seconds)
    save_figure(figure, path)


def _name(segment: Segment) -> str:
    """What a segment is, perhaps: the name of its row."""
    return segment.category or segment.guess or _UNKNOWN


def _list_rows(segments: Sequence[Segment]) -> list[str]:
    """The categories in the order in which they first come, unknown last."""
    ordered = sorted(segments, key=lambda segment: segment.start)
    rows = list(dict.fromkeys(map(_name, ordered)))
    return [name for name in rows if name != _UNKNOWN] + [_UNKNOWN] * (_UNKNOWN in rows)


def _draw_thumbnails(figure: Any, figurine: Figurine, bottom: float) -> None:
    room = _WIDTH - 2 * _MARGIN - _NAMES - _TOTALS
    n_frames = len(figurine.positions)
    samples = [int(frame) for frame in np.unique(np.linspace(0, n_frames - 1, 4 * _MOST_POSES).round())]
    apart, top = extent(figurine, samples, THREE_QUARTER)
    per_metre = _TALLEST_POSE / top
    count = int(np.clip(room / (max(apart, 0.35 * top) * per_metre), 1, min(_MOST_POSES, n_frames)))
    per_metre = min(per_metre, room / (count * max(apart, 0.35 * top)))
    frames = [int((number + 0.5) * n_frames / count) for number in range(count)]
    scale, heights = (room / per_metre / count, per_metre), (0.0, _TALLEST_POSE / per_metre)
    if figurine.canonical:
        draw_key(figure, 10)
    draw_row(figure, figurine, frames, THREE_QUARTER, scale, (_MARGIN + _NAMES, bottom), heights)


def _draw_rows(figure: Any, segments: Sequence[Segment], rows: Sequence[str], seconds: float) -> None:
    width, height = figure.get_size_inches()
    room, count = _WIDTH - 2 * _MARGIN - _NAMES - _TOTALS, max(len(rows), 1)
    bottom = _MARGIN + _TICKS
    box = ((_MARGIN + _NAMES) / width, bottom / height, room / width, count * _ROW / height)
    axes = figure.add_axes(box)
    axes.set_xlim(0.0, seconds)
    axes.set_ylim(count - 0.5, -0.5)
    for number, category in enumerate(rows):
        if number % 2 == 0:
            axes.axhspan(number - 0.5, number + 0.5, color="#f4f4f4", lw=0, zorder=0)
        mine = [segment for segment in segments if _name(segment) == category]
        for segment in mine:
            _draw_segment(axes, segment, number, seconds / room)
        middle = (bottom + (count - number - 0.5) * _ROW - 0.045) / height
        weight = "normal" if category == _UNKNOWN else "bold"
        spelled = drawable(category)  # as long as it will be drawn
        name = spelled if len(spelled) <= 30 else f"{spelled[:27]} …"
        size = 10.5 if len(name) <= 20 else 9.0
        write(figure, (_MARGIN + _NAMES - 0.1) / width, middle, name, size, ha="right", weight=weight)
        total = sum(segment.stop - segment.start for segment in mine)
        text = _say_time(total, 0.1) + "?" * any(segment.perhaps for segment in mine)
        write(figure, (_WIDTH - _MARGIN - _TOTALS + 0.1) / width, middle, text, 9.5, color=GREY)
    _draw_time_axis(axes, seconds)


def _draw_segment(
    axes: Any, segment: Segment, row: int, per_inch: float, least: float = 0.03, room: float = 0.36
) -> None:
    """A frame of full height, filled from below to the confidence.

    Parameters
    ----------
    per_inch : s of an inch.
    least : inches, so that a segment of a fraction of a second in a long take still shows.
    room : inches that "100%" needs inside a bar.
    """
    from matplotlib.patches import Rectangle

    unknown = _name(segment) == _UNKNOWN
    colour = GREY if unknown else BLUE
    length = max(segment.stop - segment.start, least * per_inch)
    floor = row + 0.5 * _BAR
    axes.add_patch(Rectangle((segment.start, floor - _BAR), length, _BAR, facecolor="white", lw=0.0))
    style: dict[str, Any] = {"facecolor": "#e4e4e4", "hatch": "////"} if unknown else {"facecolor": "#9cc7e4"}
    if segment.perhaps:
        style = {"facecolor": "#e3f0f9", "hatch": "..."}
    corner = (segment.start, floor - segment.confidence * _BAR)
    axes.add_patch(Rectangle(corner, length, segment.confidence * _BAR, edgecolor=colour, lw=0.0, **style))
    frame = Rectangle((segment.start, floor - _BAR), length, _BAR, fill=False, edgecolor=colour, lw=0.8)
    frame.set_linestyle("--" if segment.perhaps else "-")
    axes.add_patch(frame)
    if length > room * per_inch:
        plate = {"facecolor": "white", "edgecolor": "none", "pad": 0.6} if segment.category is None else None
        middle = segment.start + 0.5 * length
        text = f"{segment.confidence:.0%}" + "?" * segment.perhaps
        write(axes, middle, row + 0.02, text, 8.5, ha="center", va="center", bbox=plate, color=INK)


def _draw_time_axis(axes: Any, seconds: float) -> None:
    ticks = time_ticks(seconds, 12.5)
    step = ticks[1] if len(ticks) > 1 else seconds
    axes.set_xticks(ticks, [_say_tick(tick, step, seconds) for tick in ticks], fontsize=10)
    axes.set_xlabel("minutes:seconds" if _is_long(seconds) else "seconds", fontsize=10, color=GREY)
    axes.set_yticks([])
    axes.grid(axis="x", color=FAINT, lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=3, colors=INK)
    axes.spines[["top", "right", "left"]].set_visible(False)


def _is_long(seconds: float) -> bool:
    """Whether times are read in minutes."""
    return seconds >= 180.0


def _say_tick(second: float, step: float, seconds: float) -> str:
    if _is_long(seconds):
        return f"{int(second) // 60}:{int(second) % 60:02d}"
    return f"{second:.1f}" if step < 1 else f"{second:.0f}"


def _say_time(seconds: float, least: float) -> str:
    if _is_long(seconds):
        return f"{int(seconds) // 60}:{int(seconds) % 60:02d} min"
    return f"{max(seconds, least):.1f} s"


def _draw_head(figure: Any, title: str, segments: Sequence[Segment], seconds: float) -> None:
    width, height = figure.get_size_inches()
    known = [segment for segment in segments if segment.category is not None]
    doubtful = any(segment.perhaps for segment in segments)
    categories = len({segment.category for segment in known})
    stretches = sum(segment.stop - segment.start for segment in known)
    facts = f"{_say_time(seconds, 0.1)}, "
    if segments:
        facts += f"{count_noun(len(known), 'segment')} of {count_noun(categories, 'category')} "
        facts += f"over {stretches / seconds:.0%} of it; bars are as high as the confidence"
        facts += ", dotted ones are perhaps of their row" * doubtful
    else:
        facts += "nothing was found"
    write(figure, _MARGIN / width, 1 - 0.36 / height, shorten(title, 90), 15, weight="bold")
    write(figure, _MARGIN / width, 1 - 0.63 / height, facts, 10.5, color=GREY)
