"""Script and style of the player as text, and its data as text that may stand inside a page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

__all__ = ["SCRIPT_PARTS", "format_player_data", "read_player_script", "read_player_style"]

SCRIPT_PARTS: tuple[str, ...] = (
    "theme.js",
    "geometry.js",
    "figure.js",
    "stage.js",
    "controls.js",
    "player.js",
    "clock.js",
    "miniature_figure.js",
    "miniatures.js",
    "api.js",
)
"""In the order in which they use each other."""

# Inside a script element "</script" and "<!--" end or bend the page; U+2028 and U+2029 end lines of old scripts.
_UNSAFE = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}


def _read(name: str) -> str:
    return (files("dousa.app.player") / name).read_text(encoding="utf-8")


def read_player_script() -> str:
    """The whole script of the player; it makes ``window.dousa`` and no other global name."""
    parts = "\n".join(_read(name) for name in SCRIPT_PARTS)
    return f'(() => {{\n"use strict";\n{parts}\n}})();\n'


def read_player_style() -> str:
    """The style sheet of player and miniatures; elsewhere it sets only variables that say which theme is on."""
    return _read("player.css")


def format_player_data(data: Mapping[str, Any]) -> str:
    """Data as JSON that may stand inside a ``<script type="application/json">`` element, whatever the words are.

    Parameters
    ----------
    data : of `encode_player_data`, or anything that JSON can hold.
    """
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).translate(_UNSAFE)
