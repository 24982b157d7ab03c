"""The README as the package page shows it: pictures and links point to the project's public home.

A metadata hook of Hatchling. In README.md they are relative, so that they also work in a copy, a fork and a branch.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(?P<picture>!?)(?P<text>\[[^\]]*\])\((?P<path>[^)#:\s][^):\s]*)\)")


def make_links_absolute(text: str, home: str) -> str:
    """Markdown whose links into the project point to its home.

    Parameters
    ----------
    text : Markdown.
    home : URL of the repository, without a slash at the end.
    """

    def rewrite(link: re.Match[str]) -> str:
        kind = "raw" if link["picture"] else "blob"
        return f"{link['picture']}{link['text']}({home}/{kind}/main/{link['path']})"

    return _LINK.sub(rewrite, text)


class AbsoluteReadme(MetadataHookInterface):
    """Sets ``readme``; the home is ``Source`` of ``project.urls``."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called by Hatchling with the table ``project``."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": make_links_absolute(text, metadata["urls"]["Source"]),
        }
