"""Keypoints of other programs in JSON, one file for each frame or one for a view.

Supported for each person of a frame: OpenPose and Pose2Sim (``people``, ``pose_keypoints_2d``), results of
COCO and AlphaPose (``image_id``, ``keypoints``), annotations of COCO, MMPose (``instance_info``, ``instances``), and
landmarks of MediaPipe as lists of ``x, y, visibility``, perhaps in units of the image size. The number of points
determines their scheme. Left is the person's left.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import KeypointError, MotionFileError
from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES
from dousa.files.disk import read_bytes
from dousa.files.frame_files import natural_key, number_frames


def _pairs(words: str) -> tuple[str, ...]:
    """Return names for a left and a right point each."""
    return tuple(f"{side}_{word}" for word in words.split() for side in ("left", "right"))


COCO_17 = ("nose", *_pairs("eye ear shoulder elbow wrist hip knee ankle"))
_FEET = ("left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel")
BODY_25 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear", *_FEET,
)  # fmt: skip
COCO_18 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear",
)  # fmt: skip
HALPE_26 = (*COCO_17, "head_top", "neck", "mid_hip", *_pairs("big_toe small_toe heel"))
WHOLE_BODY = (*COCO_17, *_FEET)  # of 133; those of face and hands are left out

SCHEMES: dict[int, tuple[str, ...]] = {
    17: COCO_17,
    18: COCO_18,
    25: BODY_25,
    26: HALPE_26,
    33: MEDIAPIPE_NAMES,
    133: WHOLE_BODY,
    136: HALPE_26,
    **dict.fromkeys((75, 543, 553), MEDIAPIPE_NAMES),
}
"""Names by the number of points, by definition of COCO, OpenPose (COCO and BODY_25), Halpe, MediaPipe, COCO-WholeBody,
Halpe's whole body, and MediaPipe with hands, with a face, and with that of FreeMoCap."""

_MOST_BYTES, _MOST_FRAMES, _MOST_PEOPLE = 1_000_000_000, 2_000_000, 200
_POINT_KEYS = ("pose_keypoints_2d", "keypoints", "pose_landmarks", "poseLandmarks", "landmarks", "joints")
_PEOPLE_KEYS = ("people", "instances", "predictions", "persons", "bodies", "annots", *_POINT_KEYS)
_SCORE_KEYS = ("keypoint_scores", "scores")
_NUMBER_KEYS = ("person_id", "personID", "track_id", "idx")


class ReadPerson(NamedTuple):
    """One person in one frame: points (K, 3), x, y and confidence, and the person's number in the file, if any."""

    points: FloatArray
    number: int | None


class ReadFrames(NamedTuple):
    """The people of every frame (T,), and if the file has them the size of the images in px and the points' names."""

    frames: list[list[ReadPerson]]
    size: tuple[int, int] | None
    names: tuple[str, ...] = ()


def read_keypoint_json(path: str | os.PathLike[str]) -> ReadFrames:
    """Read a JSON file, or a folder of one for each frame.

    Raises
    ------
    KeypointError : missing, damaged, of an unknown form, or with an unknown number of points.
    """
    try:
        if os.path.isdir(path):
            return _read_folder(os.fspath(path))
        return _read_file(os.fspath(path))
    except KeypointError as error:
        raise error.at(path) from None
    except OverflowError as error:  # whole numbers of hundreds of digits
        raise KeypointError("keypoint_json.broken", reason=str(error)).at(path) from error


