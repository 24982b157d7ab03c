"""JSON forms of points of people, converted to one: people by frame, points by person.

Supported for each person of a frame: OpenPose (``people``, ``pose_keypoints_3d``: flat x, y, z, confidence),
MMPose (``instance_info``, ``instances``, ``keypoints``, ``keypoint_scores``; names in ``meta_info``), world landmarks
of MediaPipe (lists of ``x, y, z, visibility``; ``pose_world_landmarks``), TensorFlow.js (``keypoints3D``, with ``name``
of each), points by name, and bare lists (frames, joints, 3) or (frames, 3 joints).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import DousaError
from dousa.files.frame_names import natural_key, number_frames
from dousa.formats.arrays.joints import list_layouts

WORLD_KEYS = (
    "pose_keypoints_3d", "keypoints_3d", "keypoints3d", "keypoints3D", "pose_world_landmarks", "poseWorldLandmarks",
    "world_landmarks", "worldLandmarks", "landmarks_3d", "landmarks3d", "joints_3d", "joints3d", "joints3D",
    "positions_3d", "pred_xyz_jts",
)  # fmt: skip
_PLAIN_KEYS = ("keypoints", "joints", "landmarks", "positions", "points", "landmark", "pose", "skeleton")
PICTURE_KEYS = ("pose_landmarks", "poseLandmarks")
FLAT_KEY = "pose_keypoints_2d"
_POINT_KEYS = (*WORLD_KEYS, *_PLAIN_KEYS, *PICTURE_KEYS)
_PEOPLE_KEYS = ("people", "instances", "predictions", "persons", "bodies", "poses")
_FRAME_KEYS = ("instance_info", "frames", "data", "results", *_PEOPLE_KEYS)
_SCORE_KEYS = ("keypoint_scores", "scores", "confidence", "visibility", "confidences")
_SURE_KEYS = ("visibility", "score", "confidence", "conf", "c")
_NUMBER_KEYS = ("person_id", "track_id", "idx")
_RATE_KEYS = ("fps", "frame_rate", "frameRate", "framerate", "FPS")
_NAME_KEYS = ("joint_names", "keypoint_names", "names", "jointNames", "keypoints_name")
_BODY_OF = {133: 17, 136: 26, 553: 33}  # points of the body come first, then feet, face and hands
_MOST_FRAMES, _MOST_PEOPLE = 2_000_000, 200
_DEEPEST = 6


class FormError(DousaError):
    """The content is in none of the forms; the message names those expected, or the one found."""


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """One person in one frame.

    Parameters
    ----------
    points : (K, 4) x, y, z, confidence; NaN where missing; no rows where there are only points in a picture.
    key : name of the points in the file, "" of bare lists.
    names : (K,) of the points, if any; else empty.
    number : of the person by the program, else None.
    """

    points: FloatArray
    key: str = ""
    names: tuple[str, ...] = ()
    number: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """People of every frame, with their common rate in Hz and names of the points."""

    frames: list[list[Person]]
    rate: float | None = None
    names: tuple[str, ...] = ()


def list_frames(content: Any) -> Recording:
    """List the people of all frames of a JSON file's content; FormError if it has none of the known forms."""
    rate: float | None = None
    names: tuple[str, ...] = ()
    if isinstance(content, Mapping):
        rate, names = _find_rate(content), _find_names(content)
        content = _find_frames(content)
    if not isinstance(content, list) or not content:
        raise FormError("landmarks.unknown")
    if len(content) > _MOST_FRAMES:
        raise FormError("landmarks.frames", most=_MOST_FRAMES, found=len(content))
    if all(isinstance(entry, Mapping) and "image_id" in entry for entry in content):
        return Recording(_group_by_image(content), rate, names)
    if _is_person(content):  # the points of a single frame
        content = [content]
    return Recording([list_people(entry) for entry in content], rate, names)


def _find_rate(content: Mapping[str, Any]) -> float | None:
    found = next((content[key] for key in _RATE_KEYS if _is_number(content.get(key))), None)
    return float(found) if found is not None and 0 < found <= 1e6 else None


def _find_names(content: Mapping[str, Any]) -> tuple[str, ...]:
    for place in (content, content.get("meta_info_3d"), content.get("meta_info")):
        if not isinstance(place, Mapping):
            continue
        by_number = place.get("keypoint_id2name")
        if isinstance(by_number, Mapping):
            return tuple(str(by_number[key])[:100] for key in sorted(by_number, key=natural_key))
        for key in _NAME_KEYS:
            found = place.get(key)
            if isinstance(found, list) and found and all(isinstance(name, str) for name in found):
                return tuple(name[:100] for name in found)
    return ()


def _find_frames(content: Mapping[str, Any]) -> Any:
    """List of frames of an object: under a usual name, or the arrays of a single take."""
    for key in _FRAME_KEYS:
        if isinstance(content.get(key), list):
            # ``people`` at the top is a file of one frame; ``frames`` are frames, and so are arrays.
            bare = _depth(content[key]) == 3 and isinstance(content[key][0][0], list)
            return [content] if key in _PEOPLE_KEYS and not bare else content[key]
    for key in _POINT_KEYS:
        found = content.get(key)
        if isinstance(found, list) and found:
            return [{key: frame} for frame in found] if _depth(found) == 3 else [content]
    by_name = {name: rows for name, rows in content.items() if _depth(rows) == 2}
    if len(by_name) > 2 and len({len(rows) for rows in by_name.values()}) == 1:  # a path for each joint
        return [dict(zip(by_name, rows, strict=True)) for rows in zip(*by_name.values(), strict=True)]
    return [content] if _is_named_points(content) else None


