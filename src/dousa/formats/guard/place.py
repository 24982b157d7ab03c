"""Place: lost points, coordinates that are none, and such that are far from the origin.

The library, C3D and glTF hold numbers of 32 bits. Of a body far from the origin (UTM, GPS) these leave nothing. So a
file is moved to the origin while its numbers have 64 bits; the shift is kept in the provenance, and said.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import MotionFileError
from dousa.formats.guard.lost import find_lost
from dousa.messages import Message
from dousa.motion.resampling import thin
from dousa.motion.types import Skeleton

_EARTH = 4.0075e10
"""Circumference of the Earth in mm, by definition of WGS 84: no coordinate on it is larger, in any usual unit."""

_FAR = 1000.0
"""m, by definition: fields where motion is recorded are smaller. Numbers of 32 bits resolve 0.06 mm there."""


EXACT = 16.0
"""m: so far numbers of 32 bits resolve a micrometre, by the definition of IEEE 754; formats of such write what is
farther out about a place of their own."""


def settle_positions(
    path: str | os.PathLike[str], names: Sequence[str], positions: FloatArray
) -> tuple[FloatArray, tuple[Message, ...]]:
    """Take lost points as missing and refuse coordinates that are none; returns the positions and notes.

    Parameters
    ----------
    path, names : of the file and of its points (K,), for the messages.
    positions : (T, K, 3) in any unit, NaN where missing; changed in place if they can be written to.

    Raises
    ------
    MotionFileError : infinite coordinates, or such as double precision cannot place.
    """
    if positions.size == 0:
        return positions, ()
    check_place(path, names, positions)
    notes = []
    lost = find_lost(positions)
    if lost is not None:
        frame, point = np.argwhere(lost)[0]
        example = " ".join(f"{number:.7g}" for number in positions[frame, point])
        first = {"name": names[point], "frame": int(frame) + 1}
        notes.append(Message("guard.lost", n=int(lost.sum()), total=lost.size, example=example, **first))
        positions = positions if positions.flags.writeable else positions.copy()
        positions[lost] = np.nan
    return positions, tuple(notes)


def is_flat(positions: FloatArray, share: float = 1e-4, most: int = 50) -> bool:
    """Return whether all points lie in one plane in all frames, as in a picture: a person in space has depth.

    Parameters
    ----------
    positions : (T, K, 3) in any unit, NaN where missing; fewer than four that are ever seen are in a plane
        anyway.
    share : of its size that the body is thick at most: 0.2 mm of a person.
    most : frames that are looked at, the last one too.
    """
    if positions.shape[1] < 4 or not len(positions):
        return False
    one, *others = positions[0, :: positions.shape[1] // 4][:4].tolist()
    (a, b, c), (d, e, f), (g, h, i) = ([x - y for x, y in zip(other, one, strict=True)] for other in others)
    size = max(map(abs, (a, b, c, d, e, f, g, h, i)))
    if abs(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)) > share * size**3:  # nearly every file
        return False
    some = thin(positions, min(most, len(positions)))
    seen: BoolArray = np.isfinite(some).all(axis=2)
    if np.count_nonzero(seen.any(axis=0)) < 4:
        return False
    points = some[seen] - some[seen].mean(axis=0)
    least, middle, largest = np.sqrt(np.maximum(np.linalg.eigvalsh(points.T @ points), 0.0)).tolist()
    return bool(least <= share * largest < middle)


def settle_roots(
    path: str | os.PathLike[str],
    skeleton: Skeleton,
    rotations: FloatArray,
    translations: FloatArray,
    some: FloatArray,
) -> tuple[FloatArray, tuple[Message, ...]]:
    """Take lost places of the roots of a motion as missing, and refuse places that are none.

    Parameters
    ----------
    path : for the messages.
    skeleton : of the motion.
    rotations, translations : (T, J, 4) and (T, J, 3) local poses in any unit; changed in place if they can be written
        to.
    some : (T', J, 3) positions of the joints in the world, in some of the frames.

    Returns
    -------
    The translations and notes; rotations of lost frames in which nothing turns are missing too.

    Raises
    ------
    MotionFileError : infinite places, or such as double precision cannot place.
    """
    if not abs(float(translations.sum())) < _EARTH:  # spares the look at every value
        check_place(path, skeleton.names, translations)
    roots = _list_roots(skeleton)
    places = translations[:, :1] if len(roots) == 1 and roots[0] == 0 else translations[:, roots]
    if not (np.abs(places[..., 0]) == np.abs(places[..., 1])).any():  # nearly every file
        return translations, ()
    lost = find_lost(places, can_rest=True, body=some)
    notes = []
    if lost is not None:
        frame, root = np.argwhere(lost)[0]
        example = " ".join(f"{number:.7g}" for number in places[frame, root])
        first = {"name": skeleton.names[roots[root]], "frame": int(frame) + 1}
        notes.append(Message("guard.lost", n=int(lost.sum()), total=lost.size, example=example, **first))
        translations = translations if translations.flags.writeable else translations.copy()
        translations[:, roots] = np.where(lost[..., None], np.nan, translations[:, roots])
        if rotations.flags.writeable:
            frames = np.flatnonzero(lost.all(axis=1))
            rotations[frames[(np.abs(rotations[frames, :, 0]) == 1.0).all(axis=1)]] = np.nan
    return translations, tuple(notes)


@lru_cache(maxsize=64)
def _list_roots(skeleton: Skeleton) -> IndexArray:
    return np.flatnonzero(skeleton.parents < 0)


def check_place(path: str | os.PathLike[str], names: Sequence[str], positions: FloatArray) -> None:
    """Raise MotionFileError, with frame and point, for coordinates that are infinite or beyond the Earth.

    Finite ones that are the same in all three coordinates are let through: they stand for a lost point.

    Parameters
    ----------
    path, names : of the file and of its points (K,), for the message.
    positions : (T, K, 3), NaN where missing.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        if np.fmax.reduce(positions, axis=None) <= _EARTH and np.fmin.reduce(positions, axis=None) >= -_EARTH:
            return
        size = np.abs(positions)
        lost = (size == size[..., :1]).all(axis=2, keepdims=True) & np.isfinite(size)
        far = (size > _EARTH) & ~lost
    if far.any():
        frame, point, axis = np.argwhere(far)[0]
        value = float(positions[frame, point, axis])
        raise MotionFileError(path, "guard.no_place", name=names[point], frame=int(frame) + 1, found=value)


def find_shift(positions: FloatArray, unit: float = 1.0, far: float = _FAR) -> FloatArray | None:
    """Find by how much (3,) to move points so that numbers of 32 bits hold them; None where these do anyway.

    An axis is shifted if all points are far out on it: by a round number, so that the files of one scene mostly move
    equally, and to just above 0, where a floor may be.

    Parameters
    ----------
    positions : (T, K, 3) in the file's unit, NaN where missing.
    unit : metres per unit.
    far : m from the origin.
    """
    limit = far / unit
    if positions.size == 0 or np.abs(positions[0]).max() <= limit:  # spares the look at every value
        return None
    rows = positions.reshape(-1, 3)
    low, high = np.fmin.reduce(rows), np.fmax.reduce(rows)
    out = np.maximum(low, -high) > limit
    if not out.any():
        return None
    step = 10.0 ** np.round(-np.log10(unit))
    shift: FloatArray = np.where(out, np.floor(low / step) * step, 0.0)
    return shift


def note_shift(shift: FloatArray) -> Message:
    """Note that positions were moved by ``shift`` (3,), in the file's unit."""
    return Message("guard.shifted", x=shift[0], y=shift[1], z=shift[2])
