"""Tracking of people from frame to frame, and their identities over the whole film.

Crops follow their landmarks; the detector runs only at times. A person followed without a break is one stretch. A
stretch is cut where two people touch and where its points jump, because there a crop may slide from one to the other.
Pieces that begin at about the same time are assigned to people together, with the least sum of costs (Kuhn 1955):
difference of colours, distance from the expected place, difference of size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Image, IntArray
from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES
from dousa.estimation.keypoints.pose_networks import (
    MASK_SIDE,
    N_BODY,
    CroppedMask,
    LandmarkNetwork,
    Landmarks,
    PersonCrop,
    PersonDetector,
    Shrinker,
    list_parts,
    redraw_mask,
)
from dousa.motion.runs import find_equal_runs

COLOUR_BINS = 4
"""Per channel, of the colours of the upper and of the lower half of a person."""
CORE = tuple(
    MEDIAPIPE_NAMES.index(f"{side}_{part}")
    for part in ("shoulder", "elbow", "hip", "knee", "ankle")
    for side in ("left", "right")
)
"""Landmarks that distinguish people."""

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
_HIDDEN = 0.6  # of a person's pixels that belong to another
_LOST_FOR, _TRY_EVERY = 60, 3  # frames for which a lost person is searched at the last place, and how often
_SMALLEST = 24.0  # px of a crop
_COLOUR_STEP = 4  # pixels of the crop
_MASK_STEP = 256 // MASK_SIDE


@dataclass(slots=True)
class _Followed:
    """A person seen a short time ago."""

    stretch: int
    frame: int
    crop: PersonCrop
    middle: FloatArray
    speed: FloatArray
    mask: CroppedMask


_Found = tuple[_Followed | None, Landmarks]


class PeopleFollower:
    """Find the people in consecutive frames, at most ``most_people`` at a time."""

    def __init__(self, detector: PersonDetector, landmarks: LandmarkNetwork, most_people: int) -> None:
        self._detector, self._landmarks, self._most = detector, landmarks, most_people
        self._followed: list[_Followed] = []
        self._lost: list[_Followed] = []
        self._n_stretches = 0

    def resume(self, sightings: NDArray[np.void], last_frame: int) -> None:
        """Continue after stored frames.

        Parameters
        ----------
        sightings : of `SIGHTING`, all, in their order.
        last_frame : the last processed frame.
        """
        self._n_stretches = 1 + int(sightings["stretch"].max(initial=-1))
        recent = sightings[sightings["frame"] > last_frame - _LOST_FOR - 2]
        self._followed, self._lost = [], []
        for frame in range(last_frame - _LOST_FOR - 1, last_frame + 1):
            self._keep(recent[recent["frame"] == frame], frame)

    def _keep(self, rows: NDArray[np.void], frame: int) -> None:
        """Store the people seen in a frame, and recently lost ones."""
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
        """Return the people (P,) of `SIGHTING` in the next frame (H, W, 3) red, green, blue."""
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
        """Where two crops show one person, drop the one that jumped."""
        kept: list[_Found] = []
        for one in sorted(found, key=lambda pair: _measure_jump(*pair)):
            if not any(are_same(one[1], other) for _, other in kept):
                kept.append(one)
        return sorted(kept, key=lambda pair: pair[0].stretch if pair[0] else 0)

    def _detect(self, picture: Shrinker, frame: int, found: list[_Found]) -> None:
        """Add people from the detector or at places of lost people, unless they are already found."""
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
        """Return the detector's crops, highest scores first.

        The detector works at 224 pixels, so at times it also searches parts of the image for small people.
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
    """Return whether landmarks are of a person inside the image and not too small."""
    if landmarks.score < _LEAST_SCORE or landmarks.crop.size < _SMALLEST:
        return False
    inside = ((landmarks.points >= -0.5) & (landmarks.points <= np.array(size) - 0.5)).all(axis=1)
    return bool((inside & (landmarks.visibility > 0.3)).sum() >= 4)


def are_same(one: Landmarks, other: Landmarks) -> bool:
    """Return whether two sets of landmarks are of one person."""
    seen = np.minimum(one.visibility, other.visibility)[list(CORE)] > 0.3
    core = np.array(CORE)[seen] if seen.sum() >= 3 else np.array(CORE)
    distance = np.linalg.norm(one.points[core] - other.points[core], axis=1).mean()
    return bool(distance < _SAME * min(one.crop.size, other.crop.size))


def hides(one: Landmarks, other: Landmarks) -> bool:
    """Return whether most of the second person's pixels belong to the first."""
    area = other.mask.sum()
    covered = other.mask & redraw_mask((one.mask, one.crop), other.crop, MASK_SIDE)
    return bool(area == 0 or covered.sum() > _HIDDEN * area)


