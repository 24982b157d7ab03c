"""Writing of BVH: the file's own numbers where the motion still has them, else new angles and positions."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import MotionWriteError
from dousa.files.disk import atomic_write
from dousa.formats.bvh.reading import CHANNEL_NAMES, BvhLayout
from dousa.motion.canonical.reference_frame import ReferenceFrame, from_reference_frame
from dousa.motion.rotations import to_euler, unwrap_euler
from dousa.motion.types import Motion, Skeleton

_DEFAULT_TURNS = ("Zrotation", "Xrotation", "Yrotation")


@dataclass(frozen=True, slots=True, eq=False)
class _Content:
    """Content of the file: joints in the order of the file, in its unit and axes."""

    skeleton: Skeleton
    order: list[int]
    channels: list[tuple[str, ...]]
    values: FloatArray
    frame_time: str
    encoding: str


def write_bvh(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion as BVH.

    An unchanged motion from BVH is written with its own names, channels, offsets and values. A changed one keeps its
    channel order, unit and up axis as far as they can hold it. Any other is written in centimetres, Y up, six channels
    for the root, three for the other joints, six where a joint moves against its parent. Angles are continuous.

    Raises
    ------
    MotionWriteError : a joint name that BVH cannot hold, or a disk error.
    """
    content = _kept_content(motion) or _made_content(motion)
    lines = _hierarchy_lines(content, path)
    lines += ["MOTION", f"Frames: {len(content.values)}", f"Frame Time: {content.frame_time}"]
    head = "\n".join(lines) + "\n"
    try:
        encoded = head.encode(content.encoding)
    except UnicodeEncodeError:
        encoded = head.encode("utf-8", "surrogatepass")
    with atomic_write(path) as file:
        file.write(encoded)
        for start in range(0, len(content.values), 256):
            rows = content.values[start : start + 256].tolist()
            # repr is the shortest text that reads back as the same number.
            file.write("".join([" ".join(map(repr, row)) + "\n" for row in rows]).encode("ascii"))


def _layout_of(motion: Motion) -> BvhLayout | None:
    """Layout of the BVH file of the motion, if its joints are still the same."""
    layout = motion.provenance.layout if motion.provenance is not None else None
    if not isinstance(layout, BvhLayout) or len(layout.channels) != motion.skeleton.n_joints:
        return None
    if any(names for names, end in zip(layout.channels, motion.skeleton.end_sites, strict=True) if end):
        return None
    return layout


def _kept_content(motion: Motion) -> _Content | None:
    layout, skeleton = _layout_of(motion), motion.skeleton
    if layout is None or motion.provenance is None or _depth_first(skeleton) != [*range(skeleton.n_joints)]:
        return None
    values = motion.provenance.values_of(skeleton.offsets, motion.rotations, motion.translations)
    if values is None:
        return None
    in_file = Skeleton(skeleton.names, skeleton.parents, np.array(layout.offsets), skeleton.end_sites)
    order = list(range(skeleton.n_joints))
    return _Content(in_file, order, list(layout.channels), values, _frame_time(motion), layout.encoding)


def _made_content(motion: Motion) -> _Content:
    layout, frame = _layout_of(motion), ReferenceFrame(unit=0.01)
    if layout is not None and motion.provenance is not None:
        frame = ReferenceFrame(unit=motion.provenance.unit, up=motion.provenance.up)
    in_file = from_reference_frame(motion, frame)
    order = _depth_first(motion.skeleton)
    positions = _position_channels(in_file, layout, 1e-6 / frame.unit)
    turns, angles = _rotation_channels(in_file, layout)
    channels: list[tuple[str, ...]] = [()] * len(order)
    columns = []
    for joint in order:
        channels[joint] = _combine(positions[joint], turns[joint], layout.channels[joint] if layout else ())
        for name in channels[joint]:
            if name in positions[joint]:
                columns.append(in_file.translations[:, joint, CHANNEL_NAMES.index(name)])
            else:
                columns.append(np.degrees(angles[:, joint, turns[joint].index(name)]))
    values = np.stack(columns, axis=1)
    encoding = layout.encoding if layout else "utf-8"
    return _Content(in_file.skeleton, order, channels, values, _frame_time(motion), encoding)


def _combine(positions: tuple[str, ...], turns: tuple[str, ...], wanted: tuple[str, ...]) -> tuple[str, ...]:
    """The wanted order if it holds the same channels, else positions before rotations."""
    return wanted if sorted(wanted) == sorted(positions + turns) else positions + turns


