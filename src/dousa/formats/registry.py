"""The table of formats, and reading and writing by suffix.

To add a format: write a module with ``read_xxx(path, *, unit=None, up=None)`` and, where it can be written,
``write_xxx(motion, path)``, and add one line to ``FORMATS``. Modules are imported when first used. Another package adds
its formats by entry points of the group ``dousa.formats``, see `load_plugins`.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import importlib
import os
import re
from collections.abc import Callable, Mapping
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
from dousa.files.frame_files import is_frame_folder
from dousa.formats.parts import KINDS, check_chosen, file_of, split_address
from dousa.messages import Message
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
    holds : ``"motion"``, ``"trajectories"`` or ``"both"``: possible content of a file of this format.
    options : of the reader besides ``unit`` and ``up``: ``"skeleton"``; ``"frame_rate"``, ``"person"`` and
        ``"animation"`` where it has to choose. The rate of all others is settled on what they read, and so are people
        among whom no reader has chosen.
    signs : pattern in the first bytes of such files, for suffixes that other programs use too; else None.
    character : name of the function that reads a file at rest, for formats whose files need no motion; else None.
    check : name of the function that decides by path and first bytes about files without the signs, if any.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    reader: str | None
    writer: str | None
    holds: str
    options: tuple[str, ...] = ()
    signs: bytes | None = None
    character: str | None = None
    check: str | None = None


_ARRAYS = ("skeleton", "frame_rate")
_PARTS = (*_ARRAYS, "person", "animation")
_TABLE = ("frame_rate", "person", "animation")

_HEAD = 65_536
"""Bytes of a table that are looked at: a row of titles of 553 points takes 30,000 (measured on FreeMoCap's)."""

PACKED: tuple[str, ...] = (".gz", ".zip")
"""Suffixes of packed files, see `dousa.formats.packed`."""

FORMATS: tuple[Format, ...] = (
    Format("bvh", (".bvh",), "dousa.formats.bvh", "read_bvh", "write_bvh", "motion"),
    Format("amc", (".amc",), "dousa.formats.asf_amc", "read_amc", None, "motion", ("skeleton",)),
    Format("c3d", (".c3d",), "dousa.formats.c3d", "read_c3d", "write_c3d", "trajectories"),
    Format("trc", (".trc",), "dousa.formats.tables", "read_trc", "write_trc", "trajectories"),
    Format("opencap", (".opencap.trc",), "dousa.formats.opensim", None, "write_opencap", "both"),
    Format("amass", (".amass.npz",), "dousa.formats.smpl", None, "write_amass", "motion"),
    Format("npz", (".npz",), "dousa.formats.arrays", "read_any_npz", "write_npz", "both", _PARTS),
    Format(
        "npy", (".npy",), "dousa.formats.arrays", "read_arrays", None, "both", _PARTS,
        rb"'shape': \(\d+, (?:\d+, \d+|263|251|322)\)|(?s:'\|O'.*(?:motion|orient|rotmat|poses?|thetas)\W)",
    ),
    Format(
        "pkl", (".pkl", ".pk", ".pickle", ".joblib", ".pt"), "dousa.formats.arrays", "read_arrays", None, "both",
        _PARTS,
        rb"poses|thetas|keypoints3d|(?:global|root)_orient|rotmat|body_pose|\x04(?:\0{3})?pose|\x06(?:\0{3})?motion",
    ),
    Format("angles", (".angles.csv",), "dousa.formats.opensim", None, "write_angles", "motion"),
    Format(
        "csv", (".csv",), "dousa.formats.tables", "read_table", "write_motive", "both", _TABLE,
        rb"\A(?:\xef\xbb\xbf)?\"?Format Version", check="is_table",
    ),
    Format(
        "tsv", (".tsv",), "dousa.formats.tables", "read_table", None, "both", _TABLE, rb"(?m)^\s*NO_OF_FRAMES",
        check="is_table",
    ),
    Format(
        "landmarks", (".json",), "dousa.formats.landmarks", "read_landmarks", None, "both", (*_ARRAYS, "person"),
        rb"keypoints_?3[dD]\"|\"(?:pose_?)?[wW]orld_?[lL]andmarks\"|\"(?:joints|landmarks|positions)_?3[dD]\"|\"instance_info\""
        rb"|\"(?:joints19|joint_positions|Rh|smpl_poses|global_orient)\""
        rb"|\A[\s\[]{2,}\{\s*\"x\"\s*:[^{}]*\"z\"|\A\s*\[\s*\[\s*\[\s*-?\d[^][,]*,[^][,]*,[^][,]*(?:,[^][,]*)?\]\s*,\s*\[",
    ),
    Format("vmd", (".vmd",), "dousa.formats.mmd", "read_vmd", "write_vmd", "motion", ("skeleton",)),
    Format("mot", (".mot",), "dousa.formats.opensim", "read_mot", "write_mot", "motion", (), rb"hip_flexion_[rl]"),
    Format("mvnx", (".mvnx",), "dousa.formats.mvnx", "read_mvnx", None, "both", ("person",)),
    Format(
        "fbx", (".fbx",), "dousa.formats.exchange", "read_exchange", "write_fbx", "motion", ("animation",),
        character="read_exchange_character",
    ),
    Format(
        "dae", (".dae",), "dousa.formats.exchange", "read_exchange", None, "motion", ("animation",),
        character="read_exchange_character",
    ),
    Format(
        "usd", (".usd", ".usda", ".usdc", ".usdz"), "dousa.formats.exchange.usd", "read_usd", None, "motion",
        ("person",),
    ),
    Format(
        "glb", (".glb",), "dousa.formats.gltf", "read_gltf", "write_glb", "motion", ("animation",),
        character="read_gltf_character",
    ),
    Format(
        "gltf", (".gltf", ".vrm", ".vrma"), "dousa.formats.gltf", "read_gltf", None, "motion", ("animation",),
        character="read_gltf_character",
    ),
)  # fmt: skip

READERS: dict[str, Format] = {suffix: line for line in FORMATS if line.reader for suffix in line.suffixes}
"""Format by suffix, for reading."""

WRITERS: dict[str, Format] = {suffix: line for line in FORMATS if line.writer for suffix in line.suffixes}
"""Format by suffix, for writing."""

SUFFIXES: tuple[str, ...] = tuple(READERS)
"""The suffixes of ``read_motion``, lower case with the dot; each also with ``.gz`` or ``.zip`` behind it.

Those of plug-ins are missing: see `list_suffixes`.
"""

_ADVICE = {
    ".asf": "formats.asf_alone",
    ".pmx": "formats.model_alone",
    ".pmd": "formats.model_alone",
    ".sto": "formats.coordinates",
}
"""Suffixes that are no motion by themselves, and what to do about them."""


@dataclass(frozen=True, slots=True)
class Plugins:
    """The formats of other packages.

    Parameters
    ----------
    readers, writers : format by suffix.
    failures : name of an entry point that cannot be used, and the reason.
    """

    readers: dict[str, Format]
    writers: dict[str, Format]
    failures: dict[str, str]


@functools.cache
def load_plugins() -> Plugins:
    """Load the entry points of the group ``dousa.formats``, each a `Format` or a tuple of them.

    A suffix of ``FORMATS`` keeps its format. An entry point that fails is recorded and does not affect the others.
    """
    from importlib.metadata import entry_points

    plugins = Plugins({}, {}, {})
    for entry in entry_points(group="dousa.formats"):
        try:
            loaded = entry.load()
            lines = loaded if isinstance(loaded, tuple) else (loaded,)
            for line in lines:
                _check_plugin(line)
        except Exception as error:  # the code of another package may raise anything
            plugins.failures[entry.name] = f"{type(error).__name__}: {error}"
            continue
        for line in lines:
            for suffix in line.suffixes:
                if line.reader:
                    plugins.readers.setdefault(suffix, line)
                if line.writer:
                    plugins.writers.setdefault(suffix, line)
    return plugins


def _check_plugin(line: object) -> None:
    if not isinstance(line, Format):
        raise TypeError(f"expected a dousa.formats.Format, got {type(line).__name__}")
    if not isinstance(line.suffixes, tuple) or not all(re.fullmatch(r"\.[^A-Z]+", suffix) for suffix in line.suffixes):
        raise ValueError(f"expected a tuple of lower-case suffixes with the dot, got {line.suffixes!r}")


def list_suffixes() -> tuple[str, ...]:
    """Return the suffixes of files that can be read, those of plug-ins included; lower case with the dot."""
    return (*SUFFIXES, *load_plugins().readers)


def _function(path: str | os.PathLike[str], line: Format, name: str) -> Callable[..., Any]:
    try:
        function: Callable[..., Any] = getattr(importlib.import_module(line.module), name)
    except Exception as error:
        if line in FORMATS:
            raise
        raise UnknownFormatError(path, "formats.bad_plugin", plugin=line.name, reason=error) from error
    return function


def _suffix(path: str | os.PathLike[str]) -> str:
    return os.path.splitext(os.fspath(path))[1].lower()


def _find(path: str | os.PathLike[str], table: dict[str, Format]) -> Format | None:
    """The line of the longest suffix of the name."""
    name = os.path.basename(os.fspath(path)).lower()
    fitting = [suffix for suffix in table if name.endswith(suffix) and name != suffix]
    return table[max(fitting, key=len)] if fitting else None


def find_reader(path: str | os.PathLike[str]) -> Format | None:
    """Find the line of the table for a file by its name or that of a part of it; None if there is none.

    A packed file has both suffixes, such as ``walk.bvh.gz``. Of folders only those with one file per frame are known.
    """
    text = path = file_of(path)
    if os.path.isdir(path):
        return READERS[".json"] if is_frame_folder(path) else _find(text, READERS)
    name = text[: -len(_suffix(text))] if _suffix(text) in PACKED else text
    return _find(name, READERS) or _find(name, load_plugins().readers)


def is_motion_file(path: str | os.PathLike[str]) -> bool:
    """Return whether to read a file of a folder: by its suffix and, for suffixes in other use, its first bytes."""
    line = find_reader(path)
    if line is None or line.signs is None or _suffix(path) in PACKED:
        return line is not None
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD if line.check else 4096)
        shown = re.search(line.signs, head[:4096]) is not None
        return shown or bool(line.check and _function(path, line, line.check)(path, head))
    except OSError:
        return True  # its reader raises the error


