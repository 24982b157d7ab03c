"""Joint maps: a person tells which joints of a file are the canonical ones.

A file of TOML or JSON, or plain lines ``canonical = name``:

    left_elbow = "elbow_03"
    pelvis = ["hip_a", "hip_b"]      # the mean of both
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dousa.errors import JointMappingError, OptionError
from dousa.motion._recipe import Recipe, compile_recipe
from dousa.motion.joints import CANONICAL_JOINTS
from dousa.motion.naming import REQUIRED_JOINTS, match_names

__all__ = ["JointMap", "read_joint_map", "recipe_from_joint_map"]

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
            raise OptionError(f"{where}: expected a joint map of a few lines, got a file of over 1 MB")
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OptionError(f"{where}: the joint map cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise OptionError(f"{where}: expected text in UTF-8: {error}") from error
    return _checked(_parse(text, where), where)


def _parse(text: str, where: str) -> Mapping[str, Any]:
    if text.lstrip().startswith("{"):
        try:
            parsed = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            line = f":{error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
            raise OptionError(f"{where}{line}: not valid JSON: {error}") from error
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
            raise OptionError(
                f"{where}:{number}: expected 'canonical joint = name in the file', got '{content}'"
            )
        if joint.strip() in found:
            raise OptionError(f"{where}:{number}: '{joint.strip()}' is given a second time")
        found[joint.strip()] = [name.strip().strip("\"'") for name in names.strip(" []").split(",")]
    return found


def _checked(entries: Mapping[str, Any], where: str) -> dict[str, tuple[str, ...]]:
    if len(entries) == 1 and isinstance(inner := next(iter(entries.values())), dict):
        entries = inner  # a map under one heading, such as [joints]
    if not entries:
        raise OptionError(f"{where}: expected lines 'canonical joint = name in the file', got none")
    checked: dict[str, tuple[str, ...]] = {}
    for joint, value in entries.items():
        if joint not in CANONICAL_JOINTS:
            raise OptionError(
                f"{where}: '{joint}' is not a canonical joint; they are: {', '.join(CANONICAL_JOINTS)}"
            )
        names = (value,) if isinstance(value, str) else value
        if not isinstance(names, Sequence) or not names or not all(isinstance(n, str) and n for n in names):
            raise OptionError(f"{where}: '{joint}': expected a name or a list of names, got {names!r}")
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
            raise JointMappingError(
                f"the joint map gives '{absent[0]}' for {joint}, but there is no such joint", names
            )
        sources[joint] = tuple(names.index(name) for name in wanted)
    has_hips = {"left_asis", "right_asis", "sacrum"} <= sources.keys()
    missing = [j for j in REQUIRED_JOINTS if j not in sources and not (has_hips and "hip" in j)]
    if missing:
        raise JointMappingError(f"the joint map leaves out {', '.join(missing)}", names)
    return compile_recipe("joint map", sources)