def _depth_first(skeleton: Skeleton) -> list[int]:
    children: list[list[int]] = [[] for _ in skeleton.names]
    roots: list[int] = []
    for joint, parent in enumerate(skeleton.parents.tolist()):
        (children[parent] if parent >= 0 else roots).append(joint)
    order, waiting = [], roots[::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += children[order[-1]][::-1]
    return order


def _position_channels(motion: Motion, layout: BvhLayout | None, tolerance: float) -> list[tuple[str, ...]]:
    """Per joint the position channels it needs: those of the layout, all three where these do not suffice."""
    still: BoolArray = np.abs(motion.translations - motion.skeleton.offsets) <= tolerance  # false for NaN
    moving: BoolArray = np.logical_not(still.all(axis=0))
    result = []
    for joint, parent in enumerate(motion.skeleton.parents):
        names = tuple(n for n in layout.channels[joint] if n in CHANNEL_NAMES[:3]) if layout else ()
        if layout is None and parent < 0:
            names = CHANNEL_NAMES[:3]
        if any(moving[joint, axis] and CHANNEL_NAMES[axis] not in names for axis in range(3)):
            names = CHANNEL_NAMES[:3]
        result.append(names)
    return result


def _rotation_channels(motion: Motion, layout: BvhLayout | None) -> tuple[list[tuple[str, ...]], FloatArray]:
    """Per joint the rotation channels and (T, J, 3) their angles in rad, those of missing channels 0."""
    skeleton = motion.skeleton
    ends = _plain_ends(motion)
    turns: list[tuple[str, ...]] = [() if end else _DEFAULT_TURNS for end in ends]
    if layout is not None:
        for joint in np.flatnonzero(~ends):
            names = tuple(name for name in layout.channels[joint] if name in CHANNEL_NAMES[3:])
            # An order such as ZXZ is read, but not made.
            turns[joint] = names if len(set(names)) == len(names) else _DEFAULT_TURNS
    angles = np.zeros((motion.n_frames, skeleton.n_joints, 3))
    for joint in np.flatnonzero(~ends):
        if len(turns[joint]) < 3:
            found = _few_angles(motion.rotations[:, joint], turns[joint])
            if found is None:
                turns[joint] = _DEFAULT_TURNS
            else:
                angles[:, joint, : len(turns[joint])] = found
    for names in {names for names in turns if len(names) == 3}:
        joints = [joint for joint, other in enumerate(turns) if other == names]
        angles[:, joints] = unwrap_euler(to_euler(motion.rotations[:, joints], _letters(names)))
    return turns, angles


def _plain_ends(motion: Motion, same: float = 1e-6) -> BoolArray:
    """(J,) end sites that can be written as such: no child, no rotation, no motion of their own.

    ``same`` : rad, and share of the longest offset, that do not count.
    """
    skeleton = motion.skeleton
    plain = skeleton.end_sites & (skeleton.parents >= 0)
    plain[skeleton.parents[skeleton.parents >= 0]] = False
    for joint in np.flatnonzero(plain):
        unturned = np.abs(motion.rotations[:, joint, 1:]).max() <= same
        length = np.abs(skeleton.offsets).max()
        still = np.abs(motion.translations[:, joint] - skeleton.offsets[joint]).max() <= same * length
        plain[joint] = unturned and still
    return plain


def _letters(names: tuple[str, ...]) -> str:
    return "".join(name[0] for name in names)


def _few_angles(rotations: FloatArray, names: tuple[str, ...], same: float = 1e-6) -> FloatArray | None:
    """(T, k) angles about fewer than three axes, continuous; None if the rest is more than ``same`` rad."""
    letters = _letters(names)
    full = letters + "".join(axis for axis in "XYZ" if axis not in letters)
    first = to_euler(rotations, full)
    second = np.stack((first[:, 0] + np.pi, np.pi - first[:, 1], first[:, 2] + np.pi), axis=-1)
    missing = slice(len(names), None)
    rest = [np.abs(np.remainder(a[:, missing] + np.pi, 2 * np.pi) - np.pi).sum(axis=-1) for a in (first, second)]
    if (np.minimum(*rest) > same).any():
        return None
    angles: FloatArray = np.where((rest[1] < rest[0])[:, None], second, first)[:, : len(names)]
    for column in angles.T:
        seen = ~np.isnan(column)
        column[seen] = np.unwrap(column[seen])
    return angles


def _frame_time(motion: Motion) -> str:
    layout = motion.provenance.layout if motion.provenance is not None else None
    if isinstance(layout, BvhLayout) and layout.frame_rate == motion.frame_rate:
        return layout.frame_time
    return repr(1.0 / motion.frame_rate)


def _hierarchy_lines(content: _Content, path: str | os.PathLike[str]) -> list[str]:
    skeleton = content.skeleton
    lines = ["HIERARCHY"]
    open_joints: list[int] = []
    has_child = np.zeros(skeleton.n_joints, bool)
    has_child[skeleton.parents[skeleton.parents >= 0]] = True
    for joint in content.order:
        parent = int(skeleton.parents[joint])
        while open_joints and open_joints[-1] != parent:
            open_joints.pop()
            lines.append(_indent(len(open_joints)) + "}")
        is_end = skeleton.end_sites[joint] and not content.channels[joint] and not has_child[joint] and parent >= 0
        depth, inner = _indent(len(open_joints)), _indent(len(open_joints) + 1)
        title = (
            "End Site" if is_end else f"{'JOINT' if parent >= 0 else 'ROOT'} {_checked(skeleton.names[joint], path)}"
        )
        offset = " ".join(map(repr, skeleton.offsets[joint].tolist()))
        lines += [depth + title, depth + "{", f"{inner}OFFSET {offset}"]
        if not is_end:
            names = content.channels[joint]
            lines.append(" ".join((f"{inner}CHANNELS {len(names)}", *names)))
        open_joints.append(joint)
    return lines + [_indent(depth) + "}" for depth in range(len(open_joints) - 1, -1, -1)]


def _indent(depth: int) -> str:
    return "\t" * min(depth, 64)  # deeper ones would make the file grow with the square of the depth


def _checked(name: str, path: str | os.PathLike[str]) -> str:
    if not name.strip() or name != name.strip() or any(sign in name for sign in "{}\r\n"):
        raise MotionWriteError(path, "bvh.joint_name", name=name)
    return name
