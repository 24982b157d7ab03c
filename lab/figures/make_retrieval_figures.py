"""Draw the pictures of docs/retrieval.md that the demo does not make; part of ``make figures``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dousa.app.drawing.body import THREE_QUARTER, Figurine, extent, to_figurine
from dousa.app.pictures.canvas import BLUE, FAINT, GREY, INK, new_figure, save_figure, write
from dousa.app.pictures.sheets import draw_poses
from dousa.arrays import FloatArray
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.features.feature_sets import FEATURE_SETS, compute_track
from lab.places import DOCS

FIGURES = DOCS / "figures"

CATEGORY = "pick_up"
PERFORMERS = ((3, 0.0, "a quick performer"), (6, 1.6, "a slow one who waits first"))  # seed, s of waiting

WIDTH, MARGIN, LEFT = 11.0, 0.2, 1.75  # inches
HEAD, POSES, NUMBERS, CURVE, STRIP, TICKS, GAP = 0.42, 1.15, 0.26, 0.95, 0.27, 0.46, 0.1
LINE = 0.19  # inches
BAND = "#cfe3f1"


@dataclass(frozen=True)
class Shown:
    """One take: its poses, how fast motion time runs at each moment, and where its cells begin and end."""

    figurine: Figurine
    seconds: FloatArray  # (n,) middles of the frames
    speed: FloatArray  # (n,) motion time a second
    edges: FloatArray  # (T + 1,) s
    label: str

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.edges[-1])

    @property
    def frames(self) -> list[int]:
        """The frame in the middle of each cell."""
        middles = 0.5 * (self.edges[1:] + self.edges[:-1])
        return [int(second * self.figurine.frame_rate) for second in middles]


def look_at(seed: int, waiting: float, label: str) -> Shown:
    """A take of a performer, who may stand still before it, as the features see it."""
    motion = canonicalise(make_motion(CATEGORY, draw_performer(seed)))
    still = np.repeat(motion.positions[:1], round(waiting * motion.frame_rate), axis=0)
    motion = replace(motion, positions=np.concatenate([still, motion.positions]))
    track = compute_track(motion, FEATURE_SETS["extended"])
    edges = track.find_edges([0.0], [track.n_frames])[0] / track.frame_rate
    seconds = (np.arange(track.n_frames) + 0.5) / track.frame_rate
    speed = np.diff(track.times) * track.frame_rate
    return Shown(to_figurine(motion), seconds, speed, edges, label)


def draw_motion_time() -> None:
    """Two performers of one motion: ten cells of equal movement over the speed, and a pose of each cell."""
    takes = [look_at(*performer) for performer in PERFORMERS]
    panel = HEAD + POSES + NUMBERS + CURVE + 2 * STRIP + TICKS
    height = len(takes) * panel + (len(takes) - 1) * GAP
    figure = new_figure(WIDTH, height)
    tallest = max(extent(take.figurine, take.frames, THREE_QUARTER)[1] for take in takes)
    for number, take in enumerate(takes):
        top = height - number * (panel + GAP)
        title = f"{CATEGORY} by {take.label}, {take.duration:.1f} s"
        write(figure, MARGIN / WIDTH, (top - HEAD + 0.12) / height, title, 12, weight="bold")
        draw_row_of_poses(figure, take, top - HEAD - POSES, tallest)
        bottom = top - HEAD - POSES - NUMBERS - CURVE
        draw_speed(figure, take, bottom)
        even = np.linspace(0.0, take.duration, len(take.edges))
        draw_strip(figure, take.edges, bottom - STRIP, "equal movement", BAND)
        axes = draw_strip(figure, even, bottom - 2 * STRIP, "equal time", "#e6e6e6")
        axes.xaxis.set_visible(True)
        axes.tick_params(length=3, colors=INK, labelsize=10)
        axes.set_xlabel("seconds", fontsize=10, color=GREY, labelpad=1)
    save_figure(figure, FIGURES / "motion_time.png")


def add_axes(figure: Any, bottom: float, tall: float) -> Any:
    """Axes to the right of the names, in inches from below."""
    height = figure.get_size_inches()[1]
    return figure.add_axes(
        (LEFT / WIDTH, bottom / height, (WIDTH - LEFT - MARGIN) / WIDTH, tall / height), facecolor="none"
    )


def name_row(figure: Any, middle: float, *lines: str) -> None:
    """Write at the left what a row shows; ``middle`` in inches from below."""
    height = figure.get_size_inches()[1]
    for number, line in enumerate(lines):
        y = middle + LINE * (0.5 * (len(lines) - 1) - number)
        write(figure, (LEFT - 0.12) / WIDTH, y / height, line, 10, ha="right", va="center")


def draw_row_of_poses(figure: Any, take: Shown, bottom: float, tallest: float) -> None:
    """The pose in the middle of each cell of equal movement, numbered."""
    axes = add_axes(figure, bottom, POSES)
    spacing = (WIDTH - LEFT - MARGIN) * tallest / POSES / len(take.frames)
    axes.set_xlim(-0.5 * spacing, (len(take.frames) - 0.5) * spacing)
    axes.set_ylim(0.0, tallest)
    axes.set_axis_off()
    draw_poses(axes, take.figurine, take.frames, THREE_QUARTER, spacing)
    for artist in axes.get_children():
        artist.set_clip_on(False)
    for number in range(len(take.frames)):
        low = -0.6 * NUMBERS * tallest / POSES
        write(axes, number * spacing, low, str(number + 1), 10, ha="center", va="center")
    name_row(figure, bottom + 0.5 * POSES, "cells of equal", "movement:", "left side solid,", "right side dashed")


def draw_speed(figure: Any, take: Shown, bottom: float) -> None:
    """How fast the body moves, with the cells below it: all of the same area."""
    axes = add_axes(figure, bottom, CURVE)
    axes.set_xlim(0.0, take.duration)
    axes.set_ylim(0.0, 1.05 * take.speed.max())
    fine = np.linspace(0.0, take.duration, 2001)
    speed = np.interp(fine, take.seconds, take.speed)
    for number, (start, end) in enumerate(pairwise(take.edges)):
        within = np.concatenate([[start], fine[(fine > start) & (fine < end)], [end]])
        under = np.interp(within, fine, speed)
        axes.fill_between(within, under, color=BAND if number % 2 == 0 else "white", lw=0)
        axes.plot([end, end], [0.0, under[-1]], color=BLUE, lw=0.9)
    axes.plot(fine, speed, color=BLUE, lw=1.8)
    axes.set_axis_off()
    name_row(figure, bottom + 0.45 * CURVE, "how fast", "the body moves")


def draw_strip(figure: Any, edges: FloatArray, bottom: float, name: str, colour: str) -> Any:
    """A ruler of numbered cells."""
    axes = add_axes(figure, bottom, STRIP)
    axes.set_xlim(0.0, edges[-1])
    axes.set_ylim(0.0, 1.0)
    for number, (start, end) in enumerate(pairwise(edges)):
        axes.axvspan(start, end, color=colour if number % 2 == 0 else "white", lw=0)
        axes.axvline(end, color=FAINT, lw=0.8)
        write(axes, 0.5 * (start + end), 0.47, str(number + 1), 9.5, ha="center", va="center")
    axes.xaxis.set_visible(False)
    axes.yaxis.set_visible(False)
    for spine in axes.spines.values():
        spine.set(color=GREY, linewidth=0.8)
    name_row(figure, bottom + 0.5 * STRIP, name)
    return axes


def make_all() -> None:
    """Every picture."""
    FIGURES.mkdir(exist_ok=True)
    draw_motion_time()


if __name__ == "__main__":
    make_all()
