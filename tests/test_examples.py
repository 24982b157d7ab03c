"""Every public name of the package and every public method of a library has an example in its docstring that runs."""

import doctest
import inspect
import shutil
from pathlib import Path

import numpy as np
import pytest

import dousa
from dousa.app.demo import write_library, write_take
from dousa.library import Library
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.retrieval import LabelledClip

METHODS = [f"Library.{name}" for name, _ in inspect.getmembers(Library) if not name.startswith("_")]
CATEGORIES = ("walk", "wave_right", "squat")
NAMES = [name for name in dousa.__all__ if callable(getattr(dousa, name))]


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the examples read: ``motions``, a trained library, and a wave and a take of another person."""
    folder, person = tmp_path_factory.mktemp("examples"), draw_performer(77)
    write_library(folder / "motions", n_performers=4, categories=CATEGORIES)
    clips = []
    for category in CATEGORIES:
        motion = make_motion(category, person)
        moving = dousa.canonicalise(motion)
        clips.append(LabelledClip(category, category, None, moving.positions, moving.frame_rate, moving.height))
        if category == "wave_right":
            dousa.write_motion(motion, folder / "wave.bvh")
    write_take(clips, CATEGORIES, folder / "take.bvh")
    with Library.open(folder / "moves.dousa", create=True) as library:
        library.add(folder / "motions", n_jobs=1)
        library.train(n_trees=20, n_jobs=1)
    return folder


@pytest.mark.parametrize("name", [*NAMES, *METHODS])
def test_the_example_runs(name, material, tmp_path, monkeypatch, capsys):
    shutil.copytree(material, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    first, *rest = name.split(".")
    documented = inspect.getattr_static(Library, rest[0]) if rest else getattr(dousa, first)
    with dousa.Library.open("moves.dousa") as library:
        finder = doctest.DocTestFinder(recurse=False)
        known = {"dousa": dousa, "np": np, "library": library}
        examples = finder.find(documented, name, module=False, globs=known)
        assert examples and examples[0].examples, f"no >>> example in the docstring of {name}"
        answer = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(examples[0])
    assert answer.failed == 0, capsys.readouterr().out
