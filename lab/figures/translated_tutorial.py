"""Give the Japanese tutorial the commands and answers of the English one; part of ``make figures``.

Its prose is translated by hand; its blocks are the same, in the same order, so that they are written and tested once.
"""

from __future__ import annotations

import re

from lab.places import DOCS

TUTORIAL, TRANSLATION = DOCS / "tutorial.md", DOCS / "tutorial.ja.md"

_BLOCK = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def paste_blocks(source: str, translation: str) -> str:
    """The translation with the blocks of the source.

    Parameters
    ----------
    source, translation : Markdown.

    Raises
    ------
    ValueError : one has more blocks than the other.
    """
    blocks = _BLOCK.findall(source)
    n_places = len(_BLOCK.findall(translation))
    if len(blocks) != n_places:
        raise ValueError(f"expected as many blocks in both tutorials, got {len(blocks)} and {n_places}")
    remaining = iter(blocks)
    return _BLOCK.sub(lambda _: next(remaining), translation)


def update_translation() -> None:
    """Write the Japanese tutorial with the blocks of today's English one."""
    text = paste_blocks(TUTORIAL.read_text(encoding="utf-8"), TRANSLATION.read_text(encoding="utf-8"))
    TRANSLATION.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    update_translation()
