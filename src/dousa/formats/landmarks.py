"""Positions of joints in space as JSON from pose estimators of films: one file, or one for each frame.

The forms are converted to one: people by frame, points by person. Supported for each person of a frame: OpenPose
(``people``, ``pose_keypoints_3d``: flat x, y, z, confidence), MMPose (``instance_info``, ``instances``, ``keypoints``,
``keypoint_scores``; names in ``meta_info``), world landmarks of MediaPipe (lists of ``x, y, z, visibility``;
``pose_world_landmarks``), TensorFlow.js (``keypoints3D``, with ``name`` of each), points by name, and bare lists
(frames, joints, 3) or (frames, 3 joints); EasyMocap (``id``, ``keypoints3d``), Panoptic Studio (``bodies``,
``joints19``), the offline processor of Azure Kinect (``joint_positions``). SMPL poses of EasyMocap (``Rh``, ``Th``,
``poses``) are a motion.

Points in a picture (2D keypoints, MediaPipe's picture landmarks) are refused; the message names the command for them. A
point with confidence 0, or with all numbers 0, was not seen. World landmarks of MediaPipe (BlazePose GHUM) are metres
about the middle of the hips, y down.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import DousaError, MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.frame_files import list_frame_files, natural_key, number_frames
from dousa.files.json_arrays import parse_arrays
from dousa.formats.arrays.bodies import gather_people, list_bodies
from dousa.formats.arrays.content import build_content
from dousa.formats.arrays.joints import BODY_OF, list_layouts, name_joints
from dousa.formats.guard import Clock, check_even, check_memory
from dousa.formats.parts import choose
from dousa.messages import Message
from dousa.motion import Motion, Trajectories, thin
from dousa.motion.canonical.naming import match_names

WORLD_KEYS = (
    "pose_keypoints_3d", "keypoints_3d", "keypoints3d", "keypoints3D", "pose_world_landmarks", "poseWorldLandmarks",
    "world_landmarks", "worldLandmarks", "landmarks_3d", "landmarks3d", "joints_3d", "joints3d", "joints3D",
    "positions_3d", "pred_xyz_jts", "joints19", "joint_positions",
)  # fmt: skip
_PLAIN_KEYS = ("keypoints", "joints", "landmarks", "positions", "points", "landmark", "pose", "skeleton")
PICTURE_KEYS = ("pose_landmarks", "poseLandmarks")
FLAT_KEY = "pose_keypoints_2d"
_POINT_KEYS = (*WORLD_KEYS, *_PLAIN_KEYS, *PICTURE_KEYS)
_PEOPLE_KEYS = ("people", "instances", "predictions", "persons", "bodies", "annots", "poses")
_FRAME_KEYS = ("instance_info", "frames", "data", "results", *_PEOPLE_KEYS)
_SCORE_KEYS = ("keypoint_scores", "scores", "confidence", "visibility", "confidences")
_SURE_KEYS = ("visibility", "score", "confidence", "conf", "c")
_NUMBER_KEYS = ("person_id", "track_id", "body_id", "idx", "id")
_CLOCK_KEYS = (
    ("timestamp_usec", "timestamp_us", "timestamp_ms", "timestamp", "timestamps", "univTime"),
    ("frame_id", "frame_index", "frame_number", "frame", "frameId"),
)
# Seconds, by the names of the keys and the definition of Panoptic Studio's univTime.
_TIME_UNITS = {"_usec": 1e-6, "_us": 1e-6, "_ms": 1e-3, "univTime": 1e-3}
_RATE_KEYS = ("fps", "frame_rate", "frameRate", "framerate", "FPS")
_NAME_KEYS = ("joint_names", "keypoint_names", "names", "jointNames", "keypoints_name")


class FormError(DousaError):
    """The content is in none of the forms; the message names those expected, or the one found."""


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """One person in one frame.

    Parameters
    ----------
    points : (K, 3) x, y, z, or (K, 4) with the confidence; NaN where missing; no rows where there are only points in a
        picture.
    key : name of the points in the file, "" of bare lists.
    names : (K,) of the points, if any; else empty.
    number : of the person by the program, else None.
    values : numbers that the file has of the points: as many in every frame.
    """

    points: FloatArray
    key: str = ""
    names: tuple[str, ...] = ()
    number: int | None = None
    values: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """People of every frame, with their common rate in Hz, names of the points, and what else is known of time."""

    frames: list[list[Person]]
    rate: float | None = None
    names: tuple[str, ...] = ()
    times: FloatArray | None = None
    numbers: FloatArray | None = None


def list_frames(content: Any, most: int = 2_000_000) -> Recording:
    """List the people of all frames of a JSON file's content.

    FormError if it has none of the known forms, or more than ``most`` frames.
    """
    rate: float | None = None
    names: tuple[str, ...] = ()
    if isinstance(content, Mapping):
        rate, names = _find_rate(content), _find_names(content)
        content = _find_frames(content)
    if not isinstance(content, _LISTS) or not len(content):
        raise FormError("landmarks.unknown")
    if len(content) > most:
        raise FormError("landmarks.frames", most=most, found=len(content))
    if isinstance(content, list) and all(isinstance(entry, Mapping) and "image_id" in entry for entry in content):
        return Recording(_group_by_image(content, most), rate, names)
    if _is_person(content):  # the points of a single frame
        content = [content]
    times, numbers = (_list_values(content, keys) for keys in _CLOCK_KEYS)
    return Recording([_list_in_frame(entry, n) for n, entry in enumerate(content, 1)], rate, names, times, numbers)


def _list_in_frame(content: Any, number: int) -> list[Person]:
    try:
        return list_people(content)
    except FormError as error:
        if error.code == "landmarks.unknown" and number == 1:  # the form of the file
            raise
        raise FormError("landmarks.frame", frame=number, problem=error.message) from error


def _list_values(frames: Sequence[Any], keys: Sequence[str]) -> FloatArray | None:
    """The number that each frame has under one of the keys; None if one has none."""
    key = next((key for key in keys if isinstance(frames[0], Mapping) and key in frames[0]), None)
    values = [frame.get(key) if isinstance(frame, Mapping) else None for frame in frames]
    if key is None or not all(map(_is_number, values)):
        return None
    return np.array(values, np.float64) * next((unit for end, unit in _TIME_UNITS.items() if key.endswith(end)), 1.0)


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
        if isinstance(content.get(key), _LISTS):
            # ``people`` at the top is a file of one frame; ``frames`` are frames, and so are arrays.
            bare = _depth(content[key]) == 3 and isinstance(content[key][0][0], _LISTS)
            return [content] if key in _PEOPLE_KEYS and not bare else content[key]
    for key in _POINT_KEYS:
        found = content.get(key)
        if isinstance(found, _LISTS) and len(found):
            return [{key: frame} for frame in found] if _depth(found) == 3 else [content]
    by_name = {name: rows for name, rows in content.items() if _depth(rows) == 2}
    if len(by_name) > 2 and len({len(rows) for rows in by_name.values()}) == 1:  # a path for each joint
        return [dict(zip(by_name, rows, strict=True)) for rows in zip(*by_name.values(), strict=True)]
    return [content] if _is_named_points(content) else None


def _depth(value: Any, deepest: int = 6) -> int:
    """Number of nested lists (or lists and then an object with x), at most ``deepest``."""
    depth = 0
    while isinstance(value, list) and value and depth < deepest:
        value, depth = value[0], depth + 1
    return depth + (value.ndim if isinstance(value, np.ndarray) else isinstance(value, Mapping))


def _group_by_image(entries: Sequence[Mapping[str, Any]], most: int) -> list[list[Person]]:
    by_image: dict[str, list[Person]] = {}
    for entry in entries:
        by_image.setdefault(str(entry["image_id"]), []).extend(list_people(entry))
    numbered = number_frames(sorted(by_image, key=natural_key))
    if max(numbered) >= most:
        raise FormError("landmarks.frames", most=most, found=max(numbered) + 1)
    return [by_image.get(numbered.get(frame, ""), []) for frame in range(max(numbered) + 1)]


def list_people(node: Any, key: str = "", depth: int = 0, deepest: int = 6, most: int = 200) -> list[Person]:
    """List the people of one frame in any of the forms.

    FormError if it is none, nested deeper than ``deepest``, or has more than ``most`` people.
    """
    if node is None or (isinstance(node, list | Mapping) and not node):
        return []
    if depth > deepest:
        raise FormError("landmarks.unknown")
    if isinstance(node, Mapping):
        return _list_in_object(node, depth)
    if not isinstance(node, _LISTS):
        raise FormError("landmarks.unknown")
    if _is_person(node):
        return [_read_person(node, key)]
    if len(node) > most:
        raise FormError("landmarks.people", most=most, found=len(node))
    return [person for entry in node for person in list_people(entry, key, depth + 1)]


def _list_in_object(node: Mapping[str, Any], depth: int) -> list[Person]:
    for key in _POINT_KEYS:
        found = node.get(key)
        # OpenPose writes an empty list of 3D points beside those in the picture.
        if isinstance(found, (*_LISTS, Mapping)) and len(found):
            people = list_people(found, key, depth + 1)
            scores = next((node[name] for name in _SCORE_KEYS if isinstance(node.get(name), _LISTS)), None)
            number = _read_number(node)
            return [_finish(person, scores, number) for person in people]
    if isinstance(node.get(FLAT_KEY), _LISTS):
        return [Person(np.empty((0, 4)), FLAT_KEY, (), _read_number(node))]
    for key in (*_PEOPLE_KEYS, *_POINT_KEYS):
        if key in node:
            return list_people(node[key], key, depth + 1)
    if _is_named_points(node):
        person = _read_person([*node.values()], "")
        return [replace(person, names=tuple(map(str, node))[: len(person.points)])]
    raise FormError("landmarks.unknown")


def _finish(person: Person, scores: Any, number: int | None) -> Person:
    if scores is not None and len(scores) == 1 and isinstance(scores[0], _LISTS):
        scores = scores[0]
    points = person.points
    if scores is not None and len(scores) >= len(points) and all(map(_is_number, scores)):
        points = np.column_stack((points[:, :3], np.array(scores[: len(points)], np.float64)))
    values = person.values + (0 if scores is None else len(scores))
    return replace(person, points=points, number=person.number if number is None else number, values=values)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_value(value: Any) -> bool:
    return value is None or _is_number(value)


def _is_landmark(entry: Any) -> bool:
    if isinstance(entry, Mapping):
        return _is_value(entry.get("x", "")) and _is_value(entry.get("y", ""))
    plain = isinstance(entry, _LISTS) and not any(isinstance(value, (*_LISTS, Mapping)) for value in entry)
    return entry is None or (plain and 2 <= len(entry) <= 5)


def _is_named_points(node: Mapping[str, Any]) -> bool:
    return len(node) > 2 and all(entry is not None and _is_landmark(entry) for entry in node.values())


def _counts() -> set[int]:
    return {len(layout.names) for layout in list_layouts()}


def _flat_width(node: list[Any] | FloatArray) -> int:
    """Number of values per point in a flat list of numbers; 0 if it is none."""
    flat = node.ndim == 1 if isinstance(node, np.ndarray) else all(map(_is_value, node))
    if len(node) < 6 or not flat:
        return 0
    known = _counts() | set(BODY_OF)
    return next((width for width in (4, 3) if len(node) % width == 0 and len(node) // width in known), 0)


def _is_person(node: list[Any] | FloatArray) -> bool:
    """Whether a list holds the points of one person, one after the other or as a flat list of numbers."""
    if _flat_width(node):
        return True
    if isinstance(node, np.ndarray):
        return node.ndim == 2 and len(node) > 2 and 2 <= node.shape[1] <= 5
    return len(node) > 2 and any(entry is not None for entry in node) and all(map(_is_landmark, node))


def _read_person(node: list[Any] | FloatArray, key: str) -> Person:
    """The points of a person, of whom each has as many numbers as the others."""
    width = _flat_width(node)
    names: tuple[str, ...] = ()
    if width:
        points = np.array(node, np.float64).reshape(-1, width)
    elif isinstance(node, np.ndarray):
        width = node.shape[1]
        points = np.insert(node, 2, np.nan, axis=1) if width == 2 else node[:, :4]
    else:
        width = _check_points(node)
        points = np.array([_read_landmark(entry) for entry in node])
        if all(isinstance(entry, Mapping) and isinstance(entry.get("name"), str) for entry in node):
            names = tuple(entry["name"][:100] for entry in node)
    count, values = BODY_OF.get(len(points), len(points)), len(points) * width
    return Person(points[:count], key, names[:count] if len(set(names)) == len(names) else (), None, values)


def _check_points(node: list[Any]) -> int:
    """The number of numbers that each point has; FormError if one has others, or what is no number."""
    places = [
        [entry[axis] for axis in "xyz" if axis in entry] if isinstance(entry, Mapping) else entry for entry in node
    ]
    widths = [0 if entry is None else len(entry) for entry in places]
    usual = Counter(filter(None, widths)).most_common(1)[0][0]
    for number, (entry, width) in enumerate(zip(places, widths, strict=True), 1):
        if width not in (0, usual):
            raise FormError("landmarks.point", number=number, expected=usual, found=width)
        odd = [value for value in entry if not _is_value(value)] if isinstance(entry, list) else []
        if odd:
            raise FormError("landmarks.no_number", number=number, found=str(odd[0])[:40])
    return usual


def _read_landmark(entry: Any) -> tuple[float, float, float, float]:
    """x, y, z and confidence; NaN where missing, in a point without z only the z."""
    if entry is None:
        return (np.nan,) * 4
    if isinstance(entry, Mapping):
        sure = next((entry[key] for key in _SURE_KEYS if _is_number(entry.get(key))), 1.0)
        values = [entry["x"], entry["y"], entry.get("z"), sure]
    else:
        entry = [*entry]
        values = [*entry[:4], *(None, 1.0)[len(entry) - 2 :]] if len(entry) < 4 else entry[:4]
    x, y, z, sure = (np.nan if value is None else float(value) for value in values)
    return x, y, z, sure


def _read_number(node: Mapping[str, Any]) -> int | None:
    for key in _NUMBER_KEYS[: -1 if "image_id" in node else None]:  # COCO's id counts annotations
        value = node.get(key)
        if isinstance(value, list) and len(value) == 1:
            value = value[0]
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31:
            return value
    return None


_LISTS = (list, np.ndarray)

_LANDMARKS, _HIPS = 33, (23, 24)  # of MediaPipe's definition


def read_landmarks(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
    person: str | None = None,
) -> Motion | Trajectories:
    """Read 3D points or SMPL poses of a person from JSON, NaN where missing.

    Parameters
    ----------
    path : a file, or a folder of one file for each frame.
    unit, up : by default inferred from the body.
    skeleton : body model of SMPL poses.
    frame_rate : Hz; by default that of the file, else that of the program that usually writes these points.
    person : name or number; by default the one in most frames.

    Raises
    ------
    MotionFileError : missing, damaged, of another form, 2D points, no person in any frame, or not this one.
    """
    files = _read_folder(path) if os.path.isdir(path) else {}
    content = None if files else _parse(path)
    numbered = number_frames([*files])
    frames = [files.get(numbered.get(frame, "")) for frame in range(max(numbered) + 1)] if files else [content]
    poses: Any = gather_people(frames) or content
    if list_bodies(poses):
        return build_content(
            path, poses, unit=unit, up=up, skeleton=skeleton, frame_rate=frame_rate, person=person, animation=None
        )
    try:
        recording = Recording(_list_folder(path, files, numbered)) if files else list_frames(content)
        people, notes = _choose_person(path, recording, person)
    except FormError as error:
        raise MotionFileError(path, error.message) from error
    places, sure = _stack(path, people)
    refuse_pictures(path, places, {person.key for person in people if person is not None})
    places[~(sure > 0) | ~places.any(axis=2)] = np.nan
    if not np.isfinite(places).any():
        raise MotionFileError(path, "landmarks.nobody")
    clock, names = (
        Clock(recording.rate, recording.times, recording.numbers),
        _name_points(recording, people, places.shape[1]),
    )
    del content, poses, recording, people  # of a long recording they are as large as its points
    return name_joints(
        path, "landmarks", places, names, unit=unit, up=up,
        frame_rate=frame_rate, clock=clock, notes=(*notes, *note_hips(places)),
    )  # fmt: skip


def _parse(path: str | os.PathLike[str]) -> Any:
    data = read_bytes(path)
    check_memory(path, 88 * data.count(b"[") + 240 * data.count(b"{") + 8 * data.count(b","), len(data))  # of CPython
    try:
        text = data.decode("utf-8-sig")
        try:
            return parse_arrays(text)
        except json.JSONDecodeError as error:
            if "Extra data" not in error.msg:
                raise
            return [parse_arrays(line) for line in text.splitlines() if line.strip()]  # a frame in each line
    except (ValueError, RecursionError) as error:
        raise MotionFileError(path, "landmarks.broken", reason=str(error)[:200]) from error


def _read_folder(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of each frame that has a file, by its name."""
    try:
        names = list_frame_files(folder)
    except OSError as error:
        raise MotionFileError(folder, "disk.unreadable", reason=error) from error
    if not names:
        raise MotionFileError(folder, "disk.folder")
    contents = {}
    for name in names:
        try:
            contents[name] = _parse(os.path.join(folder, name))
        except MotionFileError as error:
            raise MotionFileError(folder, "landmarks.in_frame", file=name, problem=error.message) from error
    return contents


