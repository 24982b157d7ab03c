"""Keypoints in npz files.

names         (K,) text
points        (P, T, K, 2) px, nan where not seen
visibility    (P, T, K) 0 to 1
world         (P, T, K, 3) m about the hips, axes of the camera; nan where not known; may be lacking
times         (T,) s since the first frame
size          (2,) width and height in px
source        (1,) text
mask_packed   (P, T, S, S / 8) uint8, may be lacking
mask_crops    (P, T, 2, 3) see `PersonMasks`
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from dousa.errors import KeypointError
from dousa.estimation.keypoints.keypoints import PersonMasks, PersonTrack, ViewKeypoints
from dousa.files.disk import atomic_write
from dousa.files.npz_arrays import NpzFile, open_npz

_MOST_BYTES = 2_000_000_000
_MOST_POINTS, _MOST_PEOPLE = 1000, 200


def write_keypoints(path: str | os.PathLike[str], keypoints: ViewKeypoints, *, masks: bool = True) -> None:
    """Write the keypoints of one view as an npz file.

    Parameters
    ----------
    path : the file to write.
    keypoints : of one view.
    masks : write the people's masks too, where they are known.

    Raises
    ------
    MotionWriteError : the disk refuses; nothing is left behind.
    """
    people = keypoints.people
    shape = (len(people), keypoints.n_frames, len(keypoints.names))
    arrays: dict[str, NDArray[np.generic]] = {
        "names": np.array(keypoints.names),
        "points": np.zeros((*shape, 2), np.float32),
        "visibility": np.zeros(shape, np.float32),
        "times": keypoints.times,
        "size": np.array(keypoints.size, np.int64),
        "source": np.array([keypoints.source]),
    }
    if people:
        arrays["points"] = np.stack([person.points for person in people]).astype(np.float32)
        arrays["visibility"] = np.stack([person.visibility for person in people]).astype(np.float32)
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


def read_keypoint_npz(path: str | os.PathLike[str]) -> ViewKeypoints:
    """Read the keypoints of one view from an npz file that `write_keypoints` wrote.

    Raises
    ------
    KeypointError : missing, damaged, or arrays that do not make keypoints.
    """
    try:
        with open_npz(path, KeypointError) as file:
            return _read(file)
    except KeypointError as error:
        error.at(path)
        raise


def _read(file: NpzFile) -> ViewKeypoints:
    names = file.read_texts("names")
    times = file.read("times", "fiu", 1)
    width, height = _expect(file.read("size", "iu", 1), "size", (2,)).tolist()
    points = file.read("points", "f", 4, _MOST_BYTES)
    if len(points) > _MOST_PEOPLE or len(names) > _MOST_POINTS:
        raise KeypointError("keypoints.many", people=len(points), points=len(names))
    shape = (len(points), len(times), len(names))
    _expect(points, "points", (*shape, 2))
    visibility = _expect(file.read("visibility", "f", 3, _MOST_BYTES), "visibility", shape)
    world = None
    if "world" in file:
        world = _expect(file.read("world", "f", 4, _MOST_BYTES), "world", (*shape, 3))
    packed = crops = None
    if "mask_packed" in file:
        packed = file.read("mask_packed", "u", 4, _MOST_BYTES)
        crops = _expect(file.read("mask_crops", "f", 4, _MOST_BYTES), "mask_crops", (*shape[:2], 2, 3))
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
