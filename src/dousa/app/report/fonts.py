"""A Japanese font cut down to the characters of a page, so that they show on any machine.

IPAexGothic (IPA Font License 1.0) lies in the package ``matplotlib-fontja``. The licence lets a document embed the
characters that it needs (article 2, paragraphs 2, 3 and 5). The package is found without being imported: its import
would change the settings of matplotlib.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec

from dousa.extras import FONT_PACKAGE, find_font

# Chinese characters and kana begin here; fonts of every machine have the signs that come before.
_FIRST = 0x2E80
_WIDE_SPACE = "\u3000"


@dataclass(frozen=True, slots=True)
class EmbeddedFont:
    """A font for one page.

    Parameters
    ----------
    data_url : ``data:`` address of a WOFF; empty if there is nothing to embed.
    characters : what it can show.
    problem : why there is none although the page needs one; empty if all is well.
    """

    data_url: str
    characters: frozenset[str]
    problem: str = ""


def embed_font(text: str) -> EmbeddedFont:
    """The font with the Chinese characters, kana and wide signs of a text.

    Parameters
    ----------
    text : everything that the page shows.
    """
    wanted = frozenset(c for c in text if ord(c) >= _FIRST and (c.isprintable() or c == _WIDE_SPACE))
    if not wanted:
        return EmbeddedFont("", frozenset())
    path = find_font()
    if path is None or find_spec("fontTools") is None:
        return EmbeddedFont("", frozenset(), f"{FONT_PACKAGE}: pip install 'dousa[pictures]'")
    return _cut(str(path), wanted)


@lru_cache(maxsize=4)
def _cut(path: str, wanted: frozenset[str]) -> EmbeddedFont:
    from fontTools import subset
    from fontTools.ttLib import TTFont, TTLibError

    options = subset.Options()
    options.layout_features = []
    options.hinting = False
    options.notdef_outline = True
    options.name_IDs = [0, 1, 2, 13]  # copyright, name, style, licence
    options.flavor = "woff"
    try:
        with TTFont(path, lazy=True) as font:
            for table in ("GSUB", "GPOS", "vhea", "vmtx", "VORG"):
                if table in font:
                    del font[table]
            known = font.getBestCmap()
            present = frozenset(c for c in wanted if ord(c) in known)
            cutter = subset.Subsetter(options)
            cutter.populate(unicodes=[ord(c) for c in present])
            cutter.subset(font)
            buffer = io.BytesIO()
            font.flavor = "woff"
            font.save(buffer, reorderTables=False)
    except (OSError, TTLibError) as error:
        return EmbeddedFont("", frozenset(), f"{path}: {error}")
    return EmbeddedFont("data:font/woff;base64," + base64.b64encode(buffer.getvalue()).decode("ascii"), present)


def font_rule(font: EmbeddedFont) -> str:
    """The style rule that brings the font; it comes first in the list of fonts, but for its own characters only."""
    if not font.data_url:
        return ""
    source = f'url({font.data_url}) format("woff")'
    return f'@font-face{{font-family:"dousa-ja";src:{source};unicode-range:U+{_FIRST:X}-3FFFF}}'
