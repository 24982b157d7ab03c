"""Clips of a library as files: labels, formats, characters, and runs that are interrupted."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from dousa.app.pipelines.export import MANIFEST, export_clips
from dousa.errors import LibraryError, OptionError
from dousa.formats.registry import read_motion, write_motion
from dousa.library import Library
from dousa.motion import canonicalise
from dousa.motion.synthetic import draw_performer, make_motion


@pytest.fixture
def recordings(tmp_path):
    for category in ("walk", "bow"):
        for number in range(2):
            path = tmp_path / "recordings" / category / f"take{number}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(category, draw_performer(number), seed=number), path)
    return tmp_path / "recordings"


@pytest.fixture
def library(tmp_path, recordings):
    with Library.open(tmp_path / "moves.dousa", create=True) as opened:
        opened.add([recordings], n_jobs=1)
        yield opened


def rows(folder):
    with open(folder / MANIFEST, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_originals_are_the_same_bytes(tmp_path, library, recordings):
    report = export_clips(library, tmp_path / "out")
    assert sorted(report.written) == ["bow/take0.bvh", "bow/take1.bvh", "walk/take0.bvh", "walk/take1.bvh"]
    for name in report.written:
        assert (tmp_path / "out" / name).read_bytes() == (recordings / name).read_bytes()
    table = rows(tmp_path / "out")
    assert [(row["file"], row["category"]) for row in table] == [(n, n.split("/")[0]) for n in sorted(report.written)]
    assert all(row["from"] == "file" for row in table)


@pytest.mark.parametrize(
    ("to", "suffix"), [("glb", ".glb"), ("c3d", ".c3d"), ("bvh", ".bvh"), ("csv", ".csv"), ("amass", ".amass.npz")]
)
def test_formats(tmp_path, library, to, suffix):
    report = export_clips(library, tmp_path / "out", category="walk", to=to)
    assert sorted(report.written) == [f"walk/take{n}{suffix}" for n in range(2)]
    motion = read_motion(tmp_path / "out" / report.written[0])
    expected = make_motion("walk", draw_performer(0), seed=0)
    assert motion.n_frames == expected.n_frames
    if to != "amass":
        np.testing.assert_allclose(canonicalise(motion).positions, canonicalise(expected).positions, atol=1e-3)


def test_what_is_there_is_kept_and_what_changed_is_made_again(tmp_path, library):
    first = export_clips(library, tmp_path / "out", to="glb")
    times = {name: (tmp_path / "out" / name).stat().st_mtime_ns for name in first.written}
    (tmp_path / "out" / "walk" / "take1.glb").unlink()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    second = export_clips(library, tmp_path / "out", to="glb")
    assert second.written == ("walk/take1.glb",)
    assert len(second.kept) == 3
    for name in second.kept:
        assert (tmp_path / "out" / name).stat().st_mtime_ns == times[name]
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    # Onto a character it is another motion.
    character = tmp_path / "character.bvh"
    write_motion(make_motion("bow", draw_performer(9)), character)
    third = export_clips(library, tmp_path / "out", to="glb", onto=character)
    assert len(third.written) == 4
    heights = [canonicalise(read_motion(tmp_path / "out" / name)).height for name in third.written]
    np.testing.assert_allclose(heights, canonicalise(read_motion(character)).height, atol=1e-3)


def test_an_interrupted_export_goes_on(tmp_path, library):
    def stop(done, total, name):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_clips(library, tmp_path / "out", to="bvh", progress=stop)
    assert len(rows(tmp_path / "out")) == 2
    seen = []
    report = export_clips(library, tmp_path / "out", to="bvh", progress=lambda *what: seen.append(what[:2]))
    assert (len(report.kept), len(report.written)) == (2, 2)
    assert seen == [(n, 4) for n in range(5)]
    assert not [path for path in (tmp_path / "out").rglob("*") if path.name.endswith(".part")]


def test_a_source_that_is_gone(tmp_path, library, recordings):
    (recordings / "walk" / "take0.bvh").unlink()
    report = export_clips(library, tmp_path / "a", category="walk")
    assert len(report.written) == 1
    assert report.skipped[0].reason.code == "disk.missing"
    report = export_clips(library, tmp_path / "b", category="walk", to="c3d")
    assert {row["from"] for row in rows(tmp_path / "b")} == {"file", "stored joints"}
    motion = canonicalise(read_motion(tmp_path / "b" / "walk" / "take0.c3d"))
    expected = canonicalise(make_motion("walk", draw_performer(0), seed=0))
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-3)


def test_what_cannot_be_is_said(tmp_path, library):
    with pytest.raises(OptionError, match="original"):
        export_clips(library, tmp_path / "out", to="original", onto="x.bvh")
    with pytest.raises(OptionError, match="glb"):
        export_clips(library, tmp_path / "out", to="fbx")
    with pytest.raises(LibraryError):
        export_clips(library, tmp_path / "out", category="flight")
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="folder"):
        export_clips(library, tmp_path / "file")
    assert not (tmp_path / "out").exists()


def test_the_command(tmp_path, library, dousa):
    out = tmp_path / "out"
    code, said, _ = dousa("export", tmp_path / "moves.dousa", "--category", "walk", "--to", "glb", "-o", out)
    assert code == 0
    assert "2 written, 0 there already, 0 skipped" in said
    assert len(rows(out)) == 2