def _depth(value: Any) -> int:
    """Number of nested lists (or lists and then an object with x)."""
    depth = 0
    while isinstance(value, list) and value and depth < _DEEPEST:
        value, depth = value[0], depth + 1
    return depth + isinstance(value, Mapping)


def _group_by_image(entries: Sequence[Mapping[str, Any]]) -> list[list[Person]]:
    by_image: dict[str, list[Person]] = {}
    for entry in entries:
        by_image.setdefault(str(entry["image_id"]), []).extend(list_people(entry))
    numbered = number_frames(sorted(by_image, key=natural_key))
    if max(numbered) >= _MOST_FRAMES:
        raise FormError("landmarks.frames", most=_MOST_FRAMES, found=max(numbered) + 1)
    return [by_image.get(numbered.get(frame, ""), []) for frame in range(max(numbered) + 1)]


def list_people(node: Any, key: str = "", depth: int = 0) -> list[Person]:
    """List the people of one frame in any of the forms; FormError if it is none, or has too many people."""
    if node is None or node in ([], {}):
        return []
    if depth > _DEEPEST:
        raise FormError("landmarks.unknown")
    if isinstance(node, Mapping):
        return _list_in_object(node, depth)
    if not isinstance(node, list):
        raise FormError("landmarks.unknown")
    if _is_person(node):
        return [Person(*_read_points(node, key))]
    if len(node) > _MOST_PEOPLE:
        raise FormError("landmarks.people", most=_MOST_PEOPLE, found=len(node))
    return [person for entry in node for person in list_people(entry, key, depth + 1)]


def _list_in_object(node: Mapping[str, Any], depth: int) -> list[Person]:
    for key in _POINT_KEYS:
        found = node.get(key)
        # OpenPose writes an empty list of 3D points beside those in the picture.
        if isinstance(found, list | Mapping) and found:
            people = list_people(found, key, depth + 1)
            scores = next((node[name] for name in _SCORE_KEYS if isinstance(node.get(name), list)), None)
            number = _read_number(node)
            return [_finish(person, scores, number) for person in people]
    if isinstance(node.get(FLAT_KEY), list):
        return [Person(np.empty((0, 4)), FLAT_KEY, (), _read_number(node))]
    for key in (*_PEOPLE_KEYS, *_POINT_KEYS):
        if key in node:
            return list_people(node[key], key, depth + 1)
    if _is_named_points(node):
        return [Person(np.array([_read_landmark(entry) for entry in node.values()]), "", tuple(map(str, node)))]
    raise FormError("landmarks.unknown")


def _finish(person: Person, scores: Any, number: int | None) -> Person:
    if scores is not None and len(scores) == 1 and isinstance(scores[0], list):
        scores = scores[0]
    points = person.points
    if scores is not None and len(scores) >= len(points) and all(map(_is_number, scores)):
        points = points.copy()
        points[:, 3] = np.array(scores[: len(points)], np.float64)
    return Person(points, person.key, person.names, person.number if number is None else number)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_value(value: Any) -> bool:
    return value is None or _is_number(value)


def _is_landmark(entry: Any) -> bool:
    if isinstance(entry, Mapping):
        return _is_value(entry.get("x", "")) and _is_value(entry.get("y", ""))
    return entry is None or (isinstance(entry, list) and 2 <= len(entry) <= 5 and all(map(_is_value, entry)))


def _is_named_points(node: Mapping[str, Any]) -> bool:
    return len(node) > 2 and all(entry is not None and _is_landmark(entry) for entry in node.values())


def _counts() -> set[int]:
    return {len(layout.names) for layout in list_layouts()}


def _flat_width(node: list[Any]) -> int:
    """Number of values per point in a flat list of numbers; 0 if it is none."""
    if len(node) < 6 or not all(map(_is_value, node)):
        return 0
    known = _counts() | set(_BODY_OF)
    return next((width for width in (4, 3) if len(node) % width == 0 and len(node) // width in known), 0)


def _is_person(node: list[Any]) -> bool:
    """Whether a list holds the points of one person, one after the other or as a flat list of numbers."""
    if _flat_width(node):
        return True
    return len(node) > 2 and any(entry is not None for entry in node) and all(map(_is_landmark, node))


def _read_points(node: list[Any], key: str) -> tuple[FloatArray, str, tuple[str, ...]]:
    width = _flat_width(node)
    names: tuple[str, ...] = ()
    if width:
        values = np.array(node, np.float64).reshape(-1, width)
        points = np.concatenate((values, np.ones((len(values), 4 - width))), axis=1)
    else:
        points = np.array([_read_landmark(entry) for entry in node])
        if all(isinstance(entry, Mapping) and isinstance(entry.get("name"), str) for entry in node):
            names = tuple(entry["name"][:100] for entry in node)
    count = _BODY_OF.get(len(points), len(points))
    return points[:count], key, names[:count] if len(set(names)) == len(names) else ()


def _read_landmark(entry: Any) -> tuple[float, float, float, float]:
    """x, y, z and confidence; NaN where missing, in a point without z only the z."""
    if entry is None:
        return (np.nan,) * 4
    if isinstance(entry, Mapping):
        sure = next((entry[key] for key in _SURE_KEYS if _is_number(entry.get(key))), 1.0)
        values = [entry["x"], entry["y"], entry.get("z"), sure]
    else:
        values = [*entry[:4], *(None, 1.0)[len(entry) - 2 :]] if len(entry) < 4 else entry[:4]
    x, y, z, sure = (np.nan if value is None else float(value) for value in values)
    return x, y, z, sure


def _read_number(node: Mapping[str, Any]) -> int | None:
    for key in _NUMBER_KEYS:
        value = node.get(key)
        if isinstance(value, list) and len(value) == 1:
            value = value[0]
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31:
            return value
    return None
