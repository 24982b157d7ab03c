"""Keypoints of people in the frames of one view.

Pixels: x to the right, y down, the centre of the first pixel at (0, 0), as in `dousa.estimation.cameras.camera`. A
point not seen is nan with visibility 0. A person has one track over the whole film.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, Mask
from dousa.errors import KeypointError
from dousa.messages import Message

MEDIAPIPE_NAMES = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb",
    "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel",
    "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
"""The 33 points of MediaPipe's pose models, in their order (left is the person's left)."""


@dataclass(frozen=True, slots=True, eq=False)
class PersonMasks:
    """Small masks of a person, each of a square cut out of the image, one bit a pixel.

    Parameters
    ----------
    packed : (T, S, S / 8) uint8, ``np.packbits`` along the width; may be mapped from a file.
    crops : (T, 2, 3) from pixels of the square (x, y, 1) to pixels of the image; nan where there is no mask.
    """

    packed: NDArray[np.uint8]
    crops: FloatArray

    def __post_init__(self) -> None:
        crops = _frozen(self.crops)
        if self.packed.ndim != 3 or self.packed.dtype != np.uint8 or self.packed.shape[1] != 8 * self.packed.shape[2]:
            raise KeypointError("keypoints.masks", found=str(self.packed.shape))
        if crops.shape != (len(self.packed), 2, 3):
            raise _shape_error("crops", (len(self.packed), 2, 3), crops.shape)
        object.__setattr__(self, "crops", crops)

    @property
    def present(self) -> BoolArray:
        """(T,) True where there is a mask."""
        return np.asarray(np.isfinite(self.crops).all(axis=(1, 2)))

    def read(self, frame: int, size: tuple[int, int], of: tuple[int, int] | None = None) -> Mask | None:
        """Return the mask (height, width) of a frame in the whole image; None where there is none.

        Parameters
        ----------
        frame : from 0.
        size : width and height of the mask.
        of : width and height of the film's images, if other than ``size``.
        """
        from dousa.extras import cv2

        if not self.present[frame]:
            return None
        width, height = size
        crop = self.crops[frame].copy()
        if of is not None:  # pixel centres are at whole numbers, so the edges are half a pixel before 0
            scale = np.array([width / of[0], height / of[1]])
            crop *= scale[:, None]
            crop[:, 2] += (scale - 1) / 2
        small = 255 * np.unpackbits(np.asarray(self.packed[frame]), axis=1)
        drawn = cv2.warpAffine(small, crop, (width, height), flags=cv2.INTER_LINEAR)
        return np.asarray(drawn > 127)


@dataclass(frozen=True, slots=True, eq=False)
class PersonTrack:
    """One person over all frames of a view.

    Parameters
    ----------
    points : (T, K, 2) px, nan where not seen.
    visibility : (T, K) 0 to 1, that the point is there and not hidden; set to 0 where the point is nan.
    world : (T, K, 3) m about the middle of the hips, along the axes of the camera: x right, y down, z forward; nan
        where not seen. None if unknown.
    masks : the person's pixels; None if unknown.
    """

    points: FloatArray
    visibility: FloatArray
    world: FloatArray | None = None
    masks: PersonMasks | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points, np.float64)
        if points.ndim != 3 or points.shape[2] != 2:
            raise _shape_error("points", ("T", "K", 2), points.shape)
        points[~np.isfinite(points).all(axis=2)] = np.nan
        seen = np.isfinite(points[..., 0])
        visibility = np.array(self.visibility, np.float64)
        if visibility.shape != points.shape[:2]:
            raise _shape_error("visibility", points.shape[:2], visibility.shape)
        visibility[~seen] = 0.0
        if not ((visibility >= 0) & (visibility <= 1)).all():
            raise KeypointError("keypoints.visibility")
        object.__setattr__(self, "points", _frozen(points))
        object.__setattr__(self, "visibility", _frozen(visibility))
        if self.world is not None:
            if np.shape(self.world) != (*points.shape[:2], 3):
                raise _shape_error("world", (*points.shape[:2], 3), np.shape(self.world))
            object.__setattr__(self, "world", _frozen(self.world))
        if self.masks is not None and len(self.masks.packed) != len(points):
            raise _shape_error("masks", (len(points), "S", "S / 8"), self.masks.packed.shape)

    @property
    def n_frames(self) -> int:
        """T."""
        return len(self.points)

    @property
    def present(self) -> BoolArray:
        """(T,) True where any point was seen."""
        return np.asarray(np.isfinite(self.points[..., 0]).any(axis=1))

    def boxes(self, least: float = 0.0) -> FloatArray:
        """Return boxes (T, 4) left, top, right, bottom px around the points above this visibility; nan without any."""
        used = self.visibility > least
        low = np.where(used[..., None], self.points, np.inf).min(axis=1, initial=np.inf)
        high = np.where(used[..., None], self.points, -np.inf).max(axis=1, initial=-np.inf)
        box = np.concatenate([low, high], axis=1)
        box[~np.isfinite(box).all(axis=1)] = np.nan
        return box


@dataclass(frozen=True, slots=True, eq=False)
class ViewKeypoints:
    """The people of one view.

    Parameters
    ----------
    names : (K,) of the points, `MEDIAPIPE_NAMES` or those of another scheme, spelled the same.
    people : one track each; most seen first where dousa finds or reads them.
    times : (T,) s of each frame since the first of the film, rising, perhaps unevenly.
    size : width and height of the upright image in px.
    source : the file or another origin.
    warnings : notes for the user.
    """

    names: tuple[str, ...]
    people: tuple[PersonTrack, ...]
    times: FloatArray
    size: tuple[int, int]
    source: str = ""
    warnings: tuple[Message, ...] = ()

    def __post_init__(self) -> None:
        names, people, times = tuple(self.names), tuple(self.people), _frozen(self.times)
        if not names or len(set(names)) != len(names) or not all(isinstance(name, str) and name for name in names):
            raise KeypointError("keypoints.names")
        if times.ndim != 1 or not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            raise KeypointError("keypoints.times")
        if len(self.size) != 2 or not all(0 < side < 100_000 and side == int(side) for side in self.size):
            raise KeypointError("keypoints.size", found=str(self.size))
        for person in people:
            if person.points.shape[:2] != (len(times), len(names)):
                raise _shape_error("points", (len(times), len(names), 2), person.points.shape)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "people", people)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))

    @property
    def n_frames(self) -> int:
        """T."""
        return len(self.times)

    @property
    def n_people(self) -> int:
        """Number of people."""
        return len(self.people)

    @property
    def frame_rate(self) -> float:
        """Hz, from the median distance between two frames; 30 for a single frame."""
        return 30.0 if len(self.times) < 2 else float(1.0 / np.median(np.diff(self.times)))

    def find(self, names: Sequence[str]) -> list[int]:
        """Return the places of points among ``names``; KeypointError for an unknown name."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise KeypointError("keypoints.no_point", missing=missing, names=self.names)
        return [self.names.index(name) for name in names]


def sort_people(people: Sequence[PersonTrack]) -> tuple[PersonTrack, ...]:
    """Sort people by the sum of all visibilities, greatest first."""
    return tuple(sorted(people, key=lambda person: -float(person.visibility.sum())))


def _frozen(values: ArrayLike) -> FloatArray:
    array = np.array(values, np.float64)
    array.flags.writeable = False
    return array


def _shape_error(field: str, expected: tuple[object, ...], found: tuple[int, ...]) -> KeypointError:
    words = "(" + ", ".join(map(str, expected)) + ")"
    return KeypointError("keypoints.shape", field=field, expected=words, found=str(found))
