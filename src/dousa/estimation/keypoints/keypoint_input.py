"""Reading the keypoints of one view, whichever program found them."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import KeypointError
from dousa.estimation.keypoints.identities import assign
from dousa.estimation.keypoints.keypoint_files import read_keypoint_npz
from dousa.estimation.keypoints.keypoint_json import ReadPerson, read_keypoint_json, settle_units
from dousa.estimation.keypoints.keypoint_schemes import SCHEMES
from dousa.estimation.keypoints.keypoints import PersonTrack, ViewKeypoints, sort_people
from dousa.messages import Message

_DEFAULT_RATE = 30.0
_FARTHEST = 0.4  # of a person's size that the points move from one frame to the next, on average
_LOST_FOR = 60  # frames


def read_keypoints(
    path: str | os.PathLike[str], *, size: tuple[int, int] | None = None, frame_rate: float | None = None
) -> ViewKeypoints:
    """Read the keypoints of one view.

    Parameters
    ----------
    path : an npz file of dousa (see `keypoint_files`); or the JSON of another program, one file for the view or a
        folder of one for each frame: OpenPose BODY_25, Halpe 26, COCO 17, MediaPipe 33 and more (see
        `keypoint_schemes`), told by their number of points.
    size : width and height of the pictures in px; needed for JSON that does not say it.
    frame_rate : Hz of JSON; by default 30 with a warning.

    Returns
    -------
    The people, who is seen most first. Where the program did not say who is who, people are told by where they are.

    Raises
    ------
    KeypointError : missing, damaged, of an unknown form; no size.
    """
    if not os.path.exists(path):
        raise KeypointError("keypoints.missing").at(path)
    if os.path.isfile(path) and not os.fspath(path).lower().endswith(".json"):
        return read_keypoint_npz(path)
    read = read_keypoint_json(path)
    size = size or read.size
    try:
        numbers = {len(person.points) for people in read.frames for person in people}
        if len(numbers) > 1:
            raise KeypointError("keypoint_json.mixed", found=sorted(numbers))
        frames = list(settle_units(read.frames, size))
        if size is None:
            raise KeypointError("keypoint_json.no_size")
        names = SCHEMES[next(iter(numbers))] if len(numbers & SCHEMES.keys()) else _find_names(numbers)
        tracks = link_people(frames, len(names))
    except KeypointError as error:
        raise error.at(path) from None
    warnings = () if frame_rate else (Message("mask_npz.rate", path=os.fspath(path), rate=_DEFAULT_RATE),)
    times = np.arange(len(frames)) / (frame_rate or _DEFAULT_RATE)
    return ViewKeypoints(names, sort_people(tracks), times, size, os.fspath(path), warnings)


def _find_names(numbers: set[int]) -> tuple[str, ...]:
    """Of points that were cut off a larger scheme; of COCO where there is nobody at all."""
    if not numbers:
        return SCHEMES[17]
    return next(names for names in SCHEMES.values() if len(names) in numbers)


def link_people(frames: Sequence[Sequence[ReadPerson]], n_points: int) -> list[PersonTrack]:
    """Tracks (T, K) of the people of all frames.

    Parameters
    ----------
    frames : the people of each frame. Where each has a number of its own in every frame, that says who is who; else
        everybody is who was nearest in the frame before, such that the sum of the distances is least.
    n_points : K.
    """
    everybody = [person for people in frames for person in people]
    by_number = bool(everybody) and all(
        None not in (numbers := [person.number for person in people]) and len(set(numbers)) == len(numbers)
        for people in frames
    )
    found: dict[int, FloatArray] = {}
    last: dict[int, tuple[int, FloatArray]] = {}
    for frame, people in enumerate(frames):
        owners = [int(person.number or 0) for person in people] if by_number else _find_owners(frame, people, last)
        for owner, person in zip(owners, people, strict=True):
            if owner not in found:
                found[owner] = np.full((len(frames), n_points, 3), (np.nan, np.nan, 0.0))
            found[owner][frame] = person.points
            last[owner] = (frame, person.points)
    return [PersonTrack(values[..., :2], values[..., 2]) for values in found.values()]


def _find_owners(frame: int, people: Sequence[ReadPerson], last: dict[int, tuple[int, FloatArray]]) -> list[int]:
    """Numbers of the tracks that the people of a frame belong to; of new ones where none is near."""
    known = [(number, points) for number, (seen, points) in last.items() if frame - seen <= _LOST_FOR]
    costs = np.full((len(people), len(known) + len(people)), _FARTHEST)
    for row, person in enumerate(people):
        for column, (_, points) in enumerate(known):
            costs[row, column] = _measure_distance(person.points, points)
    owners, following = [], max(last, default=-1) + 1
    for row, column in enumerate(assign(costs) if len(people) else []):
        if column < len(known) and costs[row, column] < _FARTHEST:
            owners.append(known[column][0])
        else:
            owners.append(following)
            following += 1
    return owners


def _measure_distance(one: FloatArray, other: FloatArray) -> float:
    """Mean distance of the points that both have, in sizes of the person."""
    both = np.isfinite(one[:, 0]) & np.isfinite(other[:, 0])
    if not both.any():
        return 1e3
    size = float(np.ptp(one[np.isfinite(one[:, 0]), :2], axis=0).max())
    return float(np.linalg.norm(one[both, :2] - other[both, :2], axis=1).mean()) / max(size, 1.0)
