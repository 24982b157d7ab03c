# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel in the sidebar of the 3D view, the settings it edits, and the preferences."""

from __future__ import annotations

import bpy

from .operators import (
    DOUSA_OT_connect,
    DOUSA_OT_disconnect,
    DOUSA_OT_import_new,
    DOUSA_OT_import_onto,
    DOUSA_OT_open_library,
    DOUSA_OT_search,
    find_armature,
    find_span,
)
from .session import SESSION
from .studio import Found


class DousaPreferences(bpy.types.AddonPreferences):
    """Where dousa is on this machine."""

    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="dousa command",
        description="Name or full path of the program, such as /home/me/.venv/bin/dousa",
        default="dousa",
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "command")


class DousaSettings(bpy.types.PropertyGroup):
    """What the panel asks for."""

    library: bpy.props.StringProperty(name="Library", description="A .dousa file", subtype="FILE_PATH")
    address: bpy.props.StringProperty(name="Address", description="What `dousa studio` prints", subtype="PASSWORD")
    n_hits: bpy.props.IntProperty(name="Clips", description="How many clips are shown", default=12, min=1, max=60)
    mirror: bpy.props.BoolProperty(name="Mirror too", description="Search for the mirror image as well")


class DOUSA_PT_search(bpy.types.Panel):
    """Search a motion library."""

    bl_label = "dousa"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "dousa"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.window_manager.dousa
        if SESSION.studio is None:
            _draw_connecting(layout, settings)
            return
        layout.operator(DOUSA_OT_disconnect.bl_idname, icon="UNLINKED")
        armature = find_armature(context)
        column = layout.column(align=True)
        column.operator(DOUSA_OT_search.bl_idname, icon="VIEWZOOM")
        if armature is None:
            column.label(text="Select an armature.", icon="INFO")
        else:
            first, last = find_span(context, armature)
            column.label(text=f"{armature.name}, frames {first} to {last}")
        row = layout.row()
        row.prop(settings, "n_hits")
        row.prop(settings, "mirror")
        if SESSION.found is not None:
            _draw_found(layout, SESSION.found)


def _draw_connecting(layout: bpy.types.UILayout, settings: DousaSettings) -> None:
    box = layout.box()
    box.label(text="A library on this machine")
    box.prop(settings, "library", text="")
    box.operator(DOUSA_OT_open_library.bl_idname, icon="FILE_FOLDER")
    box = layout.box()
    box.label(text="A studio that is running")
    box.prop(settings, "address", text="")
    box.operator(DOUSA_OT_connect.bl_idname, icon="LINKED")


def _draw_found(layout: bpy.types.UILayout, found: Found) -> None:
    layout.label(text=found.category or (f"unknown, nearest {found.guess}" if found.guess else "unknown"))
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    for hit in found.hits:
        box = grid.box()
        box.template_icon(SESSION.icon(hit.clip_id), scale=4)
        box.label(text=f"{hit.category}{' (mirrored)' if hit.mirrored else ''}")
        box.label(text=hit.name)
        row = box.row(align=True)
        for operator, icon in ((DOUSA_OT_import_onto, "ARMATURE_DATA"), (DOUSA_OT_import_new, "ADD")):
            button = row.operator(operator.bl_idname, text="Onto" if icon == "ARMATURE_DATA" else "New", icon=icon)
            button.motion, button.name = hit.motion, hit.name


CLASSES = (DousaPreferences, DousaSettings, DOUSA_PT_search)
