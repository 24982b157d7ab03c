"""Lines, outlines and text on images of bytes, for the overlay; colours are blue, green, red as OpenCV has them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.app._canvas import BLUE, FAINT, GREEN, GREY, INK, VERMILLION

__all__ = [
    "ALARM",
    "CENTRE",
    "DARK",
    "HALF_DARK",
    "LEFT",
    "PALE",
    "RIGHT",
    "WHITE",
    "Colour",
    "Image",
    "draw_dashed",
    "draw_dashed_outlines",
    "draw_line",
    "draw_outlines",
    "find_outlines",
    "hatch",
    "measure_text",
    "to_rgb",
    "write_text",
]

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]
Points = NDArray[np.float64]


def _bgr(code: str) -> Colour:
    red, green, blue = (int(code[k : k + 2], 16) for k in (1, 3, 5))
    return blue, green, red


LEFT, RIGHT, CENTRE = _bgr(BLUE), _bgr(VERMILLION), _bgr(GREEN)
DARK, HALF_DARK, PALE, WHITE, ALARM = _bgr(INK), _bgr(GREY), _bgr(FAINT), (255, 255, 255), _bgr("#B22222")

_FRACTION_BITS = 4  # OpenCV draws at whole pixels unless told how many bits are fraction
_FAR = 20_000.0  # px, outside any picture; with the fraction it fits 32 bits
_LONGEST = 10_000.0  # px of a broken line: what leaves the picture so far is drawn whole
_DASH, _GAP = 8, 7  # px


def to_rgb(image: Image) -> Image:
    """For matplotlib, which has red first."""
    return np.ascontiguousarray(image[..., ::-1])


def draw_line(canvas: Image, points: Points, colour: Colour, width: int = 1) -> None:
    """Draw a line through points (N, 2) column, row px that need not be whole."""
    import cv2

    cv2.polylines(canvas, [_fixed(points)], False, colour, width, cv2.LINE_AA, _FRACTION_BITS)


def draw_dashed(canvas: Image, points: Points, colour: Colour, width: int = 1) -> None:
    """Draw a broken line through points (N, 2)."""
    import cv2

    if len(dashes := _break_up(points)):
        cv2.polylines(canvas, dashes, False, colour, width, cv2.LINE_AA, _FRACTION_BITS)


def draw_outlines(canvas: Image, outlines: Sequence[Points], colour: Colour, width: int = 1) -> None:
    """Draw closed lines through points (N, 2) each."""
    import cv2

    if outlines:
        lines = [_fixed(outline) for outline in outlines]
        cv2.polylines(canvas, lines, True, colour, width, cv2.LINE_AA, _FRACTION_BITS)


def draw_dashed_outlines(canvas: Image, outlines: Sequence[Points], colour: Colour, width: int = 1) -> None:
    """Draw closed broken lines through points (N, 2) each."""
    import cv2

    dashes = [dash for outline in outlines for dash in _break_up(np.concatenate((outline, outline[:1])))]
    if dashes:
        cv2.polylines(canvas, dashes, False, colour, width, cv2.LINE_AA, _FRACTION_BITS)


def _break_up(points: Points) -> list[NDArray[np.int32]]:
    """The dashes of a line, their points a pixel apart."""
    limited = np.clip(points, -_FAR, _FAR)
    lengths = np.linalg.norm(np.diff(limited, axis=0), axis=1)
    run = np.concatenate(([0.0], np.cumsum(lengths)))
    if not 1.0 <= run[-1] <= _LONGEST:
        return [_fixed(points)]
    at = np.arange(0.0, run[-1] + 1.0)
    even = _fixed(np.stack([np.interp(at, run, limited[:, axis]) for axis in (0, 1)], axis=1))
    return [even[start : start + _DASH] for start in range(0, len(even) - 1, _DASH + _GAP)]


def _fixed(points: Points) -> NDArray[np.int32]:
    limited = np.minimum(np.maximum(points, -_FAR), _FAR)
    return np.rint(limited * 2**_FRACTION_BITS).astype(np.int32).reshape(-1, 1, 2)


def find_outlines(mask: NDArray[np.bool_]) -> list[Points]:
    """The borders (N, 2) of every piece and hole of a mask."""
    import cv2

    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    if width == 0:
        return []
    cut = np.ascontiguousarray(mask[top : top + height, left : left + width]).view(np.uint8)
    found, _ = cv2.findContours(cut, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    corner = np.array([left, top], np.float64)
    return [outline[:, 0] + corner for outline in found]


def hatch(canvas: Image, colour: Colour, spacing: int = 14) -> None:
    """Strike a picture through with slanted lines, in place."""
    height, width = canvas.shape[:2]
    for start in range(-height, width, spacing):
        draw_line(canvas, np.array([[start, height], [start + height, 0]], np.float64), colour)


@lru_cache(maxsize=1)
def _font() -> Any:
    """OpenCV 5 has a font for every script; older ones draw Latin letters only."""
    import cv2

    return cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None


def write_text(
    canvas: Image,
    text: str,
    place: tuple[int, int],
    colour: Colour = DARK,
    size: int = 15,
    *,
    bold: bool = False,
) -> None:
    """Write one line; ``place`` is the left end of its base line, ``size`` its height in px."""
    import cv2

    font = _font()
    if font is not None:
        cv2.putText(canvas, text, place, colour, font, size, 700 if bold else 400)
        return
    plain = text.encode("ascii", "replace").decode()
    scale = size / 30.0
    cv2.putText(canvas, plain, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 2 if bold else 1, cv2.LINE_AA)


def measure_text(text: str, size: int = 15, *, bold: bool = False) -> int:
    """Width (px) of a line."""
    import cv2

    font = _font()
    if font is not None:
        return int(cv2.getTextSize((4000, 100), text, (0, 50), font, size, 700 if bold else 400)[2])
    plain = text.encode("ascii", "replace").decode()
    return int(cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, size / 30.0, 2 if bold else 1)[0][0])
