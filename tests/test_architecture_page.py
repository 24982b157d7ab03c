"""docs/architecture.md names the files that there are: none that is gone, and none is forgotten."""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "dousa"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")

# Where the files of a room are listed by group: the words before the list.
LISTS = {
    "retrieval": "have the methods and their figures. The files by group:",
    "library": "In the library `store` opens",
    "estimation": "its masks as bad as real ones. The files by group:",
}


def read_list(room: str) -> set[str]:
    """Names of files in the list of a room, and in the sentence before it."""
    assert PAGE.count(LISTS[room]) == 1, f"the page has lost its list of {room}"
    start = PAGE.index(LISTS[room])
    lead, items = PAGE[start:].split("\n\n", 2)[:2]
    assert items.startswith("- "), f"no list after '{LISTS[room]}'"
    return set(re.findall(r"`([a-z_*0-9]+)`", lead + items))


def test_the_tree_names_the_rooms_there_are():
    tree = re.search(r"^```\nsrc/dousa/\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    inside = set(re.findall(r"^  (\w+)(?:/|\.py)", tree, re.MULTILINE))
    folders = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    assert inside == folders | {"errors"}
    for name in re.findall(r"^(\w+)/", tree, re.MULTILINE):
        assert (ROOT / name).is_dir(), f"the tree has {name}/"
    for path in (SOURCE / "app").iterdir():
        if (path / "__init__.py").exists():
            assert f"{path.name}/" in tree, f"the tree forgets app/{path.name}/"


@pytest.mark.parametrize("room", LISTS)
def test_the_lists_name_files_that_exist(room: str):
    for name in read_list(room):
        assert any((SOURCE / room).glob(f"{name}.py")), f"the page lists {name} in {room}"


@pytest.mark.parametrize("room", LISTS)
def test_the_lists_forget_no_file(room: str):
    listed = read_list(room)
    files = {path.stem for path in (SOURCE / room).glob("*.py")} - {"__init__"}
    lost = sorted(file for file in files if not any(fnmatchcase(file, name) for name in listed))
    assert not lost, f"name them in the list of {room} in docs/architecture.md"


def test_modules_and_functions_of_the_tables_exist():
    """``app.evaluating``, ``rasteriser.pack_bits``, ``report/_svg.py``: what is named with its place is there."""
    for name in re.findall(r"`((?:app|report|player|motion|formats|library)/[\w/.]+\.\w+)`", PAGE):
        assert (SOURCE / name).exists() or (SOURCE / "app" / name).exists(), name
    for module, name in re.findall(r"`(?:dousa\.)?([a-z_]+)\.([a-z]\w+)`", PAGE):
        if name in ("py", "md", "html") or module == "joblib":
            continue
        homes = [
            *SOURCE.rglob(f"{module}.py"),
            *(path.parent for path in SOURCE.rglob(f"{module}/__init__.py")),
        ]
        found = any(
            (home / f"{name}.py").exists() or (home / name).is_dir() or has_word(home, name) for home in homes
        )
        assert found, f"`{module}.{name}`"


def has_word(home: Path, name: str) -> bool:
    file = home / "__init__.py" if home.is_dir() else home
    return re.search(rf"\b{name}\b", file.read_text(encoding="utf-8")) is not None
