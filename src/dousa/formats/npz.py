"""NPZ: dousa's own files, which hold everything a Motion or Trajectories holds.

A zip of arrays as ``numpy.savez`` makes it, uncompressed, so that ``numpy.load`` opens it too:

    format            "dousa motion"
    version           1
    kind              "motion" or "trajectories"
    names             (J,) text
    frame_rate        Hz
    parents           (J,); -1 for a root; trajectories may lack it
    provenance        JSON text: path, format, unit, unit_source, up, up_source; may be lacking
    offsets           (J, 3) m                 motion
    end_sites         (J,) bool                motion
    rotations         (T, J, 4) w x y z        motion
    translations      (T, J, 3) m              motion
    positions         (T, J, 3) m              trajectories
    rest_positions    (J, 3) m                 trajectories, may be lacking

Nothing is pickled. A reader never trusts a size in the file: only uncompressed members are accepted, and an
array must fill its member exactly, so memory is bounded by the size of the file.
"""

from __future__ import annotations

import io
import json
import os
import re
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa._files import atomic_write, read_bytes
from dousa.errors import InvalidMotionError, MotionFileError, MotionWriteError
from dousa.motion import Motion, Provenance, Skeleton, Trajectories
from dousa.motion.reference_frame import parse_unit, parse_up

__all__ = ["read_npz", "write_npz"]

_FORMAT, _VERSION = "dousa motion", 1
_MAGIC = b"\x93NUMPY"
_MOST_MEMBERS = 64
_LAST_CODE_POINT = 0x10FFFF
# The header that numpy writes, taken apart without evaluating it.
_HEADER = re.compile(
    r"\{'descr': '([<>|=]?[bifuU]\d{1,9})', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,200})\), ?\}\s*"
)
_PROVENANCE_TEXTS = ("path", "format", "unit_source", "up", "up_source")


class _DamagedError(Exception):
    """A member that is not what it should be; never leaves this module."""