def _no_format(path: str | os.PathLike[str], *, read: bool) -> UnknownFormatError:
    """The error for a file without a format: the known suffixes, and the plug-ins that failed."""
    if os.path.isdir(path):
        return UnknownFormatError(path, "formats.folder")
    suffix, plugins = _suffix(path), load_plugins()
    known = list_suffixes() if read else (*WRITERS, *plugins.writers)
    if not suffix:
        return UnknownFormatError(path, "formats.unreadable_name" if read else "formats.unwritable_name", known=known)
    problem = Message("formats.unreadable_suffix" if read else "formats.unwritable_suffix", suffix=suffix, known=known)
    for plugin, reason in plugins.failures.items():
        problem = Message("formats.failed_plugin", problem=problem, plugin=plugin, reason=reason)
    return UnknownFormatError(path, problem)


def read_motion(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
    person: str | int | None = None,
    animation: str | int | None = None,
) -> Motion | Trajectories:
    """Read a motion file of any known format, chosen by suffix.

    Parameters
    ----------
    path : file ending in one of ``SUFFIXES``, in any case, as it is or packed (``.gz``, ``.zip``); or the address of a
        part of it, such as ``moves.glb#animation=Walk``.
    unit : metres per unit of the file, or a name such as ``"cm"``; by default declared, else inferred from body height.
    up : axis of the file that points up, such as ``"y"`` or ``"-z"``; by default declared, else inferred.
    skeleton : the ``.asf`` of an ``.amc``, by default found beside and above it; the model of a ``.vmd``, by default
        found beside it; or the body model of SMPL poses, by default the mean body.
    frame_rate : Hz, whatever the file says; its frames stay.
    person : name or number (from 1) of one of several people; by default the one seen in most frames, else the first.
    animation : name or number of one of several animations; by default the longest.

    Returns
    -------
    A Motion (joint rotations) or Trajectories (positions), metres, Y up; NPZ gives what was written.

    Raises
    ------
    UnknownFormatError : the suffix is not known.
    MotionFileError : the file is missing, damaged or not of this format.
    OptionError : a unit or axis that does not exist, an impossible rate, an option that is none of this format.

    >>> motion = dousa.read_motion("wave.bvh")
    >>> motion.n_frames, motion.frame_rate
    (86, 30.0)
    """
    path, part = split_address(path)
    named: dict[str, Any] = {"skeleton": skeleton, "frame_rate": frame_rate, "person": person, "animation": animation}
    given = {name: value for name, value in (named | part).items() if value is not None}
    if frame_rate is not None and not 0 < frame_rate <= 1e6:
        raise OptionError("resampling.rate", rate=frame_rate)
    if _suffix(path) in PACKED and not os.path.isdir(path):
        return _read_packed(path, unit=unit, up=up, **given)
    if _suffix(path) in _ADVICE:
        raise UnknownFormatError(path, _ADVICE[_suffix(path)])
    line = find_reader(path)
    if line is None or line.reader is None:
        raise _no_format(path, read=True)
    for name, code in (("skeleton", "formats.skeleton"), ("animation", "formats.animation")):
        if name in given and name not in line.options:
            raise OptionError(code, path=path)
    given |= {name: str(given[name]) for name in KINDS if name in given}
    from dousa.motion.canonical.reference_frame import parse_unit, parse_up

    options: dict[str, Any] = {
        "unit": None if unit is None else parse_unit(unit),
        "up": None if up is None else parse_up(up),
        **{name: value for name, value in given.items() if name in line.options},
    }
    motion = _run(path, line, options, frame_rate)
    motion = _take_person(motion, path, given.get("person"))
    for kind in KINDS:
        if kind in given:
            check_chosen(path, kind, given[kind], motion.provenance.notes if motion.provenance else ())
    if frame_rate is not None and motion.frame_rate != frame_rate:  # read by no clock
        return dataclasses.replace(motion, frame_rate=frame_rate)
    return motion


