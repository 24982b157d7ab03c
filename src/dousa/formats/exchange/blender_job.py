"""Script for Blender: ``blender --background --python blender_job.py -- read IN OUT.glb`` or ``write IN.glb OUT HZ``.

Needs nothing of dousa, as Blender has its own Python.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any


def _read(bpy: Any, source: str, target: str) -> None:
    suffix = source.rpartition(".")[2].lower()
    if suffix == "fbx":
        try:
            bpy.ops.import_scene.fbx(filepath=source)
        except (RuntimeError, AttributeError):  # text, old versions: the newer reader supports some of them
            if "fbx_import" not in dir(bpy.ops.wm):
                raise
            bpy.ops.wm.read_factory_settings(use_empty=True)
            bpy.ops.wm.fbx_import(filepath=source)
    else:
        bpy.ops.wm.collada_import(filepath=source)
    _round_frames(bpy)
    _fit_range(bpy)
    # Of one take, what moves armature and objects is one animation; several takes stay apart.
    takes = {[*action.name.split("|"), action.name][1] for action in bpy.data.actions}
    bpy.ops.export_scene.gltf(
        filepath=target,
        export_format="GLB",
        export_optimize_animation_size=False,
        export_animation_mode="ACTIONS" if len(takes) > 1 else "ACTIVE_ACTIONS",
    )


def _round_frames(bpy: Any) -> None:
    """Round keys such as 1.9999 (from FBX times) to frame 2: the glTF exporter would begin at 1."""
    render = bpy.context.scene.render
    if abs(render.fps_base - 1.0) < 1e-4:
        render.fps_base = 1.0
    for action in bpy.data.actions:
        for curve in _list_curves(action):
            places = [0.0] * (2 * len(curve.keyframe_points))
            curve.keyframe_points.foreach_get("co", places)
            frames = places[::2]
            if all(abs(frame - round(frame)) < 0.05 for frame in frames):
                places[::2] = [float(round(frame)) for frame in frames]
                curve.keyframe_points.foreach_set("co", places)
                curve.update()


def _list_curves(action: Any) -> Any:
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]  # Blender 5
    return [curve for bag in bags for curve in bag.fcurves]


def _fit_range(bpy: Any) -> None:
    """Fit the scene to the motion: no frame is cut off, and none is held."""
    ranges = [action.frame_range for action in bpy.data.actions]
    if ranges:
        bpy.context.scene.frame_start = round(min(begin for begin, _ in ranges))
        bpy.context.scene.frame_end = round(max(end for _, end in ranges))


def _write(bpy: Any, source: str, target: str, rate: float) -> None:
    render = bpy.context.scene.render
    render.fps = max(1, round(rate))
    render.fps_base = render.fps / rate
    known = bpy.ops.import_scene.gltf.get_rna_type().properties.keys()
    bpy.ops.import_scene.gltf(
        filepath=source, **({"disable_bone_shape": True} if "disable_bone_shape" in known else {})
    )
    _fit_range(bpy)
    bpy.ops.export_scene.fbx(
        filepath=target,
        add_leaf_bones=False,
        apply_scale_options="FBX_SCALE_ALL",
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=0.0,
    )


def main() -> None:
    """Convert one file by the arguments after ``--``."""
    bpy = importlib.import_module("bpy")
    task, *words = sys.argv[sys.argv.index("--") + 1 :]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if task == "read":
        _read(bpy, words[0], words[1])
    else:
        _write(bpy, words[0], words[1], float(words[2]))


if __name__ == "__main__":
    main()
