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
from typing import Any, NamedTuple

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
"""Per channel, of the colours of the upper and of the lower half of a person, by definition of `SIGHTING`."""
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
"""One person in one frame, by definition as it is kept on the disk."""


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
    """Find the people in consecutive frames.

    Parameters
    ----------
    detector, landmarks : the networks.
    most_people : that are followed at a time.
    detect_every : frames from one look of the detector to the next, while no person is lost.
    small_every : such looks from one at parts of half the image's shorter side to the next, if that has
    small_side : px at least.
    lost_for, try_every : frames for which a lost person is searched at the last place, and from one try to the next.
    least_score : of landmarks, 0 to 1, that are a person's.
    smallest : px, the least side of a person's crop.
    """

    def __init__(
        self, detector: PersonDetector, landmarks: LandmarkNetwork, most_people: int, *, detect_every: int = 15,
        small_every: int = 4, small_side: int = 448, lost_for: int = 60, try_every: int = 3, least_score: float = 0.5,
        smallest: float = 24.0,
    ) -> None:  # fmt: skip
        self._detector, self._landmarks, self._most = detector, landmarks, most_people
        self._detect_every, self._small_every, self._small_side = detect_every, small_every, small_side
        self._lost_for, self._try_every = lost_for, try_every
        self._least_score, self._smallest = least_score, smallest
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
        recent = sightings[sightings["frame"] > last_frame - self._lost_for - 2]
        self._followed, self._lost = [], []
        for frame in range(last_frame - self._lost_for - 1, last_frame + 1):
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
            mask = (np.unpackbits(row["mask"], axis=1).astype(bool), PersonCrop(*row["crop"].tolist()))
            self._followed.append(
                _Followed(stretch, frame, PersonCrop(*row["next_crop"].tolist()), middle, speed, mask)
            )
        self._lost = [one for one in (*self._lost, *before.values()) if frame - one.frame < self._lost_for]

    def see(self, frame: int, picture: Image) -> NDArray[np.void]:
        """Return the people (P,) of `SIGHTING` in the next frame (H, W, 3) red, green, blue."""
        shrinker = Shrinker(picture)
        found: list[_Found] = []
        for one in self._followed:
            others = [other.mask for other in self._followed if other is not one]
            landmarks = self._landmarks.find(shrinker, one.crop, others, one.mask)
            if self._is_person(landmarks, shrinker.size):
                found.append((one, landmarks))
        found = self._drop_doubles(found)
        if len(found) < len(self._followed) or not found or self._lost or frame % self._detect_every == 0:
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
        crops = [one.crop for one in self._lost if (frame - one.frame) % self._try_every == 0]
        if not found or frame % self._detect_every == 0 or len(found) < len(self._followed):
            crops += self._list_detections(picture, frame)
        for crop in crops:
            if len(found) >= self._most:
                break
            if any(_is_near(crop, landmarks.next_crop) for _, landmarks in found):
                continue
            others = [(other.mask, other.crop) for _, other in found]
            landmarks = self._landmarks.find(picture, crop, others)
            if landmarks.score >= self._least_score and landmarks.next_crop is not None:
                landmarks = self._landmarks.find(picture, landmarks.next_crop, others)
            if self._is_person(landmarks, picture.size) and not any(
                are_same(landmarks, other) or hides(other, landmarks) for _, other in found
            ):
                found.append((None, landmarks))

    def _list_detections(self, picture: Shrinker, frame: int) -> list[PersonCrop]:
        """Return the detector's crops, highest scores first.

        The detector works at 224 pixels, so at times it also searches parts of the image for small people.
        """
        detections = self._detector.find(picture)
        n_looks, is_look = divmod(frame, self._detect_every)
        if is_look == 0:
            short = min(picture.size)
            parts = list_parts(picture.size, short) if max(picture.size) > 1.1 * short else []
            if n_looks % self._small_every == 0 and short >= self._small_side:
                parts += list_parts(picture.size, short // 2)
            detections += [detection for part in parts for detection in self._detector.find(picture, part)]
        return [detection.crop for detection in sorted(detections, key=lambda one: -one.score)]

    def _is_person(self, landmarks: Landmarks, size: tuple[int, int]) -> bool:
        """Return whether landmarks are of a person inside the image and not too small."""
        if landmarks.score < self._least_score or landmarks.crop.size < self._smallest:
            return False
        inside = ((landmarks.points >= -0.5) & (landmarks.points <= np.array(size) - 0.5)).all(axis=1)
        return bool((inside & (landmarks.visibility > 0.3)).sum() >= 4)


def _is_near(crop: PersonCrop, other: PersonCrop | None) -> bool:
    if other is None:
        return False
    distance = math.hypot(crop.x - other.x, crop.y - other.y)
    return distance < 0.12 * min(crop.size, other.size) and 0.6 < crop.size / other.size < 1.6


def are_same(one: Landmarks, other: Landmarks, same: float = 0.07) -> bool:
    """Return whether two sets of landmarks are of one person: nearer than ``same`` crop sizes in the mean."""
    seen = np.minimum(one.visibility, other.visibility)[list(CORE)] > 0.3
    core = np.array(CORE)[seen] if seen.sum() >= 3 else np.array(CORE)
    distance = np.linalg.norm(one.points[core] - other.points[core], axis=1).mean()
    return bool(distance < same * min(one.crop.size, other.crop.size))


def hides(one: Landmarks, other: Landmarks, most: float = 0.6) -> bool:
    """Return whether more than the share ``most`` of the second person's pixels belongs to the first."""
    area = other.mask.sum()
    covered = other.mask & redraw_mask((one.mask, one.crop), other.crop, MASK_SIDE)
    return bool(area == 0 or covered.sum() > most * area)


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
    row["crop"], row["next_crop"] = landmarks.crop, landmarks.next_crop or np.nan
    row["colours"] = count_colours(landmarks.colours, landmarks.mask)
    row["mask"] = np.packbits(landmarks.mask, axis=1)


def count_colours(colours: Image, mask: NDArray[np.bool_], step: int = 4) -> FloatArray:
    """Compute colour shares (2, bins) of a person's upper and lower half in the crop; zeros without pixels.

    Parameters
    ----------
    colours : (256, 256, 3) pixels of the crop.
    mask : (128, 128) the person.
    step : pixels of the crop from one that counts to the next.
    """
    shares = np.zeros((2, COLOUR_BINS**3))
    small = colours[::step, ::step].astype(np.int64) * COLOUR_BINS // 256
    step = step * len(mask) // len(colours)
    person = mask[::step, ::step]
    numbers = (small[..., 0] * COLOUR_BINS + small[..., 1]) * COLOUR_BINS + small[..., 2]
    rows = np.flatnonzero(person.any(axis=1))
    if len(rows):
        border = int(rows[0] + rows[-1] + 1) // 2
        for half, part in enumerate((slice(None, border), slice(border, None))):
            counts = np.bincount(numbers[part][person[part]], minlength=COLOUR_BINS**3)
            shares[half] = counts / max(1, counts.sum())
    return shares


class Piece(NamedTuple):
    """A part of a stretch that is of one person: places among the sightings, rising in time, and its stretch."""

    rows: IntArray
    stretch: int


@dataclass(slots=True)
class _Person:
    """The pieces of a person so far."""

    pieces: list[Piece] = field(default_factory=list)
    colours: FloatArray | None = None
    weight: float = 0.0


def find_identities(
    sightings: NDArray[np.void], times: FloatArray, *, together: float = 0.3, least: float = 0.3
) -> list[IntArray]:
    """Return for each person of a film the places among the sightings, most seen first.

    A person has at most one sighting a frame; those with low quality are left out.

    Parameters
    ----------
    sightings : of `people.SIGHTING`, rising in time.
    times : (T,) s of the frames.
    together : s, pieces that begin within this time are assigned to people together.
    least : s, people who are seen for less are left out.
    """
    pieces = cut_stretches(sightings)
    starts = [float(times[sightings["frame"][piece.rows[0]]]) for piece in pieces]
    search = IdentitySearch(sightings, times)
    first = 0
    while first < len(pieces):
        last = first
        while last < len(pieces) and starts[last] - starts[first] <= together:
            last += 1
        search.give(pieces[first:last])
        first = last
    found = [np.concatenate([piece.rows for piece in person.pieces]) for person in search.people]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    short = step < least  # a film may be shorter than that
    long = [rows for rows in found if not short or len(rows) * step >= min(least, 0.5 * step * len(times))]
    kept = [rows for rows in long if is_somebody(sightings, rows)]
    return sorted(kept, key=lambda rows: -_measure_presence(sightings, rows))


def _measure_presence(sightings: NDArray[np.void], rows: IntArray) -> float:
    """Sum the frames of a person, weighted by visibility and size."""
    visible = sightings["visibility"][rows][:, list(CORE)].astype(np.float64).mean(axis=1)
    return float((visible * np.sqrt(sightings["crop"][rows, 2])).sum())


def is_somebody(
    sightings: NDArray[np.void], rows: IntArray, *, quality: float = 0.65, inside: float = 0.95, most: int = 200
) -> bool:
    """Return whether the sightings at these places are of a person.

    Three quarters of them must have at least this ``quality`` (visibility of arms or legs times score, 0 to 1), and of
    ``most`` sightings at most, three quarters at least the share ``inside`` of their landmarks on the mask.
    """
    visible = sightings["visibility"][rows][:, list(CORE)].astype(np.float64)
    best = np.maximum(visible[:, :6].mean(axis=1), visible[:, 4:].mean(axis=1))  # arms and hips, hips and legs
    if np.percentile(best * sightings["score"][rows], 25) < quality:
        return False
    sample = rows[:: max(1, len(rows) // most)]
    return float(np.percentile([measure_inside(sightings[row]) for row in sample], 25)) >= inside


def measure_inside(row: np.void, visible: float = 0.5, near: int = 2) -> float:
    """Compute the share of the landmarks of a sighting that lie on its mask: nearly all, if it is a person.

    Landmarks up to this visibility do not count; ``near`` px of the mask away from it are on it.
    """
    points = row["points"][list(CORE)][row["visibility"][list(CORE)] > visible].astype(np.float64)
    side = len(row["mask"])
    x, y, size, angle = row["crop"].tolist()
    inverse = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]) * (side / size)
    places = (points - (x, y)) @ inverse.T + (side - 1) / 2
    mask = np.pad(np.unpackbits(row["mask"], axis=1).astype(bool), near)
    columns, rows = np.clip(np.rint(places).astype(int) + near, 0, side + 2 * near - 1).T
    found = [
        mask[max(0, down - near) : down + near + 1, max(0, column - near) : column + near + 1].any()
        for down, column in zip(rows, columns, strict=True)
    ]
    return float(np.mean(found)) if found else 0.0


def cut_stretches(sightings: NDArray[np.void], *, touch: float = 0.2, jump: float = 0.2) -> list[Piece]:
    """Return the pieces of all stretches, in the order in which they begin.

    Cuts where the middles of two people are less than ``touch`` crop sizes apart, and where a person is more than
    ``jump`` crop sizes off the expected place.
    """
    middles, sizes = measure_middle(sightings["points"]), sightings["crop"][:, 2]
    touching = np.zeros(len(sightings), bool)
    for start, stop in find_equal_runs(sightings["frame"]):
        apart = np.linalg.norm(middles[start:stop, None] - middles[None, start:stop], axis=2)
        near = apart < touch * np.minimum(sizes[start:stop, None], sizes[None, start:stop])
        touching[start:stop] = near.sum(axis=1) > 1
    pieces = []
    for stretch in np.unique(sightings["stretch"]):
        rows = np.flatnonzero(sightings["stretch"] == stretch)
        cuts = find_equal_runs(touching[rows])[1:, 0]
        moves = np.diff(middles[rows], axis=0, prepend=middles[rows[:1]])
        off = np.linalg.norm(np.diff(moves, axis=0, prepend=moves[:1]), axis=1) / sizes[rows]
        cuts = np.union1d(cuts, np.flatnonzero(off > jump)).astype(int)
        pieces += [Piece(part, int(stretch)) for part in np.split(rows, cuts) if len(part)]
    return sorted(pieces, key=lambda piece: int(piece.rows[0]))


@dataclass(slots=True, eq=False)
class IdentitySearch:
    """The assignment of pieces to people, with the least sum of costs.

    Parameters
    ----------
    sightings : all.
    times : (T,) s of the frames.
    new : cost of a new person: the more, the rather pieces are given to known ones.
    colour, place, size, stretch : weights of different colours, of the distance from the expected place, of another
        size, and of another stretch.
    reach, speed : crop sizes that a person may be off at once, and more per second.
    most : times that reach, and times the usual change of size, that count at most.
    goes_on : s, for which the motion of an unseen person is extrapolated.
    """

    sightings: NDArray[np.void]
    times: FloatArray
    new: float = 1.1
    colour: float = 2.0
    place: float = 0.5
    size: float = 0.25
    stretch: float = 0.6
    reach: float = 0.15
    speed: float = 1.5
    most: float = 3.0
    goes_on: float = 0.6
    people: list[_Person] = field(default_factory=list)

    def give(self, pieces: Sequence[Piece]) -> None:
        """Assign pieces that begin at about the same time to known or new people."""
        left, frames = list(pieces), self.sightings["frame"]
        while left:
            # pieces of one person may follow each other within the group: one round for each
            now: list[Piece] = []
            later: list[Piece] = []
            for piece in left:
                before = [one for one in now if frames[one.rows[-1]] < frames[piece.rows[0]]]
                (later if before else now).append(piece)
            known = list(self.people)
            costs = np.full((len(now), len(known) + len(now)), self.new)
            for row, piece in enumerate(now):
                costs[row, : len(known)] = [self._measure_cost(piece, person) for person in known]
            for row, column in enumerate(assign(costs)):
                if column >= len(known) or costs[row, column] >= self.new:
                    self.people.append(_Person())
                    self._add(now[row], self.people[-1])
                else:
                    self._add(now[row], known[column])
            left = later

    def _add(self, piece: Piece, person: _Person) -> None:
        colours, weight = self._mean_colours(piece), float(min(len(piece.rows), 60))
        total = person.weight + weight
        before = person.colours
        person.colours = colours if before is None else (person.weight * before + weight * colours) / total
        person.weight = min(total, 300.0)
        person.pieces.append(piece)

    def _mean_colours(self, piece: Piece) -> FloatArray:
        return np.asarray(self.sightings["colours"][piece.rows].astype(np.float64).mean(axis=0))

    def _measure_cost(self, piece: Piece, person: _Person) -> float:
        """Compute the cost of assigning a piece to a person; 1e6 where both are seen at the same time."""
        last, times = person.pieces[-1], self.times
        begin, end = self.sightings[piece.rows[0]], self.sightings[last.rows[-1]]
        if begin["frame"] <= end["frame"]:
            return 1e6
        gap = float(times[begin["frame"]] - times[end["frame"]])
        size = float(min(begin["crop"][2], end["crop"][2]))
        place = measure_middle(end["points"])
        if len(last.rows) > 3 and gap < 1.0:
            back = self.sightings[last.rows[-min(len(last.rows), 9)]]
            took = float(times[end["frame"]] - times[back["frame"]])
            place = place + (place - measure_middle(back["points"])) * min(gap, self.goes_on) / max(took, 1e-3)
        off = float(np.hypot(*(measure_middle(begin["points"]) - place))) / size / (self.reach + self.speed * gap)
        grown = abs(math.log(float(begin["crop"][2]) / float(end["crop"][2]))) / (0.2 + gap)
        colours = self._mean_colours(piece)
        unlike = 0.0 if person.colours is None else 1 - float(np.minimum(colours, person.colours).sum(axis=1).mean())
        cost = self.colour * unlike + self.place * min(off, self.most) + self.size * min(grown, self.most)
        return cost - (self.stretch if last.stretch == piece.stretch else 0.0)


def assign(costs: FloatArray) -> list[int]:
    """Return the column (N,) of each row of a matrix (N, M >= N) of costs, each once, with the least sum."""
    from scipy.optimize import linear_sum_assignment

    return [int(column) for column in linear_sum_assignment(costs)[1]]
