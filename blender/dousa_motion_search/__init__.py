# SPDX-License-Identifier: GPL-3.0-or-later
"""dousa in Blender: search a motion library with an action, and bring a hit onto your character."""

from __future__ import annotations

import atexit

import bpy

from . import operators, panel
from .session import SESSION

_CLASSES = (*operators.CLASSES, *panel.CLASSES)


def register() -> None:
    """Called by Blender when the extension is switched on."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.WindowManager.dousa = bpy.props.PointerProperty(type=panel.DousaSettings)
    atexit.register(SESSION.close)


def unregister() -> None:
    """Called by Blender when it is switched off."""
    SESSION.close()
    atexit.unregister(SESSION.close)
    del bpy.types.WindowManager.dousa
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
