"""The contact sheet of an estimate: some frames in every view, the worst among them, and the overlap over time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.app.pictures.canvas import count_noun, new_figure, save_figure
from dousa.app.pictures.overlay import Timeline, describe_overlap, make_legend, mean_overlap, say_time
from dousa.app.pictures.overlay_view import (
    ALARM,
    DARK,
    HALF_DARK,
    ViewPainter,
    check_views,
    find_box,
    to_rgb,
    write_text,
)
from dousa.arrays import Image
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.estimation.cameras.camera import Camera
    from dousa.estimation.silhouettes.silhouettes import Silhouettes
    from dousa.estimation.tracking.settings import Estimate

Box = tuple[int, int, int, int]

_LABEL, _GAP, _LINE, _CURVE, _LEAST = 130, 8, 24, 130, 1100  # px


def draw_overlay_sheet(
    estimate: Estimate,
    silhouettes: Silhouettes,
    cameras: Sequence[Camera],
    path: str | os.PathLike[str],
    *,
    n_frames: int = 9,
    title: str = "Model over silhouettes",
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
    step = max(picture.shape[1] for line in pictures for picture in line) + _GAP
    width = max(_LABEL + len(frames) * step, _LEAST)
    strips = [_paint_head(estimate, len(cameras), title, width), _paint_frames(estimate, frames, worst, step, width)]
    for view, line in enumerate(pictures):
        known = [mask[view] is not None for mask in masks]
        overlaps = [float(estimate.iou[frame, view]) if k else None for frame, k in zip(frames, known, strict=True)]
        strips.append(_paint_view(silhouettes.names[view], line, overlaps, step, width))
    strips += [make_legend(width, bool(estimate.occluded.any())), Timeline(estimate, width, _CURVE).paint(*frames)]
    sheet = np.concatenate(strips)
    figure = new_figure(width / 100, len(sheet) / 100, dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(to_rgb(sheet), interpolation="none", aspect="auto")
    axes.axis("off")
    save_figure(figure, path)


def _blank(width: int, height: int) -> Image:
    return np.full((height, width, 3), 255, np.uint8)


def _paint_head(estimate: Estimate, n_views: int, title: str, width: int) -> Image:
    strip = _blank(width, 70)
    overlap = mean_overlap(estimate.iou)
    mean = f"{np.nanmean(overlap):.2f}" if np.isfinite(overlap).any() else "unknown"
    lost = int(estimate.lost.sum())
    length = f"{count_noun(estimate.n_frames, 'frame')}, {estimate.n_frames / estimate.frame_rate:.1f} s"
    facts = f"{length}, {count_noun(n_views, 'view')}     mean overlap {mean}     lost frames: {lost or 'none'}"
    write_text(strip, title, (_GAP, 30), DARK, 24, bold=True)
    write_text(strip, facts, (_GAP, 58), ALARM if lost else DARK, 17)
    return strip


def _paint_frames(estimate: Estimate, frames: Sequence[int], worst: int | None, step: int, width: int) -> Image:
    """The numbers and times of the frames, and what is special about them."""
    strip = _blank(width, 2 * _LINE)
    for left, frame in zip(count(_LABEL, step), frames, strict=False):
        lost = bool(estimate.lost[frame])
        marks = [word for word, shown in (("LOST", lost), ("WORST", frame == worst)) if shown]
        write_text(strip, " ".join(marks), (left, _LINE - 6), ALARM if lost else DARK, 16, bold=True)
        write_text(strip, say_time(estimate, frame), (left, 2 * _LINE - 6), DARK, 16)
    return strip


def _paint_view(name: str, pictures: Sequence[Image], overlaps: Sequence[float | None], step: int, width: int) -> Image:
    """The pictures of one view side by side, with its name before them and the overlap below each."""
    height = max(len(picture) for picture in pictures)
    strip = _blank(width, height + _LINE)
    write_text(strip, _shorten(name), (_GAP, height // 2), DARK, 17, bold=True)
    for left, picture, overlap in zip(count(_LABEL, step), pictures, overlaps, strict=False):
        strip[: len(picture), left : left + picture.shape[1]] = picture
        write_text(strip, describe_overlap(overlap), (left, height + _LINE - 7), HALF_DARK, 15)
    return strip


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
        height: int = 250,
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


def _shorten(name: str, longest: int = 12) -> str:
    return name if len(name) <= longest else f"{name[: longest - 1]}~"
