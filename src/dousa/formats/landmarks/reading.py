"""From people in frames to the trajectories of one person.

Points in a picture (2D keypoints, MediaPipe's picture landmarks) are refused; the message names the command for them. A
point with confidence 0, or with all numbers 0, was not seen. World landmarks of MediaPipe (BlazePose GHUM) are metres
about the middle of the hips, y down.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.frame_names import number_frames
from dousa.formats.arrays.joints import list_layouts, name_joints
from dousa.formats.frame_folders import list_frame_files
from dousa.formats.landmarks.json_forms import PICTURE_KEYS, FormError, Person, Recording, list_frames, list_people
from dousa.messages import Message
from dousa.motion import Trajectories
from dousa.motion.canonical.naming import match_names

_MOST_BYTES = 2_000_000_000
_PIXELS = 3.0  # coordinates beyond this, beside confidences from 0 to 1, are places in a picture
_LANDMARKS, _HIPS = 33, (23, 24)
_AT_ORIGIN, _OFF_ORIGIN = 0.03, 0.15  # m: between the hips of world landmarks, and of those in a picture
_BODY_25 = "OpenPose BODY_25"


def read_landmarks(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    frame_rate: float | None = None,
) -> Trajectories:
    """Read 3D points of a person from JSON; of several people the one in most frames, NaN where missing.

    Parameters
    ----------
    path : a file, or a folder of one file for each frame.
    unit, up : by default inferred from the body.
    frame_rate : Hz; by default that of the file, else that of the program that usually writes these points.

    Raises
    ------
    MotionFileError : missing, damaged, of another form, 2D points, no person in any frame.
    """
    try:
        recording = _read_folder(path) if os.path.isdir(path) else list_frames(_parse(path))
        people, notes = _choose_person(recording)
    except FormError as error:
        raise MotionFileError(path, error.message) from error
    points = _stack(path, people)
    _refuse_pictures(path, points, people)
    places = points[..., :3].copy()
    places[~(points[..., 3] > 0) | (places == 0).all(axis=2)] = np.nan
    if not np.isfinite(places).any():
        raise MotionFileError(path, "landmarks.nobody")
    return name_joints(
        path, "landmarks", places, _name_points(recording, people, points.shape[1]), unit=unit, up=up,
        frame_rate=frame_rate or recording.rate, notes=(*notes, *_note_hips(places)),
    )  # fmt: skip


def _parse(path: str | os.PathLike[str]) -> Any:
    data = read_bytes(path)
    if len(data) > _MOST_BYTES:
        raise MotionFileError(path, "disk.too_large")
    try:
        text = data.decode("utf-8-sig")
        try:
            return json.loads(text)
        except json.JSONDecodeError as error:
            if "Extra data" not in error.msg:
                raise
            return [json.loads(line) for line in text.splitlines() if line.strip()]  # a frame in each line
    except (ValueError, RecursionError) as error:
        raise MotionFileError(path, "landmarks.broken", reason=str(error)[:200]) from error


def _read_folder(folder: str | os.PathLike[str]) -> Recording:
    try:
        names = list_frame_files(folder)
    except OSError as error:
        raise MotionFileError(folder, "disk.unreadable", reason=error) from error
    if not names:
        raise MotionFileError(folder, "disk.folder")
    numbered = number_frames(names)
    frames: list[list[Person]] = [[] for _ in range(max(numbered) + 1)]
    for frame, name in numbered.items():
        place = os.path.join(folder, name)
        try:
            frames[frame] = list_people(_parse(place))
        except MotionFileError as error:
            raise MotionFileError(folder, "landmarks.in_frame", file=name, problem=error.message) from error
        except FormError as error:
            raise MotionFileError(folder, "landmarks.in_frame", file=name, problem=error.message) from error
    return Recording(frames)


def _choose_person(recording: Recording) -> tuple[list[Person | None], tuple[Message, ...]]:
    """One person (or None) for each frame: the number in most of them; without numbers the first."""
    frames = [[person for person in people if len(person.points)] for people in recording.frames]
    counts = Counter(person.number for people in frames for person in people)
    if not counts:
        raise FormError("landmarks.flat" if any(recording.frames) else "landmarks.nobody")
    most = max(map(len, frames))
    # A number that is another one in every frame counts frames, not people.
    numbered = None not in counts and (most > 1 or counts.most_common(1)[0][1] > 1)
    chosen = max(counts, key=lambda number: counts[number])
    people = [next((person for person in found if not numbered or person.number == chosen), None) for found in frames]
    total = len(counts) if numbered else most
    notes = (Message("landmarks.several", found=total),) if total > 1 else ()
    return people, notes


def _stack(path: str | os.PathLike[str], people: list[Person | None]) -> FloatArray:
    """(T, K, 4) of the person, NaN in frames without."""
    sizes = Counter(len(person.points) for person in people if person is not None)
    count = max(sizes, key=lambda size: sizes[size])
    if len(sizes) > 1:
        raise MotionFileError(path, "landmarks.uneven", found=tuple(sorted(sizes)))
    if count * len(people) > 100_000_000:
        raise MotionFileError(path, "disk.too_large")
    points = np.full((len(people), count, 4), np.nan)
    for frame, person in enumerate(people):
        if person is not None:
            points[frame] = person.points
    return points


def _refuse_pictures(path: str | os.PathLike[str], points: FloatArray, people: list[Person | None]) -> None:
    keys = {person.key for person in people if person is not None}
    seen = points[np.isfinite(points[..., :2]).all(axis=2)]
    depth = seen[np.isfinite(seen[:, 2]), 2]
    landmarks = points.shape[1] == _LANDMARKS
    shares = len(depth) > 0 and bool(((depth >= 0) & (depth <= 1)).all()) and np.abs(seen[:, :2]).max() > _PIXELS
    if not depth.any() or shares:
        raise MotionFileError(path, "landmarks.flat")
    middle = points[:, _HIPS, :2].mean(axis=1) if landmarks else np.empty((0, 2))
    middle = middle[np.isfinite(middle).all(axis=1)]
    inside = ((seen[:, :2] > -0.25) & (seen[:, :2] < 1.25)).all(axis=1).mean()
    away = len(middle) > 0 and float(np.abs(np.median(middle, axis=0)).max()) > _OFF_ORIGIN
    if keys & set(PICTURE_KEYS) or (away and inside > 0.98):
        raise MotionFileError(path, "landmarks.picture")


def _name_points(recording: Recording, people: list[Person | None], count: int) -> tuple[str, ...] | None:
    """Names in the file, if they are those of a body; BODY_25 as OpenPose has them; else None."""
    own = next((person.names for person in people if person is not None), ())
    for names in (own, recording.names):
        match = match_names(names) if len(names) == count and len(set(names)) == count else None
        if match is not None and not match.missing:
            return names
    keys = {person.key for person in people if person is not None}
    if keys == {"pose_keypoints_3d"}:
        return next((y.names for y in list_layouts() if y.title == _BODY_25 and len(y.names) == count), None)
    return None


def _note_hips(places: FloatArray) -> tuple[Message, ...]:
    """Note a body with hips fixed at the origin: it does not travel."""
    if places.shape[1] != _LANDMARKS:
        return ()
    middle = places[:, _HIPS].mean(axis=1)
    seen = middle[np.isfinite(middle).all(axis=1)]
    still = len(seen) > 1 and float(np.abs(seen).max()) < _AT_ORIGIN
    return (Message("landmarks.hips_fixed"),) if still else ()
