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
from itertools import pairwise

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.markup import parse_xml
from dousa.formats.assembly import (
    add_ends,
    localise,
    median_offsets,
    order_tree,
    rest_offsets,
    settle_motion,
    settle_trajectories,
)
from dousa.formats.guard import Clock, check_even, check_memory, compare_points, settle_positions
from dousa.formats.parts import choose, distinguish
from dousa.formats.smpl import mean_body
from dousa.messages import Message
from dousa.motion import Motion, Skeleton, Trajectories
from dousa.motion.rotations import normalise

_TIPS = {
    "Head": "pTopOfHead",
    "LeftHand": "pLeftTopOfHand",
    "RightHand": "pRightTopOfHand",
    "LeftToe": "pLeftToe",
    "RightToe": "pRightToe",
}


SEGMENTS = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder", "RightUpperArm", "RightForeArm", "RightHand",
    "LeftShoulder", "LeftUpperArm", "LeftForeArm", "LeftHand", "RightUpperLeg", "RightLowerLeg", "RightFoot",
    "RightToe", "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe",
)  # fmt: skip
"""The segments in the order of MVN (user manual, "MVNX"), for files that leave them out."""

_CALIBRATION = ("identity", "tpose", "tpose-isb", "npose")

_SIDES = ("Left", "Right")
_CHAINS = (
    "Pelvis L5 L3 T12 T8 Neck Head",
    *(f"T8 {s}Shoulder {s}UpperArm {s}ForeArm {s}Hand" for s in _SIDES),
    *(f"Pelvis {s}UpperLeg {s}LowerLeg {s}Foot {s}Toe" for s in _SIDES),
)
_TREE = {child: parent for chain in _CHAINS for parent, child in pairwise(chain.split())}
_MEAN = {
    "Head": "head",
    **{
        f"{side}{segment}": f"{side.lower()}_{joint}"
        for side in _SIDES
        for segment, joint in (
            ("Shoulder", "collar"), ("UpperArm", "shoulder"), ("ForeArm", "elbow"), ("Hand", "wrist"),
            ("UpperLeg", "hip"), ("LowerLeg", "knee"), ("Foot", "ankle"), ("Toe", "foot"),
        )
    },
}  # fmt: skip


