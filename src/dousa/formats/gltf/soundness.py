"""What glTF allows in a file whose bytes all came: names of properties, places of data, kinds of values.

Nothing in a file is a checksum. But a letter or a number that was changed mostly makes something that no file may have.
Reference: Khronos Group, glTF 2.0 specification, sections 3.6, 3.11 and 5.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.formats.gltf.document import FLOAT, GltfDocument
from dousa.messages import Message

_EVERYWHERE = {"name", "extensions", "extras"}
_KEYS = {
    name: _EVERYWHERE | set(keys.split())
    for name, keys in {
        "glTF": "extensionsUsed extensionsRequired accessors animations asset buffers bufferViews cameras images"
        " materials meshes nodes samplers scene scenes skins textures",
        "nodes": "camera children skin matrix mesh rotation scale translation weights",
        "skins": "inverseBindMatrices skeleton joints",
        "buffers": "uri byteLength",
        "bufferViews": "buffer byteOffset byteLength byteStride target",
        "accessors": "bufferView byteOffset componentType normalized count type max min sparse",
        "animations": "channels samplers",
        "channels": "sampler target",
        "target": "node path",
        "samplers": "input interpolation output",
    }.items()
}
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


def check_keys(document: GltfDocument, animation: dict[str, Any] | None) -> tuple[Message, ...]:
    """Note the first property of a file that no such object has; None where there is no animation."""
    objects: list[tuple[str, Any]] = [("glTF", document.tree)]
    objects += [(name, item) for name in ("nodes", "skins", "buffers", "bufferViews", "accessors")
                for item in document.items(name)]  # fmt: skip
    if animation is not None:
        channels = animation.get("channels", [])
        objects.append(("animations", animation))
        objects += [("channels", channel) for channel in channels]
        objects += [("target", channel.get("target")) for channel in channels if isinstance(channel, dict)]
        objects += [("samplers", sampler) for sampler in animation.get("samplers", [])]
    for name, item in objects:
        if isinstance(item, dict) and not item.keys() <= _KEYS[name]:
            return (Message("gltf.unknown_key", name=name, found=min(item.keys() - _KEYS[name])[:40]),)
    return ()


def check_samplers(document: GltfDocument, animation: dict[str, Any]) -> tuple[Message, ...]:
    """Note samplers that no channel has, and data of an animation that lie across other data.

    MotionFileError for times or values of a kind that none have.
    """
    samplers = animation.get("samplers", [])
    used = {channel.get("sampler") for channel in animation.get("channels", []) if isinstance(channel, dict)}
    notes = []
    if any(number not in used for number in range(len(samplers))):
        notes.append(Message("gltf.unused", n=sum(number not in used for number in range(len(samplers)))))
    views, outputs = set(), []
    for sampler in samplers:
        for key in ("input", "output"):
            accessor = document.item("accessors", sampler.get(key) if isinstance(sampler, dict) else None)
            if accessor.get("componentType") != FLOAT and (key == "input" or not accessor.get("normalized")):
                raise document.fail("gltf.accessor", number=sampler[key])
            views.add(accessor.get("bufferView"))
        spot = document.item("accessors", sampler["output"])
        outputs.append((spot.get("bufferView"), spot.get("byteOffset", 0)))
    if len(set(outputs)) < len(outputs) and (unused := _count_unused(document)):
        notes.append(Message("gltf.unused_data", n=unused))
    if _lie_across(document, views):
        notes.append(Message("gltf.across"))
    return tuple(notes)


def _count_unused(document: GltfDocument) -> int:
    """Accessors and views that nothing refers to; 0 where an extension may."""
    meshes, animations = document.items("meshes"), document.items("animations")
    if "extensions" in document.tree or any("extensions" in str(mesh) for mesh in meshes):
        return 0
    parts = [part for mesh in meshes for part in mesh.get("primitives", [])]
    rows = [
        *(part.get("attributes", {}) for part in parts),
        *(row for part in parts for row in part.get("targets", [])),
    ]
    used = {index for row in rows for index in row.values()} | {part.get("indices") for part in parts}
    used |= {skin.get("inverseBindMatrices") for skin in document.items("skins")}
    used |= {one.get(key) for row in animations for one in row.get("samplers", []) for key in ("input", "output")}
    accessors, views = document.items("accessors"), document.items("bufferViews")
    viewed = {item.get("bufferView") for item in (*accessors, *document.items("images"))}
    return sum(index not in used for index in range(len(accessors))) + sum(
        index not in viewed for index in range(len(views))
    )


def _lie_across(document: GltfDocument, animated: Iterable[Any]) -> bool:
    """Whether a view of an animation shares some bytes with another view, but not all."""
    spans = [
        (view.get("buffer", 0), view.get("byteOffset", 0), view.get("byteLength", 0))
        for view in document.items("bufferViews")
    ]
    if not all(isinstance(number, int) for span in spans for number in span):
        return False
    chosen = {spans[index] for index in animated if isinstance(index, int) and 0 <= index < len(spans)}
    edges = np.array(sorted(set(spans)), np.int64).reshape(-1, 3)
    for buffer, start, size in chosen:
        others = edges[edges[:, 0] == buffer]
        begins, ends = others[:, 1], others[:, 1] + others[:, 2]
        overlapping = (begins < start + size) & (ends > start)
        if (overlapping & ~((begins == start) & (ends == start + size))).any():
            return True
    return False


def are_turns(values: FloatArray, near: float = 0.05) -> bool:
    """Return whether quaternions (T, 4) have unit length, but for a share ``near`` of what rounding does."""
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1.0) < near).all())
