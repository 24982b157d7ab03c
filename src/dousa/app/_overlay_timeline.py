"""The overlap of model and silhouettes over time, with what is lost, as a strip below the pictures."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.app._overlay_paint import (
    ALARM,
    DARK,
    HALF_DARK,
    PALE,
    WHITE,
    Image,
    draw_line,
    hatch,
    measure_text,
    write_text,
)

if TYPE_CHECKING:
    from dousa.estimation._types import Estimate

__all__ = ["Timeline", "find_spans", "mean_overlap"]

FloatArray = NDArray[np.float64]

_LEFT_MARGIN, _RIGHT_MARGIN, _EDGE = 62, 16, 10  # px
_LEAST_BAND = 9.0  # px: one lost frame of a long clip still shows beside the curve


def mean_overlap(iou: FloatArray) -> FloatArray:
    """Mean over the views (T,) of the overlap (T, V); NaN where no view has an image."""
    known = np.isfinite(iou)
    counts = known.sum(axis=1)
    sums = np.where(known, iou, 0.0).sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def find_spans(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First frame and the one after the last of every run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


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
        draw_line(canvas, np.array([[column, 2.0], [column, self._height - 3.0]]), WHITE, 5)
        draw_line(canvas, np.array([[column, 2.0], [column, self._height - 3.0]]), DARK, 2)
        return canvas

    def _column(self, frame: float) -> float:
        span = self._width - _LEFT_MARGIN - _RIGHT_MARGIN
        return _LEFT_MARGIN + span * frame / max(1, self._n_frames - 1)

    def _row(self, overlap: FloatArray) -> FloatArray:
        return np.asarray(_EDGE + (self._height - 2 * _EDGE) * (1.0 - overlap))

    def _draw_lost(self, lost: NDArray[np.bool_]) -> None:
        for start, stop in find_spans(lost):
            left, right = self._column(start - 0.5), self._column(stop - 0.5)
            more = max(0.0, _LEAST_BAND - (right - left)) / 2.0
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
            draw_line(self._base, np.array([[ends[0], row], [ends[1], row]]), PALE)
            write_text(self._base, f"{overlap:g}", (_LEFT_MARGIN - 26, int(row) + 5), HALF_DARK, 12)
        write_text(self._base, "IoU", (6, self._height // 2 + 5), DARK, 14)

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
            write_text(
                self._base, "no view has an image", (_LEFT_MARGIN + 8, self._height // 2 + 5), HALF_DARK, 14
            )
            return
        gaps = np.flatnonzero([broken[a + 1 : b].any() for a, b in pairwise(drawn)]) + 1
        for piece in np.split(drawn, gaps):
            points = np.stack((piece.astype(np.float64), self._row(least[piece])), axis=1)
            draw_line(self._base, points if len(points) > 1 else np.repeat(points, 2, axis=0), DARK, 2)
