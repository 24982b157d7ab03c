"""Xsens MVNX: XML with the orientation and the position of 23 segments in every frame.

Metres, Z up, X to the front; quaternions w x y z from segment to world. A segment's origin is the joint to its parent;
the tree is in ``joints``, the tips of head, hands and toes are among a segment's ``points``. Frames of the type
``identity``, ``tpose`` and ``npose`` are calibration poses; identity is the rest pose.
Reference: Xsens MVN user manual, chapter "MVNX".
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.markup import parse_xml
from dousa.formats.assembly import add_ends, localise, median_offsets, order_tree, rest_offsets, settle_motion
from dousa.formats.guard import Clock
from dousa.formats.parts import choose, distinguish
from dousa.motion import Motion, Skeleton
from dousa.motion.rotations import normalise

_TIPS = {
    "Head": "pTopOfHead",
    "LeftHand": "pLeftTopOfHand",
    "RightHand": "pRightTopOfHand",
    "LeftToe": "pLeftToe",
    "RightToe": "pRightToe",
}


def read_mvnx(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    person: str | None = None,
) -> Motion:
    """Read the segments of a subject of an MVNX file, with end sites at the tips of head, hands and toes.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default metres.
    up : axis that points up; by default Z.
    person : label or number of a subject; by default the first.

    Raises
    ------
    MotionFileError : missing, no XML, no segments or frames, frames whose numbers do not fit the segments.
    """
    try:
        root = parse_xml(read_bytes(path))
    except CalibrationError as error:
        raise MotionFileError(path, error.message) from None
    subjects = list(_children(root, "subject"))
    if not subjects:
        raise MotionFileError(path, "mvnx.no_subject")
    labels = distinguish(node.get("label") or str(number) for number, node in enumerate(subjects, 1))
    chosen, notes = choose(path, "person", labels, person)
    subject = subjects[chosen]
    segments = [node for group in _children(subject, "segments") for node in _children(group, "segment")]
    names = tuple(node.get("label", f"segment{index}") for index, node in enumerate(segments))
    if not names or len(names) > 500 or len(set(names)) != len(names):
        raise MotionFileError(path, "mvnx.segments", found=len(names))
    frames = [node for group in _children(subject, "frames") for node in _children(group, "frame")]
    taken = [frame for frame in frames if frame.get("type", "normal") == "normal"]
    if not taken:
        raise MotionFileError(path, "mvnx.no_frames")
    world = _read_values(path, taken, "orientation", len(names), 4)
    positions = _read_values(path, taken, "position", len(names), 3)
    rest = [frame for frame in frames if frame.get("type") == "identity"][:1]
    resting = _read_values(path, rest, "position", len(names), 3)[0] if rest else None
    order, parents = order_tree(names, _read_parents(subject))
    rotations, translations = localise(parents, normalise(world[:, order]), positions[:, order])
    offsets = median_offsets(translations) if resting is None else rest_offsets(parents, resting[order])
    tips = [_find_point(segments[index], _TIPS.get(names[index], "")) for index in order]
    ends = [(joint, place) for joint, place in enumerate(tips) if place is not None]
    skeleton = Skeleton(tuple(names[index] for index in order), np.array(parents, np.intp), offsets)
    return settle_motion(
        path, "mvnx", *add_ends(skeleton, rotations, translations, ends), _read_clock(subject, taken),
        unit=unit, up=up, unit_in_file=1.0, up_in_file="z", notes=notes,
    )  # fmt: skip


def _children(node: ET.Element, name: str) -> Iterator[ET.Element]:
    """Children of a name, in any namespace."""
    return (child for child in node if isinstance(child.tag, str) and child.tag.rpartition("}")[2] == name)


def _read_clock(subject: ET.Element, frames: list[ET.Element]) -> Clock:
    """The rate; ``index`` and ``time`` (ms from the start) of every frame."""
    numbers, times = (np.array([_number(frame.get(key, "")) for frame in frames]) for key in ("index", "time"))
    rate = subject.get("frameRate", "").strip()
    return Clock(_number(rate) if rate else None, times, numbers)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _read_values(
    path: str | os.PathLike[str], frames: list[ET.Element], name: str, count: int, width: int
) -> FloatArray:
    """(T, count, width) numbers of an element of every frame."""
    rows = []
    for number, frame in enumerate(frames):
        node = next(_children(frame, name), None)
        try:
            row = np.array([float(word) for word in (node.text or "").split()] if node is not None else [])
        except ValueError:
            raise MotionFileError(path, "mvnx.number", name=name, frame=number) from None
        if len(row) < count * width or not np.isfinite(row).all():
            raise MotionFileError(path, "mvnx.count", name=name, frame=number, expected=count * width, found=len(row))
        rows.append(row[: count * width])  # props come after the segments of the body
    return np.array(rows).reshape(len(frames), count, width)


def _read_parents(subject: ET.Element) -> dict[str, str]:
    """Parent of a segment by name, from the joints that connect them."""
    parents = {}
    for group in _children(subject, "joints"):
        for joint in _children(group, "joint"):
            ends = [next(_children(joint, f"connector{side}"), None) for side in (1, 2)]
            above, below = ((node.text or "").partition("/")[0].strip() if node is not None else "" for node in ends)
            parents[below] = above
    return parents


def _find_point(segment: ET.Element, label: str) -> FloatArray | None:
    for group in _children(segment, "points"):
        for point in _children(group, "point"):
            node = next(_children(point, "pos_b"), None)
            if point.get("label") == label and node is not None:
                try:
                    place = np.array([float(word) for word in (node.text or "").split()])
                except ValueError:
                    return None
                return place if place.shape == (3,) and np.isfinite(place).all() else None
    return None
