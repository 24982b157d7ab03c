"""dousa's own NPZ files, with all content of a Motion or Trajectories; and npz files of other kinds, by their arrays.

dousa's is a zip of arrays as ``numpy.savez`` makes it, uncompressed, so that ``numpy.load`` opens it too:

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

Nothing is pickled. Only uncompressed members are accepted, and an array must fill its member exactly, so memory is
bounded by the size of the file.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import InvalidMotionError, MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes
from dousa.files.npz_arrays import NpzFile, open_npz
from dousa.formats.arrays.content import read_arrays
from dousa.formats.assembly import settle_motion, settle_trajectories
from dousa.formats.guard import compare_bytes
from dousa.messages import Message
from dousa.motion import Motion, Provenance, Skeleton, Trajectories
from dousa.motion.canonical.reference_frame import parse_unit, parse_up

_FORMAT, _VERSION = "dousa motion", 1

_PROVENANCE_TEXTS = ("path", "format", "unit_source", "up", "up_source")


def read_npz(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Motion | Trajectories:
    """Read a file written by ``write_npz``; of units and axes only metres and ``"y"`` fit.

    Raises
    ------
    MotionFileError : missing, damaged, not dousa's own, written by a newer version, or another unit asked for.
    """
    if (unit is not None and parse_unit(unit) != 1.0) or (up is not None and parse_up(up) != "y"):
        raise MotionFileError(path, "dousa_npz.unit")
    data, fail = read_bytes(path), partial(MotionFileError, path)
    try:
        with open_npz(data, fail) as file:
            return _build(_Reader(file, len(data), fail))
    except InvalidMotionError as error:
        raise MotionFileError(path, "dousa_npz.damaged", reason=error) from error


class _Reader:
    """The arrays of a motion file of dousa; none may be compressed or larger than the file."""

    def __init__(self, file: NpzFile, size: int, fail: Callable[[Message], MotionFileError]) -> None:
        self.file, self._size, self.fail = file, size, fail
        if len(file.names) > 64:
            raise fail(Message("dousa_npz.many", found=len(file.names)))
        if file.compressed:
            raise fail(Message("dousa_npz.compressed", array=file.compressed[0]))

    def take(self, name: str, kinds: str, ndim: int) -> NDArray[Any]:
        """Return an array of the wanted kinds of dtype and number of axes."""
        if name not in self.file:
            raise self.fail(Message("dousa_npz.lacks", array=name))
        return self.file.read(name, kinds, ndim, self._size)


def _build(reader: _Reader) -> Motion | Trajectories:
    take = reader.take
    if str(take("format", "U", 0)) != _FORMAT:
        raise reader.fail(Message("dousa_npz.other"))
    version = int(take("version", "iu", 0))
    if version != _VERSION:
        raise reader.fail(Message("dousa_npz.version", found=str(version), known=_VERSION))
    names = tuple(str(name) for name in take("names", "U", 1))
    rate = float(take("frame_rate", "f", 0))
    provenance = _read_provenance(reader)
    kind = str(take("kind", "U", 0))
    if kind == "motion":
        parents = take("parents", "iu", 1).astype(np.int64)
        skeleton = Skeleton(names, parents, take("offsets", "f", 2), take("end_sites", "b", 1))
        return Motion(skeleton, take("rotations", "f", 3), take("translations", "f", 3), rate, provenance)
    if kind != "trajectories":
        raise reader.fail(Message("dousa_npz.kind", found=kind[:40]))
    tree = take("parents", "iu", 1).astype(np.int64) if "parents" in reader.file else None
    rest = take("rest_positions", "f", 2) if "rest_positions" in reader.file else None
    return Trajectories(names, take("positions", "f", 3), rate, tree, rest, provenance)


def _read_provenance(reader: _Reader) -> Provenance | None:
    if "provenance" not in reader.file:
        return None
    try:
        fields = json.loads(str(reader.take("provenance", "U", 0)))
    except (ValueError, RecursionError) as error:
        raise reader.fail(Message("dousa_npz.no_json")) from error
    if not isinstance(fields, dict) or not all(isinstance(fields.get(key), str) for key in _PROVENANCE_TEXTS):
        raise reader.fail(Message("dousa_npz.provenance", texts=_PROVENANCE_TEXTS))
    unit = fields.get("unit")
    if not isinstance(unit, float) or not 0 < unit < float("inf"):
        raise reader.fail(Message("dousa_npz.metres", found=repr(unit)))
    return Provenance(unit=unit, **{key: fields[key] for key in _PROVENANCE_TEXTS})


def write_npz(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write a motion or trajectories as dousa's own file; only the layout of the source file is lost.

    Raises
    ------
    MotionWriteError : a name with a zero byte, a disk error.
    """
    arrays = _list_arrays(motion)
    names = motion.skeleton.names if isinstance(motion, Motion) else motion.names
    if any("\0" in name for name in names):
        raise MotionWriteError(path, "dousa_npz.zero_byte")
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


def _list_arrays(motion: Motion | Trajectories) -> dict[str, NDArray[Any]]:
    if isinstance(motion, Motion):
        skeleton = motion.skeleton
        fields = {name: getattr(skeleton, name) for name in ("parents", "offsets", "end_sites")}
        fields |= {"rotations": motion.rotations, "translations": motion.translations}
        return {"kind": np.array("motion"), **fields}
    fields = {name: getattr(motion, name) for name in ("positions", "parents", "rest_positions")}
    given = {name: array for name, array in fields.items() if array is not None}
    return {"kind": np.array("trajectories"), **given}


def read_any_npz(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None, **options: Any
) -> Motion | Trajectories:
    """Read an npz file; its kind follows from its arrays.

    Parameters
    ----------
    path : a file that dousa wrote, or an archive of SMPL poses (AMASS), of joints (T, J, 3), or of pickled dictionaries
        of such; nothing in it is executed.
    unit, up : if not in the file; dousa's own has both.
    options : of `read_arrays`, for files of others.

    Raises
    ------
    MotionFileError : missing, damaged, or none of these.
    """
    with open_npz(path, partial(MotionFileError, path)) as file:
        behind, own = max(0, file.n_behind), "format" in file or not file.names
    motion = _guard(path, read_npz(path, unit=unit, up=up)) if own else read_arrays(path, unit=unit, up=up, **options)
    if not behind:
        return motion
    source = motion.provenance or Provenance(os.fspath(path), "npz")
    source = dataclasses.replace(source, notes=(*source.notes, *compare_bytes(0, behind)))
    return dataclasses.replace(motion, provenance=source)


def _guard(path: str | os.PathLike[str], motion: Motion | Trajectories) -> Motion | Trajectories:
    """What the guard makes of a motion of dousa's own file; the motion as it was written where it finds nothing."""
    settled: Motion | Trajectories
    if isinstance(motion, Motion):
        arrays = (motion.skeleton, motion.rotations, motion.translations)
        settled = settle_motion(path, "npz", *arrays, motion.frame_rate, unit=1.0, up="y")
    else:
        settled = settle_trajectories(path, "npz", motion.names, motion.positions, motion.frame_rate, unit=1.0, up="y")
        settled = dataclasses.replace(settled, parents=motion.parents, rest_positions=motion.rest_positions)
    found = settled.provenance
    notes = tuple(note for note in found.notes if note.code.startswith("guard.")) if found is not None else ()
    if found is None or not notes:
        return motion
    return dataclasses.replace(
        settled, provenance=dataclasses.replace(motion.provenance or found, notes=notes, shift=found.shift)
    )
