"""Success and failure at a glance: the model drawn over the silhouettes, as a video.

Every view shows the video's image or the silhouette in grey, the outline of the silhouette, and the model with its
skeleton; left and right differ by colour, line and letter; what is lost or missing is said in words.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.app.pictures.overlay_view import (
    ALARM,
    BGR_OF_SIDE,
    DARK,
    HALF_DARK,
    PALE,
    WHITE,
    ViewPainter,
    check_views,
    draw_lines,
    hatch,
    measure_text,
    write_text,
)
from dousa.arrays import FloatArray, Image
from dousa.errors import MotionWriteError, OptionError
from dousa.files.disk import atomic_write
from dousa.messages import Message
from dousa.motion.runs import find_runs

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.estimation.cameras.camera import Camera
    from dousa.estimation.silhouettes.silhouettes import Silhouettes
    from dousa.estimation.tracking.settings import Estimate

_WIDEST, _HIGHEST = 1920, 960  # px, all views together
_CAPTION, _FOOT, _TIMELINE, _BORDER = 30, 30, 76, 4  # px
_LEFT_MARGIN, _RIGHT_MARGIN, _EDGE = 62, 16, 10  # px, of the curve
_CODECS = {".mp4": "mp4v", ".mkv": "mp4v", ".avi": "MJPG"}


def write_overlay(
    estimate: Estimate,
    silhouettes: Silhouettes,
    cameras: Sequence[Camera],
    path: str | os.PathLike[str],
    *,
    progress: ProgressCallback | None = None,
) -> None:
    """Write a video of the estimate over the silhouettes and the pictures behind them, all views side by side.

    Parameters
    ----------
    estimate : of T frames.
    silhouettes : what it was made from, V views; at least T frames.
    cameras : (V,) the views.
    path : of the video, .mp4, .mkv or .avi.
    progress : called with (frames done, frames, what).

    Raises
    ------
    OptionError : another suffix; cameras, silhouettes and estimate of different numbers of views.
    MotionWriteError : the folder is missing or the disk refuses; the target is left as it was.
    """
    _check_suffix(path)
    n_frames = min(estimate.n_frames, silhouettes.n_frames)
    page = _Page(estimate, silhouettes, cameras)

    def paint() -> Iterator[Image]:
        for frame in range(n_frames):
            yield page.paint(frame)
            if progress is not None and (frame % 5 == 0 or frame == n_frames - 1):
                progress(frame + 1, n_frames, Message("pictures.overlay_video"))

    write_video(path, paint(), n_frames, estimate.frame_rate, page.size)


def _check_suffix(path: str | os.PathLike[str]) -> str:
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in _CODECS:
        raise OptionError("pictures.video_suffix", path=path, expected=tuple(_CODECS), found=suffix)
    return suffix


def write_video(
    path: str | os.PathLike[str], pictures: Iterable[Image], n_frames: int, frame_rate: float, size: tuple[int, int]
) -> None:
    """Write a video, which appears whole or not at all.

    Parameters
    ----------
    path : of the video, .mp4, .mkv or .avi.
    pictures : (height, width, 3) each, blue, green, red.
    n_frames : how many they are.
    frame_rate : Hz.
    size : width and height of the pictures in px.

    Raises
    ------
    OptionError : another suffix.
    MotionWriteError : the folder is missing or the disk refuses; the target is left as it was.
    """
    suffix = _check_suffix(path)
    with (
        atomic_write(path) as file,
        TemporaryDirectory(prefix=".overlay", dir=os.path.dirname(file.name)) as folder,
    ):
        video = os.path.join(folder, f"overlay{suffix}")
        writer = _open_video(path, video, _CODECS[suffix], frame_rate, size)
        try:
            for picture in pictures:
                writer.write(picture)
        finally:
            writer.release()
        _copy_whole(path, video, n_frames, file)


def _open_video(path, video: str, codec: str, frame_rate: float, size: tuple[int, int]):  # type: ignore[no-untyped-def]
    from dousa.extras import cv2

    # Containers keep the rate as a fraction of small numbers: beyond this encoders refuse.
    rate = float(np.clip(frame_rate, 1.0, 240.0))
    writer = cv2.VideoWriter(video, cv2.VideoWriter_fourcc(*codec), rate, size)  # type: ignore[attr-defined]
    if not writer.isOpened():
        raise MotionWriteError(path, "pictures.no_codec", codec=codec)
    return writer


def _copy_whole(path, video: str, n_frames: int, file) -> None:  # type: ignore[no-untyped-def]
    """OpenCV does not say that a disk was full: the frames are counted before the video is handed out."""
    import shutil

    from dousa.extras import cv2

    reader = cv2.VideoCapture(video)
    found = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
    reader.release()
    if found < n_frames - 1:  # Matroska tells a duration, which may round to one frame less
        raise MotionWriteError(path, "pictures.video_cut_off", found=found, expected=n_frames)
    with open(video, "rb") as made:
        shutil.copyfileobj(made, file, 1 << 20)


@dataclass(frozen=True, slots=True)
class _Cell:
    left: int
    top: int
    width: int
    height: int


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

    def paint(self, *frames: int) -> Image:
        """The strip with some frames marked."""
        canvas = self._base.copy()
        columns = map(self._column, frames)
        lines = [np.array([[column, 2.0], [column, self._height - 3.0]]) for column in columns]
        draw_lines(canvas, lines, WHITE, 5)
        draw_lines(canvas, lines, DARK, 2)
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


class _Page:
    """Where everything goes in the video's picture, and how it is painted."""

    def __init__(self, estimate: Estimate, silhouettes: Silhouettes, cameras: Sequence[Camera]) -> None:
        check_views(estimate, silhouettes, cameras)
        self._estimate, self._silhouettes = estimate, silhouettes
        self._cells, width, height = lay_out([(camera.width, camera.height) for camera in cameras])
        self._legend = make_legend(width, bool(estimate.occluded.any()))
        self.size = (width, height + len(self._legend) + _TIMELINE)
        self._grid_height = height
        self._timeline = Timeline(estimate, width, _TIMELINE)
        self._painters = [
            ViewPainter(estimate.body, camera, cell.width, cell.height)
            for camera, cell in zip(cameras, self._cells, strict=True)
        ]

    def paint(self, frame: int) -> Image:
        """The whole picture of one frame."""
        estimate = self._estimate
        canvas = np.full((self.size[1], self.size[0], 3), 255, np.uint8)
        lost = bool(estimate.lost[frame])
        masks, images = self._silhouettes.read(frame), self._silhouettes.look(frame)
        for view, (cell, painter) in enumerate(zip(self._cells, self._painters, strict=True)):
            picture = painter.paint(estimate.poses[frame], masks[view], images[view], estimate.occluded[frame])
            rows, columns = slice(cell.top, cell.top + cell.height), slice(cell.left, cell.left + cell.width)
            canvas[rows, columns] = picture
            if lost:
                _frame_in_alarm(canvas, cell)
            overlap = None if masks[view] is None else float(estimate.iou[frame, view])
            _write_caption(canvas, cell, self._silhouettes.names[view], overlap, lost)
        foot = self._grid_height + len(self._legend)
        canvas[self._grid_height : foot] = self._legend
        time = f"frame {say_time(estimate, frame)}"
        left = self.size[0] - measure_text(time, 16, bold=True) - 14
        write_text(canvas, time, (left, foot - 9), DARK, 16, bold=True)
        canvas[foot:] = self._timeline.paint(frame)
        return canvas


