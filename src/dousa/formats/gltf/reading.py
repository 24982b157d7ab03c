"""glTF 2.0, GLB, VRM, VRM animations: the joints of the skins, moved by one of the animations.

The specification has metres and Y up; files in centimetres are common, so the unit is inferred if the body would have
no possible height. Joints get the axes of the scene, as in a BVH file: at rest nothing is turned. The file's own axes,
mesh and materials stay in ``provenance.layout``, so that another animation can be written into the same file.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.formats.assembly import settle_motion
from dousa.formats.gltf.curves import Curve, choose_times
from dousa.formats.gltf.document import GltfDocument, load_document
from dousa.formats.gltf.soundness import INTERPOLATIONS, are_turns, check_keys, check_samplers
from dousa.formats.gltf.tree import JointTree, build_tree, list_nodes
from dousa.formats.parts import choose, distinguish
from dousa.messages import Message
from dousa.motion import Motion, Skeleton
from dousa.motion.rotations import conjugate, multiply, normalise, rotate

_PATHS = ("translation", "rotation", "scale")
_OTHER_PATHS = ("weights", "pointer")


@dataclass(frozen=True, slots=True, eq=False)
class GltfLayout:
    """Layout of a glTF file, kept so that a motion can be written into it.

    Parameters
    ----------
    document : the file.
    tree : its joints.
    """

    document: GltfDocument
    tree: JointTree

    def name_tree(self, root: int) -> str | None:
        """Return the name of the armature above a root, else of the skin that it belongs to."""
        node, nodes = self.tree.nodes[root], self.document.items("nodes")
        above = [other for other in nodes if node in other.get("children", [])]
        skins = [skin for skin in self.document.items("skins") if node in skin.get("joints", [])]
        return next((str(item["name"]) for item in (*above, *skins) if item.get("name")), None)

    def take(self, joints: list[int]) -> GltfLayout:
        """Return the layout with these joints alone; the rest of the file stays."""
        return GltfLayout(self.document, self.tree.take(joints))


@dataclass(frozen=True, slots=True)
class _Clip:
    number: int
    name: str
    curves: dict[tuple[int, str], Curve]
    length: float
    notes: tuple[Message, ...]


def read_gltf(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    animation: str | None = None,
) -> Motion:
    """Read an animation of a glTF, GLB, VRM or VRMA file, sampled at the rate of the keys.

    ``provenance.layout`` is a `GltfLayout`.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default metres, unless the body would have no possible height.
    up : axis that points up; by default Y.
    animation : name or number; by default the longest.

    Raises
    ------
    MotionFileError : missing, damaged, without an animation, or without this one.
    """
    return build_motion(load_document(path), unit=unit, up=up, animation=animation)


def build_motion(
    document: GltfDocument,
    *,
    unit: float | str | None,
    up: str | None,
    animation: str | None = None,
    format_name: str = "gltf",
    declared_unit: float = 1.0,
    notes: tuple[Message, ...] = (),
) -> Motion:
    """Build an animation of a document, also of one converted from another format.

    Parameters
    ----------
    document : its ``path`` goes into provenance and messages.
    unit, up, animation : as for `read_gltf`.
    format_name : for the provenance.
    declared_unit : metres per unit of the document.
    notes : for the user, on the reading of the file.
    """
    animations = document.items("animations")
    clips = [_read_clip(document, one, number) for number, one in enumerate(animations)]
    clips = [clip for clip in clips if clip.curves]
    if not clips:
        raise document.fail("gltf.no_animation" if document.items("skins") else "gltf.no_joints")
    names = distinguish(clip.name for clip in clips)
    chosen, choice = choose(document.path, "animation", names, animation, [clip.length for clip in clips])
    clip = clips[chosen]
    notes += (*choice, *clip.notes, *check_keys(document, animations[clip.number]))
    times, rate = choose_times([curve.times for curve in clip.curves.values()])
    if len(times) * max(1, len(document.items("nodes"))) > 50_000_000:
        raise document.fail("gltf.large", frames=len(times))
    tree, rotations, translations, scaled = _pose(document, clip, times)
    return settle_motion(
        document.path, format_name, _skeleton(tree), rotations, translations, rate, unit=unit, up=up,
        declared_unit=declared_unit, layout=GltfLayout(document, tree), notes=(*notes, *scaled, *document.notes),
    )  # fmt: skip


def read_gltf_character(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Motion:
    """Read one frame of a file at rest, as a character for other motions; it needs no animation."""
    return build_character(load_document(path), unit=unit, up=up)


def build_character(
    document: GltfDocument,
    *,
    unit: float | str | None,
    up: str | None,
    format_name: str = "gltf",
    declared_unit: float = 1.0,
) -> Motion:
    """Build one frame of a document at rest; parameters as of `build_motion`."""
    clips = [_read_clip(document, animation, n) for n, animation in enumerate(document.items("animations"))]
    moved = {node for clip in clips for node, _ in clip.curves}
    tree = build_tree(document, moved)
    skeleton = _skeleton(tree)
    translations = tree.offsets[None]
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (1, len(tree.names), 1))
    return settle_motion(
        document.path, format_name, skeleton, rotations, translations, 30.0,
        unit=unit, up=up, declared_unit=declared_unit, layout=GltfLayout(document, tree),
    )  # fmt: skip


def _skeleton(tree: JointTree) -> Skeleton:
    return Skeleton(tree.names, np.array(tree.parents, np.intp), tree.offsets, np.array(tree.end_sites))


def _read_clip(document: GltfDocument, animation: dict[str, Any], number: int) -> _Clip:
    channels, samplers = animation.get("channels", []), animation.get("samplers", [])
    if not isinstance(channels, list) or not isinstance(samplers, list):
        raise document.fail("gltf.list", name="channels")
    notes = check_samplers(document, animation)
    curves: dict[tuple[int, str], Curve] = {}
    for channel in channels:
        target = channel.get("target") if isinstance(channel, dict) else None
        if not isinstance(target, dict) or target.get("path") not in (*_PATHS, *_OTHER_PATHS):
            raise document.fail("gltf.target", found=str(target)[:60])
        if target["path"] in _OTHER_PATHS or "node" not in target:
            continue  # weights of a face, or an extension
        if (target["node"], target["path"]) in curves:
            raise document.fail("gltf.target_twice", node=target["node"], path=target["path"])
        document.item("nodes", target["node"])
        index = channel.get("sampler")
        sampler = samplers[index] if isinstance(index, int) and 0 <= index < len(samplers) else None
        if not isinstance(sampler, dict):
            raise document.fail("gltf.index", name="samplers", found=repr(index)[:20], count=len(samplers))
        times, values = document.numbers(sampler.get("input")), document.numbers(sampler.get("output"))
        kind = sampler.get("interpolation", "LINEAR")
        curve = Curve(times[:, 0], values, str(kind), target["path"] == "rotation")
        if kind not in INTERPOLATIONS or not curve.is_sound():
            raise document.fail("gltf.keys", number=index)
        curves[target["node"], target["path"]] = curve
    length = max((float(curve.times[-1]) for curve in curves.values()), default=0.0)
    name = animation.get("name")
    turns = (curve.values for curve in curves.values() if curve.turns and curve.kind != "CUBICSPLINE")
    if not all(map(are_turns, turns)):
        notes += (Message("gltf.no_turns"),)
    return _Clip(number, name if isinstance(name, str) else f"animation {number + 1}", curves, length, notes)


def _pose(
    document: GltfDocument, clip: _Clip, times: FloatArray
) -> tuple[JointTree, FloatArray, FloatArray, tuple[Message, ...]]:
    """Joints, local rotations (T, J, 4) and translations (T, J, 3) in the axes of the scene, and notes."""
    tree = build_tree(document, {node for node, _ in clip.curves})
    count = len(tree.names)
    rotations, translations = np.empty((len(times), count, 4)), np.empty((len(times), count, 3))
    # Where nothing is animated a node stays as the file has it, which need not be its rest pose.
    nodes = list_nodes(document)
    place = {index: number for number, index in enumerate(nodes.order)}
    for joint, node in enumerate(tree.nodes):
        turn, move = clip.curves.get((node, "rotation")), clip.curves.get((node, "translation"))
        number = place[node]
        turns = nodes.rotations[number] if turn is None else normalise(turn.sample(times)[:, [3, 0, 1, 2]])
        moves = nodes.translations[number] if move is None else move.sample(times)
        rotations[:, joint], translations[:, joint] = _to_scene(tree, joint, turns, moves * tree.scales[joint])
    grown = [c for (node, what), c in clip.curves.items() if what == "scale" and node in tree.nodes]
    scaled = any(np.ptp(curve.values, axis=0).max() > 0.01 * np.abs(curve.values).max() for curve in grown)
    return tree, rotations, translations, (Message("gltf.scaled"),) if scaled else ()


def _to_scene(tree: JointTree, joint: int, turns: FloatArray, moves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Local rotations (T, 4) and translations (T, 3) in the axes of the scene, of those in the file's own."""
    parent = tree.parents[joint]
    back = conjugate(tree.rest[joint])
    if parent >= 0:
        frame = tree.rest[parent]
        return multiply(multiply(frame, turns), back), rotate(frame, moves)
    above = tree.above.get(joint)
    if above is None:
        return multiply(turns, back), moves
    return multiply(multiply(above[3:], turns), back), above[:3] + rotate(above[3:], moves)
