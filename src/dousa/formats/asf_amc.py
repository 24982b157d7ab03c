"""Acclaim ASF and AMC: a skeleton of bones in one file, its motion in another.

A joint of the motion stands where a bone starts (``lfemur`` at the hip) and turns by C M C^-1: M are the bone's
channels, C the orientation of its axes. The last bone of a chain gets an end site at its tip. ASF lengths are inches
times the file's ``length``; an AMC file does not say its frame rate, 120 Hz is the habit of CMU and HDM05.
"""

from __future__ import annotations

import functools
import os
import re

from dousa._files import read_bytes
from dousa.errors import MotionFileError
from dousa.formats._amc_frames import parse_frames, parse_header
from dousa.formats._amc_skeleton import AsfBone, AsfSkeleton, channel_program, read_asf
from dousa.formats._channels import FileUnits, build_motion
from dousa.formats._numbers import scannable
from dousa.motion._types import Motion, Provenance

__all__ = ["TOP", "AsfBone", "AsfSkeleton", "find_skeleton", "read_amc", "read_asf"]

TOP = ".dousa-top"
"""A file of this name in a folder: what lies above does not belong to the motions here, and is not looked at."""

_USUAL_RATE = 120.0
_LEVELS = 4  # folders looked at: that of the motion and three above


def read_amc(
    path: str | os.PathLike[str],
    *,
    skeleton: str | os.PathLike[str] | None = None,
    unit: float | None = None,
    up: str | None = None,
) -> Motion:
    """Read an Acclaim motion with its skeleton.

    Parameters
    ----------
    path : the ``.amc`` file.
    skeleton : its ``.asf``; by default the one of the same name or of the actor part of the name (``HDM_bd.asf`` for
        ``HDM_bd_squat.amc``, ``86.asf`` for ``86_01.amc``), else the only one, in the same folder or up to three above,
        no further than a folder that holds a file `TOP`.
    unit : metres per unit of the file; by default what the ASF says if the body is then 0.4 to 3 m tall, else inferred.
    up : axis of the file that points up; by default y unless the body stands along another.

    Returns
    -------
    Motion in metres, Y up, at the rate of ``:SAMPLES-PER-SECOND``, else of a name that ends in ``_120`` as in HDM05,
    else 120 Hz.

    Raises
    ------
    MotionFileError : a file is missing or damaged, no or several skeletons fit; with the line.
    """
    name = os.fspath(path)
    data = scannable(read_bytes(path))
    asf = read_asf(skeleton if skeleton is not None else find_skeleton(name))
    header = parse_header(name, data)
    values = parse_frames(name, data, header.first_frame_at, asf)
    degrees = asf.degrees if header.degrees is None else header.degrees
    rate = header.frame_rate or _rate_of_name(name)
    units = FileUnits(unit, up, asf.declared_unit)
    return build_motion(name, channel_program(asf, degrees), values, rate, Provenance(name, "amc"), units)


def _rate_of_name(path: str) -> float:
    found = re.search(r"HDM_.*_(\d{2,3})\.amc$", os.path.basename(path), re.IGNORECASE)
    return float(found[1]) if found and int(found[1]) > 0 else _USUAL_RATE


def find_skeleton(path: str) -> str:
    """The ``.asf`` that goes with a motion; names are compared without regard to case."""
    folder, name = os.path.split(os.path.abspath(path))
    folders: list[str] = []
    while len(folders) < _LEVELS and folder not in folders:
        folders.append(folder)
        if os.path.exists(os.path.join(folder, TOP)):
            break
        folder = os.path.dirname(folder)
    stems = _shorter_names(os.path.splitext(name)[0].lower())
    for folder in folders:
        by_stem = _skeletons_in(folder, _modified(folder))
        for stem in stems:
            if stem in by_stem:
                return os.path.join(folder, by_stem[stem])
    for folder in folders:
        skeletons = list(_skeletons_in(folder, _modified(folder)).values())
        if len(skeletons) == 1:
            return os.path.join(folder, skeletons[0])
        if skeletons:
            shown = ", ".join(skeletons[:8]) + (" ..." if len(skeletons) > 8 else "")
            problem = f"several skeletons may fit: {shown} in {folder}; name one with --skeleton"
            raise MotionFileError(path, problem)
    problem = (
        f"no .asf skeleton found in its folder and {_LEVELS - 1} above; name it with --skeleton FILE.asf"
    )
    raise MotionFileError(path, problem)


def _shorter_names(stem: str) -> list[str]:
    """``hdm_bd_walk``, ``hdm_bd``, ``hdm``: the whole name, then without its last parts."""
    parts = re.split(r"([_\-. ])", stem)
    return ["".join(parts[:count]) for count in range(len(parts), 0, -2)]


def _modified(folder: str) -> int:
    try:
        return os.stat(folder).st_mtime_ns
    except OSError:
        return -1


@functools.lru_cache(maxsize=256)
def _skeletons_in(folder: str, modified: int) -> dict[str, str]:
    """The ``.asf`` files of a folder by stem in lower case; kept, as every motion of the folder asks."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if entry.name.lower().endswith(".asf"))
    except OSError:
        return {}
    return {os.path.splitext(name)[0].lower(): name for name in names}
