"""Keypoints of one view: files of any supported program, and npz files of dousa:

names         (K,) text
points        (P, T, K, 2) px, nan where not seen
visibility    (P, T, K) 0 to 1
world         (P, T, K, 3) m about the hips, axes of the camera; nan where unknown; optional
times         (T,) s since the first frame
size          (2,) width and height in px
source        (1,) text
mask_packed   (P, T, S, S / 8) uint8; optional
mask_crops    (P, T, 2, 3) see `PersonMasks`
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import KeypointError
from dousa.estimation.keypoints.keypoint_json import (
    SCHEMES,
    ReadFrames,
    ReadPerson,
    read_keypoint_json,
    settle_units,
)
from dousa.estimation.keypoints.keypoint_table import is_keypoint_table, read_keypoint_table, spell_points
from dousa.estimation.keypoints.keypoints import PersonMasks, PersonTrack, ViewKeypoints, sort_people
from dousa.estimation.keypoints.people import assign
from dousa.files.disk import atomic_write
from dousa.files.npz_arrays import NpzFile, open_npz
from dousa.messages import Message


def write_keypoints(path: str | os.PathLike[str], keypoints: ViewKeypoints, *, masks: bool = True) -> None:
    """Write the keypoints of one view as an npz file, with ``masks`` the people's masks too, if known.

    Raises
    ------
    MotionWriteError : the file cannot be written; no partial file stays.
    """
    people = keypoints.people
    shape = (len(people), keypoints.n_frames, len(keypoints.names))
    arrays: dict[str, NDArray[np.generic]] = {
        "names": np.array(keypoints.names),
        "points": np.array([person.points for person in people], np.float32).reshape(*shape, 2),
        "visibility": np.array([person.visibility for person in people], np.float32).reshape(shape),
        "times": keypoints.times,
        "size": np.array(keypoints.size, np.int64),
        "source": np.array([keypoints.source]),
    }
    if any(person.world is not None for person in people):
        unknown = np.full((*shape[1:], 3), np.nan)
        worlds = [unknown if person.world is None else person.world for person in people]
        arrays["world"] = np.stack(worlds).astype(np.float32)
    found = [person.masks for person in people if person.masks is not None]
    if masks and found and len(found) == len(people) and len({one.packed.shape for one in found}) == 1:
        arrays["mask_packed"] = np.stack([np.asarray(one.packed) for one in found])
        arrays["mask_crops"] = np.stack([one.crops for one in found])
    with atomic_write(path) as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def read_keypoint_npz(
    path: str | os.PathLike[str], *, most_bytes: int = 2_000_000_000, most_points: int = 1000, most_people: int = 200
) -> ViewKeypoints:
    """Read the keypoints of one view from an npz file of `write_keypoints`.

    Parameters
    ----------
    path : of the file.
    most_bytes : of one of its arrays.
    most_points, most_people : a file with more is refused.

    Raises
    ------
    KeypointError : missing, damaged, or inconsistent arrays.
    """
    try:
        with open_npz(path, KeypointError) as file:
            return _read(file, most_bytes, most_points, most_people)
    except KeypointError as error:
        error.at(path)
        raise


def _read(file: NpzFile, most: int, most_points: int, most_people: int) -> ViewKeypoints:
    names = file.read_texts("names")
    times = file.read("times", "fiu", 1)
    width, height = _expect(file.read("size", "iu", 1), "size", (2,)).tolist()
    points = file.read("points", "f", 4, most)
    if len(points) > most_people or len(names) > most_points:
        raise KeypointError("keypoints.many", people=len(points), points=len(names))
    shape = (len(points), len(times), len(names))
    _expect(points, "points", (*shape, 2))
    visibility = _expect(file.read("visibility", "f", 3, most), "visibility", shape)
    world = None
    if "world" in file:
        world = _expect(file.read("world", "f", 4, most), "world", (*shape, 3))
    packed = crops = None
    if "mask_packed" in file:
        packed = file.read("mask_packed", "u", 4, most)
        crops = _expect(file.read("mask_crops", "f", 4, most), "mask_crops", (*shape[:2], 2, 3))
        _expect(packed, "mask_packed", (*shape[:2], *packed.shape[2:]))
    people = []
    for place in range(len(points)):
        own = None if world is None or not np.isfinite(world[place]).any() else world[place]
        masks = None if packed is None or crops is None else PersonMasks(packed[place], crops[place])
        people.append(PersonTrack(points[place], visibility[place], own, masks))
    source = (*file.read_texts("source"), "")[0] if "source" in file else ""
    return ViewKeypoints(names, tuple(people), times, (width, height), source)


def _expect(array: NDArray[np.generic], name: str, shape: tuple[int, ...]) -> NDArray[np.generic]:
    if array.shape != shape:
        raise KeypointError("npz.shape", array=name, expected=str(shape), found=str(array.shape))
    return array


_OF_PEOPLE = re.compile(rb'"(people|bodies|annots|instance_info|\w*keypoints\w*|\w*landmarks\w*)"')


def holds_keypoints(path: str | os.PathLike[str]) -> bool:
    """Return whether a source holds the keypoints of a view, by what is in it; a folder by its first file."""
    try:
        if os.path.isdir(path):
            names = sorted(name for name in os.listdir(path) if not name.startswith("."))
            return bool(names) and names[0].lower().endswith(".json") and _shows_people(os.path.join(path, names[0]))
        if os.fspath(path).lower().endswith(".npz"):
            with open_npz(path, KeypointError) as arrays:
                return {"names", "points", "visibility"} <= set(arrays.names)
        if os.fspath(path).lower().endswith(".npy"):
            return count_views(path) > 0
        return is_keypoint_table(path) or (os.fspath(path).lower().endswith(".json") and _shows_people(path))
    except (OSError, KeypointError):
        return False  # its reader describes the problem


def count_views(path: str | os.PathLike[str]) -> int:
    """Return the number of views in a file: of an array (cameras, frames, points, 2 or 3), as FreeMoCap writes it.

    1 of other files; 0 of other arrays.
    """
    if not os.fspath(path).lower().endswith(".npy") or not os.path.isfile(path):
        return 1
    return 0 if (array := _map_array(path)) is None else len(array)


def _map_array(path: str | os.PathLike[str]) -> NDArray[np.floating] | None:
    """The array of a file, its numbers still on the disk; None if its shape is not that of points in pictures."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError):
        return None
    fits = array.ndim == 4 and array.dtype.kind == "f" and array.shape[3] in (2, 3)
    return array if fits and array.size and array.shape[2] in SCHEMES else None


