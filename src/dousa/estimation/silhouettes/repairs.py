"""Repairs of silhouettes by hand: brush strokes, and excluded parts that are not the person.

`RepairedSilhouettes` applies a list of repairs in order to each frame it reads; the source stays unchanged.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from dousa.arrays import Mask
from dousa.errors import SilhouetteError
from dousa.estimation.silhouettes.cleaning import label_pieces
from dousa.estimation.silhouettes.silhouettes import Silhouettes, WrappedSilhouettes, checked_frame
from dousa.extras import cv2
from dousa.messages import Message, Progress


@dataclass(frozen=True, slots=True)
class MaskStroke:
    """A stroke of a round brush in one frame of one view.

    Parameters
    ----------
    view, frame : counted from 0.
    points : (N, 2) x and y in px, at least one; pixel centres are whole numbers.
    radius : of the brush, px.
    adds : true for foreground, false for background.
    """

    view: int
    frame: int
    points: tuple[tuple[float, float], ...]
    radius: float
    adds: bool

    def __post_init__(self) -> None:
        values = [self.radius, *(value for point in self.points for value in point)]
        if not self.points or not all(map(math.isfinite, values)) or not self.radius > 0:
            raise SilhouetteError("mask_repairs.stroke")

    @property
    def frames(self) -> tuple[int, ...]:
        """The changed frames."""
        return (self.frame,)

    def apply(self, mask: Mask, frame: int) -> None:
        """Change the mask (H, W) of a frame in place."""
        bits = 4  # of a pixel: OpenCV's coordinates are whole numbers
        canvas = np.zeros(mask.shape, np.uint8)
        dots = np.round(np.asarray(self.points) * (1 << bits)).astype(np.int64)
        dots = np.clip(dots, -(1 << 20), 1 << 20).astype(np.int32)
        radius = max(1, round(self.radius * (1 << bits)))
        for one, other in pairwise(dots):
            cv2.line(canvas, one.tolist(), other.tolist(), 1, max(1, round(2 * self.radius)), shift=bits)
        for dot in dots:
            cv2.circle(canvas, dot.tolist(), radius, 1, -1, shift=bits)
        mask[canvas.view(bool)] = self.adds

    def to_json(self) -> dict[str, Any]:
        """Return plain values for `repair_from_json`."""
        points = [[round(value, 2) for value in point] for point in self.points]
        return {"kind": "stroke", **asdict(self), "points": points}


@dataclass(frozen=True, slots=True)
class ExcludedPart:
    """A connected part of one view that is not the person, in one frame or many.

    Parameters
    ----------
    view : counted from 0.
    seeds : frame -> x and y, px, of a pixel of the part; see `find_part` and `follow_part`.
    """

    view: int
    seeds: Mapping[int, tuple[int, int]]

    @property
    def frames(self) -> tuple[int, ...]:
        """The changed frames."""
        return tuple(self.seeds)

    def apply(self, mask: Mask, frame: int) -> None:
        """Change the mask (H, W) of a frame in place."""
        if frame not in self.seeds:
            return
        x, y = self.seeds[frame]
        if 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and mask[y, x]:
            mask[_part_at(mask, (x, y))] = False

    def to_json(self) -> dict[str, Any]:
        """Return plain values for `repair_from_json`."""
        return {"kind": "exclude", "view": self.view, "seeds": [[frame, *self.seeds[frame]] for frame in self.seeds]}


MaskRepair = MaskStroke | ExcludedPart
"""What can be done to silhouettes."""


def repair_from_json(given: Mapping[str, Any]) -> MaskRepair:
    """Return a repair from the plain values of its ``to_json``; SilhouetteError if they are invalid."""
    try:
        if given["kind"] == "stroke":
            points = tuple((float(x), float(y)) for x, y in given["points"])
            where = int(given["view"]), int(given["frame"])
            return MaskStroke(*where, points, float(given["radius"]), bool(given["adds"]))
        if given["kind"] == "exclude":
            seeds = {int(frame): (int(x), int(y)) for frame, x, y in given["seeds"]}
            return ExcludedPart(int(given["view"]), seeds)
    except (KeyError, TypeError, ValueError):
        pass
    raise SilhouetteError("mask_repairs.unreadable", found=str(dict(given))[:80])


class RepairedSilhouettes(WrappedSilhouettes):
    """Silhouettes with repairs, applied in order as frames are read.

    Raises
    ------
    SilhouetteError : a repair outside the views or frames.
    """

    def __init__(self, source: Silhouettes, repairs: Sequence[MaskRepair]) -> None:
        super().__init__(source)
        self._repairs: dict[tuple[int, int], list[MaskRepair]] = defaultdict(list)
        for repair in repairs:
            _check_view(source, repair.view)
            for frame in repair.frames:
                self._repairs[repair.view, checked_frame(frame, self.n_frames)].append(repair)

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """Return the repaired masks (height, width) of all views in one frame; None where a view has no image."""
        return tuple(self._repair(view, frame, mask) for view, mask in enumerate(self._inner.read(frame)))

    def read_view(self, view: int, frame: int) -> Mask | None:
        """Return the mask of one view."""
        _check_view(self._inner, view)
        return self._repair(view, frame, self._inner.read_view(view, frame))

    def _repair(self, view: int, frame: int, mask: Mask | None) -> Mask | None:
        repairs = self._repairs.get((view, frame), ())
        if mask is None or not repairs:
            return mask
        mask = np.array(mask, bool, copy=True)
        for repair in repairs:
            repair.apply(mask, frame)
        return mask


def _check_view(silhouettes: Silhouettes, view: int) -> None:
    if not 0 <= view < silhouettes.n_views:
        raise SilhouetteError("mask_repairs.view", found=view, views=silhouettes.n_views)


def find_part(silhouettes: Silhouettes, view: int, frame: int, point: tuple[float, float]) -> ExcludedPart:
    """Return the connected part (8 neighbours) of a mask at a point of a frame, or within 4 px of it.

    Parameters
    ----------
    silhouettes : with all earlier repairs.
    view, frame : counted from 0.
    point : x and y, px.

    Raises
    ------
    SilhouetteError : no foreground at this point.
    """
    return ExcludedPart(view, {frame: _find_seed(silhouettes, view, frame, point)})


def follow_part(
    silhouettes: Silhouettes,
    view: int,
    frame: int,
    point: tuple[float, float],
    progress: Progress | None = None,
    patience: int = 15,
) -> ExcludedPart:
    """Follow a part through all frames by shared area and similar size.

    Frames where it has merged with another part, such as the person, stay unchanged.

    Parameters
    ----------
    silhouettes : with all earlier repairs.
    view, frame, point : see `find_part`.
    progress : called with (frames done, frames in all, what).
    patience : frames in a row without the part that are passed over; after one more it is not looked for any further.

    Raises
    ------
    SilhouetteError : no foreground at this point.
    """
    seeds = {frame: _find_seed(silhouettes, view, frame, point)}
    mask = silhouettes.read_view(view, frame)
    assert mask is not None
    first = _part_at(mask, seeds[frame])
    n_done = 0
    for way in (range(frame + 1, silhouettes.n_frames), range(frame - 1, -1, -1)):
        part, missed = first, 0
        for place in way:
            found = _find_again(silhouettes.read_view(view, place), part)
            if found is not None:
                seeds[place], part, missed = *found, 0
            else:
                missed += 1
            n_done += 1
            if progress is not None:
                progress(n_done, silhouettes.n_frames - 1, Message("mask_repairs.following"))
            if missed > patience:
                break
    return ExcludedPart(view, dict(sorted(seeds.items())))


def _find_seed(
    silhouettes: Silhouettes, view: int, frame: int, point: tuple[float, float], near: float = 4.0
) -> tuple[int, int]:
    """Return the foreground pixel nearest to a point, at most ``near`` px away: a click beside a part counts."""
    _check_view(silhouettes, view)
    mask = silhouettes.read_view(view, checked_frame(frame, silhouettes.n_frames))
    x, y = point
    if mask is not None and mask.any() and math.isfinite(x) and math.isfinite(y):
        rows, columns = np.nonzero(mask)
        away = np.hypot(columns - x, rows - y)
        nearest = int(away.argmin())
        if away[nearest] <= near:
            return int(columns[nearest]), int(rows[nearest])
    raise SilhouetteError("mask_repairs.nothing_there")


def _part_at(mask: Mask, seed: tuple[int, int]) -> Mask:
    """Return the connected part (H, W) of a mask at a foreground pixel."""
    labels = label_pieces(mask)[0]
    return np.asarray(labels == labels[seed[1], seed[0]])


def _find_again(
    mask: Mask | None, part: Mask, least_shared: float = 0.3, most_ratio: float = 2.5
) -> tuple[tuple[int, int], Mask] | None:
    """Return a pixel of the part in another mask, and the part there.

    They share at least ``least_shared`` of the smaller one. Beyond ``most_ratio`` of their areas the part has grown
    together with another, or has lost most of itself.
    """
    if mask is None or not (mask & part).any():
        return None
    labels = label_pieces(mask)[0]
    shared = np.bincount(labels[part], minlength=2)
    shared[0] = 0
    best = int(shared.argmax())
    found = labels == best
    areas = int(found.sum()), int(part.sum())
    if shared[best] < least_shared * min(areas) or max(areas) > most_ratio * min(areas):
        return None
    row, column = np.argwhere(found & part)[0]
    return (int(column), int(row)), found
