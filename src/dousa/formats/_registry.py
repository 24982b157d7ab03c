"""The table of formats, and reading and writing by suffix.

To add a format: write a module with ``read_xxx(path, *, unit=None, up=None)`` and, where it can be written,
``write_xxx(motion, path)``, and add one line to ``FORMATS``. Modules are imported when first used.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
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

__all__ = ["FORMATS", "READERS", "SUFFIXES", "WRITERS", "Format", "read_motion", "write_motion"]


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


def _no_format(path: str | os.PathLike[str], table: dict[str, Format], verb: str) -> UnknownFormatError:
    if os.path.isdir(path):
        return UnknownFormatError(path, "expected a motion file, this is a folder")
    suffix = _suffix(path)
    what = f"no format for '{suffix}'" if suffix else "the name has no suffix"
    return UnknownFormatError(path, f"{what}; files that can be {verb} end in {', '.join(table)}")


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
        raise UnknownFormatError(
            path, "an .asf is a skeleton without motion; give the .amc that goes with it"
        )
    line = READERS.get(_suffix(path))
    if line is None or line.reader is None:
        raise _no_format(path, READERS, "read")
    from dousa.motion.reference_frame import parse_unit, parse_up

    options: dict[str, Any] = {
        "unit": None if unit is None else parse_unit(unit),
        "up": None if up is None else parse_up(up),
    }
    if skeleton is not None:
        if line.name != "amc":
            raise OptionError(f"{os.fspath(path)}: a skeleton file goes with .amc files only")
        options["skeleton"] = skeleton
    reader = _function(line, line.reader)
    try:
        motion: Motion | Trajectories = reader(path, **options)
    except DousaError as error:
        if isinstance(error, MotionFileError | OptionError):
            raise
        # A reader that built impossible arrays met a damaged file: say which.
        raise MotionFileError(path, str(error)) from error
    except MemoryError:
        raise MotionFileError(path, "the file does not fit into the memory of this machine") from None
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        problem = f"damaged, or not a {line.name.upper()} file ({type(error).__name__}: {error})"
        raise MotionFileError(path, problem) from error
    return motion


def _as_trajectories(motion: Motion | Trajectories) -> Trajectories:
    if isinstance(motion, Trajectories):
        return motion
    from dousa.motion import compute_trajectories

    return compute_trajectories(motion)


def _as_motion(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> Motion:
    if isinstance(motion, Motion):
        return motion
    from dousa.motion import fit_motion

    try:
        return fit_motion(motion)
    except JointMappingError as error:
        raise MotionWriteError(
            path,
            f"{_suffix(path)} holds joint rotations, these are positions, and no body can be fitted to them: "
            f"{error}; write .trc, .c3d or .npz instead",
        ) from error


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
        raise _no_format(path, WRITERS, "written")
    content: Motion | Trajectories = motion
    if line.holds == "trajectories":
        content = _as_trajectories(motion)
    elif line.holds == "motion":
        content = _as_motion(motion, path)
    _function(line, line.writer)(content, path)
