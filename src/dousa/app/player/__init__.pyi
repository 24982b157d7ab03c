from .data import (
    encode_motion,
    encode_pair,
    encode_player_data,
    encode_repetitions,
    format_player_data,
    read_player_script,
    read_player_style,
)
from .figures import MINIATURE_BYTES, MINIATURE_FRAMES, encode_miniature

__all__ = [
    "MINIATURE_BYTES",
    "MINIATURE_FRAMES",
    "encode_miniature",
    "encode_motion",
    "encode_pair",
    "encode_player_data",
    "encode_repetitions",
    "format_player_data",
    "read_player_script",
    "read_player_style",
]
