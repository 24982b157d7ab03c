"""Repair of assimp's GLB of an FBX file: helper nodes and the unit.

FBX places a joint by a chain of transformations (pre-rotation, pivots ...), for which assimp adds nodes named
``JOINT_$AssimpFbx$_PreRotation``. A baked animation holds the whole chain, but assimp keeps the helpers, so that they
count twice. Here each chain becomes the rest pose of its joint. The unit of FBX is 1 cm times UnitScaleFactor, which
is missing in the GLB.
"""

from __future__ import annotations

import re
import struct
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.formats.gltf.document import GltfDocument
from dousa.motion.rotations import from_matrix, to_matrix

_MARK = "_$AssimpFbx$_"
_TEXT_SCALE = re.compile(rb'"UnitScaleFactor"[^\n]{0,80}?,\s*(\d{1,9}(?:\.\d{0,17})?)\s*[\r\n]')


def read_unit(data: bytes) -> float:
    """Read the metres per unit of an FBX file, binary or text; 0.01 where it has none."""
    factor = 1.0
    place = data.find(b"UnitScaleFactor")
    found = _TEXT_SCALE.search(data)
    if found is not None:
        factor = float(found[1])
    elif place >= 0:  # S "double" S "Number" S "" D value
        start = data.find(b"D", place + len(b"UnitScaleFactor") + 5 + len(b"double"), place + 80)
        if 0 <= start <= len(data) - 9:
            (factor,) = struct.unpack_from("<d", data, start + 1)
    return 0.01 * factor if 1e-6 < factor < 1e6 else 0.01


def collapse_helpers(document: GltfDocument) -> None:
    """Put the transformations of assimp's helper nodes into their joints."""
    nodes = document.items("nodes")
    animated = _animated_nodes(document)
    for index, node in enumerate(nodes):
        name = str(node.get("name", ""))
        child = _only_child(document, node)
        if _MARK not in name or child is None or index in animated:
            continue
        joint = name.partition(_MARK)[0]
        chain = [index]
        while child is not None and str(nodes[child].get("name", "")).startswith(joint + _MARK):
            chain.append(child)
            child = _only_child(document, nodes[child])
        if child is None or nodes[child].get("name") != joint or animated & set(chain):
            continue
        matrix = np.eye(4)
        for number in (*chain, child):
            matrix = matrix @ _matrix(nodes[number])
        if not np.isfinite(matrix).all() or np.linalg.det(matrix[:3, :3]) < 1e-9:
            continue
        for number in chain:
            for key in ("matrix", "translation", "rotation", "scale"):
                nodes[number].pop(key, None)
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        turn = from_matrix(matrix[:3, :3] / scale)
        nodes[child].pop("matrix", None)
        nodes[child] |= {
            "translation": matrix[:3, 3].tolist(),
            "rotation": turn[[1, 2, 3, 0]].tolist(),
            "scale": scale.tolist(),
        }
    _lift(document, nodes)


def _lift(document: GltfDocument, nodes: list[dict[str, Any]]) -> None:
    """Remove helpers without effect from the tree."""
    for node in nodes:
        children = node.get("children")
        if not isinstance(children, list):
            continue
        lifted = []
        for number in children:
            child: int | None = number
            seen = 0
            while child is not None and _does_nothing(document.item("nodes", child)) and seen < len(nodes):
                child, seen = _only_child(document, nodes[child]), seen + 1
            lifted.append(number if child is None else child)
        node["children"] = lifted
    kept = {number for node in nodes for number in node.get("children", [])}
    for number, node in enumerate(nodes):
        if number not in kept and _does_nothing(node):
            node.pop("children", None)


def _does_nothing(node: dict[str, Any]) -> bool:
    return _MARK in str(node.get("name", "")) and not {"matrix", "translation", "rotation", "scale"} & node.keys()


def _only_child(document: GltfDocument, node: dict[str, Any]) -> int | None:
    children = node.get("children")
    if not isinstance(children, list) or len(children) != 1:
        return None
    document.item("nodes", children[0])
    return int(children[0])


def _animated_nodes(document: GltfDocument) -> set[int]:
    animated = set()
    for animation in document.items("animations"):
        for channel in animation.get("channels", []):
            target = channel.get("target") if isinstance(channel, dict) else None
            if isinstance(target, dict) and isinstance(target.get("node"), int):
                animated.add(target["node"])
    return animated


def _matrix(node: dict[str, Any]) -> FloatArray:
    try:
        if "matrix" in node:
            return np.array(node["matrix"], np.float64).reshape(4, 4).T
        x, y, z, w = (float(value) for value in node.get("rotation", (0, 0, 0, 1)))
        matrix = np.eye(4)
        matrix[:3, :3] = to_matrix(np.array([w, x, y, z])) * np.array(node.get("scale", (1, 1, 1)), np.float64)
        matrix[:3, 3] = node.get("translation", (0, 0, 0))
    except (TypeError, ValueError):
        return np.full((4, 4), np.nan)
    return matrix
