"""A check of the finished site: no page loads a script, a style, a picture or a font from the network.

A hook of MkDocs; the build fails if one does.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig

_LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\bsrc=["']?(?:https?:)?//[^"'\s>]+"""
    r"""|<link\b(?=[^>]*\brel=["']?(?:stylesheet|preconnect|preload|icon))[^>]*?\bhref=["']?(?:https?:)?//[^"'\s>]+"""
    r"""|(?:@import\s+|\burl\()\s*["']?(?:https?:)?//[^"')\s]+""",
    re.IGNORECASE,
)


def find_remote_assets(folder: Path) -> list[str]:
    """What the pages and styles of a folder load from elsewhere, each with its file."""
    found = []
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".html", ".css"):
            text = path.read_text(encoding="utf-8")
            found += [f"{path.relative_to(folder)}: {match[0]}" for match in _LOADED.finditer(text)]
    return found


def on_post_build(config: MkDocsConfig) -> None:
    """Fail if the site needs the network."""
    from mkdocs.exceptions import BuildError

    found = find_remote_assets(Path(config.site_dir))
    if found:
        raise BuildError("the site loads from the network:\n" + "\n".join(found))