def _list_folder(
    folder: str | os.PathLike[str], contents: Mapping[str, Any], numbered: Mapping[int, str]
) -> list[list[Person]]:
    """The people of every frame; none in frames without a file."""
    frames: list[list[Person]] = [[] for _ in range(max(numbered) + 1)]
    for frame, name in numbered.items():
        try:
            frames[frame] = list_people(contents[name])
        except FormError as error:
            raise MotionFileError(folder, "landmarks.in_frame", file=name, problem=error.message) from error
    return frames


def _choose_person(
    path: str | os.PathLike[str], recording: Recording, wanted: str | None
) -> tuple[list[Person | None], tuple[Message, ...]]:
    """One person (or None) for each frame: by their numbers; without numbers by the order in the frames."""
    frames = [[person for person in people if len(person.points)] for people in recording.frames]
    numbers = Counter(person.number for people in frames for person in people)
    if not numbers:
        raise FormError("guard.flat" if any(recording.frames) else "landmarks.nobody")
    # A number that is another one in every frame counts frames, not people.
    numbered = None not in numbers and (max(map(len, frames)) > 1 or max(numbers.values()) > 1)
    named: list[dict[str, Person]] = [{} for _ in frames]
    for people, own in zip(frames, named, strict=True):
        for place, one in enumerate(people, 1):
            own.setdefault(f"id {one.number}" if numbered else str(place), one)
    names = [name for name, _ in Counter(name for own in named for name in own).most_common()]
    chosen, notes = choose(path, "person", names, wanted)
    return [own.get(names[chosen]) for own in named], notes