def _measure_jump(known: _Followed | None, landmarks: Landmarks) -> float:
    """Compute the distance of a person from the expected place, in sizes of the crop."""
    if known is None:
        return math.inf
    off = measure_middle(landmarks.points) - known.middle - known.speed
    return float(np.hypot(*off)) / landmarks.crop.size


def measure_middle(points: NDArray[np.floating[Any]]) -> FloatArray:
    """Compute the middle (..., 2) of the core landmarks of (..., 33, 2)."""
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
    """Compute colour shares (2, bins) of a person's upper and lower half in the crop; zeros without pixels.

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


_TOUCH = 0.2  # of the crop's size between the middles of two people
_JUMP = 0.2  # of the crop's size, off the place where the person was expected
_TOGETHER_S = 0.3  # pieces that begin within this time are given to people together
_NEW = 1.1  # cost of a new person
_COLOUR, _PLACE, _SIZE, _SAME_STRETCH = 2.0, 0.5, 0.25, 0.6  # weights of the costs
_REACH, _SPEED = 0.15, 1.5  # crop sizes that a person may be off at once, and more per second
_MOST = 3.0
_GOES_ON_S = 0.6  # for which the motion of an unseen person is extrapolated
_LEAST_S, _LEAST_QUALITY, _LEAST_INSIDE = 0.3, 0.65, 0.95
_VISIBLE, _NEAR, _MOST_LOOKED_AT = 0.5, 2, 200  # visibility, px of the mask, sightings


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A part of a stretch that is of one person.

    Parameters
    ----------
    rows : places among the sightings, rising in time.
    stretch : the number of the stretch.
    """

    rows: IntArray
    stretch: int


@dataclass(slots=True)
class _Person:
    """The pieces of a person so far."""

    pieces: list[Piece] = field(default_factory=list)
    colours: FloatArray | None = None
    weight: float = 0.0


def find_identities(sightings: NDArray[np.void], times: FloatArray) -> list[IntArray]:
    """Return for each person of a film the places among the sightings, most seen first.

    A person has at most one sighting a frame; those with low quality or below a third of a second are left out.

    Parameters
    ----------
    sightings : of `people.SIGHTING`, rising in time.
    times : (T,) s of the frames.
    """
    pieces = cut_stretches(sightings)
    people: list[_Person] = []
    starts = [float(times[sightings["frame"][piece.rows[0]]]) for piece in pieces]
    first = 0
    while first < len(pieces):
        last = first
        while last < len(pieces) and starts[last] - starts[first] <= _TOGETHER_S:
            last += 1
        _give(pieces[first:last], people, sightings, times)
        first = last
    found = [np.concatenate([piece.rows for piece in person.pieces]) for person in people]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    least = min(_LEAST_S, 0.5 * step * len(times))  # a film may be shorter than that
    kept = [rows for rows in found if is_somebody(sightings, rows, step, least)]
    return sorted(kept, key=lambda rows: -_measure_presence(sightings, rows))


def _measure_presence(sightings: NDArray[np.void], rows: IntArray) -> float:
    """Sum the frames of a person, weighted by visibility and size."""
    visible = sightings["visibility"][rows][:, list(CORE)].astype(np.float64).mean(axis=1)
    return float((visible * np.sqrt(sightings["crop"][rows, 2])).sum())


def is_somebody(sightings: NDArray[np.void], rows: IntArray, step: float, least: float = _LEAST_S) -> bool:
    """Return whether the sightings at these places, ``step`` s apart, are of a person visible for ``least`` s."""
    if len(rows) * step < least and step < _LEAST_S:
        return False
    visible = sightings["visibility"][rows][:, list(CORE)].astype(np.float64)
    best = np.maximum(visible[:, :6].mean(axis=1), visible[:, 4:].mean(axis=1))  # arms and hips, hips and legs
    if np.percentile(best * sightings["score"][rows], 25) < _LEAST_QUALITY:
        return False
    sample = rows[:: max(1, len(rows) // _MOST_LOOKED_AT)]
    return float(np.percentile([measure_inside(sightings[row]) for row in sample], 25)) >= _LEAST_INSIDE


def measure_inside(row: np.void) -> float:
    """Compute the share of the visible landmarks of a sighting that lie on its mask: nearly all, if it is a person."""
    points = row["points"][list(CORE)][row["visibility"][list(CORE)] > _VISIBLE].astype(np.float64)
    side = len(row["mask"])
    x, y, size, angle = row["crop"].tolist()
    inverse = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]) * (side / size)
    places = (points - (x, y)) @ inverse.T + (side - 1) / 2
    mask = np.pad(np.unpackbits(row["mask"], axis=1).astype(bool), _NEAR)
    columns, rows = np.clip(np.rint(places).astype(int) + _NEAR, 0, side + 2 * _NEAR - 1).T
    near = [
        mask[max(0, down - _NEAR) : down + _NEAR + 1, max(0, column - _NEAR) : column + _NEAR + 1].any()
        for down, column in zip(rows, columns, strict=True)
    ]
    return float(np.mean(near)) if near else 0.0


