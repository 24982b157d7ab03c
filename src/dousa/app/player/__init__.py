"""The 3D player of one or two figures, and moving miniatures of motions: what report and studio put into their pages.

The player is a script of ours without dependencies, in parts that share one scope; `read_player_script` joins
them. A page needs an element, the style, the script and the data::

    dousa.createPlayer(element, data)  // see the top of player.js for its methods
    dousa.createMiniature(canvas, bytes)  // see the top of miniatures.js
    dousa.createClock()  // see the top of clock.js
"""

from __future__ import annotations

from dousa.app.player._assets import format_player_data, read_player_script, read_player_style
from dousa.app.player._data import encode_player_data
from dousa.app.player._miniature import MINIATURE_BYTES, MINIATURE_FRAMES, encode_miniature
from dousa.app.player._motions import encode_motion, encode_pair

__all__ = [
    "MINIATURE_BYTES",
    "MINIATURE_FRAMES",
    "encode_miniature",
    "encode_motion",
    "encode_pair",
    "encode_player_data",
    "format_player_data",
    "read_player_script",
    "read_player_style",
]
