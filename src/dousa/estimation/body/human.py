"""A person as a body model: fifteen parts from stature, sex and measures.

The tables and their sources are in ``anthropometry.toml``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel, pad_axes, reshape
from dousa.estimation.body.posing import standing_state
from dousa.messages import Message
from dousa.motion import rotations as rot

_TABLES = tomllib.loads(resources.files(__package__).joinpath("anthropometry.toml").read_text(encoding="utf-8"))

LENGTHS: dict[str, float] = _TABLES["lengths"]
"""Statures, from joint to joint."""

GIRTHS: dict[str, float] = _TABLES["girths"]
"""Statures round the solids of the average body, clothes included."""

SEX_FACTORS: dict[str, dict[str, float]] = _TABLES["sexes"]
"""What women and men differ by from the average of both, as shares of it."""

SEXES: tuple[str, ...] = tuple(SEX_FACTORS)
MEASURES: tuple[str, ...] = (*LENGTHS, *GIRTHS)
"""What can be measured on a person, in metres: lengths from joint to joint, ``hand`` from the wrist to the finger tips,
``foot`` from heel to tip, ``head`` from chin to crown, ``trunk`` from between the hips to the base of the neck,
breadths between the joints of both sides, girths round the clothes."""

_PARTS: dict[str, dict[str, Any]] = {part["name"]: part for part in _TABLES["part"]}
_TIPS: dict[str, dict[str, Any]] = {tip["name"]: tip for tip in _TABLES["tip"]}
_ORDER = (
    *("pelvis", "trunk", "head"),
    *(f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm", "hand")),
    *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "shank", "foot")),
)
_MIRROR = np.array([-1.0, 1.0, 1.0])  # of places, by geometry: at the plane x = 0
_MIRROR_TURN = np.array([1.0, -1.0, -1.0])  # of axes and rotation vectors, by geometry: they turn the other way

# Which coordinates of which joints and tips a length scales.
_ALL, _ACROSS, _UP = (0, 1, 2), (0,), (1,)
_SCALED: dict[str, tuple[tuple[str, tuple[int, ...]], ...]] = {
    "upper_arm": (("elbow", _ALL),),
    "forearm": (("wrist", _ALL),),
    "hand": (("hand", _ALL),),
    "thigh": (("knee", _ALL),),
    "shank": (("ankle", _ALL),),
    "foot": (("toe", _ALL),),
    "head": (("head", _ALL),),
    "trunk": (("hip", _UP), ("spine", _UP), ("neck", _UP), ("shoulder", _UP)),
    "shoulder_breadth": (("shoulder", _ACROSS),),
    "hip_breadth": (("hip", _ACROSS),),
}


USUAL_STATURE = 1.72
"""m, of a person of whom nothing is known (docs/estimation.md)."""


def make_human(
    stature: float = USUAL_STATURE, sex: str = "average", measures: Mapping[str, float] | None = None
) -> BodyModel:
    """Make a person of fifteen parts with the twenty canonical joints from anthropometric tables.

    The pose of zeros is not a standing one: shoulders and hips have their zero in the middle of their reach, see
    `standing_state`, where joints are at ease. Equal angles on both sides are mirror images. See also `fit_girths`.

    Parameters
    ----------
    stature : m, from the floor to the crown.
    sex : ``"average"``, ``"female"`` or ``"male"``; changes breadths and girths.
    measures : name of `MEASURES` -> m, measured on the person.

    Raises
    ------
    BodyModelError : a stature no person has, an unknown sex or measure, a measure far from any person's.
    """
    stature = check_stature(stature)
    if sex not in SEXES:
        raise BodyModelError("person.sex", measure="sex", known=SEXES, found=str(sex))
    factors = dict.fromkeys(MEASURES, 1.0) | SEX_FACTORS[sex]
    usual = {name: share * stature for name, share in (LENGTHS | GIRTHS).items()}
    for name, value in (measures or {}).items():
        if name not in usual:
            raise BodyModelError("person.measure", measure=name, known=MEASURES)
        # Beyond these shares of what is usual for the stature, a unit is wrong.
        factors[name] = _check_size(name, value, "person.size", 0.4 * usual[name], 2.5 * usual[name]) / usual[name]
    return _ease(_apply(_average(stature), factors))


def check_stature(stature: float) -> float:
    """Return a stature in m; BodyModelError for one that no person has."""
    return _check_size("stature", stature, "person.stature", 0.3, 3.0)  # a doll; the tallest person with a hat on


def _check_size(measure: str, value: float, code: str, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise BodyModelError("person.number", measure=measure, found=repr(value))
    number = float(value)
    if not least <= number <= most:
        remedy = _unit_remedy(number, least, most)
        raise BodyModelError(code, measure=measure, least=least, most=most, found=number, remedy=remedy)
    return number


def _unit_remedy(value: float, least: float, greatest: float) -> Message | str:
    """Suggest metres if the number is in a smaller unit."""
    if least <= 0.01 * value <= greatest:
        return Message("person.centimetres", metres=0.01 * value)
    return Message("person.millimetres", metres=0.001 * value) if least <= 0.001 * value <= greatest else ""


def _average(stature: float) -> BodyModel:
    """Return the average of both sexes, scaled."""
    rows = [(name, _PARTS[name.removeprefix(_side(name))]) for name in _ORDER]
    solids = [np.array([sphere[:4] for sphere in _solid(name)]) + 0.0 for name in _ORDER]  # no -0.0
    tips = [(name, side) for name in _TIPS for side in (("",) if name == "head" else ("left_", "right_"))]
    return BodyModel(
        names=_ORDER,
        joints=tuple(_side(name) + row["joint"] for name, row in rows),
        parents=np.array([_parent(name, row["parent"]) for name, row in rows]),
        offsets=stature * np.array([_on_side(row["offset"], name, _MIRROR) for name, row in rows]),
        rest=np.array([rot.from_axis_angle(_on_side(row["rest"], name, _MIRROR_TURN)) for name, row in rows]),
        n_axes=np.array([len(row["axes"]) for _, row in rows]),
        axes=np.array(
            [pad_axes([_on_side(axis, name, _MIRROR_TURN) for axis in row["axes"]], 3) for name, row in rows]
        ),
        limits=np.array([pad_axes(row["limits"], 2) for _, row in rows]),
        spheres=stature * np.concatenate(solids),
        sphere_starts=np.cumsum([0, *(len(solid) for solid in solids)]),
        tips=tuple(side + name for name, side in tips),
        tip_parts=np.array([_ORDER.index(side + _TIPS[name]["part"]) for name, side in tips]),
        tip_offsets=stature * np.array([_on_side(_TIPS[name]["offset"], side, _MIRROR) for name, side in tips]),
        stature=stature,
        agility=np.array([row["agility"] for _, row in rows]),
        stiffness=np.array([row["stiffness"] for _, row in rows]),
    )


def _ease(body: BodyModel) -> BodyModel:
    """Set the neutral angles to those of the standing body."""
    neutral = np.zeros((body.n_parts, 3))
    neutral[np.arange(3) < body.n_axes[:, None]] = standing_state(body)[7:]
    return replace(body, neutral=neutral + 0.0)  # no -0.0


def _side(name: str) -> str:
    return next((side for side in ("left_", "right_") if name.startswith(side)), "")


def _parent(name: str, parent: str) -> int:
    return _ORDER.index(parent if parent in _ORDER else _side(name) + parent) if parent else -1


def _on_side(vector: Sequence[float], name: str, mirror: FloatArray) -> FloatArray:
    return np.array(vector) * (mirror if name.startswith("right_") else 1.0) + 0.0  # no -0.0


def _solid(name: str) -> list[tuple[float, float, float, float, str]]:
    """Return spheres in statures, each with the girth that widens it."""
    row = _PARTS[name.removeprefix(_side(name))]
    spheres = [(*sphere, girth) for sphere, girth in zip(row["spheres"], row["girths"], strict=True)]
    mirrored = [(-x, y, z, radius, girth) for x, y, z, radius, girth in spheres]
    if _side(name) == "right_":
        return mirrored
    if _side(name) == "left_":
        return spheres
    # A middle part: its left half is in the table.
    return spheres + [sphere for sphere in mirrored if sphere[0] != 0]


def _apply(body: BodyModel, factors: Mapping[str, float]) -> BodyModel:
    """Scale lengths and girths of the body."""
    offsets, tip_offsets = body.offsets.copy(), body.tip_offsets.copy()
    for measure, moved in _SCALED.items():
        for point, axes in moved:
            for names, places in ((body.joints, offsets), (body.tips, tip_offsets)):
                for row in [i for i, name in enumerate(names) if name.removeprefix(_side(name)) == point]:
                    places[row, list(axes)] *= factors[measure]
    girths = [girth for name in _ORDER for *_, girth in _solid(name)]
    return reshape(body, offsets, tip_offsets, np.array([factors.get(girth, 1.0) for girth in girths]))