def cut_stretches(sightings: NDArray[np.void]) -> list[Piece]:
    """Return the pieces of all stretches, in the order in which they begin."""
    middles, sizes = measure_middle(sightings["points"]), sightings["crop"][:, 2]
    touching = np.zeros(len(sightings), bool)
    for start, stop in find_equal_runs(sightings["frame"]):
        apart = np.linalg.norm(middles[start:stop, None] - middles[None, start:stop], axis=2)
        near = apart < _TOUCH * np.minimum(sizes[start:stop, None], sizes[None, start:stop])
        touching[start:stop] = near.sum(axis=1) > 1
    pieces = []
    for stretch in np.unique(sightings["stretch"]):
        rows = np.flatnonzero(sightings["stretch"] == stretch)
        cuts = find_equal_runs(touching[rows])[1:, 0]
        moves = np.diff(middles[rows], axis=0, prepend=middles[rows[:1]])
        off = np.linalg.norm(np.diff(moves, axis=0, prepend=moves[:1]), axis=1) / sizes[rows]
        cuts = np.union1d(cuts, np.flatnonzero(off > _JUMP)).astype(int)
        pieces += [Piece(part, int(stretch)) for part in np.split(rows, cuts) if len(part)]
    return sorted(pieces, key=lambda piece: int(piece.rows[0]))


def _give(pieces: Sequence[Piece], people: list[_Person], sightings: NDArray[np.void], times: FloatArray) -> None:
    """Assign pieces that begin at about the same time to known or new people."""
    left = list(pieces)
    while left:
        # pieces of one person may follow each other within the group: one round for each
        now: list[Piece] = []
        later: list[Piece] = []
        for piece in left:
            before = [one for one in now if sightings["frame"][one.rows[-1]] < sightings["frame"][piece.rows[0]]]
            (later if before else now).append(piece)
        costs = np.full((len(now), len(people) + len(now)), _NEW)
        for row, piece in enumerate(now):
            for column, person in enumerate(people):
                costs[row, column] = _measure_cost(piece, person, sightings, times)
        for row, column in enumerate(assign(costs)):
            if column >= len(people) or costs[row, column] >= _NEW:
                people.append(_Person())
                _add(now[row], people[-1], sightings)
            else:
                _add(now[row], people[column], sightings)
        left = later


def _add(piece: Piece, person: _Person, sightings: NDArray[np.void]) -> None:
    colours = _mean_colours(piece, sightings)
    weight = float(min(len(piece.rows), 60))
    total = person.weight + weight
    person.colours = colours if person.colours is None else (person.weight * person.colours + weight * colours) / total
    person.weight = min(total, 300.0)
    person.pieces.append(piece)


def _mean_colours(piece: Piece, sightings: NDArray[np.void]) -> FloatArray:
    return np.asarray(sightings["colours"][piece.rows].astype(np.float64).mean(axis=0))


def _measure_cost(piece: Piece, person: _Person, sightings: NDArray[np.void], times: FloatArray) -> float:
    """Compute the cost of assigning a piece to a person; 1e6 where both are seen at the same time."""
    last = person.pieces[-1]
    begin, end = sightings[piece.rows[0]], sightings[last.rows[-1]]
    if begin["frame"] <= end["frame"]:
        return 1e6
    gap = float(times[begin["frame"]] - times[end["frame"]])
    size = float(min(begin["crop"][2], end["crop"][2]))
    place = measure_middle(end["points"])
    if len(last.rows) > 3 and gap < 1.0:
        back = sightings[last.rows[-min(len(last.rows), 9)]]
        took = float(times[end["frame"]] - times[back["frame"]])
        place = place + (place - measure_middle(back["points"])) * min(gap, _GOES_ON_S) / max(took, 1e-3)
    off = float(np.hypot(*(measure_middle(begin["points"]) - place))) / size / (_REACH + _SPEED * gap)
    grown = abs(math.log(float(begin["crop"][2]) / float(end["crop"][2]))) / (0.2 + gap)
    colours = _mean_colours(piece, sightings)
    unlike = 0.0 if person.colours is None else 1 - float(np.minimum(colours, person.colours).sum(axis=1).mean())
    cost = _COLOUR * unlike + _PLACE * min(off, _MOST) + _SIZE * min(grown, _MOST)
    return cost - (_SAME_STRETCH if last.stretch == piece.stretch else 0.0)


def assign(costs: FloatArray) -> list[int]:
    """Return the column (N,) of each row of a matrix (N, M >= N) of costs, each once, with the least sum."""
    from scipy.optimize import linear_sum_assignment

    return [int(column) for column in linear_sum_assignment(costs)[1]]
