"""Joints of a glTF file, their rest pose, and their names in the humanoid extensions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.formats.gltf.document import GltfDocument
from dousa.formats.guard.people import split_trees
from dousa.motion.rotations import conjugate, from_matrix, multiply, normalise, rotate


@dataclass(frozen=True, slots=True)
class Nodes:
    """All nodes, parents before children.

    Parameters
    ----------
    order : index in the file.
    parents : place of the parent in ``order``, -1 for a root.
    translations, rotations, scales : of the file, (N, 3), (N, 4) w x y z, (N, 3).
    """

    order: list[int]
    parents: list[int]
    translations: FloatArray
    rotations: FloatArray
    scales: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class JointTree:
    """The joints of a file: those of its skins, animated nodes, and the nodes between.

    Parameters
    ----------
    nodes : (J,) index in the file.
    names : (J,) unique; where there are several people, each is one's own.
    parents : (J,) parent before child.
    offsets : (J, 3) in the axes of the scene at rest; that of a root is its place.
    end_sites : (J,) leaves that nothing is attached to and that are not animated.
    rest : (J, 4) orientation of the node in the scene at rest.
    scales : (J, 3) by which a translation of the node is longer in the scene.
    above : per root of the tree the pose (7,) of its parent in the scene: place, then w x y z.
    """

    nodes: list[int]
    names: tuple[str, ...]
    parents: list[int]
    offsets: FloatArray
    end_sites: list[bool]
    rest: FloatArray
    scales: FloatArray
    above: dict[int, FloatArray]

    def take(self, joints: list[int]) -> JointTree:
        """Return these joints alone, whole trees of them."""
        place = {joint: number for number, joint in enumerate(joints)}
        return JointTree(
            [self.nodes[joint] for joint in joints],
            tuple(self.names[joint] for joint in joints),
            [place.get(self.parents[joint], -1) for joint in joints],
            self.offsets[joints],
            [self.end_sites[joint] for joint in joints],
            self.rest[joints],
            self.scales[joints],
            {place[joint]: pose for joint, pose in self.above.items() if joint in place},
        )


def list_nodes(document: GltfDocument) -> Nodes:
    """List the nodes in the order of their tree; MotionFileError for a node with two parents or an invalid pose."""
    nodes = document.items("nodes")
    parent = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        children = node.get("children", [])
        for child in children if isinstance(children, list) else []:
            document.item("nodes", child)
            if parent[child] >= 0 or child == index:
                raise document.fail("gltf.tree")
            parent[child] = index
    children_of: dict[int, list[int]] = {}
    for index, above in enumerate(parent):
        children_of.setdefault(above, []).append(index)
    order: list[int] = []
    waiting = children_of.get(-1, [])[::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += children_of.get(order[-1], [])[::-1]
    if len(order) != len(nodes):
        raise document.fail("gltf.tree")
    place = {index: number for number, index in enumerate(order)}
    poses = [_read_pose(document, nodes[index]) for index in order]
    parts = [np.array([pose[part] for pose in poses]).reshape(len(order), -1) for part in range(3)]
    return Nodes(order, [place.get(parent[index], -1) for index in order], parts[0], parts[1], parts[2])


def _read_pose(document: GltfDocument, node: dict[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    if "matrix" in node:
        matrix = _vector(document, node["matrix"], 16).reshape(4, 4).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if (scale < 1e-12).any():
            raise document.fail("gltf.pose")
        turn = matrix[:3, :3] / scale
        if np.linalg.det(turn) < 0:
            turn, scale = -turn, -scale
        return matrix[:3, 3], from_matrix(turn), scale
    turn = _vector(document, node.get("rotation", [0, 0, 0, 1]), 4)
    if not 1e-6 < np.linalg.norm(turn) < 1e6:
        raise document.fail("gltf.pose")
    scale = _vector(document, node.get("scale", [1, 1, 1]), 3)
    return _vector(document, node.get("translation", [0, 0, 0]), 3), normalise(turn[[3, 0, 1, 2]]), scale


def _vector(document: GltfDocument, values: object, length: int) -> FloatArray:
    try:
        vector = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        vector = np.empty(0)
    if vector.shape != (length,) or not np.isfinite(vector).all() or np.abs(vector).max() > 1e12:
        raise document.fail("gltf.pose")
    return vector


def build_tree(document: GltfDocument, animated: set[int]) -> JointTree:
    """Build the joints of a file with the nodes that an animation turns or moves.

    MotionFileError if there is neither a skin nor anything animated.
    """
    nodes = list_nodes(document)
    skinned = {joint for skin in document.items("skins") for joint in _skin_joints(document, skin)}
    members = _choose_members(document, nodes, skinned, animated)
    places = [number for number, index in enumerate(nodes.order) if index in members]
    if not places:
        raise document.fail("gltf.no_joints")
    world, rotations, scales = _compose(nodes)
    positions = world
    bound = _bind_pose(document, nodes, positions)
    if bound is not None:
        positions, rotations = bound[0], np.where(np.isnan(bound[1]), rotations, bound[1])
    joint_of = {number: joint for joint, number in enumerate(places)}
    parents = [joint_of.get(nodes.parents[number], -1) for number in places]
    offsets = positions[places].copy()
    above = {}
    for joint, number in enumerate(places):
        if parents[joint] >= 0:
            offsets[joint] -= positions[places[parents[joint]]]
        elif nodes.parents[number] >= 0:
            up = nodes.parents[number]
            above[joint] = np.concatenate((world[up], _compose(nodes)[1][up]))
    grown = np.array([scales[nodes.parents[n]] if nodes.parents[n] >= 0 else np.ones(3) for n in places])
    has_child = set(parents)
    raw = document.items("nodes")
    ends = [
        joint not in has_child and nodes.order[number] not in skinned | animated and parents[joint] >= 0
        for joint, number in enumerate(places)
    ]
    human = _humanoid_names(document)
    named = [
        human.get(nodes.order[n]) or str(raw[nodes.order[n]].get("name") or f"node{nodes.order[n]}") for n in places
    ]
    trees = split_trees(named, parents)
    owners = {int(joint): owner for owner, joints in trees.items() for joint in joints}
    names = _unique(named, [owners.get(joint, "") for joint in range(len(places))])
    return JointTree([nodes.order[n] for n in places], names, parents, offsets, ends, rotations[places], grown, above)


def _skin_joints(document: GltfDocument, skin: dict[str, Any]) -> list[int]:
    joints = skin.get("joints", [])
    if not isinstance(joints, list):
        raise document.fail("gltf.list", name="joints")
    for joint in joints:
        document.item("nodes", joint)
    return joints


def _choose_members(document: GltfDocument, nodes: Nodes, skinned: set[int], animated: set[int]) -> set[int]:
    """Nodes that become joints: skinned, else animated; nodes between; animated ones above; tips below."""
    core = skinned or animated
    raw = document.items("nodes")
    keep = [index in core for index in nodes.order]
    # Upwards: nodes with joints below that are joints, are animated, or lie below one of these.
    below = list(keep)
    for number in range(len(keep) - 1, -1, -1):
        if below[number] and nodes.parents[number] >= 0:
            below[nodes.parents[number]] = True
    inside = [False] * len(keep)
    for number, index in enumerate(nodes.order):
        parent = nodes.parents[number]
        inside[number] = (parent >= 0 and inside[parent]) or (below[number] and (keep[number] or index in animated))
    return {
        index
        for number, index in enumerate(nodes.order)
        if inside[number] and (below[number] or not {"mesh", "camera"} & raw[index].keys())
    }


def _compose(nodes: Nodes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (N, 3), orientations (N, 4) and scales (N, 3) in the scene of nodes as the file has them."""
    positions, rotations, scales = (np.array(a) for a in (nodes.translations, nodes.rotations, nodes.scales))
    for number, parent in enumerate(nodes.parents):
        if parent >= 0:
            positions[number] = positions[parent] + rotate(rotations[parent], scales[parent] * positions[number])
            rotations[number] = multiply(rotations[parent], rotations[number])
            scales[number] = scales[parent] * scales[number]
    return positions, rotations, scales