def _read_array(path: str | os.PathLike[str], view: int) -> ReadFrames:
    """The points of one camera; a third number is a confidence if it is from 0 to 1 everywhere, else MediaPipe's z."""
    array = _map_array(path)
    if array is None or not 0 <= view < len(array):
        raise KeypointError("keypoints.array").at(path)
    names = SCHEMES[array.shape[2]]
    rows = np.array(array[view, :, : len(names)], np.float64)
    points = np.ones((*rows.shape[:2], 3))
    points[..., :2] = rows[..., :2]
    if rows.shape[2] == 3 and 0 <= np.fmin.reduce(rows[..., 2], None) <= np.fmax.reduce(rows[..., 2], None) <= 1:
        points[..., 2] = np.nan_to_num(rows[..., 2])
    unseen: BoolArray = np.isnan(rows[..., :2]).any(axis=2) | (rows[..., :2] == 0).all(axis=2)
    points[unseen] = (np.nan, np.nan, 0.0)
    frames = [[] if np.all(gone) else [ReadPerson(own, 0)] for own, gone in zip(points, unseen, strict=True)]
    return ReadFrames(frames, None, names)


def _shows_people(path: str | os.PathLike[str], n_bytes: int = 20_000) -> bool:
    with open(path, "rb") as file:
        return _OF_PEOPLE.search(file.read(n_bytes)) is not None


