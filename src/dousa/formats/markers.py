"""Common code of the formats of measured points: from a file's unit and axes to metres with Y up."""

from __future__ import annotations

import dataclasses
import os
import re

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.messages import Message
from dousa.motion import Provenance, Trajectories, thin
from dousa.motion.canonical.reference_frame import (
    infer_reference_frame,
    parse_unit,
    parse_up,
    to_reference_frame,
)

_SAMPLE_FRAMES = 10
_NUMBER = re.compile(r"[-+.\deE]+")


def declared_unit(text: str) -> float | None:
    """Return metres per unit of a named unit, None if it is unknown."""
    try:
        return None if _NUMBER.fullmatch(text.strip()) else parse_unit(text)  # a number slipped from another column
    except OptionError:
        return None


def settle_trajectories(
    path: str | os.PathLike[str],
    format_name: str,
    names: tuple[str, ...],
    positions: FloatArray,
    frame_rate: float,
    *,
    unit: float | str | None,
    up: str | None,
    unit_in_file: float | None,
    up_in_file: str | None,
    default_up: str | None,
    keep_values: bool = False,
    notes: tuple[Message, ...] = (),
) -> Trajectories:
    """Build trajectories in metres with Y up from the content of a file.

    Parameters
    ----------
    path, format_name : for the provenance and the messages.
    names : (K,) of the points.
    positions : (T, K, 3) in the file's unit and axes, NaN where missing.
    frame_rate : Hz.
    unit, up : given by the caller, or None.
    unit_in_file, up_in_file : declared in the file, or None.
    default_up : usual in the format, if neither is there.
    keep_values : keep the file's own numbers in the provenance.
    notes : for the user, on the reading of the file.

    Raises
    ------
    MotionFileError : no points, no frames, infinite positions, an impossible frame rate.
    """
    known_unit = None if unit is None else parse_unit(unit)
    known_up = None if up is None else parse_up(up)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged file may hold 1e300
            raw = Trajectories(names, positions, frame_rate)
            sample = raw.replace(positions=thin(raw.positions, min(_SAMPLE_FRAMES, raw.n_frames)))
            frame = infer_reference_frame(
                sample,
                unit=known_unit,
                up=known_up,
                declared_unit=unit_in_file,
                declared_up=up_in_file,
                default_up=default_up,
                whole=lambda: raw,
            )
            settled = to_reference_frame(raw, frame)
    except InvalidMotionError as error:
        raise MotionFileError(path, "markers.damaged", reason=error) from error
    provenance = Provenance(
        os.fspath(path),
        format_name,
        frame.unit,
        frame.unit_source,
        frame.up,
        frame.up_source,
        values=raw.positions if keep_values else None,
        notes=(*notes, *frame.notes),
    )
    return dataclasses.replace(settled, provenance=provenance)
