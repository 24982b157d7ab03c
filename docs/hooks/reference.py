"""The pages of the reference: for each package its public names, taken from the package itself.

A hook of MkDocs. Names are listed by importing the package, so that a page follows when a module moves; mkdocstrings
reads signatures and docstrings from the source, by the public path of each name (`docstrings.py` makes them known).
"""

from __future__ import annotations

import importlib
import inspect
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

PACKAGES = (
    "dousa",
    "dousa.motion",
    "dousa.formats",
    "dousa.library",
    "dousa.retrieval",
    "dousa.estimation",
    "dousa.evaluation",
    "dousa.experiments",
    "dousa.motion.synthetic",
)
_GROUPS = ("Classes", "Functions", "Constants")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add a page for each package."""
    from mkdocs.structure.files import File

    for package in PACKAGES:
        path = f"reference/{package.removeprefix('dousa.')}.md"
        files.append(File.generated(config, path, content=write_page(package)))
    return files


def write_page(package: str) -> str:
    """The page of a package in Markdown: what it is, a table of its names, then each name."""
    module = importlib.import_module(package)
    names = [name for name in module.__all__ if not name.startswith("__")]
    groups: dict[str, list[str]] = {group: [] for group in _GROUPS}
    for name in sorted(names, key=str.lower):
        groups[_find_group(getattr(module, name))].append(name)
    lines = [f"# `{package}`", "", inspect.getdoc(module) or "", ""]
    for group, members in groups.items():
        if members:
            lines += [f"| {group} | |", "| --- | --- |"]
            lines += [_write_row(package, name, getattr(module, name)) for name in members] + [""]
    for group, members in groups.items():
        if members:
            lines += [f"## {group}", ""]
            lines += [f"::: {package}.{name}\n" for name in members]
    return "\n".join(lines)


def _find_group(value: Any) -> str:
    if inspect.isclass(value):
        return "Classes"
    return "Functions" if callable(value) else "Constants"


def _write_row(package: str, name: str, value: Any) -> str:
    described = inspect.isclass(value) or callable(value)
    text = (inspect.getdoc(value) or "") if described else ""
    first = text.partition("\n\n")[0].replace("\n", " ").replace("|", "\\|")
    return f"| [`{name}`][{package}.{name}] | {first} |"