def _run(path: str, line: Format, options: Mapping[str, Any], frame_rate: float | None) -> Motion | Trajectories:
    """Call a reader; every error of a damaged file names it."""
    assert line.reader is not None
    import numpy as np

    from dousa.formats.guard.clock import given_rate

    reader = _function(path, line, line.reader)
    try:
        # A damaged file may hold 1e300.
        with given_rate(frame_rate), np.errstate(over="ignore", invalid="ignore"):
            motion: Motion | Trajectories = reader(path, **options)
    except DousaError as error:
        if isinstance(error, MotionFileError | OptionError):
            raise
        # Impossible arrays come from a damaged file: name it.
        raise MotionFileError(path, error.message) from error
    except MemoryError:
        raise MotionFileError(path, "disk.too_large") from None
    except (ArithmeticError, LookupError, TypeError, ValueError, csv.Error) as error:
        raise MotionFileError(
            path, "formats.damaged", format=line.name.upper(), kind=type(error).__name__, reason=error
        ) from error
    return motion


def _take_person(motion: Motion | Trajectories, path: str, wanted: str | None) -> Motion | Trajectories:
    parents = motion.skeleton.parents if isinstance(motion, Motion) else motion.parents
    is_single = parents is not None and (parents < 0).sum() == 1
    notes = motion.provenance.notes if motion.provenance is not None else ()
    if (wanted is None and is_single) or any(note.code.startswith("parts.person") for note in notes):
        return motion  # the reader has chosen
    from dousa.formats.guard.people import take_person

    return take_person(motion, path, wanted)


