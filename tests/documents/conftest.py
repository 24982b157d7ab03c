"""What the documents run leaves the package as it is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from documents.commands import ROOT

SOURCE = ROOT / "src"


def hash_package() -> dict[str, str]:
    """Digests of all that the package ships beside its code: tables, trained models, pages."""
    paths = sorted(path for path in SOURCE.rglob("*") if path.is_file() and is_data(path))
    return {path.relative_to(SOURCE).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def is_data(path: Path) -> bool:
    """Whether a file is shipped and is neither code nor a cache."""
    return path.suffix not in (".py", ".pyi") and "__pycache__" not in path.parts


@pytest.fixture(autouse=True)
def package_stays() -> Iterator[None]:
    """No command of a document changes what the package ships: one did, and its numbers were released."""
    before = hash_package()
    assert any(name.endswith(".npz") for name in before) and any(name.endswith(".toml") for name in before)
    yield
    after = hash_package()
    changed = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    assert not changed, f"the commands of this test changed {changed}: restore them with git"
