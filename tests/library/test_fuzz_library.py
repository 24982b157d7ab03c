"""Random damage to a library file: every outcome is an answer or a DousaError, in bounded time and memory.

``DOUSA_FUZZ_SECONDS`` seconds, 1 by default.
"""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from dousa.library import Library
from fuzzing import fuzz

pytestmark = [pytest.mark.fuzz, pytest.mark.sqlite]


def ask_library(path: Path) -> None:
    """Open a library, ask it what people ask, and have it looked at and repaired."""
    with Library.open(path) as library:
        library.check()
        clips = library.clips()
        library.search(clips[0].id, 5)
        library.search_text("both hands overhead")
        list(library.iterate_trajectories([clip.id for clip in clips]))
        library.journal()
        library.find(1, k=2)
        library.label(clips[-1].id)
    shutil.copy(path, path.with_name("again.dousa"))
    with Library.open(path.with_name("again.dousa")) as library:
        library.check(repair=True)


def test_damaged_libraries(tmp_path, moves, write_move):
    folder = tmp_path / "sound"
    folder.mkdir()
    with Library.open(folder / "moves.dousa", create=True) as library:
        library.add(moves, n_jobs=1)
        library.add(write_move(tmp_path / "z.bvh", "bow", 50, n_frames=150), kind="take", n_jobs=1)
        library.train(n_trees=3, n_jobs=1)
        library.tag([1], add=["x"])
        library.remove([2])
    with closing(sqlite3.connect(folder / "moves.dousa")) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
    fuzz(tmp_path, [folder / "moves.dousa"], ask_library, seconds=20.0)