def _read_packed(path: str | os.PathLike[str], **options: Any) -> Motion | Trajectories:
    from dousa.formats.packed import unpack

    with unpack(path, list_suffixes()) as inner:
        try:
            motion = read_motion(inner, **options)
        except MotionFileError as error:
            if os.path.dirname(error.path) == os.path.dirname(inner):
                error.path = os.fspath(path)
            raise
    if motion.provenance is None:
        return motion
    return dataclasses.replace(motion, provenance=dataclasses.replace(motion.provenance, path=os.fspath(path)))


def _fit(motion: Trajectories, path: str | os.PathLike[str]) -> Motion:
    from dousa.motion import fit_motion

    try:
        return fit_motion(motion)
    except JointMappingError as error:
        raise MotionWriteError(path, "formats.no_rotations", suffix=_suffix(path), reason=error) from error


def write_motion(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write a motion file in the format of its suffix; it appears whole or not at all.

    A Motion written to a format of trajectories (C3D, TRC) becomes the positions of its joints. Trajectories written to
    a format of rotations (BVH) become the motion of a body of the canonical joints that is fitted to them.

    Parameters
    ----------
    motion : what to write.
    path : file ending in one of the suffixes in ``WRITERS``, in any case.

    Raises
    ------
    UnknownFormatError : the suffix is not known, or this format is only read.
    MotionWriteError : the motion does not fit the format, or a disk error.

    >>> dousa.write_motion(dousa.read_motion("wave.bvh"), "wave.trc")
    >>> dousa.read_motion("wave.trc").frame_rate
    30.0
    """
    line = _find(path, WRITERS) or _find(path, load_plugins().writers)
    if line is None or line.writer is None:
        raise _no_format(path, read=False)
    if line.holds == "trajectories" and isinstance(motion, Motion):
        from dousa.motion import compute_trajectories

        motion = compute_trajectories(motion)
    elif line.holds == "motion" and isinstance(motion, Trajectories):
        motion = _fit(motion, path)
    _function(path, line, line.writer)(motion, path)


def read_character(path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None) -> Motion:
    """Read the skeleton of a file, as a motion or as a single pose.

    Parameters
    ----------
    path : any file of joint rotations, or the address of one of several skeletons in it; a glTF, GLB, VRM or FBX needs
        no animation.
    unit, up : if not in the file.

    Raises
    ------
    MotionFileError : the file cannot be read.
    OptionError : it holds positions, and no skeleton.
    """
    line = find_reader(path)
    if line is not None and line.character is not None:
        file, part = split_address(path)
        character = _function(path, line, line.character)(file, unit=unit, up=up)
        character = _take_person(character, file, part.get("person"))
    else:
        character = read_motion(path, unit=unit, up=up)
    if not isinstance(character, Motion):
        raise OptionError("retarget.no_skeleton", path=path)
    return character
