"""Pages of the site that stand in the root of the project: README (the home), CHANGELOG and CONTRIBUTING.

A hook of MkDocs. GitHub and the site resolve links from different folders, so links are rewritten here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.slugs import slugify

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
_HEADS = {"index.md": "---\nhide: [navigation]\n---\n\n"}
_MOVED = {**PAGES, "docs/examples": "gallery/index.md"}

_LINK = re.compile(r"(?<=\]\()(?P<path>[^)#:\s]+)(?P<anchor>#[^)\s]*)?(?=\))")


def rewrite_links(text: str) -> str:
    """Links between the files of the project as links between the pages of the site."""

    def rewrite(link: re.Match[str]) -> str:
        path = _MOVED.get(link["path"], link["path"].removeprefix("docs/"))
        return path + (link["anchor"] or "")

    return _LINK.sub(rewrite, text)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Anchors of headings as GitHub makes them, so that a link works in both places."""
    config.mdx_configs["toc"]["slugify"] = slugify(case="lower")
    return config


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages of the project's root."""
    for source, page in PAGES.items():
        text = rewrite_links((ROOT / source).read_text(encoding="utf-8"))
        files.append(File.generated(config, page, content=_HEADS.get(page, "") + text))
    return files


def on_post_page(output: str, *, page: Page, **_: Any) -> str:
    """Say which language a page is in: ``lang`` in its head decides the shapes of the characters."""
    language = page.meta.get("lang")
    return output.replace('<html lang="en"', f'<html lang="{language}"', 1) if language else output
