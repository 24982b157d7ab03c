"""Following people from frame to frame: crops follow their landmarks, the detector runs only now and then.

What comes out are stretches: somebody who is followed without a break has one number. Who is the same person before
and after a break, or after people have crossed, is settled over the whole film by `identities`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Image
from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES
from dousa.estimation.keypoints.person_crops import PersonCrop, Shrinker, list_parts
from dousa.estimation.keypoints.pose_networks import (
    MASK_SIDE,
    N_BODY,
    CroppedMask,
    LandmarkNetwork,
    Landmarks,
    PersonDetector,
    redraw_mask,
)

COLOUR_BINS = 4
"""Per channel, of the colours of the upper and of the lower half of a person."""
CORE = tuple(
    MEDIAPIPE_NAMES.index(f"{side}_{part}")
    for part in ("shoulder", "elbow", "hip", "knee", "ankle")
    for side in ("left", "right")
)
"""Landmarks by which people are told apart."""

SIGHTING = np.dtype(
    [
        ("frame", "<i4"),
        ("stretch", "<i4"),  # number of the stretch
        ("score", "<f4"),
        ("points", "<f4", (N_BODY, 2)),
        ("visibility", "<f4", (N_BODY,)),
        ("world", "<f4", (N_BODY, 3)),
        ("crop", "<f8", (4,)),  # x, y, size, angle
        ("next_crop", "<f8", (4,)),
        ("colours", "<f4", (2, COLOUR_BINS**3)),  # shares, upper and lower half
        ("mask", "u1", (MASK_SIDE, MASK_SIDE // 8)),
    ]
)
"""One person in one frame, as it is kept on the disk."""

_LEAST_SCORE = 0.5
_DETECT_EVERY = 15  # frames
_SMALL_EVERY, _SMALL_PARTS = 4, 448  # of these looks, one at parts of half the side; px of the picture's shorter side
_SAME = 0.07  # of the crop's size: landmarks that are nearer than this, on average, are of one person
_HIDDEN = 0.6  # of somebody's pixels that are another's
_LOST_FOR, _TRY_EVERY = 60, 3  # frames that somebody is looked for where they were, and how often
_SMALLEST = 24.0  # px of a crop
_COLOUR_STEP = 4  # pixels of the crop
_MASK_STEP = 256 // MASK_SIDE


@dataclass(slots=True)
class _Followed:
    """Somebody who was seen a short time ago."""

    stretch: int
    frame: int
    crop: PersonCrop
    middle: FloatArray
    speed: FloatArray
    mask: CroppedMask


_Found = tuple[_Followed | None, Landmarks]


class PeopleFollower:
    """Finds the people in frames that come in turn.

    Parameters
    ----------
    detector, landmarks : the networks.
    most_people : that are followed at a time.
    """

    def __init__(self, detector: PersonDetector, landmarks: LandmarkNetwork, most_people: int) -> None:
        self._detector, self._landmarks, self._most = detector, landmarks, most_people
        self._followed: list[_Followed] = []
        self._lost: list[_Followed] = []
        self._n_stretches = 0

    def resume(self, sightings: NDArray[np.void], last_frame: int) -> None:
        """Go on after what was kept of earlier frames, as if there had been no break.

        Parameters
        ----------
        sightings : of `SIGHTING`, all, in their order.
        last_frame : that was looked at.
        """
        self._n_stretches = 1 + int(sightings["stretch"].max(initial=-1))
        recent = sightings[sightings["frame"] > last_frame - _LOST_FOR - 2]
        self._followed, self._lost = [], []
        for frame in range(last_frame - _LOST_FOR - 1, last_frame + 1):
            self._keep(recent[recent["frame"] == frame], frame)

    def _keep(self, rows: NDArray[np.void], frame: int) -> None:
        """Remember who was seen in a frame, and for a while who was not."""
        before = {one.stretch: one for one in self._followed}
        self._followed = []
        for row in rows:
            if not np.isfinite(row["next_crop"]).all():
                continue
            stretch, middle = int(row["stretch"]), measure_middle(row["points"])
            known = before.pop(stretch, None)
            speed = np.zeros(2) if known is None else middle - known.middle
            mask = (np.unpackbits(row["mask"], axis=1).astype(bool), _to_crop(row["crop"]))
            self._followed.append(_Followed(stretch, frame, _to_crop(row["next_crop"]), middle, speed, mask))
        self._lost = [one for one in (*self._lost, *before.values()) if frame - one.frame < _LOST_FOR]

    def see(self, frame: int, picture: Image) -> NDArray[np.void]:
        """The people (P,) of `SIGHTING` in the next frame (H, W, 3) red, green, blue."""
        shrinker = Shrinker(picture)
        found: list[_Found] = []
        for one in self._followed:
            others = [other.mask for other in self._followed if other is not one]
            landmarks = self._landmarks.find(shrinker, one.crop, others, one.mask)
            if _is_person(landmarks, shrinker.size):
                found.append((one, landmarks))
        found = self._drop_doubles(found)
        if len(found) < len(self._followed) or not found or self._lost or frame % _DETECT_EVERY == 0:
            self._detect(shrinker, frame, found)
        rows = np.zeros(len(found), SIGHTING)
        for row, (known, landmarks) in zip(rows, found, strict=True):
            if known is None:
                stretch, self._n_stretches = self._n_stretches, self._n_stretches + 1
            else:
                stretch = known.stretch
            _fill(row, frame, stretch, landmarks)
        self._keep(rows, frame)
        return rows

    def _drop_doubles(self, found: list[_Found]) -> list[_Found]:
        """Where two crops have slid onto one person, the one is dropped that jumped."""
        kept: list[_Found] = []
        for one in sorted(found, key=lambda pair: _measure_jump(*pair)):
            if not any(are_same(one[1], other) for _, other in kept):
                kept.append(one)
        return sorted(kept, key=lambda pair: pair[0].stretch if pair[0] else 0)

    def _detect(self, picture: Shrinker, frame: int, found: list[_Found]) -> None:
        """Add the people that the detector finds besides those that are followed, or who are where they were lost."""
        crops = [one.crop for one in self._lost if (frame - one.frame) % _TRY_EVERY == 0]
        if not found or frame % _DETECT_EVERY == 0 or len(found) < len(self._followed):
            crops += self._list_detections(picture, frame)
        for crop in crops:
            if len(found) >= self._most:
                break
            if any(_is_near(crop, landmarks.next_crop) for _, landmarks in found):
                continue
            others = [(other.mask, other.crop) for _, other in found]
            landmarks = self._landmarks.find(picture, crop, others)
            if landmarks.score >= _LEAST_SCORE and landmarks.next_crop is not None:
                landmarks = self._landmarks.find(picture, landmarks.next_crop, others)
            if _is_person(landmarks, picture.size) and not any(
                are_same(landmarks, other) or hides(other, landmarks) for _, other in found
            ):
                found.append((None, landmarks))

    def _list_detections(self, picture: Shrinker, frame: int) -> list[PersonCrop]:
        """What the detector finds, the surest first.

        It sees a picture at 224 pixels only: at times parts of the picture are looked at for people who are small.
        """
        detections = self._detector.find(picture)
        n_looks, is_look = divmod(frame, _DETECT_EVERY)
        if is_look == 0:
            short = min(picture.size)
            parts = list_parts(picture.size, short) if max(picture.size) > 1.1 * short else []
            if n_looks % _SMALL_EVERY == 0 and short >= _SMALL_PARTS:
                parts += list_parts(picture.size, short // 2)
            detections += [detection for part in parts for detection in self._detector.find(picture, part)]
        return [detection.crop for detection in sorted(detections, key=lambda one: -one.score)]


def _is_near(crop: PersonCrop, other: PersonCrop | None) -> bool:
    if other is None:
        return False
    distance = math.hypot(crop.x - other.x, crop.y - other.y)
    return distance < 0.12 * min(crop.size, other.size) and 0.6 < crop.size / other.size < 1.6


def _is_person(landmarks: Landmarks, size: tuple[int, int]) -> bool:
    """Whether there is somebody, in the picture, of more than a few pixels."""
    if landmarks.score < _LEAST_SCORE or landmarks.crop.size < _SMALLEST:
        return False
    inside = ((landmarks.points >= -0.5) & (landmarks.points <= np.array(size) - 0.5)).all(axis=1)
    return bool((inside & (landmarks.visibility > 0.3)).sum() >= 4)


def are_same(one: Landmarks, other: Landmarks) -> bool:
    """Whether two sets of landmarks are of one person."""
    seen = np.minimum(one.visibility, other.visibility)[list(CORE)] > 0.3
    core = np.array(CORE)[seen] if seen.sum() >= 3 else np.array(CORE)
    distance = np.linalg.norm(one.points[core] - other.points[core], axis=1).mean()
    return bool(distance < _SAME * min(one.crop.size, other.crop.size))


def hides(one: Landmarks, other: Landmarks) -> bool:
    """Whether most of the other's pixels are those of the one."""
    area = other.mask.sum()
    covered = other.mask & redraw_mask((one.mask, one.crop), other.crop, MASK_SIDE)
    return bool(area == 0 or covered.sum() > _HIDDEN * area)


