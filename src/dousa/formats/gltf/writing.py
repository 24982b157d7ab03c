"""Writing of GLB: a skeleton with its animation and a mesh of bones for viewers, or into the file of a character.

A motion from a glTF file, or on a character of one, is written into that file: mesh, materials and nodes stay, its
animations are replaced.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import MotionWriteError
from dousa.files.disk import atomic_write
from dousa.formats.gltf.document import FLOAT, UINT, USHORT, pack_document
from dousa.formats.gltf.reading import GltfLayout
from dousa.formats.gltf.tree import JointTree
from dousa.formats.guard import EXACT, find_shift
from dousa.motion import Motion, compute_rest_positions
from dousa.motion.canonical.reference_frame import ReferenceFrame, from_reference_frame
from dousa.motion.rotations import conjugate, multiply, rotate


class _Buffer:
    """A binary buffer under construction, with its views and accessors."""

    def __init__(self, tree: dict[str, Any], data: bytes = b"") -> None:
        self.parts, self.size = [data], len(data)
        self.views: list[dict[str, Any]] = tree.setdefault("bufferViews", [])
        self.accessors: list[dict[str, Any]] = tree.setdefault("accessors", [])
        self.align()

    def align(self) -> None:
        rest = -self.size % 4
        if rest:
            self.parts.append(b"\0" * rest)
            self.size += rest

    def add(self, values: NDArray[Any], kind: str, component: int, *, target: int | None = None) -> int:
        """Add values and return the index of their accessor; floats of one or three columns get their bounds."""
        data = np.ascontiguousarray(values).tobytes()
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        self.parts.append(data)
        self.size += len(data)
        self.align()
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        if kind in ("SCALAR", "VEC3") and component == FLOAT:
            flat = values.reshape(len(values), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_glb(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion as GLB, in metres with Y up; missing values hold the value before them.

    Raises
    ------
    MotionWriteError : no pose at all of a joint, a disk error.
    """
    motion = _without_gaps(motion, path)
    layout = motion.provenance.layout if motion.provenance is not None else None
    if isinstance(layout, GltfLayout) and layout.tree.names == motion.skeleton.names:
        tree, buffer = _open_character(layout)
        _animate_character(motion, layout.tree, tree, buffer)
    else:
        tree = {"asset": {"version": "2.0", "generator": "dousa"}, "scene": 0}
        buffer = _Buffer(tree)
        roots = np.flatnonzero(motion.skeleton.parents < 0)
        shift = find_shift(motion.translations[:, roots], far=EXACT)
        if shift is not None:
            moved = motion.translations.copy()
            moved[:, roots] -= shift
            motion = motion.replace(translations=moved)
        _add_skeleton(motion, tree, buffer)
        if shift is not None:  # the numbers of JSON have 64 bits, those of an animation 32
            tree["nodes"].append(
                {"name": "place", "translation": shift.tolist(), "children": tree["scenes"][0]["nodes"]}
            )
            tree["scenes"] = [{"nodes": [len(tree["nodes"]) - 1]}]
        turns, moves = _continuous(motion.rotations), motion.translations
        moving: BoolArray = np.max(np.abs(moves - motion.skeleton.offsets), axis=(0, 2)) > 1e-6
        turning: BoolArray = np.logical_or(~motion.skeleton.end_sites, (np.abs(turns[..., 1:]) > 1e-7).any(axis=(0, 2)))
        _add_animation(motion, tree, buffer, list(range(motion.skeleton.n_joints)), (turns, turning), (moves, moving))
    tree["buffers"] = [{"byteLength": buffer.size}]
    with atomic_write(path) as file:
        file.write(pack_document(tree, b"".join(buffer.parts)))


def _without_gaps(motion: Motion, path: str | os.PathLike[str]) -> Motion:
    """Fill missing poses with the one before, those at the start with the first one."""
    if np.isfinite(motion.rotations.sum()) and np.isfinite(motion.translations.sum()):
        return motion
    filled = []
    for values in (motion.rotations, motion.translations):
        result = np.array(values)
        gone: BoolArray = np.isnan(values.sum(axis=2))
        if gone.all(axis=0).any():
            never = int(np.flatnonzero(gone.all(axis=0))[0])
            raise MotionWriteError(path, "gltf.never_seen", joint=motion.skeleton.names[never])
        for joint in np.flatnonzero(gone.any(axis=0)):
            seen = np.flatnonzero(~gone[:, joint])
            last = np.maximum(np.searchsorted(seen, np.arange(len(values)), side="right") - 1, 0)
            result[:, joint] = values[seen[last], joint]
        filled.append(result)
    return Motion(motion.skeleton, filled[0], filled[1], motion.frame_rate, motion.provenance)


