"""The keys of a VMD file: of bones, and which IK is on.

Header of 30 bytes and the name of the model; then counted tables: bones (name of 15 bytes in Shift-JIS, frame at 30 Hz,
place, quaternion x y z w, 64 bytes of Bezier curves for x, y, z and the turn), face, camera, light, shadow, IK. A curve
leads from the key before to its own key: (0, 0), (x1, y1), (x2, y2), (127, 127). Left-handed with Y up and Z to the
back: z is mirrored here, so that a model faces +Z. Later tables may be missing.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.motion.rotations import slerp


class Cursor:
    """A place in the bytes of a file, little endian.

    Parameters
    ----------
    path : for messages.
    data : all bytes.
    place : where to begin.
    """

    def __init__(self, path: str | os.PathLike[str], data: bytes, place: int = 0) -> None:
        self.path, self.data, self.place = path, data, place

    @property
    def left(self) -> int:
        """Number of bytes that follow."""
        return len(self.data) - self.place

    def fail(self, code: str, **values: Any) -> MotionFileError:
        """Return an error about this file."""
        return MotionFileError(self.path, code, **values)

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        if not 0 <= size <= self.left:
            raise self.fail("mmd.truncated", place=self.place)
        self.place += size
        return self.data[self.place - size : self.place]

    def unpack(self, form: str) -> tuple[Any, ...]:
        """Return values of a format of `struct`."""
        return struct.unpack("<" + form, self.take(struct.calcsize("<" + form)))

    def count(self, form: str, smallest: int) -> int:
        """Return a number of items of at least so many bytes each; no more than fit in the rest of the file."""
        (number,) = self.unpack(form)
        if number < 0 or number * smallest > self.left:
            raise self.fail("mmd.truncated", place=self.place)
        return int(number)

    def rows(self, dtype: np.dtype[Any], form: str = "I") -> NDArray[Any]:
        """Return a counted table of rows of one size."""
        number = self.count(form, dtype.itemsize)
        return np.frombuffer(self.take(number * dtype.itemsize), dtype)

    def index(self, size: int) -> int:
        """Return an index, -1 for none, in 1, 2 or 4 bytes."""
        return int(self.unpack({1: "b", 2: "h", 4: "i"}[size])[0])


def decode_name(raw: bytes) -> str:
    """Decode a name of a VMD or PMD file: Shift-JIS up to the first zero byte; a letter cut at the end is left out."""
    text = raw.split(b"\0", 1)[0]
    try:
        return text.decode("cp932")
    except UnicodeDecodeError as error:
        if error.end >= len(text):
            return text[: error.start].decode("cp932", "replace")
        return text.decode("cp932", "replace")


_MAGIC = b"Vocaloid Motion Data "
# A key of a bone, by the definition of the format.
_BONE = np.dtype(
    [("name", "S15"), ("frame", "<u4"), ("place", "<f4", 3), ("turn", "<f4", 4), ("curve", "u1", 64)]
)  # fmt: skip
# Straight curves by the definition of the format: x1, y1, x2, y2 of four channels; three more rows, each shifted.
_STRAIGHT = b"".join((bytes([20] * 8 + [107] * 8) + bytes(3))[row : row + 16] for row in range(4))
# Bytes of a row of the tables that follow, by the definition of the format.
_SIZES = {"face": 23, "camera": 61, "light": 28, "shadow": 9}


@dataclass(frozen=True, slots=True, eq=False)
class BoneKeys:
    """The keys of one bone, frames ascending and each once.

    Parameters
    ----------
    frames : (K,).
    places : (K, 3) moved from rest, units of the file, z mirrored.
    turns : (K, 4) unit quaternions w x y z.
    curves : (K, 4, 4) x1, y1, x2, y2 from 0 to 1 of the curves of x, y, z and the turn.
    """

    frames: IndexArray
    places: FloatArray
    turns: FloatArray
    curves: FloatArray

    def sample(self, n_frames: int) -> tuple[FloatArray, FloatArray]:
        """Interpolate places (T, 3) and turns (T, 4) at the frames 0 to T - 1."""
        wanted = np.arange(n_frames)
        after = np.clip(np.searchsorted(self.frames, wanted, side="left"), 0, len(self.frames) - 1)
        before = np.maximum(after - (self.frames[after] > wanted), 0)
        span = np.maximum(self.frames[after] - self.frames[before], 1)
        share = np.clip((wanted - self.frames[before]) / span, 0.0, 1.0)
        places = np.repeat(self.places[:1], n_frames, axis=0)
        for axis in np.flatnonzero(np.ptp(self.places, axis=0)):  # most bones only turn
            way = self.places[after, axis] - self.places[before, axis]
            places[:, axis] = self.places[before, axis] + way * ease(share, self.curves[after, axis])
        return places, slerp(self.turns[before], self.turns[after], ease(share, self.curves[after, 3]))


def ease(share: FloatArray, curves: FloatArray, bisections: int = 20) -> FloatArray:
    """Compute the progress (T,) of a value after a share (T,) of the time, by Bezier curves (T, 4) x1, y1, x2, y2."""
    x1, y1, x2, y2 = curves.T
    result = share.copy()
    bent = ((x1 != y1) | (x2 != y2)) & (share > 0) & (share < 1)
    if bent.any():
        x1, y1, x2, y2, wanted = x1[bent], y1[bent], x2[bent], y2[bent], share[bent]
        low, high = np.zeros(len(wanted)), np.ones(len(wanted))
        for _ in range(bisections):
            middle = (low + high) / 2
            rest = 1 - middle
            left = 3 * rest * rest * middle * x1 + 3 * rest * middle * middle * x2 + middle**3 < wanted
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        middle = (low + high) / 2
        rest = 1 - middle
        result[bent] = 3 * rest * rest * middle * y1 + 3 * rest * middle * middle * y2 + middle**3
    return result


@dataclass(frozen=True, slots=True, eq=False)
class VmdFile:
    """Keys of a body in a VMD file.

    Parameters
    ----------
    model : name of the model of the motion.
    bones : keys by the name of the bone.
    n_frames : at 30 Hz, from frame 0 to the last key of a bone.
    switches : (frame, {name of the IK bone: whether it is on}), frames ascending.
    """

    model: str
    bones: dict[str, BoneKeys]
    n_frames: int
    switches: tuple[tuple[int, dict[str, bool]], ...]


def load_vmd(path: str | os.PathLike[str]) -> VmdFile:
    """Read the keys of bones and of IK; MotionFileError if damaged, without keys of bones, or too long."""
    data = read_bytes(path)
    if not data.startswith(_MAGIC):
        raise MotionFileError(path, "mmd.no_vmd")
    cursor = Cursor(path, data)
    version = cursor.take(30).split(b"\0", 1)[0]
    model = decode_name(cursor.take(10 if version == _MAGIC + b"file" else 20))
    rows = cursor.rows(_BONE)
    if not len(rows):
        raise MotionFileError(path, "mmd.no_bones")
    last = int(rows["frame"].max())
    most = max(1000, 100 * len(rows))
    if last >= most:
        raise MotionFileError(path, "mmd.frames", found=last, keys=len(rows))
    return VmdFile(model, _sort_keys(cursor, rows), last + 1, _read_switches(cursor))


def _sort_keys(cursor: Cursor, rows: np.ndarray, most: int = 10_000) -> dict[str, BoneKeys]:
    """Keys by the name of the bone; MotionFileError for values that are not finite, or more than ``most`` bones."""
    if not (np.isfinite(rows["place"]).all() and np.isfinite(rows["turn"]).all()):
        raise cursor.fail("mmd.finite")
    raw, inverse = np.unique(rows["name"], return_inverse=True)
    # What follows the zero byte of a name is anything.
    decoded = [decode_name(bytes(name)) for name in raw]
    names = list(dict.fromkeys(decoded))
    if len(names) > most:
        raise cursor.fail("mmd.many_bones", found=len(names), most=most)
    owner = np.array([names.index(name) for name in decoded], np.intp)[inverse]
    order = np.lexsort((rows["frame"], owner))
    counts = np.bincount(owner, minlength=len(names))
    return dict(zip(names, map(_make_keys, np.split(rows[order], np.cumsum(counts)[:-1])), strict=True))


def _make_keys(rows: np.ndarray) -> BoneKeys:
    """Keys of one bone from its rows, frames ascending; of several in a frame the last counts."""
    rows = rows[np.append(rows["frame"][1:] != rows["frame"][:-1], True)]
    turns = rows["turn"].astype(np.float64)[:, [3, 0, 1, 2]] * (1, -1, -1, 1)
    lengths = np.linalg.norm(turns, axis=1, keepdims=True)
    turns = np.where(lengths > 1e-6, turns / np.maximum(lengths, 1e-6), (1.0, 0, 0, 0))
    # Of each channel its own row of 16 bytes: the first row is partly overwritten by the switch of the physics.
    curves = rows["curve"].reshape(-1, 4, 4, 4)[:, :, :, 0].astype(np.float64) / 127.0
    places = rows["place"].astype(np.float64) * (1, 1, -1)
    return BoneKeys(rows["frame"].astype(np.intp), places, turns, np.minimum(curves, 1.0))


def encode_keys(model: str, bones: dict[str, tuple[FloatArray, FloatArray]]) -> bytes:
    """Return the head of a VMD file and the table of its keys, a key for each row from frame 0 on, without curves.

    Parameters
    ----------
    model : name of the model of the motion.
    bones : by name places (K, 3) moved from rest, units of the file, z mirrored, and unit quaternions (K, 4) w x y z.
    """
    tables = []
    for name, (places, turns) in bones.items():
        rows = np.zeros(len(turns), _BONE)
        rows["name"], rows["frame"] = name.encode("cp932")[:15], np.arange(len(turns))
        rows["place"] = places * (1, 1, -1)
        rows["turn"] = (turns * (1, -1, -1, 1))[:, [1, 2, 3, 0]]
        rows["curve"] = np.frombuffer(_STRAIGHT, np.uint8)
        tables.append(rows)
    keys = np.concatenate(tables)
    head = (_MAGIC + b"0002").ljust(30, b"\0") + model.encode("cp932")[:20].ljust(20, b"\0")
    return head + struct.pack("<I", len(keys)) + keys.tobytes()


def _read_switches(cursor: Cursor) -> tuple[tuple[int, dict[str, bool]], ...]:
    """Switches of IK by frame; () where the file ends before, as in older programs."""
    switches = []
    try:
        for size in _SIZES.values():
            cursor.take(cursor.count("I", size) * size)
        for _ in range(cursor.count("I", 9)):
            frame, _, number = cursor.unpack("IBI")
            if number * 21 > cursor.left:
                break
            rows = [cursor.unpack("20sB") for _ in range(number)]
            switches.append((int(frame), {decode_name(name): bool(on) for name, on in rows}))
    except MotionFileError:
        pass
    return tuple(sorted(switches, key=lambda row: row[0]))
