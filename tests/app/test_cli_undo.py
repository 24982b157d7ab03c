"""``dousa undo``, ``dousa tag``, saved searches: what people do to a library bit by bit, and take back."""

import json
import zipfile
from pathlib import Path

import pytest

from dousa.library import Library
from made_clips import write_clips


@pytest.fixture(scope="module")
def motions(tmp_path_factory) -> Path:
    return write_clips(tmp_path_factory.mktemp("motions"), ("squat", "bow"), 2)


@pytest.fixture
def library(motions, tmp_path) -> Path:
    path = tmp_path / "moves.dousa"
    with Library.open(path, create=True) as made:
        made.add(motions)
    return path


def ids(library, **filters):
    with Library.open(library) as opened:
        return [clip.id for clip in opened.clips(**filters)]


def test_undo_redo_and_the_list(dousa, library):
    category = next(iter(Library.open(library).categories()))
    own = ids(library, category=category)
    assert dousa("relabel", library, "--where-category", category, "--category", "x")[0] == 0
    assert dousa("remove", library, own[0])[0] == 0
    code, out, _ = dousa("undo", library, "--list")
    lines = out.splitlines()
    assert code == 0 and len(lines) == 3
    assert lines[0].endswith("MB kept") and "1 clip removed" in lines[0]
    assert "category 'x'" in lines[1] and "added" in lines[2]
    assert dousa("undo", library)[1] == "undone: 1 clip removed\n"
    assert dousa("undo", library)[0] == 0
    assert ids(library, category=category) == own
    listed = json.loads(dousa("undo", library, "--list", "--json")[1])
    assert [entry["is_undone"] for entry in listed] == [True, True, False]
    assert dousa("--lang", "ja", "undo", library, "--redo")[1].startswith("やり直しました: ")
    assert "(undone)" in dousa("undo", library, "--list")[1]
    number = listed[1]["number"]
    assert json.loads(dousa("undo", library, number, "--json")[1])["kind"] == "relabel"
    assert dousa("undo", library)[0] == 0  # what was added
    assert ids(library) == []
    code, _, err = dousa("undo", library)
    assert (code, "nothing to undo" in err) == (2, True)
    assert dousa("undo", library, "--list", "--redo")[0] == 2
    assert dousa("undo", library, "99")[0] == 2


def test_removing_for_good_keeps_nothing(dousa, library):
    clip = ids(library)[0]
    assert dousa("remove", library, clip, "--for-good")[0] == 0
    assert "removed" not in dousa("undo", library, "--list")[1]
    code, _, err = dousa("undo", library)
    assert (code, "changed since" in err or "no longer as it left" in err) == (2, True)


def test_tags_and_what_is_selected_by_them(dousa, library, tmp_path):
    first, second, third, *_ = ids(library)
    assert dousa("tag", library, first, second, "+fight", "+draft")[1].startswith("tags of 2 changed")
    assert dousa("tag", library, "--tag", "fight", "-draft", "+high kick")[0] == 0
    assert dousa("tag", library, third, "+favourite", "+夜")[0] == 0
    code, out, _ = dousa("tag", library, "--list")
    assert (code, "fight: 2 clips" in out, "draft" in out, "夜: 1 clip" in out) == (0, True, False, True)
    assert len(json.loads(dousa("list", library, "--tag", "high kick", "--json")[1])["clips"]) == 2
    assert dousa("list", library, "--tag", "fight", "--save", "fights")[0] == 0
    out = dousa("tag", library, "--list")[1]
    assert "search 'fights': tag=fight" in out
    target = tmp_path / "fights.zip"
    assert dousa("export", library, "--select", "fights", "--to", "bvh", "-o", target)[0] == 0
    with zipfile.ZipFile(target) as packed:
        assert sum(name.endswith(".bvh") for name in packed.namelist()) == 2
        assert packed.read("manifest.csv").decode().count("fight; high kick") == 2
    assert dousa("tag", library, "--select", "fights", "-fight")[0] == 0
    code, _, err = dousa("export", library, "--select", "fights", "-o", target)
    assert (code, "nothing fits the saved search" in err) == (2, True)
    for words in ((first,), (first, "+"), (first, "-"), ("+lonely",), ("--select", "none", "+x")):
        assert dousa("tag", library, *words)[0] == 2
    assert dousa("list", library, "--save", "all")[0] == 2
    assert dousa("undo", library)[0] == 0
    assert len(ids(library, tag="fight")) == 2