def read_npz(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Motion | Trajectories:
    """Read a file written by ``write_npz``.

    Parameters
    ----------
    path : the file.
    unit, up : accepted for the sake of ``read_motion``; only metres and ``"y"`` fit, as dousa's own files hold
        nothing else.

    Returns
    -------
    The Motion or Trajectories that was written.

    Raises
    ------
    MotionFileError : missing, damaged, not dousa's own, written by a newer version, or another unit asked for.
    """
    if (unit is not None and parse_unit(unit) != 1.0) or (up is not None and parse_up(up) != "y"):
        raise MotionFileError(path, "dousa's own files are in metres with Y up; leave out unit and up axis")
    data = read_bytes(path)
    try:
        arrays = _read_members(data)
        return _build(arrays)
    except _DamagedError as error:
        raise MotionFileError(path, str(error)) from error
    except InvalidMotionError as error:
        raise MotionFileError(path, f"damaged: {error}") from error
    # What zipfile raises on damaged archives, found by fuzzing and in its source.
    except (
        zipfile.BadZipFile,
        NotImplementedError,
        RuntimeError,
        OSError,
        EOFError,
        ValueError,
        OverflowError,
    ) as error:
        raise MotionFileError(path, f"damaged, or not an .npz file: {error}") from error


def _read_members(data: bytes) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        if len(members) > _MOST_MEMBERS:
            raise _DamagedError(f"expected a motion file of dousa, got an archive of {len(members)} files")
        for member in members:
            name = member.filename.removesuffix(".npy")
            if member.compress_type != zipfile.ZIP_STORED:
                raise _DamagedError(
                    f"'{name}' is compressed; dousa writes uncompressed files, write it again"
                )
            if member.file_size > len(data):
                raise _DamagedError(f"'{name}' claims {member.file_size} bytes, the file has {len(data)}")
            arrays[name] = _parse_array(name, archive.read(member))
    return arrays


def _parse_array(name: str, data: bytes) -> NDArray[Any]:
    """The array in the bytes of an .npy file; its size must match to the byte."""
    if data[:6] != _MAGIC or len(data) < 12:
        raise _DamagedError(f"'{name[:40]}' is not a numpy array")
    wide = data[6] >= 2
    start = 12 if wide else 10
    end = start + int.from_bytes(data[8:start], "little")
    found = _HEADER.fullmatch(data[start:end].decode("latin-1"))
    if found is None:
        raise _DamagedError(f"'{name[:40]}' is not a plain numpy array of numbers or text")
    dtype = _parse_dtype(found[1])
    shape = tuple(int(size) for size in found[3].replace(" ", "").split(",") if size)
    count = 1
    for size in shape:
        count *= size
    if count * dtype.itemsize != len(data) - end or len(shape) > 4:
        raise _DamagedError(
            f"'{name[:40]}' declares shape {shape}, {count * dtype.itemsize} bytes, and holds {len(data) - end}"
        )
    if count == 0:
        return np.empty(shape, dtype)
    flat = np.frombuffer(data, dtype, count, end)
    if dtype.kind == "U" and flat.astype(dtype.newbyteorder("=")).view(np.uint32).max() > _LAST_CODE_POINT:
        raise _DamagedError(f"'{name[:40]}' is not text")
    return flat.reshape(shape, order="F" if found[2] == "True" else "C")


def _parse_dtype(text: str) -> np.dtype[Any]:
    try:
        dtype = np.dtype(text)
    except TypeError as error:
        raise _DamagedError(f"no such kind of number: '{text}'") from error
    if dtype.itemsize == 0:  # a thousand million empty texts would take no room in the file
        raise _DamagedError("an array of items without size")
    return dtype


def _take(arrays: dict[str, NDArray[Any]], name: str, kinds: str, ndim: int) -> NDArray[Any]:
    """An array of the wanted kinds of dtype and number of axes."""
    if name not in arrays:
        raise _DamagedError(f"not a motion file of dousa: no array '{name}'")
    array = arrays[name]
    if array.dtype.kind not in kinds or array.ndim != ndim:
        raise _DamagedError(
            f"'{name}': expected {ndim} axes of kind '{kinds}', got {array.ndim} of '{array.dtype.kind}'"
        )
    return array


def _build(arrays: dict[str, NDArray[Any]]) -> Motion | Trajectories:
    if str(_take(arrays, "format", "U", 0)) != _FORMAT:
        raise _DamagedError("not a motion file of dousa")
    version = int(_take(arrays, "version", "iu", 0))
    if version != _VERSION:
        raise _DamagedError(
            f"written by another version of dousa (layout {version}, known: {_VERSION}); update dousa"
        )
    names = tuple(str(name) for name in _take(arrays, "names", "U", 1))
    rate = float(_take(arrays, "frame_rate", "f", 0))
    provenance = _read_provenance(arrays)
    kind = str(_take(arrays, "kind", "U", 0))
    if kind == "motion":
        skeleton = Skeleton(
            names,
            _take(arrays, "parents", "iu", 1).astype(np.int64),
            _take(arrays, "offsets", "f", 2),
            _take(arrays, "end_sites", "b", 1),
        )
        rotations, translations = _take(arrays, "rotations", "f", 3), _take(arrays, "translations", "f", 3)
        return Motion(skeleton, rotations, translations, rate, provenance)
    if kind != "trajectories":
        raise _DamagedError(f"kind: expected 'motion' or 'trajectories', got '{kind[:40]}'")
    parents = _take(arrays, "parents", "iu", 1).astype(np.int64) if "parents" in arrays else None
    rest = _take(arrays, "rest_positions", "f", 2) if "rest_positions" in arrays else None
    return Trajectories(names, _take(arrays, "positions", "f", 3), rate, parents, rest, provenance)


def _read_provenance(arrays: dict[str, NDArray[Any]]) -> Provenance | None:
    if "provenance" not in arrays:
        return None
    try:
        fields = json.loads(str(_take(arrays, "provenance", "U", 0)))
    except (ValueError, RecursionError) as error:
        raise _DamagedError("provenance: not JSON") from error
    if not isinstance(fields, dict) or not all(isinstance(fields.get(key), str) for key in _PROVENANCE_TEXTS):
        raise _DamagedError(f"provenance: expected the texts {', '.join(_PROVENANCE_TEXTS)}")
    unit = fields.get("unit")
    if not isinstance(unit, float) or not 0 < unit < float("inf"):
        raise _DamagedError(f"provenance: expected metres per unit above 0, got {unit!r}")
    return Provenance(unit=unit, **{key: fields[key] for key in _PROVENANCE_TEXTS})


def write_npz(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write a motion or trajectories as dousa's own file; nothing is lost but the layout of the source file.

    Parameters
    ----------
    motion : what to write.
    path : the file to write.

    Raises
    ------
    MotionWriteError : a name with a zero byte, a disk that refuses.
    """
    arrays = _motion_arrays(motion) if isinstance(motion, Motion) else _trajectory_arrays(motion)
    names = motion.skeleton.names if isinstance(motion, Motion) else motion.names
    if any("\0" in name for name in names):
        raise MotionWriteError(path, "a joint name holds a zero byte; rename it")
    arrays |= {
        "format": np.array(_FORMAT),
        "version": np.array(_VERSION),
        "names": np.array(names),
        "frame_rate": np.array(motion.frame_rate),
    }
    source = motion.provenance
    if source is not None:
        fields = {key: getattr(source, key) for key in _PROVENANCE_TEXTS} | {"unit": float(source.unit)}
        arrays["provenance"] = np.array(json.dumps(fields))
    with atomic_write(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def _motion_arrays(motion: Motion) -> dict[str, NDArray[Any]]:
    return {
        "kind": np.array("motion"),
        "parents": motion.skeleton.parents,
        "offsets": motion.skeleton.offsets,
        "end_sites": motion.skeleton.end_sites,
        "rotations": motion.rotations,
        "translations": motion.translations,
    }


def _trajectory_arrays(motion: Trajectories) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {"kind": np.array("trajectories"), "positions": motion.positions}
    if motion.parents is not None:
        arrays["parents"] = motion.parents
    if motion.rest_positions is not None:
        arrays["rest_positions"] = motion.rest_positions
    return arrays
