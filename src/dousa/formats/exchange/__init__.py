"""FBX and Collada, read and written through the user's Blender or assimp."""

from __future__ import annotations

from dousa.formats.exchange.conversion import read_exchange, read_exchange_character, write_fbx

__all__ = ["read_exchange", "read_exchange_character", "write_fbx"]
