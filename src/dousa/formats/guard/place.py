"""Place: lost points, coordinates that are none, and such that are far from the origin.

The library, C3D and glTF hold numbers of 32 bits. Of a body far from the origin (UTM, GPS) these leave nothing. So a
file is moved to the origin while its numbers have 64 bits; the shift is kept in the provenance, and said.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.formats.guard.lost import Cloud, find_lost, measure_cloud
from dousa.messages import Message
from dousa.motion.types import Skeleton

_FINEST = 1e-6
"""Share of the size of the body that a coordinate must resolve, by definition: 2 micrometres of a person."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Points after the checks: positions (T, K, 3), what was taken off them (3,), and notes."""

    positions: FloatArray
    shift: FloatArray | None = None
    notes: tuple[Message, ...] = ()


def settle_positions(path: str | os.PathLike[str], names: Sequence[str], positions: FloatArray) -> Placed:
    """Take lost points as missing, refuse coordinates that are none, and move what is far to the origin.

    Parameters
    ----------
    path, names : of the file and of its points (K,), for the messages.
    positions : (T, K, 3) in any unit, NaN where missing; not changed.

    Raises
    ------
    MotionFileError : infinite coordinates, or such as double precision cannot place.
    """
    if positions.size == 0:
        return Placed(positions)
    cloud = measure_cloud(positions)
    check_place(path, names, positions, cloud)
    notes = []
    lost = find_lost(positions, cloud)
    if lost is not None:
        frame, point = np.argwhere(lost)[0]
        example = " ".join(f"{number:.7g}" for number in positions[frame, point])
        notes.append(Message("guard.lost", n=int(lost.sum()), total=lost.size, example=example))
        positions = np.where(lost[..., None], np.nan, positions)
    shift = find_shift(positions, cloud)
    if shift is not None:
        positions = positions - shift
        notes.append(Message("guard.shifted", x=shift[0], y=shift[1], z=shift[2]))
    return Placed(positions, shift, tuple(notes))


def settle_roots(
    path: str | os.PathLike[str],
    skeleton: Skeleton,
    rotations: FloatArray,
    translations: FloatArray,
    cloud: Cloud,
) -> Placed:
    """Take lost places of roots as missing, refuse places that are none, and move what is far to the origin.

    Parameters
    ----------
    path : for the messages.
    skeleton : of the motion.
    rotations, translations : (T, J, 4) and (T, J, 3) local poses in any unit; changed in place if they can be written
        to.
    cloud : of the joints in the world, in some of the frames.

    Returns
    -------
    The translations, the shift and notes; rotations of lost frames in which nothing turns are missing too.

    Raises
    ------
    MotionFileError : infinite places, or such as double precision cannot place.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if not abs(float(translations.sum())) < _limit(cloud):  # spares the look at every value
            check_place(path, skeleton.names, translations, cloud)
    roots = np.flatnonzero(skeleton.parents < 0)
    lost = find_lost(translations[:, roots], cloud, can_rest=True)
    notes = []
    if lost is not None:
        frame, root = np.argwhere(lost)[0]
        example = " ".join(f"{number:.7g}" for number in translations[frame, roots[root]])
        notes.append(Message("guard.lost", n=int(lost.sum()), total=lost.size, example=example))
        translations = _writable(translations)
        translations[:, roots] = np.where(lost[..., None], np.nan, translations[:, roots])
        if rotations.flags.writeable:
            still = lost.all(axis=1)
            still[still] = (np.abs(rotations[still, :, 0]) == 1.0).all(axis=1)
            rotations[still] = np.nan
    shift = find_shift(translations[:, roots], cloud)
    if shift is not None:
        translations = _writable(translations)
        translations[:, roots] -= shift
        notes.append(Message("guard.shifted", x=shift[0], y=shift[1], z=shift[2]))
    return Placed(translations, shift, tuple(notes))


def _writable(array: FloatArray) -> FloatArray:
    return array if array.flags.writeable else array.copy()


def _limit(cloud: Cloud) -> float:
    """Greatest coordinate of which double precision leaves enough of the body."""
    return cloud.size * _FINEST / 2.0**-53 if cloud.size > 0 else float(np.finfo(np.float32).max)


def check_place(path: str | os.PathLike[str], names: Sequence[str], positions: FloatArray, cloud: Cloud) -> None:
    """Raise MotionFileError, with frame and point, for infinite coordinates and such as double precision cannot place.

    Large numbers that are the same in all three coordinates are let through: they stand for a lost point.

    Parameters
    ----------
    path, names : of the file and of its points (K,), for the message.
    positions : (T, K, 3), NaN where missing.
    cloud : of the points.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.abs(positions)
        greatest = np.fmax.reduce(size, axis=None, initial=0.0)
        limit = _limit(cloud)
        if greatest <= limit:
            return
        equal = (size == size[..., :1]).all(axis=2, keepdims=True) & np.isfinite(size) & (cloud.size > 0)
        far = (size > limit) & ~equal
    if far.any():
        frame, point, axis = np.argwhere(far)[0]
        value = float(positions[frame, point, axis])
        raise MotionFileError(path, "guard.no_place", name=names[point], frame=int(frame) + 1, found=value)


def find_shift(positions: FloatArray, cloud: Cloud | None = None) -> FloatArray | None:
    """Find by how much (3,) to move points so that numbers of 32 bits hold them; None where these do anyway.

    An axis is shifted if all points are so far out on it that 32 bits resolve less than a millionth of the body: by a
    round number, so that the files of one scene mostly move equally, and to just above 0, where a floor may be.

    Parameters
    ----------
    positions : (T, K, 3) in any unit, NaN where missing; nothing lost among them.
    cloud : of the points, if it is known.
    """
    cloud = cloud or measure_cloud(positions)
    limit = cloud.size * _FINEST * 2.0**24
    if not cloud.size > 0 or np.abs(cloud.middle).max() <= limit:
        return None
    rows = positions.reshape(-1, 3)
    low, high = np.fmin.reduce(rows), np.fmax.reduce(rows)
    out = np.maximum(low, -high) > limit
    if not out.any():
        return None
    step = 10.0 ** np.floor(np.log10(cloud.size))
    shift: FloatArray = np.where(out, np.floor(low / step) * step, 0.0)
    return shift
