"""How to make the 20 canonical points from the points of a file: a sparse linear map, compiled once per skeleton.

Nearly every canonical joint is one point of the file, so the map is one gather; the few means and
extrapolations are added as weighted sums.
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
from dousa.motion.canonical.naming import NameMatch, find_missing, match_names

HAND_REACH = 0.4
"""Wrist to knuckles as a share of the forearm; Winter, Biomechanics of human movement: about 0.058 H / 0.146 H."""

_HEAD_REACH = 0.45  # neck to head, as a share of pelvis to neck
_SPINE_SHARE = 0.4  # where the joint between pelvis and neck lies in most skeletons

Weights = dict[int, float]


@dataclass(frozen=True, slots=True, eq=False)  # hashed by identity: it is the key of caches
class Recipe:
    """Compiled canonical mapping.

    Parameters
    ----------
    table : which names, or "tree shape" or "joint map".
    sources : canonical joint -> indices of the points it is the mean of.
    derived : canonical joints made from other joints.
    gather : (20,) index of one point per canonical joint.
    blends : (row, indices, weights) of the rows that are not one point.
    pelvis_markers : indices of left ASIS, right ASIS and of the sacrum (one or two), if hips come from markers.
    has_toes : false if the rows of the toes repeat the ankles.
    """

    table: str
    sources: dict[str, tuple[int, ...]]
    derived: tuple[str, ...]
    gather: IndexArray
    blends: tuple[tuple[int, IndexArray, FloatArray], ...]
    pelvis_markers: tuple[tuple[int, ...], ...]
    has_toes: bool

    def apply(self, positions: FloatArray) -> FloatArray:
        """Canonical points (T, 20, 3) of points (T, K, 3); hips from markers and toes still to be made."""
        result = positions.take(self.gather, axis=1)
        for row, indices, weights in self.blends:
            result[:, row] = np.tensordot(positions[:, indices], weights, axes=(1, 0))
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


def _complete(rows: dict[str, Weights], has_hips: bool) -> None:
    """Make the joints that no point stands for from those that are there."""
    if not has_hips:  # placeholders until the pelvis markers tell
        rows["left_hip"], rows["right_hip"] = rows["pelvis"], rows["pelvis"]
    if "pelvis" not in rows:
        rows["pelvis"] = _combine((0.5, rows["left_hip"]), (0.5, rows["right_hip"]))
    if "neck" not in rows:
        rows["neck"] = _combine((0.5, rows["left_shoulder"]), (0.5, rows["right_shoulder"]))
    if "spine" not in rows:
        rows["spine"] = _combine((1 - _SPINE_SHARE, rows["pelvis"]), (_SPINE_SHARE, rows["neck"]))
    if "head" not in rows:
        rows["head"] = _combine((1 + _HEAD_REACH, rows["neck"]), (-_HEAD_REACH, rows["pelvis"]))
    for side in ("left", "right"):
        if f"{side}_hand" not in rows:
            wrist, elbow = rows[f"{side}_wrist"], rows[f"{side}_elbow"]
            rows[f"{side}_hand"] = _combine((1 + HAND_REACH, wrist), (-HAND_REACH, elbow))
        if f"{side}_toe" not in rows:
            rows[f"{side}_toe"] = rows[f"{side}_ankle"]


def compile_recipe(table: str, sources: dict[str, tuple[int, ...]]) -> Recipe:
    """Compile a mapping that has all required joints.

    Parameters
    ----------
    table : where the mapping comes from.
    sources : place -> indices, as in `naming.NameMatch`.
    """
    rows = {place: _mean(indices) for place, indices in sources.items() if place in JOINT_INDEX}
    derived = tuple(joint for joint in CANONICAL_JOINTS if joint not in rows)
    has_hips = "left_hip" in rows and "right_hip" in rows
    markers: tuple[tuple[int, ...], ...] = ()
    if not has_hips:
        markers = tuple(sources[place] for place in ("left_asis", "right_asis", "sacrum"))
        rows["pelvis"] = _combine((0.25, _mean(markers[0])), (0.25, _mean(markers[1])), (0.5, _mean(markers[2])))
    has_toes = "left_toe" in rows and "right_toe" in rows
    _complete(rows, has_hips)
    gather = np.zeros(len(CANONICAL_JOINTS), np.intp)
    blends = []
    for name, row in JOINT_INDEX.items():
        indices = np.array(list(rows[name]), np.intp)
        gather[row] = indices[0]
        if len(indices) > 1:
            blends.append((row, indices, np.array(list(rows[name].values()))))
    kept = {joint: sources[joint] for joint in CANONICAL_JOINTS if joint in sources}
    return Recipe(table, kept, derived, gather, tuple(blends), markers, has_toes)


@lru_cache(maxsize=256)
def named_recipe(names: tuple[str, ...]) -> tuple[Recipe | None, NameMatch | None]:
    """The recipe that the names tell, or None and what the best table lacks."""
    match = match_names(names)
    if match is None or match.missing:
        return None, match
    return compile_recipe(match.table, match.sources), match


JointMap = Mapping[str, str | Sequence[str]]

_MOST_BYTES = 1_000_000


def read_joint_map(path: str | os.PathLike[str]) -> dict[str, tuple[str, ...]]:
    """Read a joint map.

    Parameters
    ----------
    path : TOML, JSON or lines ``canonical = name``.

    Returns
    -------
    Canonical joint -> names in the file whose mean it is.

    Raises
    ------
    OptionError : the file cannot be read, or says something that is not a joint map.
    """
    where = os.fspath(path)
    try:
        if Path(path).stat().st_size > _MOST_BYTES:
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
    """``canonical = name`` without quotes; names joined by commas are averaged."""
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
    """The canonical mapping that a joint map tells; what it leaves out is told by the names.

    Parameters
    ----------
    joint_map : canonical joint -> name or names in the file.
    names : (K,) names in the file.

    Raises
    ------
    JointMappingError : a name that the file has not, or required joints that neither tells.
    OptionError : a key that is not a canonical joint.
    """
    match = match_names(names)
    sources = dict(match.sources) if match is not None else {}
    for joint, wanted in _checked(joint_map, "joint map").items():
        absent = [name for name in wanted if name not in names]
        if absent:
            raise JointMappingError("joint_map.absent", names, name=absent[0], joint=joint)
        sources[joint] = tuple(names.index(name) for name in wanted)
    missing = find_missing(sources)
    if missing:
        raise JointMappingError("joint_map.incomplete", names, missing=missing)
    return compile_recipe("joint map", sources)
