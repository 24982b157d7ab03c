"""Units and axes of a file: metres per unit, and which axis points up.

Few motion files declare either. The unit follows from the height of the body; the up axis is the usual one of the
format unless the body itself stands along another axis in nearly all frames.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.messages import Message
from dousa.motion.canonical.geometry import STATURE_PER_HEIGHT, body_points, estimate_stature
from dousa.motion.canonical.mapping import ChosenMap, choose_map
from dousa.motion.canonical.naming import named_by_estimators
from dousa.motion.canonical.upright import (
    find_fall,
    guess_from_cloud,
    points_along,
    rest_direction,
    stands_along,
    weigh_axes,
)
from dousa.motion.types import Motion, Skeleton, Trajectories, freeze

CMU_UNIT = 0.0254 / 0.45
"""Metres per unit of the files made from the CMU database, whose lengths are inches times 0.45."""

# Metres per unit, by definition; words for units of length in all spellings come down to these.
_UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "cmu": CMU_UNIT}
_METRES = re.compile(r"(milli|centi|deci|)met(?:re|er)s?")
_SPELLINGS = {"inch": "in", "inches": "in", "foot": "ft", "feet": "ft"}

# Rows, by definition: where the file's axes point once the axis of the key points to +Y. All are rotations.
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
    up_source : ``"given"``, ``"declared"``, ``"assumed"`` (usual in the format, and not contradicted),
        ``"inferred"`` (from the body) or ``"guessed"`` (too little evidence).
    notes : for the user, on how they were found.
    body : that they were found by; None if the file holds none.
    """

    unit: float = 1.0
    unit_source: str = "declared"
    up: str = "y"
    up_source: str = "assumed"
    notes: tuple[Message, ...] = ()
    body: ChosenMap | None = field(default=None, compare=False)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the file's axes to Y up."""
        return _ROTATIONS[self.up]

    def place(self, positions: FloatArray) -> FloatArray:
        """Convert positions (..., 3) of the file to metres with Y up, read-only."""
        return _turn(positions, self.unit, self.rotation)


def parse_unit(text: str | float) -> float:
    """Return the metres per unit of m, cm, mm, dm, inch, ft, cmu (inches times 0.45) or a number of metres above 0.

    Raises
    ------
    OptionError : anything else.
    """
    key = str(text).strip().lower()
    key = _SPELLINGS.get(key) or _METRES.sub(lambda word: word[1][:1] + "m", key)
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
    """Return the up axis in its normal spelling, ``"y"`` for ``"+Y"``; OptionError if it is no axis."""
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
    declared_up: str | None = None,
    default_up: str | None = "y",
    whole: Callable[[], FloatArray] | None = None,
    assumed: float = 1.7,
) -> ReferenceFrame:
    """Find the unit and the up axis of a file.

    A rejected declared unit gives ``unit_source == "inferred"`` and a note.

    Parameters
    ----------
    sample : some frames of the file (ten will do, spread over it), in the file's unit and axes.
    unit : metres per unit, given by the caller.
    up : up axis, given by the caller.
    declared_unit : metres per unit in the file; rejected if the body would be under 0.3 m or over 3 m.
    declared_up : up axis in the file; rejected if the body clearly stands along another.
    default_up : usual up axis of the format; None if it has none.
    whole : returns the positions (T, K, 3) of all frames, used where the sample leaves a doubt.
    assumed : m, stature where no usual unit makes the body a plausible one.
    """
    body = choose_map(sample)
    points = None if body is None else body.points
    stature = estimate_stature(sample, points)
    if unit is not None:
        found: tuple[float, str, tuple[Message, ...]] = (unit, "given", ())
    elif declared_unit is None and points is not None and _is_normalised(stature, sample.names):
        note = Message("units.normalised", stature=stature, unit=assumed / stature, share=1 / stature)
        found = (assumed / stature, "assumed", (note,))
    else:
        found = _choose_unit(stature, declared_unit, assumed, mapped=points is not None)
    if up is not None:
        axis: tuple[str, str, tuple[Message, ...]] = (parse_up(up), "given", ())
    elif body is None or not stature > 0:
        axis = _up_of_a_cloud(sample, declared_up, default_up)
    else:
        axis = _choose_up(sample, body, stature, found[0], declared_up, default_up, whole)
    return ReferenceFrame(found[0], found[1], axis[0], axis[1], (*found[2], *axis[2]), body)


