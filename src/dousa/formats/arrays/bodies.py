"""Bodies of SMPL in nested content, as programs that watch films save it: by person, by frame, in world and camera.

A dictionary whose arrays are the rotations of a body is a body. Of a dictionary of others, keys that are numbers are
people; of other keys the one that says world or global is taken before one that says camera. Arrays of several people
(SLAHMR) have one more axis. A dictionary of frames (4DHumans, ROMP) is turned into people first.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.files.frame_files import natural_key
from dousa.formats.smpl_poses import are_poses, find_roles, rank_place, read_rotations

_PERSON = re.compile(r"(?:id|person|track|subject|body|human|p)?[ _-]?(\d+)", re.IGNORECASE)
_Value = TypeVar("_Value")
_PICTURE = re.compile(r"\.(?:jpe?g|png|bmp)$", re.IGNORECASE)
_TRACKS = ("tid", "tracked_ids", "track_ids", "person_ids")


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body in a file.

    Parameters
    ----------
    name : of its person, or of the dictionary that holds it; "" of the only one.
    arrays : by name.
    turns : (T, J, 4) rotations of the arrays, in the frames in which it is seen; None of damaged ones.
    in_world : whether names say that it stands in the world.
    """

    name: str
    arrays: Mapping[str, NDArray[Any]]
    turns: FloatArray | None
    in_world: bool


def as_array(value: Any) -> NDArray[Any] | None:
    """Return numbers as an array; None for anything else."""
    if isinstance(value, bool | str | bytes | dict) or value is None:
        return None
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal lengths
        return None
    return array if array.dtype.kind in "iuf" else None


def list_bodies(content: Any, name: str = "", depth: int = 0, deepest: int = 6, most: int = 200) -> list[Body]:
    """List the bodies of nested dictionaries and lists, nested at most ``deepest``; [] if there are none.

    ``most`` : items of a list of people, or of something that is looked into.
    """
    if depth > deepest:
        return []
    if isinstance(content, list) and len(content) <= most:
        content = {f"{number}": item for number, item in enumerate(content, 1) if isinstance(item, Mapping)}
    if not isinstance(content, Mapping):
        return []
    content = _gather_frames(content) or content
    if are_poses(find_roles(map(str, content))):
        arrays = {str(key): array for key, value in content.items() if (array := as_array(value)) is not None}
        in_world = any(rank_place(one) == 0 for one in arrays)
        bodies = [Body(name, arrays, _read_turns(arrays), in_world)]
        if bodies[0].turns is None:
            rows = enumerate(_split(arrays), 1)
            bodies = [Body(f"id {number}", own, _read_turns(own), in_world) for number, own in rows]
        if bodies and all(body.turns is not None for body in bodies):
            return bodies
    found = {str(key): bodies for key, value in content.items() if (bodies := list_bodies(value, str(key), depth + 1))}
    people = name_people(found)
    if people:
        return [
            replace(body, name=who if len(own) == 1 else f"{who} {body.name}")
            for who, own in people.items()
            for body in own
        ]
    if not found:
        return []
    best = min(found, key=rank_place)
    return [replace(body, in_world=body.in_world or rank_place(best) == 0) for body in found[best]]


def name_people(found: Mapping[str, _Value]) -> dict[str, _Value]:
    """Return values by the name of their person, ``id 7``; {} unless all keys are numbers of people."""
    matches = {key: _PERSON.fullmatch(key) for key in found}
    return {f"id {match[1]}": found[key] for key, match in matches.items() if match} if all(matches.values()) else {}


def _read_turns(arrays: Mapping[str, NDArray[Any]]) -> FloatArray | None:
    """Rotations of the body of some arrays; None if they are none."""
    with np.errstate(over="ignore", invalid="ignore"):
        return read_rotations(arrays.get, find_roles(arrays)).turns


def _split(arrays: Mapping[str, NDArray[Any]], most: int = 200) -> list[dict[str, NDArray[Any]]]:
    """Split arrays along their first axis, of people, as long as most of them are on it; at most so many."""
    counts = Counter(len(array) for array in arrays.values() if array.ndim)
    count = counts.most_common(1)[0][0] if counts else 0
    rows = {key: array for key, array in arrays.items() if array.ndim and len(array) == count}
    return [{key: array[n] for key, array in rows.items()} for n in range(count if count <= most else 0)]


def _gather_frames(content: Mapping[Any, Any]) -> Mapping[Any, Any] | None:
    """Turn frames that hold bodies of one pose each into people: lists of them, or arrays; None of other content.

    What is called as a picture is a frame (ROMP), as is what holds a list ``smpl`` (4DHumans).
    """
    pictures = all(_PICTURE.search(str(key)) for key in content)
    known = (isinstance(frame, Mapping) and isinstance(frame.get("smpl"), list) for frame in content.values())
    if len(content) < 2 or not (pictures or all(known)):
        return None
    named = []
    for key in sorted(content, key=lambda key: natural_key(str(key))):
        frame, tracks = content[key], None
        if isinstance(frame, Mapping):
            tracks = next((frame[name] for name in _TRACKS if isinstance(frame.get(name), list | np.ndarray)), None)
            arrays = {str(name): array for name, value in frame.items() if (array := as_array(value)) is not None}
            frame = frame["smpl"] if isinstance(frame.get("smpl"), list) else _split(arrays)
        poses = [pose for pose in frame if isinstance(pose, Mapping)] if isinstance(frame, list) else []
        numbers = range(len(poses)) if tracks is None else tracks
        named.append([{"id": who, **pose} for who, pose in zip(numbers, poses, strict=False)])
    return gather_people(named)


def gather_people(frames: Sequence[Any]) -> dict[int, Mapping[str, Any]]:
    """Gather bodies of one pose each, listed by frame, by the number of their person; {} where the frames have none.

    Parameters
    ----------
    frames : of each frame a list of dictionaries, with the ``id`` of a person each; that of the place in the list where
        there is none. A dictionary in its stead has the list under ``annots``.
    """
    people: dict[int, list[tuple[int, Mapping[str, Any]]]] = {}
    for number, frame in enumerate(frames):
        listed = frame.get("annots") if isinstance(frame, Mapping) else frame
        for place, pose in enumerate(listed if isinstance(listed, list) else ()):
            if isinstance(pose, Mapping) and are_poses(find_roles(map(str, pose))):
                who = pose.get("id", place)
                people.setdefault(int(who) if isinstance(who, int | float) else place, []).append((number, pose))
    gathered: dict[int, Mapping[str, Any]] = {}
    for who, poses in people.items():
        whole: dict[str, Any] = {"frame_ids": np.array([number for number, _ in poses])}
        for key in poses[0][1]:
            rows = [as_array(pose.get(key)) for _, pose in poses]
            found = [row for row in rows if row is not None and row.ndim and row.shape == rows[0].shape]  # type: ignore[union-attr]
            if key != "id" and len(found) == len(rows):
                whole[str(key)] = np.stack(found)
        gathered[who] = whole
    return gathered
