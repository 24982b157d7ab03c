"""Skeletons of USD stages, found by the process of `usd_job`, as motions.

Unit (``metersPerUnit``) and up axis are those of the stage. Joints get the axes of the scene, as in a BVH file: at rest
(the bind pose) nothing is turned.
"""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import tempfile
from functools import partial

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MissingExtraError, MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.npz_arrays import open_npz
from dousa.formats.assembly import localise, rest_offsets, settle_motion
from dousa.formats.exchange.programs import Program, ProgramError, run_program
from dousa.formats.parts import choose, distinguish
from dousa.messages import Message
from dousa.motion import Motion, Skeleton
from dousa.motion.rotations import conjugate, from_matrix, multiply

_SIGNS = re.compile(rb"\A(?:#usda|PXR-USDC|PK\x03\x04)")
_CODE = re.compile(r"\bcode (usd\.[a-z_]{1,30})$")


def read_usd(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    person: str | None = None,
) -> Motion:
    """Read the animation of a skeleton of a USD file (text, binary or package).

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default that of the stage, unless the body would have no possible height.
    up : axis that points up; by default that of the stage.
    person : name or number of a skeleton; by default the first that is animated.

    Raises
    ------
    MotionFileError : missing, damaged, no such skeleton, no animation.
    MissingExtraError : usd-core is not installed.
    """
    if not _SIGNS.search(read_bytes(path)[:16]):
        raise MotionFileError(path, "exchange.other_content", format="USD")
    if importlib.util.find_spec("pxr") is None:
        raise MissingExtraError("usd-core", "usd")
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        found = os.path.join(folder, "skeleton.npz")
        job = os.path.join(os.path.dirname(__file__), "usd_job.py")
        _run_job(path, [job, os.path.abspath(path), found], folder, found)
        with open_npz(found, partial(MotionFileError, path)) as file:
            people = distinguish(file.read_texts("people"))
        chosen, notes = choose(path, "person", people, person)
        if chosen:
            os.remove(found)
            _run_job(path, [job, os.path.abspath(path), found, str(chosen)], folder, found)
        return build_usd(path, found, unit=unit, up=up, notes=notes)


def _run_job(path: str | os.PathLike[str], words: list[str], folder: str, found: str) -> None:
    try:
        run_program(Program("usd", sys.executable), words, folder, found)
    except ProgramError as error:
        said = _CODE.search(str(error.message.values.get("reason", "")))
        raise MotionFileError(path, Message(said[1]) if said else error.message) from error


def build_usd(
    path: str | os.PathLike[str],
    found: str | os.PathLike[str],
    *,
    unit: float | str | None,
    up: str | None,
    notes: tuple[Message, ...] = (),
) -> Motion:
    """Build a motion from the arrays of `usd_job`.

    Parameters
    ----------
    path : of the USD file, for messages and provenance.
    found : npz with the arrays.
    unit, up : as for `read_usd`.
    notes : for the user, on the reading of the file.
    """
    fail, most_bytes = partial(MotionFileError, path), 4_000_000_000
    with open_npz(found, fail) as file:
        frames = file.read("frames", "f", 4, most_bytes)
        rest = file.read("rest", "f", 3, most_bytes)
        parents = [int(parent) for parent in file.read("parents", "i", 1)]
        names = _shorten(file.read_texts("names"))
        rate, metres = (float(file.read(name, "fi", 1)[0]) for name in ("rate", "unit"))
        axis = file.read_texts("up")[0].lower()
    n_joints = len(parents)
    if not 0 < n_joints <= 10_000 or any(parent >= joint for joint, parent in enumerate(parents)):
        raise fail(Message("usd.tree"))
    if not (np.isfinite(frames).all() and np.isfinite(rest).all()) or not 0 < rate <= 1e6:
        raise fail(Message("usd.finite"))
    resting, places = _pose_of(rest), rest[:, 3, :3]
    world = multiply(_pose_of(frames), conjugate(resting))
    rotations, translations = localise(parents, world, frames[:, :, 3, :3])
    skeleton = Skeleton(names, np.array(parents, np.intp), rest_offsets(parents, places))
    return settle_motion(
        path, "usd", skeleton, rotations, translations, rate,
        unit=unit, up=up, declared_unit=metres if 0 < metres < 1e6 else None,
        up_in_file=axis if axis in ("y", "z") else None, notes=notes,
    )  # fmt: skip


def _pose_of(matrices: FloatArray) -> FloatArray:
    """Orientations (..., 4) of matrices (..., 4, 4) for row vectors, with any scale."""
    axes = matrices[..., :3, :3]
    lengths = np.linalg.norm(axes, axis=-1, keepdims=True)
    axes = np.where(lengths > 1e-12, axes / np.maximum(lengths, 1e-12), np.eye(3))
    mirrored = np.linalg.det(axes) < 0
    axes = np.where(mirrored[..., None, None], -axes, axes)
    return from_matrix(np.swapaxes(axes, -1, -2))


def _shorten(paths: tuple[str, ...]) -> tuple[str, ...]:
    """Last part of each path of a joint, if these are unique."""
    names = tuple(path.rpartition("/")[2] or path for path in paths)
    return names if len(set(names)) == len(names) else paths