def read_keypoints(
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] | None = None,
    frame_rate: float | None = None,
    usual_size: tuple[int, int] | None = None,
    view: int = 0,
) -> ViewKeypoints:
    """Read the keypoints of one view; the people come most seen first.

    Without numbers of persons in the file, people are linked by their places.

    Parameters
    ----------
    path : an npz file of dousa; the JSON of another program, one file for the view or a folder of one for each
        frame, recognised by the number of points (see `keypoint_json`); the CSV of DeepLabCut; or the array of
        FreeMoCap (cameras, frames, points, 2 or 3).
    size : width and height of the images in px; needed for other files than npz that do not say it.
    frame_rate : Hz of other files than npz; by default 30 with a warning.
    usual_size : as ``size``, such as that of the camera; used where the file has none.
    view : the camera's place in an array of several.

    Raises
    ------
    KeypointError : missing, damaged, of an unknown form; no size.
    """
    if not os.path.exists(path):
        raise KeypointError("keypoints.missing").at(path)
    is_table = os.path.isfile(path) and is_keypoint_table(path)
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if os.path.isfile(path) and not is_table and suffix not in (".json", ".npy"):
        return read_keypoint_npz(path)
    if suffix == ".npy":
        read = _read_array(path, view)
    else:
        read = read_keypoint_table(path) if is_table else read_keypoint_json(path)
    size = size or read.size or usual_size
    try:
        numbers = {len(person.points) for people in read.frames for person in people}
        if len(numbers) > 1:
            raise KeypointError("keypoint_json.mixed", found=sorted(numbers))
        frames = list(settle_units(read.frames, size))
        if size is None:
            raise KeypointError("keypoint_json.no_size")
        names = _find_names(numbers, read.names)
        tracks = link_people(frames, len(names))
    except KeypointError as error:
        raise error.at(path) from None
    rate = frame_rate or 30.0
    warnings = () if frame_rate else (Message("mask_npz.rate", path=os.fspath(path), rate=rate),)
    times = np.arange(len(frames)) / rate
    return ViewKeypoints(names, sort_people(tracks), times, size, os.fspath(path), warnings)


def _find_names(numbers: set[int], given: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the points: those of the file, else by their number; those of COCO if no person is there."""
    if len(numbers) == 1 and len(given) >= (number := next(iter(numbers))):
        return spell_points(given)[:number]
    if not numbers:
        return SCHEMES[17]
    known = SCHEMES.values()  # of a larger scheme the first ones are kept
    return SCHEMES.get(next(iter(numbers))) or next(names for names in known if len(names) in numbers)


def link_people(
    frames: Sequence[Sequence[ReadPerson]], n_points: int, *, farthest: float = 0.4, lost_for: int = 60
) -> list[PersonTrack]:
    """Return tracks (T, K) of the people of all frames.

    Parameters
    ----------
    frames : the people of each frame. If each has a unique number in every frame, the numbers decide; else people are
        matched to the last frames such that the sum of the distances is least.
    n_points : K.
    farthest : of a person's size, that the points move from one frame to the next, on average.
    lost_for : frames after which a person who comes back is another one.
    """
    everybody = [person for people in frames for person in people]
    by_number = bool(everybody) and all(
        None not in (numbers := [person.number for person in people]) and len(set(numbers)) == len(numbers)
        for people in frames
    )
    found: dict[int, FloatArray] = {}
    last: dict[int, tuple[int, FloatArray]] = {}
    for frame, people in enumerate(frames):
        if by_number:
            owners = [int(person.number or 0) for person in people]
        else:
            known = {owner: points for owner, (seen, points) in last.items() if frame - seen <= lost_for}
            owners = _find_owners(people, known, max(last, default=-1) + 1, farthest)
        for owner, person in zip(owners, people, strict=True):
            if owner not in found:
                found[owner] = np.full((len(frames), n_points, 3), (np.nan, np.nan, 0.0))
            found[owner][frame] = person.points
            last[owner] = (frame, person.points)
    return [PersonTrack(values[..., :2], values[..., 2]) for values in found.values()]


def _find_owners(
    people: Sequence[ReadPerson], known: dict[int, FloatArray], following: int, farthest: float
) -> list[int]:
    """Return the track numbers of the people of a frame; new ones, from ``following`` on, where no track is near."""
    costs = np.full((len(people), len(known) + len(people)), farthest)
    for row, person in enumerate(people):
        for column, points in enumerate(known.values()):
            costs[row, column] = _measure_distance(person.points, points)
    owners = []
    for row, column in enumerate(assign(costs) if len(people) else []):
        if column < len(known) and costs[row, column] < farthest:
            owners.append(list(known)[column])
        else:
            owners.append(following)
            following += 1
    return owners


def _measure_distance(one: FloatArray, other: FloatArray) -> float:
    """Compute the mean distance of common points, in sizes of the person."""
    both = np.isfinite(one[:, 0]) & np.isfinite(other[:, 0])
    if not both.any():
        return 1e3
    size = float(np.ptp(one[np.isfinite(one[:, 0]), :2], axis=0).max())
    return float(np.linalg.norm(one[both, :2] - other[both, :2], axis=1).mean()) / max(size, 1.0)