def _stack(path: str | os.PathLike[str], people: list[Person | None]) -> tuple[FloatArray, FloatArray]:
    """Points (T, K, 3) of the person, NaN in frames without, and their confidences (T, K)."""
    seen = {frame: person for frame, person in enumerate(people, 1) if person is not None}
    check_even(path, {frame: person.values for frame, person in seen.items()})
    count = check_even(path, {frame: len(person.points) for frame, person in seen.items()})
    if count * len(people) > 100_000_000:
        raise MotionFileError(path, "disk.too_large")
    places, sure = np.full((len(people), count, 3), np.nan), np.ones((len(people), count))
    for frame, person in enumerate(people):
        if person is not None:
            places[frame] = person.points[:, :3]
            if person.points.shape[1] > 3:
                sure[frame] = person.points[:, 3]
    return places, sure


def refuse_pictures(
    path: str | os.PathLike[str],
    points: FloatArray,
    keys: Collection[str] = (),
    pixels: float = 3.0,
    off_origin: float = 0.15,
    most: int = 5000,
) -> None:
    """Raise MotionFileError for points in a picture.

    Parameters
    ----------
    points : (T, K, 3).
    keys : names of the points in the file.
    pixels : coordinates beyond this, beside confidences from 0 to 1, are places in a picture.
    off_origin : m from the middle of the hips of world landmarks.
    most : frames that are looked at, spread evenly.
    """
    points = thin(points, min(most, len(points)))
    seen = points[np.isfinite(points[..., :2]).all(axis=2)]
    depth = seen[np.isfinite(seen[:, 2]), 2]
    landmarks = points.shape[1] == _LANDMARKS
    shares = len(depth) > 0 and bool(((depth >= 0) & (depth <= 1)).all()) and np.abs(seen[:, :2]).max() > pixels
    if not depth.any() or shares:
        raise MotionFileError(path, "guard.flat")
    middle = points[:, _HIPS, :2].mean(axis=1) if landmarks else np.empty((0, 2))
    middle = middle[np.isfinite(middle).all(axis=1)]
    inside = ((seen[:, :2] > -0.25) & (seen[:, :2] < 1.25)).all(axis=1).mean()
    away = len(middle) > 0 and float(np.abs(np.median(middle, axis=0)).max()) > off_origin
    if set(keys) & set(PICTURE_KEYS) or (away and inside > 0.98):
        raise MotionFileError(path, "landmarks.picture")


def _name_points(recording: Recording, people: list[Person | None], count: int) -> tuple[str, ...] | None:
    """Names in the file, if they are those of a body; BODY_25 as OpenPose has them; else None."""
    own = next((person.names for person in people if person is not None), ())
    for names in (own, recording.names):
        match = match_names(names) if len(names) == count and len(set(names)) == count else None
        if match is not None and not match.missing:
            return names
    keys = {person.key for person in people if person is not None}
    if keys == {"pose_keypoints_3d"}:
        return next((y.names for y in list_layouts() if y.title == "OpenPose BODY_25" and len(y.names) == count), None)
    return None


def note_hips(places: FloatArray, at_origin: float = 0.03) -> tuple[Message, ...]:
    """Note a body whose hips stay within ``at_origin`` m of the origin: it does not travel."""
    if places.shape[1] != _LANDMARKS:
        return ()
    middle = places[:, _HIPS].mean(axis=1)
    seen = middle[np.isfinite(middle).all(axis=1)]
    still = len(seen) > 1 and float(np.abs(seen).max()) < at_origin
    return (Message("landmarks.hips_fixed"),) if still else ()
