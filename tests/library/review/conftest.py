"""Libraries of made clips that are not trained; each file of tests says which in its fixture ``made``."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from dousa.app.demo import write_library
from dousa.library import Library

MakeClips = Callable[[int, Sequence[str]], Path]


@pytest.fixture(scope="module")
def make_clips(tmp_path_factory: pytest.TempPathFactory) -> MakeClips:
    """``make_clips(people, categories)``: the path of a library with one clip of each."""

    def make(n_people: int, categories: Sequence[str]) -> Path:
        folder = tmp_path_factory.mktemp("made")
        write_library(folder / "motions", n_performers=n_people, categories=categories)
        with Library.open(folder / "made.dousa", create=True) as library:
            library.add([folder / "motions"])
        return folder / "made.dousa"

    return make


@pytest.fixture
def library(made: Path, tmp_path: Path) -> Iterator[Library]:
    """A copy, open."""
    with Library.open(shutil.copy(made, tmp_path / "made.dousa")) as opened:
        yield opened
