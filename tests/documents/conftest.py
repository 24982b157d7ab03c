"""What the documents run leaves the package as it is."""

import functools
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from documents.commands import ROOT

SOURCE = ROOT / "src"


def hash_package() -> dict[str, str]:
    """Digests of all that the package ships beside its code: tables, trained models, pages."""
    paths = (Path(folder, name) for folder, _, names in os.walk(SOURCE) if is_shipped(folder) for name in names)
    found = sorted(path for path in paths if path.suffix not in (".py", ".pyi"))
    return {path.relative_to(SOURCE).as_posix(): hash_file(path, path.stat().st_mtime_ns) for path in found}


def is_shipped(folder: str) -> bool:
    """Whether the files of a folder are no cache."""
    return not folder.endswith("__pycache__")


@functools.cache
def hash_file(path: Path, written_ns: int) -> str:
    """Digest of a file as it was last written; read once."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(autouse=True)
def package_stays() -> Iterator[None]:
    """No command of a document changes what the package ships: one did, and its numbers were released."""
    before = hash_package()
    assert any(name.endswith(".npz") for name in before) and any(name.endswith(".toml") for name in before)
    yield
    after = hash_package()
    changed = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    assert not changed, f"the commands of this test changed {changed}: restore them with git"
