"""Whether a film was taken by one camera that stands still, without a cut.

Corners of the first picture are looked for in later ones (Lucas and Kanade 1981, there and back). Where most lie as one
similarity has moved them, the camera has moved. Where they are gone, the pictures before are compared one by one: at a
cut they go from one picture to the next. A person who comes before the lens does neither. A cut that leaves the
camera where it was is not seen.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import CalibrationError
from dousa.extras import cv2, require
from dousa.messages import Message, Progress

_SIDE = 640  # px, longer side of the pictures that are compared, of larger ones
_LIMIT = 0.01  # of the longer side: at 3 m, by a lens of 70 degrees, 4 cm, the error of an estimate
_BLANK = 4.0  # grey levels, spread of a black or white picture with the noise of a camera


class _Picture(NamedTuple):
    """A small grey picture (H, W), and its time, s since the first one of the film."""

    seconds: float
    grey: NDArray[np.uint8]


class _Change(NamedTuple):
    """From one picture to another: shares of corners found again, and found in place; how far the scene moves.

    ``moved`` (4, 2) is that of the picture's four edges by its longer side, nan where nothing moves as a whole.
    """

    found: float
    in_place: float
    moved: FloatArray


def check_steady(path: str | os.PathLike[str], progress: Progress | None = None, *, gone: float = 0.3) -> None:
    """Raise CalibrationError if a film has a cut, or if its camera moves by more than 1 % of the longer side.

    Parameters
    ----------
    path : a film; what cannot be read is left to those who read it.
    progress : called with (s looked at, s in all, what).
    gone : share of the first picture's corners; with fewer in their place the pictures before are looked at.
    """
    report = progress or (lambda done, total, what: None)
    first: _Picture | None = None
    corners: FloatArray = np.zeros((0, 1, 2))
    before = 0.0
    for picture, duration in _sample(path):
        report(int(picture.seconds), int(duration) + 1, Message("steady.looking", film=os.path.basename(path)))
        change = None if first is None else _compare(first, picture, corners)
        if first is not None and change is not None and _exceeds(change.moved):
            raise _say_moves(path, first.seconds, picture.seconds, change.moved)
        if change is not None and change.in_place < gone:
            _look_closer(path, before, picture.seconds)
            first = None  # it is hidden: from now on the pictures are compared with this one
        before = picture.seconds
        if first is None and (found := _find_corners(picture)) is not None:
            first, corners = picture, found


def _look_closer(
    path: str | os.PathLike[str], first: float, last: float, *, lost: float = 0.2, kept: float = 0.5, more: float = 0.2
) -> None:
    """Compare each picture with the next, ``more`` s longer.

    At a cut less than the share ``lost`` of the corners is found again, but ``kept`` from the pictures before and after
    to the next: noise before a covered lens is not found again in any picture.
    """
    moved = np.zeros((4, 2))
    times, found = [], []
    for one, other in pairwise(_read(path, max(0.0, first - more), last + more)):
        corners = _find_corners(one)
        change = None if corners is None else _compare(one, other, corners)
        times.append(other.seconds)
        found.append(0.0 if change is None else change.found)
        if change is not None and first <= one.seconds and other.seconds <= last:
            moved += np.nan_to_num(change.moved)
    shares = np.array([1.0, *found, 1.0])
    cuts = (shares[1:-1] < lost) & (shares[:-2] > kept) & (shares[2:] > kept)
    if cuts.any():
        raise CalibrationError("steady.cut", seconds=times[int(np.argmax(cuts))]).at(path)
    if _exceeds(moved):
        raise _say_moves(path, first, last, moved)


def _exceeds(moved: FloatArray) -> bool:
    return bool((np.linalg.norm(moved, axis=1) > _LIMIT).any())


def _say_moves(path: str | os.PathLike[str], first: float, last: float, moved: FloatArray) -> CalibrationError:
    share = float(np.linalg.norm(moved, axis=1).max())
    return CalibrationError("steady.moves", first=first, last=last, share=share).at(path)


def _find_corners(picture: _Picture, most: int = 400, least: int = 40) -> FloatArray | None:
    """Return corners (N, 1, 2) px all over a picture, None where fewer than ``least``: it is blank, or nearly."""
    corners = cv2.goodFeaturesToTrack(picture.grey, most, 0.01, 10)
    return None if corners is None or len(corners) < least else np.asarray(corners)


def _compare(one: _Picture, other: _Picture, corners: FloatArray, sure: float = 0.5) -> _Change | None:
    """Compare two pictures by the corners (N, 1, 2) of the first, which are found again within ``sure`` px."""
    spread = float(other.grey.std())
    if spread < _BLANK:
        return None
    gain = float(one.grey.std()) / spread  # a light that is switched is no cut
    grey = np.clip(one.grey.mean() + gain * (other.grey - other.grey.mean()), 0, 255).astype(np.uint8)
    there, forth = _follow(one.grey, grey, corners)
    back, home = _follow(grey, one.grey, there)
    found = forth & home & (np.linalg.norm(back - corners, axis=2)[:, 0] < sure)
    before, after = corners[found, 0], there[found, 0]
    away = np.linalg.norm(after - before, axis=1)
    height, width = one.grey.shape
    moved = _move_edges(before, after, (width, height))
    return _Change(float(found.mean()), float((away < _LIMIT * max(width, height)).sum() / len(corners)), moved)


def _follow(one: NDArray[np.uint8], other: NDArray[np.uint8], corners: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return where corners (N, 1, 2) px of one picture are in another, and (N,) whether they were found."""
    there, good, _ = cv2.calcOpticalFlowPyrLK(one, other, corners, corners.copy())
    return np.asarray(there), np.asarray(good)[:, 0] > 0


