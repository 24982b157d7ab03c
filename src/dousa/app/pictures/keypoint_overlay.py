"""Keypoints drawn over their film: who was found where, and which side is which.

A person has one colour, number and outline; the bones of the left side are drawn through, those of the right are
broken; a point that is thought to be hidden is a ring.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.pictures.canvas import BLUE, GREEN, PURPLE, VERMILLION
from dousa.app.pictures.overlay import write_video
from dousa.app.pictures.overlay_view import DARK, WHITE, draw_lines, find_outlines, to_bgr, write_text
from dousa.arrays import FloatArray, Image
from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.estimation import PersonTrack, ViewKeypoints

_LONGEST = 960  # px of a side, by definition of the picture
_LIMBS = ("shoulder elbow", "elbow wrist", "shoulder hip", "hip knee", "knee ankle", "ankle heel", "ankle foot_index",
          "ankle big_toe", "wrist index")  # fmt: skip
BONES = (
    *((f"{side}_{first}", f"{side}_{last}") for side in ("left", "right") for first, last in map(str.split, _LIMBS)),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
)
"""Bones of all schemes of points: what a scheme does not have is left out."""


_COLOURS = tuple(map(to_bgr, (VERMILLION, BLUE, GREEN, PURPLE, "#E69F00", "#56B4E9")))


def draw_people(canvas: Image, keypoints: ViewKeypoints, frame: int, scale: float) -> None:
    """Draw the people of a frame over its picture, in place.

    Parameters
    ----------
    canvas : (H, W, 3) blue, green, red.
    keypoints : of the film.
    frame : from 0.
    scale : of the canvas, compared with the film.
    """
    for number, person in enumerate(keypoints.people):
        if person.present[frame]:
            _draw_person(canvas, keypoints, person, frame, scale, number)


def _draw_person(
    canvas: Image, keypoints: ViewKeypoints, person: PersonTrack, frame: int, scale: float, number: int
) -> None:
    from dousa.extras import cv2

    colour = _COLOURS[number % len(_COLOURS)]
    points: FloatArray = (person.points[frame] + 0.5) * scale - 0.5
    if person.masks is not None:
        mask = person.masks.read(frame, (canvas.shape[1], canvas.shape[0]), keypoints.size)
        if mask is not None:
            draw_lines(canvas, find_outlines(mask), colour, closed=True)
    places = {name: point for name, point in zip(keypoints.names, points, strict=True) if np.isfinite(point).all()}
    for first, last in BONES:
        if first in places and last in places:
            dashed = first.startswith("right") and last.startswith("right")
            draw_lines(canvas, [np.stack([places[first], places[last]])], colour, 2, dashed=dashed)
    for name, visibility in zip(keypoints.names, person.visibility[frame], strict=True):
        if name in places:
            at = tuple(int(value) for value in np.rint(places[name]))
            cv2.circle(canvas, at, 3, *((WHITE, -1) if visibility > 0.5 else (colour, 1)))
    if places:
        high = min(places.values(), key=lambda point: float(point[1]))
        write_text(canvas, str(number + 1), (int(high[0]) + 6, max(22, int(high[1]) - 8)), colour, 22, bold=True)


def _paint(keypoints: ViewKeypoints, longest: int) -> Iterator[tuple[int, Image]]:
    from dousa.estimation.keypoints.films import FilmFrames
    from dousa.extras import cv2

    width, height, scale = _fit(keypoints.size, longest)
    with FilmFrames(keypoints.source) as film:
        if film.size != keypoints.size:
            raise OptionError("keypoint_overlay.other_film", path=film.path)
        for frame, seconds, picture in film.read():
            if frame >= keypoints.n_frames:
                return
            small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            canvas = np.ascontiguousarray(small[..., ::-1], np.uint8)
            draw_people(canvas, keypoints, frame, scale)
            text = f"{frame}   {seconds:.2f} s"
            write_text(canvas, text, (9, height - 9), DARK, 16, bold=True)
            write_text(canvas, text, (8, height - 10), WHITE, 16, bold=True)
            yield frame, canvas


def _fit(size: tuple[int, int], longest: int) -> tuple[int, int, float]:
    """Width and height, even as codecs want them, and the scale."""
    scale = min(1.0, longest / max(size))
    width, height = (max(2, round(side * scale / 2) * 2) for side in size)
    return width, height, width / size[0]


def write_keypoint_overlay(
    keypoints: ViewKeypoints, path: str | os.PathLike[str], progress: ProgressCallback | None = None
) -> None:
    """Write a video of the film with its keypoints.

    Parameters
    ----------
    keypoints : of a film; their ``source`` is read again.
    path : .mp4, .mkv or .avi.
    progress : called with (frames done, frames, what).

    Raises
    ------
    OptionError : another suffix, or the source is another film.
    KeypointError : the film cannot be read.
    MotionWriteError : the disk refuses; the target is left as it was.
    """
    width, height, _ = _fit(keypoints.size, _LONGEST)

    def paint() -> Iterator[Image]:
        for frame, picture in _paint(keypoints, _LONGEST):
            yield picture
            if progress is not None and frame % 10 == 0:
                progress(frame + 1, keypoints.n_frames, Message("pictures.overlay_video"))

    write_video(path, paint(), keypoints.n_frames, keypoints.frame_rate, (width, height))