def _continuous(rotations: FloatArray) -> FloatArray:
    """The same rotations (T, J, 4) with signs such that a viewer turns the short way."""
    flips = (rotations[1:] * rotations[:-1]).sum(axis=2) < 0
    signs = np.where(np.cumsum(flips, axis=0) % 2 == 1, -1.0, 1.0)
    result = np.array(rotations)
    result[1:] *= signs[..., None]
    return result


def _add_animation(
    motion: Motion,
    tree: dict[str, Any],
    buffer: _Buffer,
    nodes: list[int],
    turns: tuple[FloatArray, BoolArray],
    moves: tuple[FloatArray, BoolArray],
) -> None:
    times = buffer.add((np.arange(motion.n_frames) / motion.frame_rate).astype("<f4"), "SCALAR", FLOAT)
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    quaternions = turns[0][..., [1, 2, 3, 0]].astype("<f4")
    places = moves[0].astype("<f4")
    for joint, node in enumerate(nodes):
        for what, values, used in (("rotation", quaternions, turns[1]), ("translation", places, moves[1])):
            if used[joint]:
                output = buffer.add(values[:, joint], f"VEC{values.shape[2]}", FLOAT)
                channels.append({"sampler": len(samplers), "target": {"node": node, "path": what}})
                samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
    if not channels:  # nothing moves: a file without an animation would not be a motion
        channels.append({"sampler": 0, "target": {"node": nodes[0], "path": "rotation"}})
        samplers.append({"input": times, "output": buffer.add(quaternions[:, 0], "VEC4", FLOAT)})
    tree["animations"] = [{"name": "motion", "channels": channels, "samplers": samplers}]


