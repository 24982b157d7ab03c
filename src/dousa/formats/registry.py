"""The table of formats, and reading and writing by suffix.

To add a format: write a module with ``read_xxx(path, *, unit=None, up=None)`` and, where it can be written,
``write_xxx(motion, path)``, and add one line to ``FORMATS``. Modules are imported when first used.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from dousa.errors import (
    DousaError,
    JointMappingError,
    MotionFileError,
    MotionWriteError,
    OptionError,
    UnknownFormatError,
)
from dousa.motion import Motion, Trajectories


@dataclass(frozen=True, slots=True)
class Format:
    """One line of the table of formats.

    Parameters
    ----------
    name : short name, the ``format`` of a ``Provenance``.
    suffixes : file name endings, lower case with the dot.
    module : where the functions live.
    reader : name of the function that reads a file, None if the format is only written.
    writer : name of the function that writes a file, None if the format is only read.
    holds : ``"motion"``, ``"trajectories"`` or ``"both"``: what a file of this format can hold.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    reader: str | None
    writer: str | None
    holds: str


FORMATS: tuple[Format, ...] = (
    Format("bvh", (".bvh",), "dousa.formats.bvh", "read_bvh", "write_bvh", "motion"),
    Format("amc", (".amc",), "dousa.formats.asf_amc", "read_amc", None, "motion"),
    Format("c3d", (".c3d",), "dousa.formats.c3d", "read_c3d", "write_c3d", "trajectories"),
    Format("trc", (".trc",), "dousa.formats.trc", "read_trc", "write_trc", "trajectories"),
    Format("npz", (".npz",), "dousa.formats.npz", "read_npz", "write_npz", "both"),
)

READERS: dict[str, Format] = {suffix: line for line in FORMATS if line.reader for suffix in line.suffixes}
"""Format by suffix, for reading."""

WRITERS: dict[str, Format] = {suffix: line for line in FORMATS if line.writer for suffix in line.suffixes}
"""Format by suffix, for writing."""

SUFFIXES: tuple[str, ...] = tuple(READERS)
"""The suffixes that ``read_motion`` knows, lower case with the dot."""


def _function(line: Format, name: str) -> Callable[..., Any]:
    function: Callable[..., Any] = getattr(importlib.import_module(line.module), name)
    return function


def _suffix(path: str | os.PathLike[str]) -> str:
    return os.path.splitext(os.fspath(path))[1].lower()


def _no_format(path: str | os.PathLike[str], known: Iterable[str], *, read: bool) -> UnknownFormatError:
    suffix, names = _suffix(path), tuple(known)
    if os.path.isdir(path):
        return UnknownFormatError(path, "formats.folder")
    if not suffix:
        return UnknownFormatError(path, "formats.unreadable_name" if read else "formats.unwritable_name", known=names)
    code = "formats.unreadable_suffix" if read else "formats.unwritable_suffix"
    return UnknownFormatError(path, code, suffix=suffix, known=names)


def read_motion(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
) -> Motion | Trajectories:
    """Read a motion file of any known format; the suffix tells which.

    Parameters
    ----------
    path : file ending in one of ``SUFFIXES``, in any case.
    unit : metres per unit of the file, or a name such as ``"cm"``; by default what the file declares, else
        inferred from body height.
    up : axis of the file that points up, such as ``"y"`` or ``"-z"``; by default what the file declares, else
        inferred.
    skeleton : the ``.asf`` of an ``.amc``; by default looked for beside and above it.

    Returns
    -------
    A Motion (BVH, AMC) or Trajectories (C3D, TRC), metres, Y up; NPZ gives what was written.

    Raises
    ------
    UnknownFormatError : the suffix is not known.
    MotionFileError : the file is missing, damaged or not of this format.
    OptionError : a unit or axis that does not exist.
    """
    if _suffix(path) == ".asf":
        raise UnknownFormatError(path, "formats.asf_alone")
    line = READERS.get(_suffix(path))
    if line is None or line.reader is None:
        raise _no_format(path, READERS, read=True)
    from dousa.motion.canonical.reference_frame import parse_unit, parse_up

    options: dict[str, Any] = {
        "unit": None if unit is None else parse_unit(unit),
        "up": None if up is None else parse_up(up),
    }
    if skeleton is not None:
        if line.name != "amc":
            raise OptionError("formats.skeleton", path=path)
        options["skeleton"] = skeleton
    reader = _function(line, line.reader)
    try:
        motion: Motion | Trajectories = reader(path, **options)
    except DousaError as error:
        if isinstance(error, MotionFileError | OptionError):
            raise
        # A reader that built impossible arrays met a damaged file: say which.
        raise MotionFileError(path, error.message) from error
    except MemoryError:
        raise MotionFileError(path, "disk.too_large") from None
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise MotionFileError(
            path, "formats.damaged", format=line.name.upper(), kind=type(error).__name__, reason=error
        ) from error
    return motion


def _fit(motion: Trajectories, path: str | os.PathLike[str]) -> Motion:
    from dousa.motion import fit_motion

    try:
        return fit_motion(motion)
    except JointMappingError as error:
        raise MotionWriteError(path, "formats.no_rotations", suffix=_suffix(path), reason=error) from error


def write_motion(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write a motion file; the suffix tells the format.

    The file appears whole or not at all. A Motion written to a format of trajectories (C3D, TRC) becomes the
    positions of its joints; trajectories written to a format of rotations (BVH) become the motion of a body of the
    canonical joints that is fitted to them.

    Parameters
    ----------
    motion : what to write.
    path : file ending in one of the suffixes in ``WRITERS``, in any case.

    Raises
    ------
    UnknownFormatError : the suffix is not known, or this format is only read.
    MotionWriteError : the motion does not fit the format, or the disk refuses.
    """
    line = WRITERS.get(_suffix(path))
    if line is None or line.writer is None:
        raise _no_format(path, WRITERS, read=False)
    if line.holds == "trajectories" and isinstance(motion, Motion):
        from dousa.motion import compute_trajectories

        motion = compute_trajectories(motion)
    elif line.holds == "motion" and isinstance(motion, Trajectories):
        motion = _fit(motion, path)
    _function(line, line.writer)(motion, path)