def read_mvnx(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    person: str | None = None,
) -> Motion | Trajectories:
    """Read the segments of a subject of an MVNX file, with end sites at the tips of head, hands and toes.

    What is exported is a choice: positions without orientations become trajectories; of orientations without positions
    the body stays in its place, with the lengths of the points of its segments, else of the mean body.

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
    data = read_bytes(path)
    check_memory(path, 90 * data.count(b"<"), len(data))  # of an element of CPython
    try:
        subjects = list(_children(parse_xml(data), "subject"))
    except CalibrationError as error:
        raise MotionFileError(path, error.message) from None
    if not subjects:
        raise MotionFileError(path, "mvnx.no_subject")
    labels = distinguish(node.get("label") or str(number) for number, node in enumerate(subjects, 1))
    chosen, notes = choose(path, "person", labels, person)
    subject = subjects[chosen]
    segments = [node for group in _children(subject, "segments") for node in _children(group, "segment")]
    names = tuple(node.get("label", f"segment{index}") for index, node in enumerate(segments)) or SEGMENTS
    segments = segments or [ET.Element("segment", label=name) for name in names]
    if not names or len(names) > 500 or len(set(names)) != len(names):
        raise MotionFileError(path, "mvnx.segments", found=len(names))
    notes += _compare_counts(path, subject, len(names))
    frames, taken, more = _list_frames(path, subject)
    notes += more
    clock = _read_clock(subject, taken)
    held = {_name(node) for node in taken[0]} & {"orientation", "position"}
    if not held:
        raise MotionFileError(path, "mvnx.no_pose", found=tuple(_name(node) for node in taken[0]) or ("-",))
    positions = _read_values(path, taken, "position", len(names), 3) if "position" in held else None
    if "orientation" not in held:
        assert positions is not None
        return settle_trajectories(
            path, "mvnx", names, positions, clock, unit=unit, up=up, declared_unit=1.0, declared_up="z", default_up="z",
            notes=(*notes, Message("mvnx.no_orientation")),
        )  # fmt: skip
    order, parents, more = _order_segments(path, subject, names)
    notes += more
    world = _read_values(path, taken, "orientation", len(names), 4)[:, order]
    world = normalise(world)
    rest = [frame for frame in frames if frame.get("type") == "identity" and _has(frame, "position")][:1]
    resting = _read_values(path, rest, "position", len(names), 3)[0] if rest else None
    if positions is None:
        given = resting[order] if resting is not None else _place_points(subject, segments, names, order, parents)
        notes += (Message("mvnx.no_position" if given is not None else "mvnx.mean_body"),)
        offsets = rest_offsets(parents, _place_mean(path, names)[order] if given is None else given)
        turned = np.broadcast_to(np.zeros(3), (*world.shape[:2], 3))
        rotations, _ = localise(parents, world, turned)
        translations = np.tile(offsets, (len(taken), 1, 1))
    else:
        positions, lost = settle_positions(path, names, positions)
        notes += lost
        rotations, translations = localise(parents, world, positions[:, order])
        offsets = median_offsets(translations) if resting is None else rest_offsets(parents, resting[order])
    tips = [_find_point(segments[index], _TIPS.get(names[index], "")) for index in order]
    ends = [(joint, place) for joint, place in enumerate(tips) if place is not None]
    skeleton = Skeleton(tuple(names[index] for index in order), np.array(parents, np.intp), offsets)
    poses = add_ends(skeleton, rotations, translations, ends)
    del data, subjects, subject, frames, taken, segments, world, rotations, translations  # larger than the poses
    return settle_motion(
        path, "mvnx", *poses, clock,
        unit=unit, up=up, unit_in_file=1.0, up_in_file="z", notes=notes,
    )  # fmt: skip


def _compare_counts(path: str | os.PathLike[str], subject: ET.Element, found: int) -> tuple[Message, ...]:
    """Note declared numbers of segments and joints that are not there; MotionFileError for more segments than names."""
    notes: tuple[Message, ...] = ()
    joints = sum(1 for _ in _list_joints(subject))
    for node in (subject, *_children(subject, "frames")):
        for key, count in (("segmentCount", found), ("jointCount", joints)):
            said = node.get(key, "")
            if not said.isdecimal() or len(said) > 8 or not count:
                continue
            if key == "segmentCount" and int(said) > found:
                raise MotionFileError(path, "mvnx.segment_count", declared=int(said), found=found)
            notes += compare_points(int(said), count)
    return notes[:1]


def _list_frames(
    path: str | os.PathLike[str], subject: ET.Element
) -> tuple[list[ET.Element], list[ET.Element], tuple[Message, ...]]:
    """All frames, those that are no calibration, and a note about frames of another kind."""
    frames = [node for group in _children(subject, "frames") for node in _children(group, "frame")]
    taken = [frame for frame in frames if frame.get("type", "normal") == "normal"]
    if not taken:
        raise MotionFileError(path, "mvnx.no_frames")
    strange = [kind for frame in frames if (kind := frame.get("type", "normal")) not in ("normal", *_CALIBRATION)]
    return frames, taken, (Message("mvnx.frame_type", n=len(strange), found=strange[0][:40]),) if strange else ()


def _order_segments(
    path: str | os.PathLike[str], subject: ET.Element, names: tuple[str, ...]
) -> tuple[list[int], list[int], tuple[Message, ...]]:
    """Order and parents of the segments as of `order_tree`, and notes on joints of others.

    Raises
    ------
    MotionFileError : a segment with two parents, or one that is below itself.
    """
    parents: dict[str, str] = {}
    joints = [(above, below) for above, _, below in _list_joints(subject)]
    unknown = [name for joint in joints for name in joint if name not in names]
    for above, below in joints:
        if above in names and below in names and parents.setdefault(below, above) != above:
            raise MotionFileError(path, "mvnx.two_parents", segment=below, one=parents[below], other=above)
    for name in parents:
        above = name
        for _ in parents:
            above = parents.get(above, "")
        if above in parents:
            raise MotionFileError(path, "mvnx.circle", segment=above, parent=parents[above])
    notes = (Message("mvnx.unknown_segment", n=len(unknown), segment=unknown[0]),) if unknown else ()
    return *order_tree(names, _TREE | parents), notes


def _name(node: ET.Element) -> str:
    return node.tag.rpartition("}")[2] if isinstance(node.tag, str) else ""


def _has(frame: ET.Element, name: str) -> bool:
    return next(_children(frame, name), None) is not None


def _place_points(
    subject: ET.Element, segments: list[ET.Element], names: tuple[str, ...], order: list[int], parents: list[int]
) -> FloatArray | None:
    """(J, 3) places at rest by the points that the joints connect; None if some are missing."""
    connected = {below: point for _, point, below in _list_joints(subject)}
    places: FloatArray = np.zeros((len(order), 3))
    for place, index in enumerate(order):
        if parents[place] >= 0:
            point = _find_point(segments[order[parents[place]]], connected.get(names[index], ""))
            if point is None:
                return None
            places[place] = places[parents[place]] + point
    places[:, 2] -= places[:, 2].min()
    return places


def _place_mean(path: str | os.PathLike[str], names: tuple[str, ...]) -> FloatArray:
    """(J, 3) places of the segments of the mean body of SMPL, which stands as MVN's identity pose does, X to the front.

    MVN has five vertebrae from pelvis to neck; they are spread evenly.
    """
    body = mean_body(22)
    rest: FloatArray = np.zeros_like(body.offsets)
    for joint, parent in enumerate(body.parents):
        rest[joint] = body.offsets[joint] + (rest[parent] if parent >= 0 else 0.0)
    rest = (rest - rest[0])[:, [2, 0, 1]]
    at = dict(zip(body.names, rest, strict=True))
    trunk = ("Pelvis", "L5", "L3", "T12", "T8", "Neck")
    placed = {name: at["neck"] * number / (len(trunk) - 1) for number, name in enumerate(trunk)}
    placed |= {name: at[joint] for name, joint in _MEAN.items()}
    missing = [name for name in names if name not in placed]
    if missing:
        raise MotionFileError(path, "mvnx.no_lengths", names=tuple(missing[:10]))
    floor = np.array([0.0, 0.0, min(place[2] for place in placed.values())])
    return np.array([placed[name] - floor for name in names])


def _children(node: ET.Element, name: str) -> Iterator[ET.Element]:
    """Children of a name, in any namespace."""
    return (child for child in node if isinstance(child.tag, str) and child.tag.rpartition("}")[2] == name)


def _read_clock(subject: ET.Element, frames: list[ET.Element]) -> Clock:
    """The rate; ``index`` and ``time`` (ms from the start) of every frame."""
    numbers, times = (np.array([_number(frame.get(key, "")) for frame in frames]) for key in ("index", "time"))
    rate = subject.get("frameRate", "").strip()
    return Clock(_number(rate) if rate else None, times / 1000, numbers)


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
        rows.append(row)
    held = check_even(path, dict(enumerate(map(len, rows), 1)))
    if held < count * width:
        raise MotionFileError(path, "mvnx.count", name=name, expected=count * width, found=held)
    return np.array(rows)[:, : count * width].reshape(len(frames), count, width)  # props come after the body


def _list_joints(subject: ET.Element) -> Iterator[tuple[str, str, str]]:
    """Of every joint the segment above, the point of it that is the joint, and the segment below."""
    for group in _children(subject, "joints"):
        for joint in _children(group, "joint"):
            ends = [next(_children(joint, f"connector{side}"), None) for side in (1, 2)]
            above, below = ((node.text or "" if node is not None else "").partition("/")[::2] for node in ends)
            yield above[0].strip(), above[1].strip(), below[0].strip()


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
