"""Imports run as the diagrams of docs/architecture.md say, and `import dousa` loads nothing heavy."""

from __future__ import annotations

import ast
import itertools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import dousa

SOURCE = Path(dousa.__file__).parent
PAGE = Path(__file__).resolve().parents[1] / "docs" / "architecture.md"
HELPERS = ("errors", "_files", "_lazy")  # of any room; they import nothing but each other
_COMMANDS = ("cli", "demo_studio")  # of app, by how they begin

Pair = tuple[str, str]


def read_diagrams() -> list[list[list[str]]]:
    """The blocks of arrows of the page: lines of rooms, from the one that knows nobody to the one that nobody knows."""
    blocks = re.findall(r"^```\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [[re.split(r" +<-+ +", line) for line in block.splitlines()] for block in blocks if "<-" in block]


ROOMS, APP_ROOMS = read_diagrams()


def allowed(lines: list[list[str]]) -> set[Pair]:
    """(room, what it may import): what stands to its left in a line."""
    return {(there, here) for line in lines for here, there in itertools.combinations(line, 2)}


def arrows(lines: list[list[str]]) -> set[Pair]:
    return {(there, here) for line in lines for here, there in itertools.pairwise(line)}


def list_imports(path: Path) -> Iterator[list[str]]:
    """The modules of dousa that a file imports, each as its parts below dousa."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}: imports are written in full"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        yield from (name.split(".")[1:] for name in names if name.startswith("dousa."))


def room_of(parts: list[str]) -> str:
    return parts[0]


def app_room_of(parts: list[str]) -> str:
    """Room within app, of the parts below app."""
    if parts[0] in ("player", "report", "studio"):
        return parts[0]
    if parts[0].startswith(_COMMANDS):
        return "cli"
    return "demo" if parts[0].startswith("demo") else "work"


def find_pairs() -> dict[Pair, str]:
    """Every import from one room into another, with a file that does it."""
    pairs: dict[Pair, str] = {}
    for path in SOURCE.rglob("*.py"):
        here = path.relative_to(SOURCE).with_suffix("").parts
        if here == ("__init__",):
            continue
        for there in list_imports(path):
            if there and (SOURCE / f"{there[0]}.py").exists() | (SOURCE / there[0]).is_dir():
                pairs.setdefault((room_of(list(here)), room_of(there)), "/".join(here))
    return {pair: file for pair, file in pairs.items() if len(set(pair)) == 2}


def find_app_pairs() -> dict[Pair, str]:
    pairs: dict[Pair, str] = {}
    for path in (SOURCE / "app").rglob("*.py"):
        here = path.relative_to(SOURCE / "app").with_suffix("").parts
        for there in list_imports(path):
            if there[0] == "app" and len(there) > 1 and here != ("__init__",):
                pairs.setdefault((app_room_of(list(here)), app_room_of(there[1:])), "/".join(here))
    return {pair: file for pair, file in pairs.items() if len(set(pair)) == 2}


def test_the_diagram_has_every_room():
    folders = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    assert {room for line in ROOMS for room in line} == folders | {"errors"}
    inside = {path.name for path in (SOURCE / "app").iterdir() if (path / "__init__.py").exists()}
    assert {room for line in APP_ROOMS for room in line} == inside | {"work", "demo", "cli"}


def test_imports_run_one_way():
    may = allowed(ROOMS)
    for (here, there), file in find_pairs().items():
        if there in HELPERS:
            continue
        assert (here, there) in may, f"{file}.py imports dousa.{there}; the diagram has no such way"


def test_imports_inside_app_run_one_way():
    may = allowed(APP_ROOMS)
    for (here, there), file in find_app_pairs().items():
        assert (here, there) in may, f"app/{file}.py ({here}) imports {there}; the diagram has no such way"


def test_every_arrow_of_the_diagrams_is_an_import():
    assert arrows(ROOMS) <= set(find_pairs())
    assert arrows(APP_ROOMS) <= set(find_app_pairs())


@pytest.mark.parametrize("lines", [ROOMS, APP_ROOMS], ids=["dousa", "app"])
def test_the_diagrams_have_no_circle(lines: list[list[str]]):
    assert not {(there, here) for here, there in allowed(lines)} & allowed(lines)


@pytest.mark.parametrize("statement", ["import dousa", "import dousa.app.cli"])
def test_start_up_is_light(statement):
    heavy = "numpy numba scipy sklearn sqlalchemy matplotlib joblib ezc3d fastapi uvicorn jinja2 cv2".split()
    code = f"import sys; {statement}; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_every_public_name_can_be_loaded():
    for name in dousa.__all__:
        assert getattr(dousa, name) is not None
    with pytest.raises(AttributeError):
        dousa.no_such_name  # noqa: B018
