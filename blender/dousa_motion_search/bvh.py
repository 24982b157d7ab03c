# SPDX-License-Identifier: GPL-3.0-or-later
"""Armatures as BVH and back, with numpy and mathutils alone.

A BVH rotation is that of a bone against its parent in world axes at rest. With the rest rotation M of a bone it is
B = M Q M^-1, where Q is the rotation that the bone is posed by: so a motion that dousa gave the character's own
skeleton becomes key frames without any fitting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from mathutils import Euler, Matrix, Quaternion, Vector

_CENTIMETRES = 100.0
_CHANNELS = "Zrotation Xrotation Yrotation"
_Y_UP = Matrix(((1, 0, 0), (0, 0, 1), (0, -1, 0)))  # Blender's z is up, that of BVH is y


class BvhError(Exception):
    """One sentence for the person."""


@dataclass(frozen=True)
class Joint:
    """A bone in a BVH file; children follow their parents.

    bone: its name in Blender, nothing for the joint that joins several roots; name: in the file; parent: index of a
    joint or -1; head, tail: world at rest, cm, y up; rest: (3, 3) world rotation at rest, y up.
    """

    bone: str
    name: str
    parent: int
    head: Vector
    tail: Vector
    rest: Matrix


def read_skeleton(armature) -> list[Joint]:
    """The bones that carry the character: those that deform, and what they hang on; all, where none deforms."""
    bones = armature.data.bones
    if not bones:
        raise BvhError(f"{armature.name} has no bones.")
    wanted = {bone.name for bone in bones if bone.use_deform} or {bone.name for bone in bones}
    for name in list(wanted):
        wanted.update(parent.name for parent in bones[name].parent_recursive)
    roots = [bone for bone in bones if bone.name in wanted and bone.parent is None]
    unit, rotation = _world(armature)
    joints: list[Joint] = []
    if len(roots) > 1:
        joints.append(Joint("", "all_roots", -1, Vector(), Vector((0, 1, 0)), Matrix.Identity(3)))
    taken = {joint.name for joint in joints}
    stack = [(bone, 0 if joints else -1) for bone in reversed(roots)]
    while stack:
        bone, parent = stack.pop()
        name = _name(bone.name, taken)
        head, tail = (unit @ armature.matrix_world @ place for place in (bone.head_local, bone.tail_local))
        rest = _Y_UP @ rotation @ bone.matrix_local.to_quaternion().to_matrix()
        joints.append(Joint(bone.name, name, parent, head, tail, rest))
        stack.extend((child, len(joints) - 1) for child in reversed(bone.children) if child.name in wanted)
    return joints


def _name(bone: str, taken: set[str]) -> str:
    """One word, unlike all others."""
    stem = "_".join(bone.split()) or "bone"
    name, number = stem, 2
    while name in taken:
        name, number = f"{stem}_{number}", number + 1
    taken.add(name)
    return name


def _world(armature) -> tuple[Matrix, Matrix]:
    """From the world of Blender to centimetres with y up; and the rotation of the armature in its world."""
    import bpy

    scale = bpy.context.scene.unit_settings.scale_length * _CENTIMETRES
    return (_Y_UP * scale).to_4x4(), armature.matrix_world.to_quaternion().to_matrix()


def write_bvh(joints: list[Joint], rotations: np.ndarray, roots: np.ndarray, frame_time: float) -> str:
    """The text of a BVH file.

    rotations: (n, joints, 3) degrees about Z, X, Y; roots: (n, 3) cm, where the first joint is.
    """
    children: list[list[int]] = [[] for _ in joints]
    for index, joint in enumerate(joints):
        if joint.parent >= 0:
            children[joint.parent].append(index)
    lines = ["HIERARCHY"]
    order: list[int] = []

    def add(index: int, depth: int) -> None:
        joint, pad = joints[index], "\t" * depth
        start = joints[joint.parent].head if joint.parent >= 0 else joint.head
        lines.append(f"{pad}{'JOINT' if joint.parent >= 0 else 'ROOT'} {joint.name}")
        lines.append(f"{pad}{{")
        lines.append(f"{pad}\tOFFSET {_numbers(joint.head - start)}")
        place = "" if joint.parent >= 0 else "Xposition Yposition Zposition "
        lines.append(f"{pad}\tCHANNELS {3 if joint.parent >= 0 else 6} {place}{_CHANNELS}")
        order.append(index)
        for child in children[index]:
            add(child, depth + 1)
        if not children[index]:
            lines.extend((f"{pad}\tEnd Site", f"{pad}\t{{"))
            lines.extend((f"{pad}\t\tOFFSET {_numbers(joint.tail - joint.head)}", f"{pad}\t}}"))
        lines.append(f"{pad}}}")

    add(0, 0)
    lines += ["MOTION", f"Frames: {len(rotations)}", f"Frame Time: {frame_time:.8f}"]
    table = np.concatenate([roots, rotations[:, order].reshape(len(rotations), -1)], axis=1)
    lines += [" ".join(f"{value:.6f}" for value in row) for row in table]
    return "\n".join(lines) + "\n"


def _numbers(vector: Vector) -> str:
    return " ".join(f"{value:.6f}" for value in vector)


def record(armature, first: int, last: int) -> str:
    """What an armature does from one frame to another, as BVH."""
    import bpy

    scene = bpy.context.scene
    joints = read_skeleton(armature)
    before = scene.frame_current, scene.frame_subframe
    rotations = np.zeros((last - first + 1, len(joints), 3))
    roots = np.zeros((len(rotations), 3))
    try:
        for row in range(len(rotations)):
            scene.frame_set(first + row)
            posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
            rotations[row], roots[row] = _read_pose(posed, joints)
    finally:
        scene.frame_set(before[0], subframe=before[1])
    return write_bvh(joints, rotations, roots, scene.render.fps_base / scene.render.fps)


def _read_pose(posed, joints: list[Joint]) -> tuple[np.ndarray, Vector]:
    unit, turn = _world(posed)
    turned: list[Matrix] = []
    angles = np.zeros((len(joints), 3))
    root = Vector()
    for index, joint in enumerate(joints):
        if joint.bone:
            bone = posed.pose.bones[joint.bone]
            world = _Y_UP @ turn @ bone.matrix.to_quaternion().to_matrix()
            turned.append(world @ joint.rest.transposed())
            if joint.parent < 0:
                root = unit @ posed.matrix_world @ bone.head
        else:
            turned.append(Matrix.Identity(3))
        parent = turned[joint.parent].transposed() if joint.parent >= 0 else Matrix.Identity(3)
        # Euler angles about fixed axes, the last named first: R = Rz Rx Ry.
        about = (parent @ turned[index]).to_euler("YXZ")
        angles[index] = [math.degrees(about.z), math.degrees(about.x), math.degrees(about.y)]
    return angles, root


def rest_bvh(armature) -> str:
    """The character at rest, as a BVH of two frames."""
    joints = read_skeleton(armature)
    return write_bvh(joints, np.zeros((2, len(joints), 3)), np.array([joints[0].head] * 2), 1 / 30)


@dataclass(frozen=True)
class Recording:
    """A BVH file that was read: names (joints), rotations (n, joints) quaternions, roots (n, 3) cm, frame_time s."""

    names: list[str]
    rotations: list[list[Quaternion]]
    roots: list[Vector]
    frame_time: float


def read_bvh(text: str) -> Recording:
    """Names and rotations of a file that dousa wrote."""
    names: list[str] = []
    channels: list[list[str]] = []
    lines = iter(text.splitlines())
    for line in lines:
        words = line.split()
        if not words:
            continue
        if words[0] in ("ROOT", "JOINT"):
            names.append(" ".join(words[1:]))
        elif words[0] == "CHANNELS":
            channels.append([word.lower() for word in words[2:]])
        elif words[0] == "MOTION":
            break
    n_frames = int(next(lines).split()[-1])
    frame_time = float(next(lines).split()[-1])
    table = np.array([line.split() for line in lines if line.strip()], float)
    if len(table) != n_frames or table.shape[1] != sum(map(len, channels)):
        raise BvhError("dousa's answer is no whole BVH file.")
    starts = np.cumsum([0, *map(len, channels)])
    rotations = [
        [_rotation(row[start:], own) for start, own in zip(starts[:-1], channels, strict=True)] for row in table
    ]
    axes = [channels[0].index(f"{axis}position") for axis in "xyz"]
    return Recording(names, rotations, [Vector(row[axes]) for row in table], frame_time)


def _rotation(row: np.ndarray, channels: list[str]) -> Quaternion:
    """Of a row that begins with the values of a joint's channels."""
    total = Quaternion()
    for value, channel in zip(row[: len(channels)], channels, strict=True):
        if channel.endswith("rotation"):
            angles = [0.0, 0.0, 0.0]
            angles["xyz".index(channel[0])] = math.radians(value)
            total = total @ Euler(angles).to_quaternion()
    return total


