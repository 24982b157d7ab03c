"""Pictures of matrices: viridis, and a PNG writer of a few lines, so that no picture library is loaded."""

from __future__ import annotations

import base64
import struct
import zlib
from functools import lru_cache

import numpy as np

from dousa.motion._types import FloatArray

__all__ = ["encode_map", "viridis_gradient", "viridis_table"]

# viridis (Smith and van der Walt, CC0) at 17 even places; between them it is straight enough.
_ANCHORS = (
    "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 "
    "fde725"
).split()
_UNKNOWN = 255  # the colour index of what is not known: transparent


@lru_cache(maxsize=1)
def viridis_table() -> np.ndarray:
    """(255, 3) uint8, dark to light."""
    anchors = np.array([[int(text[i : i + 2], 16) for i in (0, 2, 4)] for text in _ANCHORS], float)
    places = np.linspace(0, len(anchors) - 1, _UNKNOWN)
    columns = [np.interp(places, np.arange(len(anchors)), anchors[:, k]) for k in range(3)]
    return np.rint(np.stack(columns, axis=1)).astype(np.uint8)


def viridis_gradient() -> str:
    """The stops of a CSS gradient, dark to light."""
    return ", ".join(f"#{text}" for text in _ANCHORS)


def encode_map(values: FloatArray, low: float, high: float) -> str:
    """A matrix as a ``data:`` address of a PNG in viridis.

    Parameters
    ----------
    values : (H, W), first row on top; what is not finite becomes transparent.
    low, high : values of the darkest and the lightest colour.
    """
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-12), 0.0, 1.0)
    indices = np.where(known, np.rint(share * (_UNKNOWN - 1)), _UNKNOWN).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(_encode_png(indices)).decode("ascii")


def _encode_png(indices: np.ndarray) -> bytes:
    """PNG (W3C, third edition) of colour indices (H, W)."""
    height, width = indices.shape
    lines = np.zeros((height, width + 1), np.uint8)  # the first byte of a line names its filter: none
    lines[:, 1:] = indices
    palette = np.vstack([viridis_table(), [[0, 0, 0]]]).astype(np.uint8)
    alpha = bytes([255] * _UNKNOWN + [0])
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)),
        (b"PLTE", palette.tobytes()),
        (b"tRNS", alpha),
        (b"IDAT", zlib.compress(lines.tobytes(), 6)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
