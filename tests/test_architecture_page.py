"""docs/architecture.md names files and folders that there are."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "dousa"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_tree_names_the_rooms_there_are():
    tree = re.search(r"^```\nsrc/dousa/\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    named = set(re.findall(r"^  (\w+)(?:/|\.py)", tree, re.MULTILINE))
    folders = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    assert named == folders | {path.stem for path in SOURCE.glob("[!_]*.py")}
    for name in re.findall(r"^(\w+)/", tree, re.MULTILINE):
        assert (ROOT / name).is_dir(), f"the tree has {name}/"
    for room, inside in re.findall(r"^  (\w+)/ (.*)$", tree, re.MULTILINE):
        there = {path.parent.name for path in (SOURCE / room).glob("*/__init__.py")}
        assert set(re.findall(r"(\w+)/", inside)) <= there, f"the tree names what is not in {room}/"


def test_every_sub_room_stands_in_the_tree():
    tree = re.search(r"^```\nsrc/dousa/\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    for path in SOURCE.glob("*/*/__init__.py"):
        if path.parent.parent.name != "formats":  # one folder a format
            assert f"{path.parent.name}/" in tree, f"the tree forgets {path.parent.relative_to(SOURCE)}/"


def test_the_files_that_the_page_names_are_there():
    named = re.findall(r"`((?:\w+/)+(?:\w+\.py)?)`", PAGE)
    assert len(named) > 20
    for name in named:
        assert (SOURCE / name).exists() or (ROOT / name).exists(), f"the page names {name}"
    for name in re.findall(r"`((?:\w+/)+\w+\.py)`: `(\w+)`", PAGE):
        assert name[1] in (SOURCE / name[0]).read_text(encoding="utf-8"), f"no {name[1]} in {name[0]}"