def _measure_jump(known: _Followed | None, landmarks: Landmarks) -> float:
    """How far somebody is from where they were expected, in sizes of the crop."""
    if known is None:
        return math.inf
    off = measure_middle(landmarks.points) - known.middle - known.speed
    return float(np.hypot(*off)) / landmarks.crop.size


def measure_middle(points: NDArray[np.floating[Any]]) -> FloatArray:
    """(..., 2) the middle of the landmarks (..., 33, 2) by which people are told apart."""
    return np.asarray(points[..., list(CORE), :].astype(np.float64).mean(axis=-2))


def _fill(row: np.void | NDArray[np.void], frame: int, stretch: int, landmarks: Landmarks) -> None:
    row["frame"], row["stretch"], row["score"] = frame, stretch, landmarks.score
    row["points"], row["visibility"], row["world"] = landmarks.points, landmarks.visibility, landmarks.world
    row["crop"] = _to_row(landmarks.crop)
    row["next_crop"] = np.nan if landmarks.next_crop is None else _to_row(landmarks.next_crop)
    row["colours"] = count_colours(landmarks.colours, landmarks.mask)
    row["mask"] = np.packbits(landmarks.mask, axis=1)


def _to_crop(row: NDArray[np.float64]) -> PersonCrop:
    return PersonCrop(*(float(value) for value in row))


def _to_row(crop: PersonCrop) -> Sequence[float]:
    return crop.x, crop.y, crop.size, crop.angle


def count_colours(colours: Image, mask: NDArray[np.bool_]) -> FloatArray:
    """(2, bins) shares of the colours of a person's upper and lower half, in the crop; zeros where there is nothing.

    Parameters
    ----------
    colours : (256, 256, 3) pixels of the crop.
    mask : (128, 128) the person.
    """
    shares = np.zeros((2, COLOUR_BINS**3))
    small = colours[::_COLOUR_STEP, ::_COLOUR_STEP].astype(np.int64) * COLOUR_BINS // 256
    person = mask[:: _COLOUR_STEP // _MASK_STEP, :: _COLOUR_STEP // _MASK_STEP]
    numbers = (small[..., 0] * COLOUR_BINS + small[..., 1]) * COLOUR_BINS + small[..., 2]
    rows = np.flatnonzero(person.any(axis=1))
    if len(rows):
        border = int(rows[0] + rows[-1] + 1) // 2
        for half, part in enumerate((slice(None, border), slice(border, None))):
            counts = np.bincount(numbers[part][person[part]], minlength=COLOUR_BINS**3)
            shares[half] = counts / max(1, counts.sum())
    return shares
