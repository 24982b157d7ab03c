"""Imports run one way, and `import dousa` loads nothing heavy."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import dousa

SOURCE = Path(dousa.__file__).parent
RANK = {
    "errors": 0,
    "motion": 1,
    "formats": 2,
    "retrieval": 2,
    "estimation": 2,
    "evaluation": 2,
    "library": 3,
    "app": 4,
}
MODULES = sorted(path.relative_to(SOURCE) for path in SOURCE.rglob("*.py") if path.parent != SOURCE)


def imported_rooms(path: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are written in full"
            names = (
                [node.module] if node.module != "dousa" else [f"dousa.{alias.name}" for alias in node.names]
            )
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        rooms |= {name.split(".")[1] for name in names if name.startswith("dousa.")}
    return rooms


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_imports_run_one_way(module):
    here = module.parts[0]
    for there in imported_rooms(SOURCE / module) & set(RANK):
        assert there == here or RANK[there] < RANK[here], f"{module} imports dousa.{there}"


@pytest.mark.parametrize("statement", ["import dousa", "import dousa.app.cli"])
def test_start_up_is_light(statement):
    heavy = "numpy numba scipy sklearn sqlalchemy matplotlib joblib ezc3d".split()
    code = f"import sys; {statement}; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_every_public_name_can_be_loaded():
    for name in dousa.__all__:
        assert getattr(dousa, name) is not None
    with pytest.raises(AttributeError):
        dousa.no_such_name  # noqa: B018