def lay_out(sizes: Sequence[tuple[int, int]], common_height: int = 480) -> tuple[list[_Cell], int, int]:
    """Views of one height in the grid that shows them largest.

    Parameters
    ----------
    sizes : (V,) width and height of the views in px.
    common_height : px, to which small images are enlarged.

    Returns
    -------
    (V,) cells, and the even width and height of the whole.
    """
    widest = max(width / height for width, height in sizes)
    tallest = max(common_height, *(height for _, height in sizes))
    best, best_columns = 0, 1
    for columns in range(1, len(sizes) + 1):
        lines = -(-len(sizes) // columns)
        high = min(tallest, int((_WIDEST / columns - _BORDER) / widest), _HIGHEST // lines - _CAPTION)
        if high > best:
            best, best_columns = high, columns
    height = max(best, 16)
    step_x, step_y = round(height * widest) + _BORDER, height + _CAPTION
    cells = [
        _Cell(
            (k % best_columns) * step_x + (step_x - _BORDER - max(1, round(height * w / h))) // 2 + _BORDER // 2,
            (k // best_columns) * step_y + _CAPTION,
            max(1, round(height * w / h)),
            height,
        )
        for k, (w, h) in enumerate(sizes)
    ]
    lines = -(-len(sizes) // best_columns)
    width = max(best_columns * step_x, 320)
    return cells, width + width % 2, lines * step_y + (lines * step_y) % 2


def _frame_in_alarm(canvas: Image, cell: _Cell) -> None:
    from dousa.extras import cv2

    corner = (cell.left + cell.width - 3, cell.top + cell.height - 3)
    cv2.rectangle(canvas, (cell.left + 2, cell.top + 2), corner, ALARM, 5)


def say_time(estimate: Estimate, frame: int) -> str:
    """The number of a frame, from 1, of how many, and its time."""
    return f"{frame + 1} / {estimate.n_frames}   {frame / estimate.frame_rate:.2f} s"


def describe_overlap(overlap: float | None) -> str:
    """How well model and silhouette agree; None where there is no image."""
    if overlap is None:
        return "no image"
    return f"overlap {overlap:.2f}" if np.isfinite(overlap) else "overlap -"


def _write_caption(canvas: Image, cell: _Cell, name: str, overlap: float | None, lost: bool) -> None:
    base = cell.top - 9
    known, said = overlap is not None and np.isfinite(overlap), describe_overlap(overlap)
    right = cell.left + cell.width - measure_text(said, 16, bold=True) - 6
    write_text(canvas, said, (right, base), DARK if known else HALF_DARK, 16, bold=True)
    if lost:
        width = measure_text("LOST", 16, bold=True)
        right -= width + 26
        canvas[cell.top - _CAPTION + 4 : cell.top - 3, right : right + width + 14] = ALARM
        write_text(canvas, "LOST", (right + 7, base), WHITE, 16, bold=True)
    room = right - cell.left - 10
    while len(name) > 1 and measure_text(name, 16) > room:
        name = name[:-2] + "~" if name.endswith("~") else name[:-1] + "~"
    write_text(canvas, name, (cell.left + 4, base), DARK, 16)


def make_legend(width: int, hidden: bool) -> Image:
    """What the lines mean, in as many rows as it takes; the last leaves room for the time."""
    entries = [
        (DARK, 2, "silhouette"),
        (BGR_OF_SIDE["left"], 3, "left (L)"),
        (BGR_OF_SIDE["right"], 3, "right (R), dashed"),
        (BGR_OF_SIDE[""], 3, "middle"),
    ]
    texts = [text for *_, text in entries] + (["no fill: hidden, placed by inertia"] if hidden else [])
    places, row, left = [], 0, 12
    for text in texts:
        need = 44 + measure_text(text, 14) + 22
        if left > 12 and left + need > width:
            row, left = row + 1, 12
        places.append((row, left))
        left += need
    if left + 240 > width:
        row += 1
    canvas = np.full(((row + 1) * _FOOT, width, 3), 255, np.uint8)
    for k, (line, left) in enumerate(places):
        base = line * _FOOT + 21
        if k < len(entries):
            colour, thick, text = entries[k]
            sample = np.array([[left, base - 5.0], [left + 34.0, base - 5.0]])
            draw_lines(canvas, [sample], colour, thick, dashed=text.endswith("dashed"))
            write_text(canvas, texts[k], (left + 42, base), DARK, 14)
        else:
            write_text(canvas, texts[k], (left, base), HALF_DARK, 14)
    return canvas
