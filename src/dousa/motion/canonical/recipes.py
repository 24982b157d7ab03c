"""Sparse linear maps from the points of a file to the 20 canonical points, compiled once per skeleton.

Nearly every canonical joint is one point of the file, so the map is a gather plus a few weighted sums.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import JointMappingError, OptionError
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX
from dousa.motion.canonical.naming import NameMatch, find_missing, holds_limb, match_names, rank_matches

HAND_REACH = 0.4
"""Wrist to knuckles as a share of the forearm; Winter, Biomechanics of human movement: about 0.058 H / 0.146 H."""

Weights = dict[int, float]


@dataclass(frozen=True, slots=True, eq=False)  # hashed by identity: it is the key of caches
class Recipe:
    """Compiled canonical mapping.

    Parameters
    ----------
    table : name family, "tree shape" or "joint map".
    sources : canonical joint -> indices of the points it is the mean of.
    derived : canonical joints made from other joints.
    gather : (20,) index of one point per canonical joint.
    blends : (row, indices, weights) of the rows that are not one point.
    pelvis_markers : indices of left ASIS, right ASIS and of the sacrum (one or two), if hips come from markers.
    has_toes : false if the rows of the toes repeat the ankles.
    absent : canonical joints that cannot be made: NaN.
    skin : joints with a marker on one side only, see `joint_centres`.
    """

    table: str
    sources: dict[str, tuple[int, ...]]
    derived: tuple[str, ...]
    gather: IndexArray
    blends: tuple[tuple[int, IndexArray, FloatArray], ...]
    pelvis_markers: tuple[tuple[int, ...], ...]
    has_toes: bool
    absent: tuple[str, ...] = ()
    skin: frozenset[str] = frozenset()

    @property
    def estimated(self) -> tuple[str, ...]:
        """Joints whose centres are estimated from markers on the skin."""
        hips = {"left_hip", "right_hip"} - set(self.sources) - set(self.absent)
        return tuple(joint for joint in CANONICAL_JOINTS if joint in hips | self.skin)

    def apply(self, positions: FloatArray) -> FloatArray:
        """Compute canonical points (T, 20, 3) of points (T, K, 3); hips from markers and toes are not made yet."""
        result = positions.take(self.gather, axis=1)
        for row, indices, weights in self.blends:
            result[:, row] = np.tensordot(positions[:, indices], weights, axes=(1, 0))
        if self.absent:
            result[:, [JOINT_INDEX[joint] for joint in self.absent]] = np.nan
        return result


def _mean(indices: tuple[int, ...]) -> Weights:
    weights: Weights = {}
    for index in indices:
        weights[index] = weights.get(index, 0.0) + 1.0 / len(indices)
    return weights


def _combine(*terms: tuple[float, Weights]) -> Weights:
    total: Weights = {}
    for factor, weights in terms:
        for index, weight in weights.items():
            total[index] = total.get(index, 0.0) + factor * weight
    return total


def _blend(rows: dict[str, Weights], name: str, *terms: tuple[float, str]) -> None:
    """Make a joint without a point from joints that are all there."""
    if name not in rows and all(joint in rows for _, joint in terms):
        rows[name] = _combine(*((factor, rows[joint]) for factor, joint in terms))


def _complete(rows: dict[str, Weights], spine_share: float = 0.4, head_reach: float = 0.45) -> None:
    """Make joints without a point from those that are there; the others stay absent.

    Parameters
    ----------
    spine_share : of pelvis to neck, where the joint between them lies in most skeletons.
    head_reach : neck to head, as a share of pelvis to neck.
    """
    _blend(rows, "pelvis", (0.5, "left_hip"), (0.5, "right_hip"))
    _blend(rows, "neck", (0.5, "left_shoulder"), (0.5, "right_shoulder"))
    _blend(rows, "spine", (1 - spine_share, "pelvis"), (spine_share, "neck"))
    _blend(rows, "head", (1 + head_reach, "neck"), (-head_reach, "pelvis"))
    for side in ("left", "right"):
        _blend(rows, f"{side}_hand", (1 + HAND_REACH, f"{side}_wrist"), (-HAND_REACH, f"{side}_elbow"))
        if f"{side}_ankle" in rows and f"{side}_knee" in rows:
            _blend(rows, f"{side}_toe", (1.0, f"{side}_ankle"))


def compile_recipe(table: str, sources: dict[str, tuple[int, ...]], skin: frozenset[str] = frozenset()) -> Recipe:
    """Compile a mapping; joints that it lacks and that cannot be made from others are absent.

    Parameters
    ----------
    table : where the mapping comes from.
    sources : place -> indices, as in `naming.NameMatch`.
    skin : joints whose source is a marker on one side of them.
    """
    rows = {place: _mean(indices) for place, indices in sources.items() if place in JOINT_INDEX}
    derived = tuple(joint for joint in CANONICAL_JOINTS if joint not in rows)
    markers = _hip_markers(sources, rows)
    has_toes = "left_toe" in rows and "right_toe" in rows
    _complete(rows)
    gather = np.zeros(len(CANONICAL_JOINTS), np.intp)
    blends = []
    for name, row in JOINT_INDEX.items():
        if name not in rows:
            continue
        indices = np.array(list(rows[name]), np.intp)
        gather[row] = indices[0]
        if len(indices) > 1:
            blends.append((row, indices, np.array(list(rows[name].values()))))
    kept = {joint: sources[joint] for joint in CANONICAL_JOINTS if joint in sources}
    absent = tuple(joint for joint in CANONICAL_JOINTS if joint not in rows)
    derived = tuple(joint for joint in derived if joint in rows)
    return Recipe(table, kept, derived, gather, tuple(blends), markers, has_toes, absent, skin & set(kept))


def _hip_markers(
    sources: dict[str, tuple[int, ...]], rows: dict[str, Weights], inward: float = 0.2
) -> tuple[tuple[int, ...], ...]:
    """Markers that hips are made from: spines of the pelvis and sacrum; places in ``rows`` until then.

    ``inward`` : how far inside of the trochanters the hip joints are, as a share of their distance.
    """
    if "left_hip" in rows and "right_hip" in rows:
        return ()
    spines = ("left_asis", "right_asis", "sacrum")
    trochanters = ("left_trochanter", "right_trochanter")
    if all(place in sources for place in spines):
        markers = tuple(sources[place] for place in spines)
        pelvis = _combine((0.25, _mean(markers[0])), (0.25, _mean(markers[1])), (0.5, _mean(markers[2])))
        rows.setdefault("pelvis", pelvis)
        rows["left_hip"], rows["right_hip"] = pelvis, pelvis
        return markers
    if all(place in sources for place in trochanters):
        left, right = (_mean(sources[place]) for place in trochanters)
        rows["left_hip"] = _combine((1 - inward, left), (inward, right))
        rows["right_hip"] = _combine((1 - inward, right), (inward, left))
    return ()


@lru_cache(maxsize=256)
def named_recipes(names: tuple[str, ...]) -> tuple[Recipe, ...]:
    """Return the recipes of whole bodies by names, the table that covers most first."""
    return tuple(_compile_match(match) for match in rank_matches(names) if not match.missing)


def _compile_match(match: NameMatch) -> Recipe:
    return compile_recipe(match.table, match.sources, match.skin)


@lru_cache(maxsize=256)
def partial_recipes(names: tuple[str, ...]) -> tuple[Recipe, ...]:
    """Return the recipes by names of a part of a body with a whole arm or leg, the fullest first."""
    return tuple(_compile_match(match) for match in rank_matches(names) if holds_limb(match.missing))


@lru_cache(maxsize=256)
def on_the_skin(recipe: Recipe) -> Recipe:
    """Return the recipe with points named like joints as markers on their outer side, hips on the trochanters."""
    sources = {joint.replace("_hip", "_trochanter"): points for joint, points in recipe.sources.items()}
    sides = ("left", "right")
    skin = frozenset(f"{side}_{joint}" for side in sides for joint in ("shoulder", "elbow", "knee", "ankle"))
    return compile_recipe(recipe.table, sources, skin)


JointMap = Mapping[str, str | Sequence[str]]


def read_joint_map(path: str | os.PathLike[str]) -> dict[str, tuple[str, ...]]:
    """Read a joint map, canonical joint -> names in the file, from TOML, JSON or lines ``canonical = name``.

    Raises
    ------
    OptionError : the file cannot be read, or is no joint map.
    """
    where = os.fspath(path)
    try:
        if Path(path).stat().st_size > 1_000_000:
            raise OptionError("joint_map.too_large", where=where)
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OptionError("joint_map.unreadable", where=where, reason=error) from error
    except UnicodeDecodeError as error:
        raise OptionError("joint_map.not_utf8", where=where, reason=error) from error
    return _checked(_parse(text, where), where)


def _parse(text: str, where: str) -> Mapping[str, Any]:
    if text.lstrip().startswith("{"):
        try:
            parsed = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            line = f":{error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
            raise OptionError("joint_map.not_json", where=f"{where}{line}", reason=error) from error
        return dict(parsed)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError):
        return _parse_lines(text, where)


def _parse_lines(text: str, where: str) -> dict[str, Any]:
    """Read ``canonical = name`` without quotes; names joined by commas are averaged."""
    found: dict[str, Any] = {}
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        joint, equals, names = content.partition("=")
        if not equals or not names.strip():
            raise OptionError("joint_map.no_pair", where=f"{where}:{number}", content=content)
        if joint.strip() in found:
            raise OptionError("joint_map.twice", where=f"{where}:{number}", joint=joint.strip())
        found[joint.strip()] = [name.strip().strip("\"'") for name in names.strip(" []").split(",")]
    return found


def _checked(entries: Mapping[str, Any], where: str) -> dict[str, tuple[str, ...]]:
    if len(entries) == 1 and isinstance(inner := next(iter(entries.values())), dict):
        entries = inner  # a map under one heading, such as [joints]
    if not entries:
        raise OptionError("joint_map.empty", where=where)
    checked: dict[str, tuple[str, ...]] = {}
    for joint, value in entries.items():
        if joint not in CANONICAL_JOINTS:
            raise OptionError("joint_map.not_canonical", where=where, joint=joint, known=CANONICAL_JOINTS)
        names = (value,) if isinstance(value, str) else value
        if not isinstance(names, Sequence) or not names or not all(isinstance(n, str) and n for n in names):
            raise OptionError("joint_map.no_name", where=where, joint=joint, found=repr(names))
        checked[joint] = tuple(names)
    return checked


def recipe_from_joint_map(joint_map: JointMap, names: tuple[str, ...]) -> Recipe:
    """Compile a joint map, completed by the names.

    Parameters
    ----------
    joint_map : canonical joint -> name or names in the file.
    names : (K,) names in the file.

    Raises
    ------
    JointMappingError : a name missing in the file, or required joints in neither.
    OptionError : a key that is not a canonical joint.
    """
    match = match_names(names)
    sources = dict(match.sources) if match is not None else {}
    skin = set(match.skin) if match is not None else set()
    for joint, wanted in _checked(joint_map, "joint map").items():
        absent = [name for name in wanted if name not in names]
        if absent:
            raise JointMappingError("joint_map.absent", names, name=absent[0], joint=joint)
        sources[joint] = tuple(names.index(name) for name in wanted)
        skin.discard(joint)
    missing = find_missing(sources)
    if missing and not holds_limb(missing):
        raise JointMappingError("joint_map.incomplete", names, missing=missing)
    return compile_recipe("joint map", sources, frozenset(skin))
