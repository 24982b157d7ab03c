"""Writing C3D files: Intel floats, millimetres, Y up, no analog channels."""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence

import numpy as np

from dousa._files import atomic_write
from dousa.errors import MotionWriteError
from dousa.motion import Trajectories

__all__ = ["write_c3d"]

_BLOCK = 512
_INTEL = 84
_MOST_LABELS = 255  # of one parameter, whose sizes are bytes
_FULL_COUNTER = 65_535
_CHUNK_FRAMES = 4096


def write_c3d(motion: Trajectories, path: str | os.PathLike[str]) -> None:
    """Write trajectories as a C3D file, in mm with Y up, as 32-bit floats.

    Missing positions get the residual -1. Names are kept; the tree and the rest pose have no place in C3D.

    Parameters
    ----------
    motion : trajectories.
    path : the file to write.

    Raises
    ------
    MotionWriteError : names that C3D cannot hold, too many points, positions too large, a disk that refuses.
    """
    names = [_check_name(path, name) for name in motion.names]
    # The place of the data is in the parameters, whose size does not depend on it.
    blocks = -(-len(_parameter_section(motion, names, 0)) // _BLOCK)
    if len(names) > _FULL_COUNTER or blocks > 255:
        raise MotionWriteError(
            path, f"{len(names)} points with these names do not fit into a C3D file; use .npz"
        )
    section = _parameter_section(motion, names, 2 + blocks).ljust(blocks * _BLOCK, b"\0")
    section = section[:2] + bytes([blocks]) + section[3:]
    with atomic_write(path) as file:
        file.write(_header(motion, 2 + blocks))
        file.write(section)
        for start in range(0, motion.n_frames, _CHUNK_FRAMES):
            file.write(_encode_frames(path, motion.positions[start : start + _CHUNK_FRAMES]))
        file.write(bytes(-file.tell() % _BLOCK))


def _check_name(path: str | os.PathLike[str], name: str) -> bytes:
    try:
        text = name.encode("utf-8")
    except UnicodeEncodeError:
        text = b""
    if not text.strip() or len(text) > 255 or text.startswith(b"*") or b"\0" in text:
        raise MotionWriteError(
            path,
            f"point name {name[:40]!r}: C3D wants 1 to 255 bytes and no * at the start, "
            "which marks unlabelled points",
        )
    return text


def _encode_frames(path: str | os.PathLike[str], positions: np.ndarray) -> bytes:
    words = np.zeros((*positions.shape[:2], 4), "<f4")
    missing = np.isnan(positions).any(axis=2)
    with np.errstate(over="ignore"):
        words[..., :3] = positions * 1000.0
    words[missing] = (0.0, 0.0, 0.0, -1.0)
    if not np.isfinite(words).all():
        raise MotionWriteError(path, "positions beyond the range of 32-bit floats; is the unit right?")
    return words.tobytes()


def _header(motion: Trajectories, data_block: int) -> bytes:
    last = min(motion.n_frames, _FULL_COUNTER)
    start = struct.pack(
        "<BBHHHHHfHHf", 2, 0x50, len(motion.names), 0, 1, last, 0, -1.0, data_block, 0, motion.frame_rate
    )
    return start.ljust(_BLOCK, b"\0")


def _parameter_section(motion: Trajectories, names: list[bytes], data_block: int) -> bytes:
    frames = motion.n_frames
    point = [
        _integers("USED", [len(names)]),
        _floats("SCALE", [-1.0]),
        _floats("RATE", [motion.frame_rate]),
        _integers("DATA_START", [data_block]),
        _integers("FRAMES", [min(frames, _FULL_COUNTER)]),
        _floats("LONG_FRAMES", [frames]),
        _texts("UNITS", [b"mm"]),
        _texts("X_SCREEN", [b"+X"]),
        _texts("Y_SCREEN", [b"+Y"]),
    ]
    for number, start in enumerate(range(0, len(names), _MOST_LABELS), 1):
        part, suffix = names[start : start + _MOST_LABELS], "" if number == 1 else str(number)
        point += [_texts(f"LABELS{suffix}", part), _texts(f"DESCRIPTIONS{suffix}", [b""] * len(part))]
    groups = {
        "POINT": point,
        "ANALOG": [_integers("USED", [0]), _floats("RATE", [0.0]), _floats("GEN_SCALE", [1.0])],
        "FORCE_PLATFORM": [_integers("USED", [0])],
        "TRIAL": [
            _integers("ACTUAL_START_FIELD", [1, 0]),
            _integers("ACTUAL_END_FIELD", [frames % 65_536, frames // 65_536]),
        ],
    }
    section = bytes([1, 0x50, 0, _INTEL])
    for group_id, (name, parameters) in enumerate(groups.items(), 1):
        section += struct.pack("bb", len(name), -group_id) + name.encode() + b"\3\0\0"
        for parameter_name, content in parameters:
            section += struct.pack("bb", len(parameter_name), group_id) + parameter_name.encode()
            section += struct.pack("<H", len(content) + 3) + content + b"\0"
    return section + b"\0\0"


def _integers(name: str, values: Sequence[int]) -> tuple[str, bytes]:
    return name, _array(2, values, "<u2")


def _floats(name: str, values: Sequence[float]) -> tuple[str, bytes]:
    return name, _array(4, values, "<f4")


def _array(item_size: int, values: Sequence[float], dtype: str) -> bytes:
    """One value is a scalar, more are a list."""
    axes = [] if len(values) == 1 else [len(values)]
    return struct.pack("bB", item_size, len(axes)) + bytes(axes) + np.array(values, dtype).tobytes()


def _texts(name: str, values: list[bytes]) -> tuple[str, bytes]:
    """One text is a string, more are a table of strings of equal length."""
    length = max(1, *map(len, values)) if len(values) > 1 else max(1, len(values[0]))
    content = b"".join(value.ljust(length) for value in values)
    return name, struct.pack("bBBB", -1, 2, length, len(values)) + content
