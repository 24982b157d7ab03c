"""Units and axes of a file: metres per unit, and which axis points up.

Few motion files say either. The unit follows from the height of the body; the up axis is what the format's
users agreed on unless the body itself stands along another axis in nearly all frames.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.motion.canonical.geometry import (
    body_points,
    estimate_stature,
    find_recipe,
    find_upright_axis,
    measure_rest,
)
from dousa.motion.types import Motion, Skeleton, Trajectories, freeze

CMU_UNIT = 0.0254 / 0.45
"""Metres per unit of the files made from the CMU database, whose lengths are inches times 0.45."""

_UNITS = {
    "m": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "inch": 0.0254,
    "inches": 0.0254,
    "in": 0.0254,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "cmu": CMU_UNIT,
}
_PREFIXED = re.compile(r"(milli|centi|deci)met(?:re|er)s?")
_COMMON = (1.0, 0.01, 0.001)
_RARE = (CMU_UNIT, 0.0254, 0.1, 0.3048)
_COMMON_STATURE = (0.8, 2.5)  # m, a child of two to a giant
_RARE_STATURE = (1.2, 2.2)  # m
_POSSIBLE_STATURE = (0.4, 3.0)  # m; beyond, a declared unit is not believed
_ASSUMED_STATURE = 1.7  # m

# Rows: where the file's axes point once the axis of the key points to +Y. All are rotations.
_ROTATIONS: dict[str, FloatArray] = {
    "x": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "-x": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "y": np.eye(3),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}

_Moving = TypeVar("_Moving", Motion, Trajectories)


@dataclass(frozen=True, slots=True)
class ReferenceFrame:
    """How a file's numbers become metres with Y up.

    Parameters
    ----------
    unit : metres per unit of the file.
    unit_source : ``"given"`` by the caller, ``"declared"`` in the file, ``"inferred"`` from the body's height, or
        ``"assumed"``: no usual unit makes the body a plausible height, so it was made 1.7 m tall.
    up : axis of the file that points up: ``"x"``, ``"y"``, ``"z"``, ``"-x"``, ``"-y"`` or ``"-z"``.
    up_source : ``"given"``, ``"assumed"`` (the format's habit) or ``"inferred"`` (from the body).
    """

    unit: float = 1.0
    unit_source: str = "declared"
    up: str = "y"
    up_source: str = "assumed"

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the file's axes to Y up."""
        return _ROTATIONS[self.up]


def parse_unit(text: str | float) -> float:
    """Metres per unit.

    Parameters
    ----------
    text : ``"m"``, ``"cm"``, ``"mm"``, ``"dm"``, ``"inch"``, ``"ft"``, ``"cmu"`` (inches times 0.45) or metres as
        a number above 0.

    Raises
    ------
    OptionError : anything else.
    """
    key = str(text).strip().lower()
    key = _PREFIXED.sub(lambda word: word[1][0] + "m", key)
    if key in _UNITS:
        return _UNITS[key]
    try:
        unit = float(key)
    except ValueError:
        unit = float("nan")
    if not (np.isfinite(unit) and unit > 0):
        raise OptionError("units.unit", text=text)
    return unit


def parse_up(text: str) -> str:
    """The up axis in its normal spelling, ``"y"`` for ``"+Y"``; OptionError if it is no axis."""
    key = str(text).strip().lower().removeprefix("+")
    if key not in _ROTATIONS:
        raise OptionError("units.up", text=text)
    return key


def infer_reference_frame(
    sample: Trajectories,
    *,
    unit: float | None = None,
    up: str | None = None,
    declared_unit: float | None = None,
    default_up: str | None = "y",
) -> ReferenceFrame:
    """Find the unit and the up axis of a file.

    Parameters
    ----------
    sample : some frames of the file (ten will do, spread over it), in the file's unit and axes.
    unit : metres per unit if the caller knows.
    up : up axis if the caller knows.
    declared_unit : metres per unit if the file says; not believed if the body would be under 0.4 m or over 3 m.
    default_up : the format's habit; None if it has none, then the body decides between y and z.

    Returns
    -------
    The frame. A declared unit that was not believed shows as ``unit_source == "inferred"``.
    """
    recipe = find_recipe(sample.names, sample.parents, sample.positions)
    points = None if recipe is None else body_points(recipe, sample.positions)
    if up is None:
        rest = None if recipe is None else measure_rest(recipe, sample.rest_positions)
        found = find_upright_axis(sample, points, rest, default_up)
        up, up_source = (found, "inferred") if found != default_up else (found, "assumed")
    else:
        up, up_source = parse_up(up), "given"
    if unit is not None:
        return ReferenceFrame(float(unit), "given", up, up_source)
    unit, unit_source = _choose_unit(estimate_stature(sample, points), declared_unit)
    return ReferenceFrame(unit, unit_source, up, up_source)


def _choose_unit(stature: float, declared: float | None) -> tuple[float, str]:
    """Metres per unit for a body of this stature in file units (NaN or 0 if it could not be measured)."""
    measured = bool(np.isfinite(stature)) and stature > 0
    if declared is not None:
        low, high = _POSSIBLE_STATURE
        if not measured or low <= stature * declared <= high:
            return declared, "declared"
    if not measured:
        return 1.0, "assumed"
    for units, (low, high) in ((_COMMON, _COMMON_STATURE), (_RARE, _RARE_STATURE)):
        for candidate in units:
            if low <= stature * candidate <= high:
                return candidate, "inferred"
    return _ASSUMED_STATURE / stature, "assumed"


def to_reference_frame(moving: _Moving, frame: ReferenceFrame) -> _Moving:
    """Turn a motion in the unit and axes of a file into metres with Y up.

    Parameters
    ----------
    moving : motion or trajectories in file units.
    frame : the file's unit and up axis.

    Returns
    -------
    The same type in metres, Y up. Roots are rotated; rest positions of trajectories are rotated with them.
    The provenance is kept as it is.
    """
    return _change_frame(moving, frame.unit, frame.rotation)


def from_reference_frame(moving: _Moving, frame: ReferenceFrame) -> _Moving:
    """Turn a motion in metres with Y up into the unit and axes of a file; the inverse of `to_reference_frame`."""
    return _change_frame(moving, 1.0 / frame.unit, frame.rotation.T)


def _change_frame(moving: _Moving, scale: float, rotation: FloatArray) -> _Moving:
    if isinstance(moving, Motion):
        return _change_motion(moving, scale, rotation)
    rest = None if moving.rest_positions is None else _turn(moving.rest_positions, scale, rotation)
    positions = _turn(moving.positions, scale, rotation)
    return dataclasses.replace(moving, positions=positions, rest_positions=rest)


def _turn(points: FloatArray, scale: float, rotation: FloatArray) -> FloatArray:
    """Points (..., 3) scaled and turned by a signed permutation of the axes, exact but for the scale."""
    turned = points * scale
    if not np.array_equal(rotation, np.eye(3)):
        columns = np.abs(rotation).argmax(axis=1)
        turned = np.ascontiguousarray(turned[..., columns]) * rotation[range(3), columns]
    return freeze(turned)


def _change_motion(motion: Motion, scale: float, rotation: FloatArray) -> Motion:
    skeleton = motion.skeleton
    offsets = skeleton.offsets * scale
    translations = motion.translations * scale
    rotations = motion.rotations
    if not np.array_equal(rotation, np.eye(3)):
        from dousa.motion.rotations import from_matrix, multiply

        roots = np.flatnonzero(skeleton.parents < 0)
        turn = from_matrix(rotation)
        offsets[roots] = _turn(offsets[roots], 1.0, rotation)
        translations[:, roots] = _turn(translations[:, roots], 1.0, rotation)
        rotations = rotations.copy()
        rotations[:, roots] = multiply(turn, rotations[:, roots])
    turned = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.end_sites)
    return dataclasses.replace(motion, skeleton=turned, rotations=freeze(rotations), translations=freeze(translations))
