"""C3D: measured points in binary (Vicon, Qualisys, Motion Analysis ...; c3d.org).

Reference: Motion Lab Systems, "The C3D File Format User Guide" (2021). All three processors (Intel, DEC, MIPS),
integer and float storage, more than 255 labels and more than 65,535 frames are read; analog channels are skipped.

Why no library reads the file. Measured on damaged copies of one good file (bytes changed in the header and
parameter section, or cut off; memory limited to 2 GB):

- ezc3d 1.7.2 (C++): 1,500 copies gave 72 segmentation faults, 4 hangs and 29 failed huge allocations. A crash
  cannot be caught, and whatever check would keep such files away from it must understand the whole section.
- c3d 0.6.0 (Python): no crash, but it refuses sound files on which header and parameters disagree in what does not
  matter here (analog rate, scale), or in which a parameter occurs twice, and takes one Python step per frame.

So the two sections are taken apart here with every pointer checked (``_c3d_sections.py``) and the data in one numpy
view; the tests compare with ezc3d, value by value.
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from dousa._files import read_bytes
from dousa.errors import MotionFileError
from dousa.formats._c3d_sections import BLOCK, Sections, decode_floats, parse_sections
from dousa.formats._c3d_writer import write_c3d
from dousa.formats._markers import declared_unit, settle_trajectories
from dousa.motion import Trajectories
from dousa.motion._types import FloatArray

__all__ = ["read_c3d", "write_c3d"]

# Parameters of the POINT group that list the points which are no positions.
_NOT_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "REACTIONS", "SCALARS")
_FULL_COUNTER = 65_535


def read_c3d(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Trajectories:
    """Read the points of a C3D file.

    Unlabelled points (no name, or one that starts with ``*``) and computed angles, forces, moments and powers are
    left out.

    Parameters
    ----------
    path : the file.
    unit : metres per unit, or its name; by default POINT:UNITS, else inferred from body height.
    up : axis that points up; by default POINT:Y_SCREEN, else inferred.

    Returns
    -------
    Trajectories in metres, Y up, NaN where missing.

    Raises
    ------
    MotionFileError : missing, not C3D, damaged, cut off, without points.
    """
    data = read_bytes(path)
    sections = parse_sections(path, data)
    chosen, names = _choose_points(sections)
    positions = _read_positions(sections, data, chosen)
    units = sections.texts("POINT:UNITS")
    return settle_trajectories(
        path,
        "c3d",
        names,
        positions,
        _frame_rate(sections),
        unit=unit,
        up=up,
        unit_in_file=declared_unit(units[0]) if units else None,
        up_in_file=_up_axis(sections),
        default_up=None,
    )


def _n_points(sections: Sections) -> int:
    used = sections.number("POINT:USED")
    count = sections.header.n_points if used is None or not np.isfinite(used) else int(used)
    if count <= 0:
        raise MotionFileError(sections.path, "the file has no points, only analog channels at best")
    return count


def _choose_points(sections: Sections) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Indices and names of the points that are labelled positions; of all points if none has a label."""
    count = _n_points(sections)
    labels = sections.texts("POINT:LABELS")[:count]
    labels += [""] * (count - len(labels))
    if not any(labels):
        return np.arange(count), tuple(f"point{number + 1}" for number in range(count))
    left_out = {name for group in _NOT_POSITIONS for name in sections.texts(f"POINT:{group}")}
    chosen = [
        number for number, label in enumerate(labels) if label and label[0] != "*" and label not in left_out
    ]
    if not chosen:
        raise MotionFileError(sections.path, "the file has no labelled markers; label them first")
    return np.array(chosen), tuple(labels[number] for number in chosen)


def _frame_rate(sections: Sections) -> float:
    rate = sections.number("POINT:RATE")
    if rate is None or not rate > 0:
        rate = sections.header.frame_rate
    if not 0 < rate <= 1e6:
        raise MotionFileError(sections.path, f"expected a POINT:RATE in Hz above 0, got {rate:g}")
    return float(str(np.float32(rate)))  # 29.97, not 29.969999313354492


