# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person can do: connect, search, import."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy

from . import bvh
from .session import SESSION
from .studio import Studio, StudioError


def find_armature(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active armature, or that of the active mesh."""
    active = context.active_object
    if active is None:
        return None
    return active if active.type == "ARMATURE" else active.find_armature()


def find_span(context: bpy.types.Context, armature: bpy.types.Object) -> tuple[int, int]:
    """First and last frame of the query: the preview range, else the armature's action, else the scene."""
    scene = context.scene
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    action = armature.animation_data.action if armature.animation_data else None
    if action is not None:
        first, last = action.frame_range
        return round(first), round(last)
    return scene.frame_start, scene.frame_end


class _Asking(bpy.types.Operator):
    """An operator that talks to dousa: what goes wrong is one sentence in the status bar."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        if context.window is not None:
            context.window.cursor_set("WAIT")
        try:
            done = self.ask(context)
        except (StudioError, bvh.BvhError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if context.window is not None:
                context.window.cursor_set("DEFAULT")
        self.report({"INFO"}, done)
        return {"FINISHED"}

    def ask(self, context: bpy.types.Context) -> str:
        """Do it; a sentence that says what was done."""
        raise NotImplementedError


class _WithArmature:
    """For operators that need a studio and an armature."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return SESSION.studio is not None and find_armature(context) is not None


class DOUSA_OT_open_library(_Asking):
    """Start dousa on this machine with the library"""

    bl_idname = "dousa.open_library"
    bl_label = "Open library"

    def ask(self, context: bpy.types.Context) -> str:
        settings = context.window_manager.dousa
        preferences = context.preferences.addons.get(__package__)
        command = preferences.preferences.command if preferences else "dousa"
        SESSION.connect(Studio.start(bpy.path.abspath(settings.library), command))
        return _describe_library()


class DOUSA_OT_connect(_Asking):
    """Connect to a studio that is running: its address is what `dousa studio` prints"""

    bl_idname = "dousa.connect"
    bl_label = "Connect"

    def ask(self, context: bpy.types.Context) -> str:
        studio = Studio(context.window_manager.dousa.address)
        studio.info()
        SESSION.connect(studio)
        return _describe_library()


def _describe_library() -> str:
    library = SESSION.require_studio().info()["library"]
    return f"Connected: {library['name']}, {library['n_clips']} clips."


class DOUSA_OT_disconnect(bpy.types.Operator):
    """Let the library go; a studio that was started here is stopped"""

    bl_idname = "dousa.disconnect"
    bl_label = "Disconnect"

    def execute(self, context: bpy.types.Context) -> set[str]:
        SESSION.close()
        return {"FINISHED"}


class DOUSA_OT_search(_WithArmature, _Asking):
    """Find the clips most like what the armature does (in the preview range, if one is set)"""

    bl_idname = "dousa.search"
    bl_label = "Search with this armature"

    def ask(self, context: bpy.types.Context) -> str:
        settings = context.window_manager.dousa
        armature = find_armature(context)
        query = bvh.record(armature, *find_span(context, armature))
        found = SESSION.require_studio().search(query, settings.n_hits, mirror=settings.mirror)
        SESSION.show(found)
        return f"{len(found.hits)} clips like it."


class _Importing(_Asking):
    bl_options = {"REGISTER", "UNDO"}

    motion: bpy.props.StringProperty(options={"HIDDEN"})
    name: bpy.props.StringProperty(options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return SESSION.studio is not None


class DOUSA_OT_import_onto(_WithArmature, _Importing):
    """Give the active armature this motion: as a new action, from the current frame on"""

    bl_idname = "dousa.import_onto"
    bl_label = "Onto the active armature"

    def ask(self, context: bpy.types.Context) -> str:
        armature = find_armature(context)
        text = SESSION.require_studio().bvh(self.motion, bvh.rest_bvh(armature))
        first, last = bvh.apply(armature, bvh.read_bvh(text), self.name, context.scene.frame_current)
        return f"{self.name}: frames {first} to {last} of {armature.name}."


class DOUSA_OT_import_new(_Importing):
    """Import this motion with its own skeleton, as a new armature"""

    bl_idname = "dousa.import_new"
    bl_label = "As a new armature"

    def ask(self, context: bpy.types.Context) -> str:
        text = SESSION.require_studio().bvh(self.motion)
        with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
            path = Path(folder) / f"{Path(self.name).stem or 'motion'}.bvh"
            path.write_text(text)
            try:
                bpy.ops.import_anim.bvh(
                    filepath=str(path), global_scale=0.01, frame_start=context.scene.frame_current, use_fps_scale=True
                )
            except (AttributeError, RuntimeError) as error:
                raise bvh.BvhError(f"Blender's own BVH import did not work ({error}): is that add-on on?") from error
        return f"{self.name} is the new armature {context.active_object.name}."


CLASSES = (
    DOUSA_OT_open_library,
    DOUSA_OT_connect,
    DOUSA_OT_disconnect,
    DOUSA_OT_search,
    DOUSA_OT_import_onto,
    DOUSA_OT_import_new,
)
