"""The contact sheet of an estimate: some frames in every view, the worst among them, and the overlap over time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.pictures.canvas import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    INK,
    PURPLE,
    VERMILLION,
    count_noun,
    new_figure,
    save_figure,
    write,
)
from dousa.app.pictures.overlay_view import (
    ALARM,
    DARK,
    HALF_DARK,
    PALE,
    WHITE,
    ViewPainter,
    check_views,
    draw_lines,
    find_box,
    hatch,
    measure_text,
    to_rgb,
    write_text,
)
from dousa.arrays import FloatArray, Image
from dousa.errors import OptionError
from dousa.motion.runs import find_runs

if TYPE_CHECKING:
    from dousa.estimation.cameras.camera import Camera
    from dousa.estimation.silhouettes.silhouettes import Silhouettes
    from dousa.estimation.tracking.settings import Estimate

_LEFT_MARGIN, _RIGHT_MARGIN, _EDGE = 62, 16, 10  # px


def mean_overlap(iou: FloatArray) -> FloatArray:
    """Mean over the views (T,) of the overlap (T, V); NaN where no view has an image."""
    known = np.isfinite(iou)
    counts = known.sum(axis=1)
    sums = np.where(known, iou, 0.0).sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


class Timeline:
    """A strip with the curve, drawn once; each frame gets a copy with its place marked.

    Parameters
    ----------
    estimate : of T frames.
    width, height : px.
    """

    def __init__(self, estimate: Estimate, width: int, height: int) -> None:
        self._n_frames = estimate.n_frames
        self._width, self._height = width, height
        self._base = np.full((height, width, 3), 255, np.uint8)
        self._draw_lost(estimate.lost)
        self._draw_scale()
        self._draw_curve(mean_overlap(estimate.iou))

    def paint(self, frame: int) -> Image:
        """The strip with one frame marked."""
        canvas = self._base.copy()
        column = self._column(frame)
        line = np.array([[column, 2.0], [column, self._height - 3.0]])
        draw_lines(canvas, [line], WHITE, 5)
        draw_lines(canvas, [line], DARK, 2)
        return canvas

    def _column(self, frame: float) -> float:
        span = self._width - _LEFT_MARGIN - _RIGHT_MARGIN
        return _LEFT_MARGIN + span * frame / max(1, self._n_frames - 1)

    def _row(self, overlap: FloatArray) -> FloatArray:
        return np.asarray(_EDGE + (self._height - 2 * _EDGE) * (1.0 - overlap))

    def _draw_lost(self, lost: NDArray[np.bool_], least: float = 9.0) -> None:
        """Hatch lost frames, in bands of least px so that one frame of a long clip still shows beside the curve."""
        for start, stop in find_runs(lost).tolist():
            left, right = self._column(start - 0.5), self._column(stop - 0.5)
            more = max(0.0, least - (right - left)) / 2.0
            left = max(int(left - more), _LEFT_MARGIN)
            right = min(int(right + more), self._width - _RIGHT_MARGIN)
            band = self._base[_EDGE : self._height - _EDGE, left:right]
            band[:] = (225, 225, 250)
            cut = np.ascontiguousarray(band)
            hatch(cut, ALARM, 9)
            band[:] = cut
            if right - left > measure_text("LOST", 13, bold=True) + 6:
                write_text(self._base, "LOST", (left + 4, self._height - _EDGE - 5), ALARM, 13, bold=True)

    def _draw_scale(self) -> None:
        ends = np.array([_LEFT_MARGIN, self._width - _RIGHT_MARGIN], np.float64)
        for overlap in (0.0, 0.5, 1.0):
            row = float(self._row(np.array(overlap)))
            draw_lines(self._base, [np.array([[ends[0], row], [ends[1], row]])], PALE)
            write_text(self._base, f"{overlap:g}", (_LEFT_MARGIN - 26, int(row) + 5), HALF_DARK, 12)
        write_text(self._base, "overlap", (6, int(self._row(np.array(0.75))) + 5), DARK, 14)

    def _draw_curve(self, overlap: FloatArray) -> None:
        """The least value where several frames share a column, so that no short failure vanishes."""
        columns = np.round(self._column(np.arange(len(overlap)))).astype(np.intp)  # type: ignore[arg-type]
        known = np.isfinite(overlap)
        least = np.full(self._width, np.inf)
        np.minimum.at(least, columns[known], overlap[known])
        broken = np.zeros(self._width, bool)
        broken[columns[~known]] = True
        drawn = np.flatnonzero(np.isfinite(least))
        if not len(drawn):
            write_text(self._base, "no view has an image", (_LEFT_MARGIN + 8, self._height // 2 + 5), HALF_DARK, 14)
            return
        gaps = np.flatnonzero([broken[a + 1 : b].any() for a, b in pairwise(drawn)]) + 1
        for piece in np.split(drawn, gaps):
            points = np.stack((piece.astype(np.float64), self._row(least[piece])), axis=1)
            draw_lines(self._base, [points if len(points) > 1 else np.repeat(points, 2, axis=0)], DARK, 2)


Box = tuple[int, int, int, int]

_WIDTH, _VIEW_LABEL, _MARGIN = 15.0, 0.95, 0.25  # inches
_HEAD, _LINE_HEAD, _CURVE, _FOOT, _GAP = 0.72, 0.42, 1.9, 0.35, 0.06  # inches
_ALARM = "#B22222"
_CURVES = ((BLUE, "-"), (VERMILLION, "--"), (GREEN, "-."), (PURPLE, ":"))


def draw_overlay_sheet(
    estimate: Estimate,
    silhouettes: Silhouettes,
    cameras: Sequence[Camera],
    path: str | os.PathLike[str],
    *,
    n_frames: int = 9,
    title: str = "",
) -> None:
    """Draw frames spread over the clip and the worst one, all views, with the overlap over time below.

    Parameters
    ----------
    estimate : of T frames.
    silhouettes : what it was made from, V views; at least T frames.
    cameras : (V,) the views.
    path : of the picture, .png, .svg or .pdf.
    n_frames : most frames to show, 1 to 24.
    title : what it is, above.

    Raises
    ------
    OptionError : another suffix, too few or too many frames; views that do not agree in number.
    MotionWriteError : the folder is missing or the disk refuses.
    """
    if not 1 <= n_frames <= 24:
        raise OptionError("pictures.sheet_frames", found=n_frames)
    check_views(estimate, silhouettes, cameras)
    frames, worst = choose_frames(estimate, min(estimate.n_frames, silhouettes.n_frames), n_frames)
    masks = [silhouettes.read(frame) for frame in frames]
    cuts = [_CutOut(estimate, camera, [mask[view] for mask in masks], frames) for view, camera in enumerate(cameras)]
    pictures: list[list[Image]] = [[] for _ in cameras]
    for number, frame in enumerate(frames):
        for line, cut, mask, image in zip(pictures, cuts, masks[number], silhouettes.look(frame), strict=True):
            line.append(cut.paint(number, frame, mask, image))
    present = [[mask is not None for mask in views] for views in masks]
    sheet = _Sheet(estimate, silhouettes.names, frames, worst, present)
    save_figure(sheet.draw(pictures, title), path)


def choose_frames(estimate: Estimate, available: int, count: int) -> tuple[list[int], int | None]:
    """Frames spread over the clip and, among them, the one that fits worst (None if no overlap is known)."""
    overlap = mean_overlap(estimate.iou[:available])
    worst = int(np.nanargmin(overlap)) if np.isfinite(overlap).any() else None
    spread = np.unique(np.round(np.linspace(0, available - 1, min(count, available))).astype(int)).tolist()
    if worst is not None and worst not in spread:
        if len(spread) >= count:
            spread.remove(min(spread, key=lambda frame: abs(frame - worst)))
        spread = sorted([*spread, worst])
    return spread, worst


class _CutOut:
    """The pictures of one view, all cut to the one size that shows the person in each, round the person.

    Parameters
    ----------
    estimate : of T frames.
    camera : the view.
    masks : of the chosen frames; None where there is no image.
    frames : those chosen.
    height : px of a picture: finer than it is shown, but not so fine that lines vanish.
    shape : least width of a picture by its height.
    room : share of the person's height left round the person.
    """

    def __init__(
        self,
        estimate: Estimate,
        camera: Camera,
        masks: Sequence[NDArray[np.bool_] | None],
        frames: Sequence[int],
        height: int = 360,
        shape: float = 0.75,
        room: float = 0.12,
    ) -> None:
        from dousa.estimation.raster.rasteriser import draw_body

        models = draw_body(estimate.body, estimate.poses[list(frames)], camera)
        self._estimate, self._camera = estimate, camera
        self._boxes = [_find_box(mask, model) for mask, model in zip(masks, models, strict=True)]
        known = [box for box in self._boxes if box]
        wide = max((box[2] - box[0] for box in known), default=camera.width)
        high = max((box[3] - box[1] for box in known), default=camera.height)
        around = 2 * int(room * high) + 4
        # Of like shape in all views, so that the lines of the sheet are of like height.
        self._high = min(max(high + around, int((wide + around) / shape)), camera.height)
        self._wide = min(max(wide + around, int(shape * self._high)), camera.width)
        self._scale = height / self._high
        size = (max(1, round(camera.width * self._scale)), max(1, round(camera.height * self._scale)))
        self._painter = ViewPainter(estimate.body, camera, *size)

    def paint(self, number: int, frame: int, mask: NDArray[np.bool_] | None, image: Image | None) -> Image:
        """The picture of one of the chosen frames."""
        estimate = self._estimate
        picture = self._painter.paint(estimate.poses[frame], mask, image, estimate.occluded[frame])
        left, top = _corner(self._boxes[number], self._wide, self._high, self._camera)
        first, last = int(top * self._scale), int((top + self._high) * self._scale)
        begin, end = int(left * self._scale), int((left + self._wide) * self._scale)
        return picture[first : max(last, first + 1), begin : max(end, begin + 1)]


def _find_box(mask: NDArray[np.bool_] | None, model: NDArray[np.bool_]) -> Box | None:
    """Where the model is, and the silhouette too unless its specks fill the picture."""
    boxes: list[Box] = []
    found = find_box(model)
    if found is not None:
        rows, columns = found
        boxes.append((columns.start, rows.start, columns.stop, rows.stop))
    if mask is not None:
        from dousa.extras import cv2

        _, _, pieces, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
        if len(pieces) > 1:
            left, top, width, height, _ = pieces[1:][int(np.argmax(pieces[1:, cv2.CC_STAT_AREA]))]
            boxes.append((int(left), int(top), int(left + width), int(top + height)))
    if not boxes:
        return None
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    return int(low[0]), int(low[1]), int(high[2]), int(high[3])


def _corner(box: Box | None, wide: int, high: int, camera: Camera) -> tuple[int, int]:
    if box is None:
        box = (0, 0, camera.width, camera.height)
    left = (box[0] + box[2] - wide) // 2
    top = (box[1] + box[3] - high) // 2
    return int(np.clip(left, 0, camera.width - wide)), int(np.clip(top, 0, camera.height - high))


class _Sheet:
    """The figure: a line of pictures per view, a column per frame, the curves below."""

    def __init__(
        self,
        estimate: Estimate,
        names: Sequence[str],
        frames: Sequence[int],
        worst: int | None,
        present: Sequence[Sequence[bool]],
    ) -> None:
        self._estimate, self._names = estimate, names
        self._frames, self._worst, self._present = frames, worst, present

    def draw(self, pictures: Sequence[Sequence[Image]], title: str) -> Any:
        cell = (_WIDTH - 2 * _MARGIN - _VIEW_LABEL) / max(len(self._frames), 4) - _GAP
        heights = [cell * line[0].shape[0] / line[0].shape[1] for line in pictures]
        total = _HEAD + _LINE_HEAD + sum(heights) + len(heights) * (_GAP + 0.2) + _CURVE + _FOOT
        self._figure = new_figure(_WIDTH, total)
        self._total = total
        self._write_head(title)
        top = _HEAD
        write(self._figure, *self._at(_MARGIN, top + 0.34), "frame", 9, color=GREY)
        for column, frame in enumerate(self._frames):
            self._write_frame(column, frame, cell, top)
        top += _LINE_HEAD
        for view, (line, height) in enumerate(zip(pictures, heights, strict=True)):
            name = _shorten(self._names[view])
            write(self._figure, *self._at(_MARGIN, top + height / 2), name, 10, weight="bold")
            for column, picture in enumerate(line):
                left = _MARGIN + _VIEW_LABEL + column * (cell + _GAP)
                self._show(picture, left, top, cell, height, bool(self._estimate.lost[self._frames[column]]))
                overlap = self._estimate.iou[self._frames[column], view]
                text = "no image" if not self._present[column][view] else f"overlap {overlap:.2f}"
                write(self._figure, *self._at(left, top + height + 0.15), text, 8, color=GREY)
            top += height + _GAP + 0.2
        self._draw_curves(top + 0.2)
        return self._figure

    def _at(self, left: float, top: float) -> tuple[float, float]:
        """Inches from the upper left corner as shares of the figure."""
        return left / _WIDTH, 1.0 - top / self._total

    def _axes(self, left: float, top: float, width: float, height: float) -> Any:
        x, y = self._at(left, top + height)
        return self._figure.add_axes((x, y, width / _WIDTH, height / self._total))

    def _write_head(self, title: str) -> None:
        estimate = self._estimate
        overlap = mean_overlap(estimate.iou)
        mean = f"{np.nanmean(overlap):.2f}" if np.isfinite(overlap).any() else "unknown"
        lost = int(estimate.lost.sum())
        summary = (
            f"{count_noun(estimate.n_frames, 'frame')}, {estimate.n_frames / estimate.frame_rate:.1f} s, "
            f"{count_noun(len(self._names), 'view')}"
            f"      mean overlap {mean}      lost frames: {lost if lost else 'none'}"
        )
        write(self._figure, *self._at(_MARGIN, 0.28), title or "Model over silhouettes", 13, weight="bold")
        write(self._figure, *self._at(_MARGIN, 0.52), summary, 10, color=_ALARM if lost else INK)
        entries = [
            (INK, "-", "silhouette"),
            (BLUE, "-", "left (L)"),
            (VERMILLION, "--", "right (R), dashed"),
            (GREEN, "-", "middle"),
        ]
        self._write_key(entries, _WIDTH - 7.4, 0.3)
        if estimate.occluded.any():
            text = "no fill: part hidden in every view, placed by inertia alone"
            write(self._figure, *self._at(_WIDTH - 7.4, 0.52), text, 8.5, color=GREY)

    def _write_key(self, entries: Sequence[tuple[str, Any, str]], left: float, top: float) -> None:
        from matplotlib.lines import Line2D

        for colour, style, text in entries:
            (x, y), (end, _) = self._at(left, top - 0.05), self._at(left + 0.4, top)
            self._figure.add_artist(Line2D([x, end], [y, y], color=colour, linestyle=style, linewidth=2.2))
            write(self._figure, *self._at(left + 0.48, top), text, 9)
            left += 0.48 + 0.085 * len(text) + 0.3

    def _write_frame(self, column: int, frame: int, cell: float, top: float) -> None:
        left = _MARGIN + _VIEW_LABEL + column * (cell + _GAP)
        seconds = frame / self._estimate.frame_rate
        text = f"{frame + 1}  ({seconds:.2f} s)"
        lost = bool(self._estimate.lost[frame])
        marks = [word for word, shown in (("LOST", lost), ("WORST", frame == self._worst)) if shown]
        write(self._figure, *self._at(left, top + 0.34), text, 9)
        if marks:
            colour = _ALARM if lost else INK
            write(self._figure, *self._at(left, top + 0.16), " ".join(marks), 9, color=colour, weight="bold")

    def _show(self, picture: Image, left: float, top: float, width: float, height: float, lost: bool) -> None:
        axes = self._axes(left, top, width, height)
        axes.imshow(to_rgb(picture), interpolation="antialiased", aspect="auto")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set(color=_ALARM if lost else FAINT, linewidth=3.0 if lost else 0.8)

    def _draw_curves(self, top: float) -> None:
        estimate = self._estimate
        axes = self._axes(_MARGIN + _VIEW_LABEL, top + 0.2, _WIDTH - 2 * _MARGIN - _VIEW_LABEL, _CURVE - 0.55)
        seconds = np.arange(estimate.n_frames) / estimate.frame_rate
        overlap = mean_overlap(estimate.iou)
        self._mark_lost(axes, overlap)
        key: list[tuple[str, Any, str]] = [(INK, "-", "mean of the views")]
        if 1 < len(self._names) <= len(_CURVES):
            for name, curve, (colour, style) in zip(self._names, estimate.iou.T, _CURVES, strict=False):
                axes.plot(seconds, curve, color=colour, linestyle=style, linewidth=1.1)
                key.append((colour, style, _shorten(name)))
        self._write_key(key, _MARGIN + _VIEW_LABEL, top + 0.1)
        axes.plot(seconds, overlap, color=INK, linewidth=2.2)
        for frame in self._frames:
            axes.axvline(frame / estimate.frame_rate, color=FAINT, linewidth=0.8, zorder=0)
        if self._worst is not None:
            place = (self._worst / estimate.frame_rate, float(overlap[self._worst]))
            axes.plot(*place, marker="v", color=INK, markersize=8, clip_on=False)
            above = place[1] < 0.4
            late = 2 * self._worst > estimate.n_frames
            text, height = ("worst  ", "right") if late else ("  worst", "left")
            write(axes, place[0], place[1] + (0.08 if above else -0.16), text, 9, ha=height, weight="bold")
        end = max(float(seconds[-1]), 1e-3)
        axes.set(ylim=(0, 1), xlim=(-0.005 * end, 1.005 * end), yticks=[0, 0.5, 1], ylabel="overlap")
        axes.set_xlabel("seconds", loc="right", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)

    def _mark_lost(self, axes: Any, overlap: FloatArray) -> None:
        estimate = self._estimate
        spans = find_runs(estimate.lost).tolist()
        for start, stop in spans:
            edges = ((start - 0.5) / estimate.frame_rate, (stop - 0.5) / estimate.frame_rate)
            axes.axvspan(*edges, facecolor="#fbeaea", edgecolor="#e3a5a5", hatch="//", linewidth=0.6)
            if len(spans) > 1 and stop - start < 0.04 * estimate.n_frames:
                continue  # hatched only
            low = np.nan_to_num(overlap[start:stop]).mean() < 0.5
            style: dict[str, Any] = {"color": _ALARM, "weight": "bold", "ha": "center", "clip_on": True}
            write(axes, sum(edges) / 2, 0.84 if low else 0.06, "LOST", 9, **style)


def _shorten(name: str, longest: int = 11) -> str:
    """So many characters of a name; one that the fonts may lack takes the room of its code."""
    room = np.cumsum([1 if ord(character) < 0x2000 else 6 for character in name])
    if not len(room) or room[-1] <= longest:
        return name
    return f"{name[: int((room < longest).sum())]}…"
