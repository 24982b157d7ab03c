"""The demonstration, end to end on a few small categories."""

import io

import pytest
from rich.console import Console

from dousa.app.demo import run_demo, write_library
from dousa.errors import OptionError
from dousa.library import Library

CATEGORIES = ("bow", "kick_left", "walk")


@pytest.fixture
def console():
    return Console(file=io.StringIO(), width=140)


def told(console):
    return console.file.getvalue()


def test_a_library_on_the_disk_is_the_same_each_time(tmp_path):
    seen = []
    first, second = (
        write_library(tmp_path / name, 2, 2, 3, ("walk", "bow"), lambda *step: seen.append(step[:2])) for name in "ab"
    )
    assert [path.relative_to(tmp_path / "a").as_posix() for path in first[:3]] == [
        "walk/performer00_1.bvh",
        "walk/performer00_2.bvh",
        "walk/performer01_1.bvh",
    ]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert seen[7] == (8, 8)


@pytest.mark.slow
def test_demo_can_be_run_again_and_tells_the_same(tmp_path, console, capsys):
    output = tmp_path / "out"
    for _ in range(2):
        run_demo(console, output, n_jobs=1, n_performers=3, categories=CATEGORIES)
    text = told(console)
    assert text.count("In truth kick_left; the forest says kick_left") == 2
    assert "match" in text
    assert "were there already" in text
    assert "Of all 3 queries" in text
    assert "forest" in capsys.readouterr().out + text
    assert text.count("Why: the ") == 2
    for name in ("search.png", "experiment.png", "timeline.png"):
        assert (output / name).stat().st_size > 10_000
    with Library.open(output / "demo.dousa", read_only=True) as library:
        clips = [clip for clip in library.clips() if clip.kind == "clip"]
        assert [clip.path for clip in library.clips() if clip.kind == "take"] == [str(output / "take.bvh")]
    assert len(clips) == 9
    assert {clip.performer for clip in clips} == {"performer00", "performer01", "performer02"}


def test_demo_says_where_it_cannot_write(tmp_path, console):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OptionError, match="choose another with --output"):
        run_demo(console, tmp_path / "file" / "out")
