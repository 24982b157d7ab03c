"""What all pictures share: colours that everyone can tell apart, text in any script, whole files."""

from __future__ import annotations

import io
import logging
import os
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from dousa.app.targets import find_picture_format
from dousa.extras import find_font, require
from dousa.files.disk import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito (2008): distinct for every kind of colour vision, and of different lightness.
BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
INK = "#222222"
GREY = "#6b6b6b"
FAINT = "#c9c9c9"

SIDE_COLOURS = {"left": BLUE, "right": VERMILLION, "": GREEN}
"""Colours of the limbs of a side, and of trunk and head."""

_METADATA: dict[str, dict[str, Any]] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}

# Fonts with Chinese, Japanese or Korean characters that systems commonly have.
_WIDE_FONTS = (
    "Noto Sans CJK JP",
    "Noto Sans JP",
    "Source Han Sans JP",
    "IPAexGothic",
    "IPAGothic",
    "TakaoGothic",
    "VL Gothic",
    "Hiragino Sans",
    "Yu Gothic",
    "Meiryo",
    "MS Gothic",
    "Noto Sans CJK SC",
    "PingFang SC",
    "Microsoft YaHei",
    "WenQuanYi Zen Hei",
    "Noto Sans CJK KR",
    "Malgun Gothic",
    "Arial Unicode MS",
    "Droid Sans Fallback",
)


def new_figure(width: float, height: float, dpi: float = 110) -> Figure:
    """An empty white figure of so many inches; no window system and no global state is touched."""
    require("matplotlib", "pictures")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=dpi, facecolor="white")


@lru_cache(maxsize=1)
def _fonts() -> tuple[tuple[str, ...], tuple[Any, ...]]:
    """Names of the fonts to use, first choice first, and the fonts themselves to ask for characters."""
    require("matplotlib", "pictures")
    from matplotlib import font_manager

    # The Japanese font has no bold; the warning that plain letters stand for it is of no use.
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    japanese = find_font()
    if japanese is not None:
        font_manager.fontManager.addfont(str(japanese))
    present = {entry.name: entry.fname for entry in font_manager.fontManager.ttflist}
    names = ["DejaVu Sans", *(name for name in _WIDE_FONTS if name in present)]
    opened = tuple(font_manager.get_font(present[name]) for name in names if name in present)
    return tuple(names), opened


def drawable(text: str) -> str:
    """The text with every character that no font can draw spelled as its code, such as \\u52d5."""
    _, fonts = _fonts()
    out = []
    for character in text:
        code = ord(character)
        if character.isprintable() and any(font.get_char_index(code) for font in fonts):
            out.append(character)
        else:
            out.append(character.encode("unicode_escape").decode("ascii"))
    return "".join(out)


def write(target: Any, x: float, y: float, text: str, size: float = 9.0, **style: Any) -> None:
    """Write on a figure or axes; dollar signs are dollar signs, and what cannot be drawn is spelled out."""
    names, _ = _fonts()
    options = {"color": INK, "ha": "left", "va": "baseline", **style}
    target.text(x, y, drawable(text), fontsize=size, family=list(names), parse_math=False, **options)


def shorten(text: str, length: int) -> str:
    """A text of at most so many characters: its beginning and its end."""
    return text if len(text) <= length else f"{text[: length - 20]} ... {text[-15:]}"


def count_noun(number: int, noun: str) -> str:
    """A number with its noun: "1 view", "3 categories", "no segments"."""
    if number == 1:
        return f"1 {noun}"
    return f"{number or 'no'} {noun[:-1]}ies" if noun.endswith("y") else f"{number or 'no'} {noun}s"


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the picture, whole or not at all; the same picture gives the same bytes.

    Raises
    ------
    OptionError : the suffix is not .png, .svg or .pdf.
    MotionWriteError : the folder is missing or the disk refuses.
    """
    from matplotlib import rc_context

    kind = find_picture_format(path)
    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "dousa"}):
        figure.savefig(buffer, format=kind, metadata=_METADATA[kind], facecolor="white")
    with atomic_write(path) as file:
        file.write(buffer.getvalue())