def _parse(path: str) -> Any:
    try:
        if os.path.isfile(path) and os.path.getsize(path) > _MOST_BYTES:
            raise KeypointError("keypoint_json.large", most=_MOST_BYTES // 1_000_000)
        return json.loads(read_bytes(path))
    except MotionFileError as error:
        raise KeypointError(error.message).at(path) from error
    except (ValueError, RecursionError) as error:
        raise KeypointError("keypoint_json.broken", reason=str(error)[:200]).at(path) from error


def _read_folder(folder: str) -> ReadFrames:
    names = [name for name in os.listdir(folder) if name.lower().endswith(".json") and not name.startswith(".")]
    if not names:
        raise KeypointError("keypoint_json.empty_folder")
    numbered = number_frames(sorted(names, key=natural_key))
    n_frames = max(numbered) + 1
    if n_frames > _MOST_FRAMES:
        raise KeypointError("keypoint_json.frames", most=_MOST_FRAMES, found=n_frames)
    frames: list[list[ReadPerson]] = [[] for _ in range(n_frames)]
    size = None
    for frame, name in numbered.items():
        try:
            content = _parse(os.path.join(folder, name))
            frames[frame] = _list_people(content)
            size = size or (_read_size(content) if isinstance(content, Mapping) else None)
        except KeypointError as error:
            raise error.at(os.path.join(folder, name)) from None
    return ReadFrames(frames, size)


def _read_file(path: str) -> ReadFrames:
    """Read a single file: a list of frames, or a list of people with their frames."""
    content = _parse(path)
    size, names = None, _find_names(content)
    if isinstance(content, Mapping):
        images = content.get("images")
        if isinstance(content.get("annotations"), list):
            if isinstance(images, list) and images and isinstance(images[0], Mapping):
                size = _read_size(images[0])
            content = content["annotations"]
        else:
            size = _read_size(content)
            frames = next((content[key] for key in ("instance_info", "frames", "data") if key in content), None)
            if frames is None and content and all(_holds_people(entry) for entry in content.values()):
                return ReadFrames(_place_images({image: _list_people(entry) for image, entry in content.items()}), size)
            content = [content] if frames is None else frames
    if not isinstance(content, list) or not content:
        raise KeypointError("keypoint_json.unknown")
    if len(content) > _MOST_FRAMES * 10:
        raise KeypointError("keypoint_json.frames", most=_MOST_FRAMES, found=len(content))
    if all(isinstance(entry, Mapping) and "image_id" in entry for entry in content):
        return ReadFrames(_group_by_image(content), size, names)
    return ReadFrames([_list_people(entry) for entry in content], size, names)


def _holds_people(entry: Any) -> bool:
    return isinstance(entry, Mapping) and any(isinstance(entry.get(key), list) for key in _PEOPLE_KEYS)


def _find_names(content: Any) -> tuple[str, ...]:
    """Return the names that MMPose (``meta_info``) and COCO (``categories``) give the points; none otherwise."""
    if not isinstance(content, Mapping):
        return ()
    named: Any = None
    about, categories = content.get("meta_info"), content.get("categories")
    if isinstance(about, Mapping) and isinstance(about.get("keypoint_id2name"), Mapping):
        named = list(about["keypoint_id2name"].values())
    elif isinstance(categories, list) and categories and isinstance(categories[0], Mapping):
        named = categories[0].get("keypoints")
    names = tuple(named) if isinstance(named, list) and all(isinstance(name, str) for name in named) else ()
    return names if len(set(names)) == len(names) else ()


def _read_size(node: Mapping[str, Any]) -> tuple[int, int] | None:
    found = [node.get(key) for key in ("width", "height")]
    width, height = (side if isinstance(side, int) and 0 < side < 100_000 else 0 for side in found)
    return (width, height) if width and height else None


def _group_by_image(entries: list[Mapping[str, Any]]) -> list[list[ReadPerson]]:
    """Group people by image; frames without people follow from the numbers."""
    by_image: dict[str, list[ReadPerson]] = {}
    for entry in entries:
        by_image.setdefault(str(entry["image_id"]), []).append(_read_person(entry))
    return _place_images(by_image)


def _place_images(by_image: Mapping[str, list[ReadPerson]]) -> list[list[ReadPerson]]:
    numbered = number_frames(sorted(by_image, key=natural_key))
    if max(numbered) >= _MOST_FRAMES:
        raise KeypointError("keypoint_json.frames", most=_MOST_FRAMES, found=max(numbered) + 1)
    return [by_image.get(numbered.get(frame, ""), []) for frame in range(max(numbered) + 1)]


def _list_people(node: Any) -> list[ReadPerson]:
    """Return the people of a frame in any known form."""
    if node is None or node == []:
        return []
    if isinstance(node, Mapping):
        if _is_person(node):
            return [_read_person(node)]
        key = next((key for key in _PEOPLE_KEYS if key in node), None)
        if key is not None:
            return _list_people(node[key])
    if not isinstance(node, list):
        raise KeypointError("keypoint_json.unknown")
    if len(node) in SCHEMES and all(_is_landmark(entry) for entry in node):
        return [ReadPerson(_to_points([_read_landmark(entry) for entry in node]), None)]
    if len(node) > _MOST_PEOPLE:
        raise KeypointError("keypoint_json.people", most=_MOST_PEOPLE, found=len(node))
    people = []
    for entry in node:
        has_points = isinstance(entry, Mapping) and any(key in entry for key in _POINT_KEYS)
        people += [_read_person(entry)] if has_points else _list_people(entry)
    return people


def _is_person(node: Mapping[str, Any]) -> bool:
    """Return whether these are the points of one person, not of several."""
    points = next((node[key] for key in _POINT_KEYS if isinstance(node.get(key), list)), None)
    return points is not None and len(points) > 0 and (_is_number(points[0]) or any(key in node for key in _SCORE_KEYS))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_landmark(entry: Any) -> bool:
    if isinstance(entry, Mapping):
        return _is_number(entry.get("x")) and _is_number(entry.get("y"))
    return isinstance(entry, list) and 2 <= len(entry) <= 5 and all(map(_is_number, entry))


def _read_landmark(entry: Any) -> tuple[float, float, float]:
    """x, y and confidence; of a list, x and y with the confidence as the third or, beside a depth, the fourth."""
    if isinstance(entry, Mapping):
        sure = next((entry[key] for key in ("visibility", "score", "confidence") if _is_number(entry.get(key))), 1.0)
        return float(entry["x"]), float(entry["y"]), float(sure)
    return float(entry[0]), float(entry[1]), float(entry[3] if len(entry) > 3 else entry[2] if len(entry) > 2 else 1.0)


def _read_person(node: Mapping[str, Any]) -> ReadPerson:
    raw = next((node[key] for key in _POINT_KEYS if key in node), None)
    if not isinstance(raw, list):
        raise KeypointError("keypoint_json.unknown")
    scores = next((node[key] for key in _SCORE_KEYS if isinstance(node.get(key), list)), None)
    if raw and all(map(_is_number, raw)):
        n_values = next((n for n in (3, 2) if len(raw) % n == 0 and len(raw) // n in SCHEMES), 0)
        if not n_values:
            raise KeypointError("keypoint_json.points", found=len(raw) / 3, known=tuple(SCHEMES))
        rows = [tuple(map(float, raw[start : start + n_values])) for start in range(0, len(raw), n_values)]
        values = [(*row, 1.0)[:3] for row in rows]
    elif all(_is_landmark(entry) for entry in raw):
        values = [_read_landmark(entry) for entry in raw]
    else:
        raise KeypointError("keypoint_json.unknown")
    points = _to_points(values)
    if scores is not None and len(scores) == len(values) and all(map(_is_number, scores)):
        points[:, 2] = np.array(scores, np.float64)[: len(points)]
    return ReadPerson(points, _read_number(node))


def _read_number(node: Mapping[str, Any]) -> int | None:
    for key in _NUMBER_KEYS:
        value = node.get(key)
        if isinstance(value, list) and len(value) == 1:
            value = value[0]
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31:
            return value
    return None


def _to_points(values: list[tuple[float, ...]]) -> FloatArray:
    """(K, 3) of a known scheme; points of face and hands are cut off."""
    names = SCHEMES.get(len(values))
    if names is None:
        raise KeypointError("keypoint_json.points", found=len(values), known=tuple(SCHEMES))
    return np.array(values, np.float64)[: len(names)]


def settle_units(
    frames: list[list[ReadPerson]], size: tuple[int, int] | None, *, shares: float = 2.0, farthest: float = 1e6
) -> Iterator[list[ReadPerson]]:
    """Return the people with points in px and confidences from 0 to 1, nan where a point was not seen.

    Coordinates are shares of the image if none is above ``shares``, as no picture of a person is that small in px.
    What lies ``farthest`` px out is no place in a picture.
    """
    everybody = [person.points for people in frames for person in people]
    places = np.concatenate([points[:, :2] for points in everybody]) if everybody else np.zeros((0, 2))
    sure = np.concatenate([points[:, 2] for points in everybody]) if everybody else np.zeros(0)
    known = places[np.isfinite(places).all(axis=1)]
    is_share = len(known) > 0 and float(np.abs(known).max()) <= shares
    if is_share and size is None:
        raise KeypointError("keypoint_json.no_size")
    is_flag = bool(len(sure)) and bool(np.isin(sure, (0, 1, 2)).all()) and bool((sure == 2).any())
    for people in frames:
        settled = []
        for person in people:
            points = person.points.copy()
            nowhere = (points[:, :2] == 0).all(axis=1) & ~(points[:, 2] > 0)
            if is_share and size is not None:
                points[:, :2] = points[:, :2] * np.array(size) - 0.5
            points[:, 2] = np.clip(np.nan_to_num(points[:, 2] / (2 if is_flag else 1), nan=0.0), 0, 1)
            points[nowhere | ~(np.abs(points[:, :2]) < farthest).all(axis=1)] = (np.nan, np.nan, 0.0)
            settled.append(ReadPerson(points, person.number))
        yield settled
