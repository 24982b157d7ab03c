"""What is dear to make and never changed, as a trained library: one worker makes it, the others wait and read it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

try:
    import fcntl
except ImportError:  # elsewhere each makes its own
    fcntl = None

__all__ = ["make_once"]


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """A folder that ``make`` has filled, the same for all workers of a run.

    Parameters
    ----------
    factory : of the temporary folders of this worker; those of all lie beside one another.
    name : of the folder, one for each thing.
    make : fills an empty folder; where it fails, each worker tries, and each says why.
    """
    worker = factory.getbasetemp()
    if fcntl is None or not worker.name.startswith("popen-"):
        folder = factory.mktemp(name, numbered=False)
        make(folder)
        return folder
    folder, made = worker.parent / name, worker.parent / f"{name}.made"
    with open(worker.parent / f"{name}.lock", "ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            made.touch()
    return folder