def apply(armature, recording: Recording, name: str, first: int) -> tuple[int, int]:
    """Key frames of a new action on an armature whose skeleton the recording has; its first and last frame.

    The action before it is kept in the file. Bones that the recording lacks stay as they are.
    """
    import bpy

    joints = {joint.name: joint for joint in read_skeleton(armature)}
    known = [(index, joints[found]) for index, found in enumerate(recording.names) if found in joints]
    if not any(joint.bone for _, joint in known):
        raise BvhError(f"No bone of {armature.name} is in dousa's answer.")
    scene = bpy.context.scene
    step = recording.frame_time * scene.render.fps / scene.render.fps_base
    if armature.animation_data is None:
        armature.animation_data_create()
    if armature.animation_data.action is not None:
        armature.animation_data.action.use_fake_user = True
    armature.animation_data.action = bpy.data.actions.new(name)
    for index, joint in known:
        if joint.bone:
            _key_rotation(armature.pose.bones[joint.bone], joint, recording, index, first, step)
    _key_root(armature, next(joint for _, joint in known if joint.bone), recording, first, step)
    return first, first + round((len(recording.roots) - 1) * step)


def _key_rotation(bone, joint: Joint, recording: Recording, index: int, first: int, step: float) -> None:
    rest = joint.rest.to_quaternion()
    back = rest.conjugated()
    bone.rotation_mode = "QUATERNION"
    last = None
    for row, rotations in enumerate(recording.rotations):
        posed = back @ rotations[index] @ rest
        if last is not None:
            posed.make_compatible(last)
        last = posed
        bone.rotation_quaternion = posed
        bone.keyframe_insert("rotation_quaternion", frame=first + row * step)


def _key_root(armature, joint: Joint, recording: Recording, first: int, step: float) -> None:
    """Where the body is: the first bone's place. A joint that only joins several roots has none of its own."""
    unit, _ = _world(armature)
    bone = armature.pose.bones[joint.bone]
    to_armature = (unit @ armature.matrix_world).inverted()
    own = bone.bone.matrix_local.to_quaternion().conjugated()
    start = recording.roots[0] if joint.parent >= 0 else None
    for row, root in enumerate(recording.roots):
        place = root if start is None else joint.head + (root - start)
        bone.location = own @ (to_armature @ place - bone.bone.head_local)
        bone.keyframe_insert("location", frame=first + row * step)