def _add_skeleton(motion: Motion, tree: dict[str, Any], buffer: _Buffer) -> None:
    """Nodes of the joints, and a skinned mesh: a bone from every joint to each of its children."""
    skeleton = motion.skeleton
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(skeleton.names):
        node: dict[str, Any] = {"name": name, "translation": skeleton.offsets[joint].tolist()}
        children = np.flatnonzero(skeleton.parents == joint).tolist()
        if children:
            node["children"] = children
        nodes.append(node)
    roots = np.flatnonzero(skeleton.parents < 0).tolist()
    rest = compute_rest_positions(skeleton)
    # End sites carry nothing, which identifies them to a reader.
    bones = np.flatnonzero(~skeleton.end_sites | (skeleton.parents < 0))
    corners, faces, owners = _draw_bones(rest, skeleton.parents.tolist())
    normals = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    flat, flat_owners = corners[faces.reshape(-1)], owners[faces.reshape(-1)]
    attached = np.zeros((len(flat), 4), "<u2")
    attached[:, 0] = np.searchsorted(bones, flat_owners)
    weights = np.zeros((len(flat), 4), "<f4")
    weights[:, 0] = 1.0
    inverse = np.tile(np.eye(4), (len(bones), 1, 1))
    inverse[:, 3, :3] = -rest[bones]  # columns first
    vertices = 34962
    attributes = {
        "POSITION": buffer.add(flat.astype("<f4"), "VEC3", FLOAT, target=vertices),
        "NORMAL": buffer.add(np.repeat(normals, 3, axis=0).astype("<f4"), "VEC3", FLOAT, target=vertices),
        "JOINTS_0": buffer.add(attached, "VEC4", USHORT, target=vertices),
        "WEIGHTS_0": buffer.add(weights, "VEC4", FLOAT, target=vertices),
    }
    indices = buffer.add(np.arange(len(flat), dtype="<u4"), "SCALAR", UINT, target=34963)
    matrices = buffer.add(inverse.reshape(-1, 16).astype("<f4"), "MAT4", FLOAT)
    material = {"pbrMetallicRoughness": {"baseColorFactor": [0.55, 0.65, 0.8, 1.0], "metallicFactor": 0.0}}
    tree["materials"] = [{"name": "bones", **material}]
    tree["meshes"] = [{"name": "bones", "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}]
    tree["skins"] = [{"joints": bones.tolist(), "inverseBindMatrices": matrices}]
    nodes.append({"name": "bones", "mesh": 0, "skin": 0})
    tree["nodes"] = nodes
    tree["scenes"] = [{"nodes": [*roots, len(nodes) - 1]}]


def _draw_bones(
    rest: FloatArray, parents: list[int], thickness: float = 0.12, widest: float = 0.03
) -> tuple[FloatArray, NDArray[Any], NDArray[Any]]:
    """Corners (C, 3), triangles (F, 3) and the joint (C,) that carries each corner: an octahedron per bone.

    ``thickness`` : of a bone, as a share of its length; at most ``widest`` m.
    """
    corners: list[FloatArray] = []
    faces: list[tuple[int, int, int]] = []
    owners: list[int] = []
    bones = [(parent, rest[parent], rest[joint]) for joint, parent in enumerate(parents) if parent >= 0]
    bones = [bone for bone in bones if np.linalg.norm(bone[2] - bone[1]) > 1e-4]
    if not bones:
        up = np.array([0.0, 0.04, 0.0])
        bones = [(joint, place - up, place + up) for joint, place in enumerate(rest)]
    for joint, start, end in bones:
        axis = end - start
        length = float(np.linalg.norm(axis))
        helper = np.eye(3)[np.argmin(np.abs(axis))]
        side = np.cross(axis, helper)
        side *= min(thickness * length, widest) / np.linalg.norm(side)
        other = np.cross(axis / length, side)
        waist = start + 0.15 * axis
        first = 6 * len(owners)
        corners += [start, waist + side, waist + other, waist - side, waist - other, end]
        owners.append(joint)
        for k in range(4):
            a, b = 1 + k, 1 + (k + 1) % 4
            faces += [(first, first + b, first + a), (first + 5, first + a, first + b)]
    return np.array(corners), np.array(faces), np.repeat(owners, 6)


def _open_character(layout: GltfLayout) -> tuple[dict[str, Any], _Buffer]:
    """The file's own JSON with all buffers in one and no animation."""
    document = layout.document
    tree = {key: value for key, value in document.tree.items() if key not in ("animations", "buffers")}
    starts, joined = [], b""
    for number, data in enumerate(document.buffers):
        if data is None:
            raise document.fail("gltf.extension", name=next(iter(document.items("buffers")[number]["extensions"])))
        starts.append(len(joined))
        joined += data + b"\0" * (-len(data) % 4)
    views = []
    for view in document.items("bufferViews"):
        number = view.get("buffer", 0)
        views.append({**view, "buffer": 0, "byteOffset": starts[number] + view.get("byteOffset", 0)})
    tree["bufferViews"], tree["accessors"] = views, list(document.items("accessors"))
    return tree, _Buffer(tree, joined)


def _animate_character(motion: Motion, joints: JointTree, tree: dict[str, Any], buffer: _Buffer) -> None:
    """Turn the motion into the unit and the axes of each node."""
    source = motion.provenance
    frame = ReferenceFrame(unit=source.unit, up=source.up) if source is not None else ReferenceFrame()
    own = from_reference_frame(motion, frame)
    turns, moves = np.empty_like(own.rotations), np.empty_like(own.translations)
    for joint, parent in enumerate(joints.parents):
        turn, move = multiply(own.rotations[:, joint], joints.rest[joint]), own.translations[:, joint]
        if parent >= 0:
            back = conjugate(joints.rest[parent])
            turn, move = multiply(back, turn), rotate(back, move)
        elif joint in joints.above:
            above = joints.above[joint]
            back = conjugate(above[3:])
            turn, move = multiply(back, turn), rotate(back, move - above[:3])
        turns[:, joint], moves[:, joint] = turn, move / joints.scales[joint]
    offsets = np.array([_place_of(tree["nodes"][node]) for node in joints.nodes])
    moving: BoolArray = (np.abs(moves - offsets) > 1e-5 * max(1.0, float(np.abs(offsets).max()))).any(axis=(0, 2))
    for node in joints.nodes:  # an animated node must not have a matrix
        if "matrix" in tree["nodes"][node]:
            tree["nodes"] = list(tree["nodes"])
            tree["nodes"][node] = {key: value for key, value in tree["nodes"][node].items() if key != "matrix"}
            moving[joints.nodes.index(node)] = True
    every: BoolArray = np.ones(len(joints.nodes), bool)
    _add_animation(motion, tree, buffer, joints.nodes, (_continuous(turns), every), (moves, moving))


def _place_of(node: dict[str, Any]) -> list[float]:
    return [float(value) for value in node.get("translation", [0.0, 0.0, 0.0])]