def _up_axis(sections: Sections) -> str | None:
    texts = sections.texts("POINT:Y_SCREEN")
    axis = texts[0].lower().removeprefix("+") if texts else ""
    return axis if axis.removeprefix("-") in ("x", "y", "z") else None


def _read_positions(sections: Sections, data: bytes, chosen: NDArray[np.intp]) -> FloatArray:
    """Positions (T, K, 3) of the chosen points in file units, NaN where the residual is negative."""
    scale = sections.number("POINT:SCALE") or sections.header.scale
    if scale == 0 or not np.isfinite(scale):
        raise MotionFileError(sections.path, f"expected a POINT:SCALE other than 0, got {scale:g}")
    width = 4 * _n_points(sections)
    row = width + _n_analog(sections)
    item_size = 4 if scale < 0 else 2
    start = _data_start(sections)
    frames = _count_frames(sections, max(0, len(data) - start) // (row * item_size))
    block = data[start : start + frames * row * item_size]
    if scale < 0:
        values = decode_floats(block, sections.processor)
    else:
        values = np.frombuffer(block, ">i2" if sections.big_endian else "<i2")
    points = values.reshape(frames, row)[:, :width].reshape(frames, -1, 4)[:, chosen]
    with np.errstate(invalid="ignore"):  # a damaged float may be a signalling NaN
        positions = points[..., :3].astype(np.float64)
        missing = points[..., 3] < 0
    if scale > 0:
        positions *= scale
    positions[missing] = np.nan
    return positions


def _n_analog(sections: Sections) -> int:
    """Analog samples per frame, all channels together."""
    count = sections.header.n_analog
    used, rate = sections.number("ANALOG:USED"), sections.number("ANALOG:RATE")
    points_rate = sections.number("POINT:RATE")
    if count == 0 and used and rate and points_rate and np.isfinite([used, rate, points_rate]).all():
        # Some programs leave the header word empty.
        count = int(used) * max(1, round(min(abs(rate / points_rate), 1e6)))
    return count


def _data_start(sections: Sections) -> int:
    block = float(sections.header.data_block)
    if block < 2:
        block = sections.number("POINT:DATA_START") or 0
    if not 2 <= block <= _FULL_COUNTER:
        raise MotionFileError(
            sections.path, f"expected the data after the header, got block {block:g}; damaged?"
        )
    return (int(block) - 1) * BLOCK


def _count_frames(sections: Sections, held: int) -> int:
    """Number of frames: the largest declared one that the file holds.

    Four places may declare it; programs keep them with different care, and 16 bits overflow.
    """
    header = sections.header
    declared = [header.last_frame - header.first_frame + 1]
    for key in ("POINT:FRAMES", "POINT:LONG_FRAMES"):
        number = sections.number(key)
        if number is not None and np.isfinite(number):
            declared.append(int(number))
    first, last = sections.numbers("TRIAL:ACTUAL_START_FIELD"), sections.numbers("TRIAL:ACTUAL_END_FIELD")
    if len(first) >= 2 and len(last) >= 2 and np.isfinite([*first[:2], *last[:2]]).all():
        words = np.array([1.0, 65_536.0])
        declared.append(int(last[:2] @ words - first[:2] @ words) + 1)
    if max(declared) > _FULL_COUNTER:
        declared = [count for count in declared if count > _FULL_COUNTER]  # the others overflowed
    declared = [count for count in declared if count > 0]
    if not declared:
        raise MotionFileError(sections.path, "the file has no frames")
    fitting = [count for count in declared if count <= held]
    if not fitting:
        raise MotionFileError(
            sections.path,
            f"the header declares {min(declared)} frames, the file holds {held}; is it truncated?",
        )
    return max(fitting)