def _choose_up(
    sample: Trajectories,
    body: ChosenMap,
    stature: float,
    unit: float,
    declared: str | None,
    habit: str | None,
    whole: Callable[[], FloatArray] | None,
) -> tuple[str, str, tuple[Message, ...]]:
    """The up axis, its source, and notes for the user."""
    points = body.points
    rest = rest_direction(body.recipe, sample.rest_positions)
    expected = declared or habit
    if expected is not None and stands_along(points, expected, rest):
        return expected, "declared" if declared else "assumed", ()
    resting = next((axis for axis in ("y", "z") if rest is not None and points_along(rest, axis)), None)
    if declared is None and resting is not None and stands_along(points, resting, rest):
        return resting, "inferred", ()
    fall = None
    if whole is not None:
        points = body_points(body.recipe, whole())
        fall = find_fall(points, sample.frame_rate, unit)
    found = weigh_axes(points, stature / STATURE_PER_HEIGHT, rest, habit=habit, declared=declared, fall=fall)
    if declared is not None:
        if found.axis == declared:
            return declared, "declared", ()
        return found.axis, "inferred", (Message("units.other_up", declared=declared, up=found.axis),)
    if not found.clear:
        return found.axis, "guessed", (Message("units.guessed_up", up=found.axis, second=found.second),)
    return found.axis, "assumed" if found.axis == habit else "inferred", ()


def _up_of_a_cloud(
    sample: Trajectories, declared: str | None, habit: str | None
) -> tuple[str, str, tuple[Message, ...]]:
    """The up axis of points without a map: declared, usual in the format, or the longer extent."""
    if declared is not None:
        return declared, "declared", ()
    up = guess_from_cloud(sample.positions)
    if habit is not None and up != habit:
        return habit, "guessed", (Message("units.guessed_up", up=habit, second=up),)
    if habit is not None:
        return habit, "assumed", ()
    return up, "guessed", (Message("units.guessed_up", up=up, second="y" if up == "z" else "z"),)


def _choose_unit(
    stature: float,
    declared: float | None,
    assumed: float,
    *,
    mapped: bool,
    possible: tuple[float, float] = (0.3, 3.0),
    declarable: tuple[float, float] = (0.9, 2.3),
    usual: tuple[float, float] = (1.3, 2.15),
    cloud: tuple[float, float] = (0.02, 6.0),
) -> tuple[float, str, tuple[Message, ...]]:
    """Metres per unit for a body of this stature in file units (NaN or 0 if it could not be measured).

    Parameters
    ----------
    mapped : whether the stature is that of a body, not the extent of some points.
    possible : m; beyond this stature a declared unit is not believed.
    declarable, usual : m; beyond this stature a declared, or an inferred unit is doubtful.
    cloud : m; beyond this extent of points without a map a declared unit is doubtful.
    """
    measured = bool(np.isfinite(stature)) and stature > 0
    low, high = possible
    if declared is not None and (not measured or not mapped or low <= stature * declared <= high):
        extent = stature * declared if measured else 1.0
        if not mapped and not cloud[0] <= extent <= cloud[1]:
            return declared, "declared", (Message("units.odd_extent", unit=declared, extent=extent),)
        if mapped and measured and not declarable[0] <= extent <= declarable[1]:
            return declared, "declared", (Message("units.odd_body", unit=declared, stature=extent),)
        return declared, "declared", ()
    if not measured:
        return 1.0, "assumed", ()
    unit, source = _likely_unit(stature, assumed)
    notes = []
    if declared is not None:
        notes.append(Message("units.other_unit", declared=declared, stature=stature * declared, unit=unit))
    if source == "assumed":
        if not mapped:
            return 1.0, "assumed", (Message("units.unknown", extent=stature),)
        notes.append(Message("units.assumed", unit=unit, share=unit / assumed))
    elif not usual[0] <= stature * unit <= usual[1] and mapped:
        notes.append(Message("units.unusual", unit=unit, stature=stature * unit, adult=assumed / stature))
    return unit, source, tuple(notes)