def _bind_pose(
    document: GltfDocument, nodes: Nodes, positions: FloatArray, same_length: float = 0.01
) -> tuple[FloatArray, FloatArray] | None:
    """Places and orientations (NaN: as the parent's) in the pose in which the skins were attached.

    Nodes often stand in the first frame of an animation; the skin has the rest pose. None where its bones differ from
    those of the nodes by more than the share ``same_length``: then the skin was attached in other units.
    """
    place_of = {index: number for number, index in enumerate(nodes.order)}
    bound: dict[int, FloatArray] = {}
    for skin in document.items("skins"):
        if "inverseBindMatrices" not in skin:
            return None
        joints, matrices = _skin_joints(document, skin), document.numbers(skin["inverseBindMatrices"])
        if matrices.shape[1:] != (16,) or len(matrices) < len(joints):
            raise document.fail("gltf.skin")
        for joint, matrix in zip(joints, matrices, strict=False):
            turned = matrix.reshape(4, 4).T
            if abs(np.linalg.det(turned)) > 1e-12:
                bound.setdefault(place_of[joint], np.linalg.inv(turned))
    if not bound:
        return None
    _, standing, _ = _compose(nodes)
    at, turns = positions.copy(), np.full((len(positions), 4), np.nan)
    for number in range(len(positions)):
        parent = nodes.parents[number]
        if number in bound:
            matrix = bound[number]
            axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-12)
            if np.linalg.det(axes) < 0.5:
                return None
            at[number], turns[number] = matrix[:3, 3], from_matrix(axes)
            if parent in bound:
                length, other = (float(np.linalg.norm(p[number] - p[parent])) for p in (at, positions))
                if abs(length - other) > same_length * max(length, other, 1e-9):
                    return None
        elif parent >= 0 and not np.isnan(turns[parent, 0]):
            change = multiply(turns[parent], conjugate(standing[parent]))
            at[number] = at[parent] + rotate(change, positions[number] - positions[parent])
            turns[number] = multiply(change, standing[number])
    return at, turns


def _humanoid_names(document: GltfDocument) -> dict[int, str]:
    """Names of the bones by node, of VRM 0 and 1 and VRM animations."""
    extensions = document.tree.get("extensions")
    names: dict[int, str] = {}
    for key in ("VRMC_vrm_animation", "VRMC_vrm", "VRM"):
        extension = extensions.get(key) if isinstance(extensions, dict) else None
        humanoid = extension.get("humanoid") if isinstance(extension, dict) else None
        bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
        if isinstance(bones, list):  # VRM 0
            bones = {bone.get("bone"): bone for bone in bones if isinstance(bone, dict)}
        for name, bone in bones.items() if isinstance(bones, dict) else ():
            if isinstance(bone, dict) and isinstance(bone.get("node"), int) and isinstance(name, str):
                names.setdefault(bone["node"], name)
    return names


def _unique(names: list[str], owners: list[str]) -> tuple[str, ...]:
    """Number what is there twice for one owner."""
    seen: dict[tuple[str, str], int] = {}
    result = []
    for name, owner in zip(names, owners, strict=True):
        seen[owner, name] = seen.get((owner, name), 0) + 1
        result.append(name if seen[owner, name] == 1 else f"{name}.{seen[owner, name]}")
    return tuple(result)
