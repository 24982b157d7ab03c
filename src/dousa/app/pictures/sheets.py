"""Sheets of stick figures: the contact sheet of a motion, the answer to a search.

Left and right, match and mismatch differ by colour and by line, marker or word, so that every picture can be read
without colour.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.drawing.body import (
    FRONT,
    LIMB_JOINTS,
    SIDE,
    THREE_QUARTER,
    Figurine,
    extent,
    head_radius,
    place_poses,
    to_figurine,
)
from dousa.app.pictures.canvas import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    INK,
    SIDE_COLOURS,
    VERMILLION,
    new_figure,
    save_figure,
    shorten,
    write,
)
from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.motion import JOINT_INDEX

if TYPE_CHECKING:
    from dousa.app.drawing.body import Drawable
    from dousa.formats.motion_files import ReadOptions
    from dousa.library import Hit, Library, SearchResult


_WIDTH, _MARGIN, _HEAD, _TIMES, _VIEW_LABEL, _CAPTION = 13.0, 0.25, 0.85, 0.3, 0.75, 2.6  # inches


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """One row of a search sheet.

    Parameters
    ----------
    motion : what to draw.
    category : of the clip; for the query the one that the forest names.
    path : of the clip.
    note : one more line, such as the rank and likeness.
    verdict : ``"match"``, ``"differs"`` or nothing.
    """

    motion: Drawable
    category: str
    path: str
    note: str = ""
    verdict: str = ""


def draw_contact_sheet(
    motion: Drawable, path: str | os.PathLike[str], n_poses: int = 10, title: str | None = None
) -> None:
    """Draw poses at equal times, each from the front and from the right side, over the floor.

    Parameters
    ----------
    motion : any motion; points that are no human joints are drawn as dots, with the lines of their tree.
    path : .png, .svg or .pdf.
    n_poses : how many; fewer if the motion has fewer frames.
    title : the file's name, for instance.

    Raises
    ------
    OptionError : fewer than one pose, or another suffix.
    MotionWriteError : the picture cannot be written.
    """
    if n_poses < 1:
        raise OptionError("pictures.no_poses", found=n_poses)
    figurine = to_figurine(motion)
    frames = _spread(len(figurine.positions), n_poses)
    lines = [frames[k : k + 10] for k in range(0, len(frames), 10)]
    spacing, top = np.max([extent(figurine, line, view) for line in lines for view in (FRONT, SIDE)], axis=0)
    apart, per_metre = _fit(spacing, top, columns=max(len(lines[0]), 4), label=_VIEW_LABEL, tallest=2.6)
    row = top * per_metre + 0.12
    height = _HEAD + len(lines) * (2 * row + _TIMES) + _MARGIN
    figure = new_figure(_WIDTH, height)
    for number, line in enumerate(lines):
        bottom = height - _HEAD - number * (2 * row + _TIMES)
        for view, name in ((FRONT, "front"), (SIDE, "right side")):
            bottom -= row
            corner = (_MARGIN + _VIEW_LABEL, bottom)
            _strip(figure, figurine, line, view, (apart, per_metre), corner)
            write(figure, _MARGIN / _WIDTH, (bottom + 0.4 * row) / height, name, 9, color=GREY)
        for column, frame in enumerate(line):
            x = _MARGIN + _VIEW_LABEL + (column + 0.5) * apart * per_metre
            seconds = f"{frame / figurine.frame_rate:.2f} s"
            write(figure, x / _WIDTH, (bottom - 0.17) / height, seconds, 8, ha="center", color=GREY)
    _head(figure, height, title or "motion", _facts(figurine), figurine.canonical)
    save_figure(figure, path)


def _fit(spacing: float, top: float, *, columns: int, label: float, tallest: float) -> tuple[float, float]:
    """Distance of neighbouring poses in m, and inches on paper per m: the largest scale at which the columns fit the
    page beside a label, and rows are not taller (inches)."""
    room = (_WIDTH - 2 * _MARGIN - label) / columns
    wide = max(spacing, 0.35 * top) * 1.04
    per_metre = min(room / wide, tallest / top)
    return min(room / per_metre, 1.5 * wide), per_metre


def _spread(n_frames: int, n_poses: int) -> list[int]:
    """At most n_poses different frames at equal spacing, the first and the last among them."""
    return [int(frame) for frame in np.unique(np.round(np.linspace(0, n_frames - 1, n_poses)))]


def _facts(figurine: Figurine) -> str:
    n_frames = len(figurine.positions)
    frames = "1 frame" if n_frames == 1 else f"{n_frames} frames"
    facts = f"{n_frames / figurine.frame_rate:.2f} s, {frames} at {figurine.frame_rate:g} Hz"
    if figurine.canonical:
        return f"{facts}, height {figurine.height:.2f} m"
    points = f"{facts}, {figurine.positions.shape[1]} points over {figurine.height:.2f} m in height"
    return f"{points}; joints not told apart, drawn as they are"


def _strip(
    figure: Any,
    figurine: Figurine,
    frames: Sequence[int],
    view: float,
    scale: tuple[float, float],
    corner: tuple[float, float],
) -> None:
    """Axes of a scale as of `_fit`, with a little room below and above; lower left corner in inches."""
    _, per_metre = scale
    _, top = extent(figurine, frames, view)
    draw_row(figure, figurine, frames, view, scale, corner, (-0.03 / per_metre, top + 0.06 / per_metre))


def _head(figure: Any, height: float, title: str, facts: str, legend: bool) -> None:
    write(figure, _MARGIN / _WIDTH, 1 - 0.36 / height, shorten(title, 90), 14, weight="bold")
    write(figure, _MARGIN / _WIDTH, 1 - 0.62 / height, shorten(facts, 150), 9.5, color=GREY)
    if legend:
        draw_key(figure)


def draw_key(figure: Any, size: float = 9) -> None:
    """Draw which limbs are left and which are right at the upper right, in letters of so many points."""
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    figure.legend(
        [
            Line2D([], [], color=colour, ls=line, lw=2.0, marker=marker, ms=5)
            for colour, line, marker in _SIDES.values()
        ],
        [f"{side} arm and leg" for side in _SIDES],
        loc="upper right",
        bbox_to_anchor=(1 - _MARGIN / width, 1 - 0.08 / height),
        frameon=False,
        fontsize=size,
        handlelength=3.4,
        labelcolor=INK,
    )


def _short_path(path: str) -> str:
    return "/".join(os.path.normpath(path).split(os.sep)[-2:])


def draw_search_result(
    library: Library,
    query: int | str | os.PathLike[str],
    result: SearchResult,
    path: str | os.PathLike[str],
    options: ReadOptions | None = None,
    truth: str | None = None,
) -> None:
    """Draw the answer of `Library.search` as a search sheet.

    Parameters
    ----------
    library : the one that was searched.
    query : what it was asked for: a motion file or the number of a clip.
    result : its answer.
    path : .png, .svg or .pdf; errors as of `save_figure`.
    options : what the query file does not say.
    truth : category of the query, if it is known; a result of another category "differs". By default the
        category that the forest takes the query for.
    """
    from dousa.formats.motion_files import read_canonical

    expected = truth or result.verdict.guess
    if isinstance(query, int):
        motion: Drawable = library.trajectories(query)
    else:
        motion, _ = read_canonical(query, options, whole=False)
    share = max(result.histogram.values(), default=0.0)
    doubtful = f"perhaps {result.verdict.guess}" if result.verdict.perhaps else "unknown"
    asked = Strip(
        motion,
        result.category or doubtful,
        str(result.query),
        f"so say {share:.0%} of the trees" + (f"; in truth: {truth}" if truth else ""),
    )
    hits = [
        Strip(
            library.trajectories(hit.clip_id),
            hit.category,
            hit.path,
            _note_rank(hit, likeness),
            "match" if hit.category == expected else "differs",
        )
        for hit, likeness in zip(result.results, result.likenesses, strict=True)
    ]
    draw_search_sheet(asked, hits, path, title=f"What is like {_short_path(result.query)}?")


def _note_rank(hit: Hit, likeness: float | None) -> str:
    percent = "-" if likeness is None else f"{likeness:.0%}"
    return f"rank {hit.rank}, likeness {percent}{', mirrored' if hit.mirrored else ''}"


def draw_search_sheet(
    query: Strip, hits: Sequence[Strip], path: str | os.PathLike[str], n_poses: int = 10, title: str = "Search"
) -> None:
    """Draw a query and, below it, the motions found, best first, as rows of poses.

    Parameters
    ----------
    query, hits : the rows.
    path : .png, .svg or .pdf.
    n_poses : poses in a row, at equal times from start to end.
    title : of the sheet.

    Raises
    ------
    OptionError : fewer than one pose, or another suffix.
    MotionWriteError : the picture cannot be written.
    """
    if n_poses < 1:
        raise OptionError("pictures.no_poses", found=n_poses)
    from matplotlib.lines import Line2D

    strips = [query, *hits]
    figurines = [to_figurine(strip.motion) for strip in strips]
    chosen = [_spread(len(figurine.positions), n_poses) for figurine in figurines]
    pairs = list(zip(figurines, chosen, strict=True))
    spacing, top = np.max([extent(figurine, frames, THREE_QUARTER) for figurine, frames in pairs], axis=0)
    scale = _fit(spacing, top, columns=n_poses, label=_CAPTION, tallest=1.2)
    row = max(top * scale[1] + 0.16, 0.9)
    height = _HEAD + len(strips) * row + 2 * _MARGIN
    figure = new_figure(_WIDTH, height)
    for number, (figurine, frames) in enumerate(pairs):
        bottom = height - _HEAD - (number + 1) * row - (_MARGIN if number else 0.0)
        corner = (_MARGIN + _CAPTION, bottom)
        _strip(figure, figurine, frames, THREE_QUARTER, scale, corner)
        _caption(figure, strips[number], bottom + 0.5 * row, is_query=number == 0)
    rule, edge = (height - _HEAD - row - 0.6 * _MARGIN) / height, _MARGIN / _WIDTH
    figure.add_artist(Line2D([edge, 1 - edge], [rule] * 2, color=FAINT, lw=0.8))
    facts = "the query on top, then the most similar motions, best first; every row from its start to its end"
    _head(figure, height, title, facts, any(figurine.canonical for figurine in figurines))
    save_figure(figure, path)


def _caption(figure: Any, strip: Strip, middle: float, *, is_query: bool) -> None:
    width, height = figure.get_size_inches()
    x = _MARGIN / width
    name = f"query: {strip.category}" if is_query else strip.category
    write(figure, x, (middle + 0.16) / height, shorten(name, 32), 10.5, weight="bold")
    write(figure, x, (middle - 0.03) / height, shorten(_short_path(strip.path), 46), 8, color=GREY)
    if strip.note:
        write(figure, x, (middle - 0.2) / height, strip.note, 8, color=GREY)
    if strip.verdict:
        colour, sign = (GREEN, "✓") if strip.verdict == "match" else (VERMILLION, "✗")
        write(figure, x, (middle - 0.38) / height, f"{sign} {strip.verdict}", 9, color=colour, weight="bold")


_SIDES = {
    "left": (SIDE_COLOURS["left"], "-", "o"),
    "right": (SIDE_COLOURS["right"], (0, (2.4, 0.9)), "s"),
}
"""Colour, line (in units of its width) and marker of the limbs of a side; each of them suffices to tell the side."""


def draw_row(
    figure: Any,
    figurine: Figurine,
    frames: Sequence[int],
    view: float,
    scale: tuple[float, float],
    corner: tuple[float, float],
    heights: tuple[float, float],
) -> None:
    """Draw poses side by side over a floor line, on axes whose unit is the metre in both directions.

    Parameters
    ----------
    figurine, frames, view : which poses, seen from where.
    scale : m between the poses, and inches per m.
    corner : lower left, inches.
    heights : m, the lowest and the highest that is shown.
    """
    width, height = figure.get_size_inches()
    (spacing, per_metre), (low, high) = scale, heights
    across = len(frames) * spacing * per_metre
    box = (corner[0] / width, corner[1] / height, across / width, (high - low) * per_metre / height)
    axes = figure.add_axes(box, frameon=False)
    axes.set_xlim(-0.5 * spacing, (len(frames) - 0.5) * spacing)
    axes.set_ylim(low, high)
    axes.set_axis_off()
    draw_poses(axes, figurine, frames, view, spacing)
    for artist in axes.get_children():
        artist.set_clip_on(False)


def draw_poses(axes: Any, figurine: Figurine, frames: Sequence[int], view: float, spacing: float) -> None:
    """Draw poses side by side, `spacing` m apart, on axes whose unit is the metre, over a floor line."""
    poses = place_poses(figurine, frames, view)
    poses[..., 0] += spacing * np.arange(len(frames))[:, None]
    axes.plot([-0.5 * spacing, (len(frames) - 0.5) * spacing], [0, 0], color=FAINT, lw=1.0, zorder=0)
    if figurine.canonical:
        _draw_people(axes, poses, figurine.height, view)
    else:
        _draw_points(axes, poses, figurine.parents)


def _lines(axes: Any, poses: FloatArray, chains: Sequence[Sequence[int]], **style: Any) -> None:
    """The same polylines in every pose, drawn as one, which is many times faster."""
    gap = np.full((len(poses), 1, 2), np.nan)
    parts = [np.concatenate((poses[:, list(chain)], gap), axis=1).reshape(-1, 2) for chain in chains]
    x, y = np.concatenate(parts).T
    axes.plot(x, y, solid_capstyle="round", dash_capstyle="butt", **style)


def _draw_people(axes: Any, poses: FloatArray, height: float, view: float) -> None:
    from matplotlib.collections import EllipseCollection

    def indices(*names: str) -> list[int]:
        return [JOINT_INDEX[name] for name in names]

    _lines(axes, poses, [indices("pelvis", "spine", "neck", "head")], color=INK, lw=2.0, zorder=3)
    for side, (colour, line, marker) in _SIDES.items():
        # From the side the right limbs are nearer to the viewer than the left ones.
        depth = 2.0 if view > 0 and side == "left" else 4.0
        arm, leg = (indices(*chain) for chain in LIMB_JOINTS if chain[0].startswith(side))
        girdles = [[*indices("neck"), arm[0]], [*indices("pelvis"), leg[0]]]
        _lines(axes, poses, girdles, color=INK, lw=1.4, zorder=3)
        _lines(axes, poses, [arm, leg], color=colour, ls=line, lw=1.7, zorder=depth)
        tips = poses[:, [arm[-1], leg[-1]]].reshape(-1, 2)
        axes.plot(*tips.T, ls="", marker=marker, ms=3.0, color=colour, zorder=depth + 0.5)
    size = np.full(len(poses), 2 * head_radius(height))
    heads = EllipseCollection(
        size, size, np.zeros(len(poses)), units="xy", offsets=poses[:, JOINT_INDEX["head"]],
        offset_transform=axes.transData, facecolor="white", edgecolor=INK, lw=1.4, zorder=3.5,
    )  # fmt: skip
    axes.add_collection(heads)


def _draw_points(axes: Any, poses: FloatArray, parents: Sequence[int] | None) -> None:
    bones = [(child, parent) for child, parent in enumerate(parents or ()) if parent >= 0]
    if bones:
        _lines(axes, poses, bones, color=GREY, lw=1.0, zorder=2)
    axes.plot(*poses.reshape(-1, 2).T, ls="", marker="o", ms=2.6, color=BLUE, zorder=3)