def _is_normalised(
    stature: float,
    names: tuple[str, ...],
    person: tuple[float, float] = (0.8, 2.5),
    adult: tuple[float, float] = (1.4, 2.05),
) -> bool:
    """Whether a body of a pose estimator is about a metre tall in file units, but no adult.

    Such methods scale bodies by a constant. ``person``, ``adult`` : m, least and greatest stature.
    """
    if not person[0] <= stature <= person[1] or adult[0] <= stature <= adult[1]:
        return False
    return named_by_estimators(names)


def _likely_unit(stature: float, assumed: float) -> tuple[float, str]:
    """The first usual unit that makes a person: a child of two to a giant; rarer units must make an adult."""
    for units, low, high in (((1.0, 0.01, 0.001), 0.8, 2.5), ((CMU_UNIT, 0.0254, 0.1, 0.3048), 1.35, 2.2)):
        for candidate in units:
            if low <= stature * candidate <= high:
                return candidate, "inferred"
    return assumed / stature, "assumed"


def from_reference_frame(moving: _Moving, frame: ReferenceFrame) -> _Moving:
    """Convert a motion in metres with Y up to the unit and axes of a file; the provenance is kept."""
    scale, rotation = 1.0 / frame.unit, frame.rotation.T
    if isinstance(moving, Motion):
        skeleton, *poses = change_arrays(moving.skeleton, moving.rotations, moving.translations, scale, rotation)
        return dataclasses.replace(moving, skeleton=skeleton, rotations=poses[0], translations=poses[1])
    rest = None if moving.rest_positions is None else _turn(moving.rest_positions, scale, rotation)
    return dataclasses.replace(moving, positions=_turn(moving.positions, scale, rotation), rest_positions=rest)


def _turn(points: FloatArray, scale: float, rotation: FloatArray) -> FloatArray:
    """Scale points (..., 3) and turn them by a signed permutation of the axes, exact but for the scale."""
    if np.array_equal(rotation, np.eye(3)):
        return freeze(points * scale)
    turned: FloatArray = np.empty_like(points)
    for axis, column in enumerate(np.abs(rotation).argmax(axis=1)):  # a long recording takes a copy, not three
        np.multiply(points[..., column], scale * rotation[axis, column], out=turned[..., axis])
    return freeze(turned)


def change_arrays(
    skeleton: Skeleton, rotations: FloatArray, translations: FloatArray, scale: float, rotation: FloatArray
) -> tuple[Skeleton, FloatArray, FloatArray]:
    """Scale a motion's lengths and turn its roots by a signed permutation of the axes; arrays become read-only.

    ``translations`` are changed in place if they can be written to.
    """
    offsets = skeleton.offsets * scale
    translations = np.multiply(translations, scale, out=translations if translations.flags.writeable else None)
    if not np.array_equal(rotation, np.eye(3)):
        from dousa.motion.rotations import from_matrix, multiply

        roots = np.flatnonzero(skeleton.parents < 0)
        turn = from_matrix(rotation)
        offsets[roots] = _turn(offsets[roots], 1.0, rotation)
        translations[:, roots] = _turn(translations[:, roots], 1.0, rotation)
        rotations = rotations.copy()
        rotations[:, roots] = multiply(turn, rotations[:, roots])
    turned = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.end_sites)
    return turned, freeze(rotations), freeze(translations)