def _move_edges(before: FloatArray, after: FloatArray, size: tuple[int, int], least: int = 20) -> FloatArray:
    """Return how far the similarity of most corners, ``least`` or more, moves the picture's edges, see `_Change`.

    They must lie all over it, as a background does and a person does not.
    """
    nothing = np.full((4, 2), np.nan)
    if len(before) < least:
        return nothing
    similar, kept = cv2.estimateAffinePartial2D(before, after, ransacReprojThreshold=1.5)
    if similar is None or kept.sum() < max(least, 0.5 * len(before)):
        return nothing
    spread = np.ptp(np.quantile(before[kept[:, 0] > 0], (0.1, 0.9), axis=0), axis=0)
    if (spread < 0.5 * np.array(size)).any():
        return nothing
    edges = np.array([(0, 0), (size[0], 0), (0, size[1]), size], np.float64)
    return np.asarray(edges @ similar[:, :2].T + similar[:, 2] - edges) / max(size)


def _sample(path: str | os.PathLike[str], every: float = 0.5, long: float = 60.0) -> Iterator[tuple[_Picture, float]]:
    """Yield pictures ``every`` s, and the film's length in s; of films of over ``long`` s only key pictures."""
    av = require("av", "film")
    try:
        with av.open(os.fspath(path)) as container:
            duration = (container.duration or 0) / av.time_base
    except (av.error.FFmpegError, OSError, ValueError):
        return
    for keys_only in (True, False) if duration > long else (False,):
        last = 0.0
        for picture in _read(path, every=every, keys_only=keys_only):
            last = picture.seconds
            yield picture, duration
        if last > 0:
            return  # else there is one key picture, and all the others must do


def _read(
    path: str | os.PathLike[str],
    first: float = 0.0,
    last: float = np.inf,
    *,
    every: float = 0.0,
    keys_only: bool = False,
) -> Iterator[_Picture]:
    """Yield the pictures between two times, ``every`` s; none from where the film cannot be read on."""
    av = require("av", "film")
    try:
        with av.open(os.fspath(path)) as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            if keys_only:
                stream.codec_context.skip_frame = "NONKEY"
            begin = float((stream.start_time or 0) * stream.time_base)
            if first > 0:
                container.seek(int((first + begin) / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                seconds = float(frame.time or 0.0) - begin
                if seconds > last:
                    return
                if seconds >= first:
                    first = seconds + every
                    yield _Picture(seconds, _shrink(frame))
    except (av.error.FFmpegError, OSError, ValueError, IndexError):
        return


def _shrink(frame: Any) -> NDArray[np.uint8]:
    scale = min(1.0, _SIDE / max(frame.width, frame.height))
    size = {"width": max(1, round(scale * frame.width)), "height": max(1, round(scale * frame.height))}
    return np.asarray(frame.reformat(format="gray", interpolation="AREA", **size).to_ndarray(), np.uint8)
