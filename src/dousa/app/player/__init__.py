"""The 3D player of two figures: what report and studio put into their pages.

The player is a script of ours without dependencies, in parts that share one scope; `read_player_script` joins
them. A page needs an element, the style, the script and the data::

    dousa.createPlayer(element, data)  // see the top of player.js for its methods
"""

from __future__ import annotations

from dousa.app.player._assets import format_player_data, read_player_script, read_player_style
from dousa.app.player._data import encode_player_data

__all__ = ["encode_player_data", "format_player_data", "read_player_script", "read_player_style"]
