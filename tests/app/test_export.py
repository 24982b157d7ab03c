"""The command `dousa export`: options, answers, and what it says of mistakes."""

import csv
import json
import zipfile

import pytest

from dousa.formats.registry import read_motion, write_motion
from dousa.motion.synthetic import draw_performer, make_motion


@pytest.fixture
def moves(tmp_path, dousa):
    for category in ("walk", "bow"):
        path = tmp_path / "recordings" / category / "take.bvh"
        path.parent.mkdir(parents=True)
        write_motion(make_motion(category, draw_performer(1)), path)
    assert dousa("add", tmp_path / "moves.dousa", tmp_path / "recordings")[0] == 0
    return tmp_path / "moves.dousa"


def test_a_folder(tmp_path, moves, succeed):
    out = tmp_path / "out"
    said, _ = succeed("export", moves, "--category", "walk", "--to", "glb", "-o", out)
    assert "1 written, 0 there already, 0 skipped" in said
    with open(out / "manifest.csv", encoding="utf-8", newline="") as file:
        assert [row["category"] for row in csv.DictReader(file)] == ["walk"]


def test_chosen_clips_in_a_zip_on_a_character(tmp_path, moves, succeed):
    character = tmp_path / "character.bvh"
    write_motion(make_motion("jump", draw_performer(5)), character)
    options = ("--to", "bvh", "--onto", character, "--keep-reach", "--frame-rate", "30", "--read", "up=y", "--json")
    said, _ = succeed("export", moves, "2", "-o", tmp_path / "out.zip", *options)
    (name,) = json.loads(said)["written"]
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        archive.extract(name, tmp_path)
        (row,) = csv.DictReader(archive.read("manifest.csv").decode().splitlines())
    assert row["worst_limb"].split("_")[0] in ("left", "right")
    assert 0.0 <= float(row["worst_deg"]) < 90.0
    assert 1 <= int(row["worst_frame"]) <= int(row["n_frames"])
    assert read_motion(tmp_path / name).frame_rate == pytest.approx(30.0)
    for onto, is_told in ((("--onto", character), True), (("--onto", character), True), ((), False)):
        succeed("export", moves, "2", "-o", tmp_path / "out", "--to", "bvh", *onto)
        with open(tmp_path / "out" / "manifest.csv", encoding="utf-8", newline="") as file:
            assert [bool(row["worst_limb"]) for row in csv.DictReader(file)] == [is_told]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--to", "docx"), "glb"),
        (("--onto", "nobody.bvh"), "original"),
        (("--to", "bvh", "--keep-reach"), "--onto"),
        (("--to", "bvh", "--onto", "nobody.bvh"), "nobody.bvh"),
        (("--category", "flight"), "flight"),
        (("--to", "fbx"), "out: .fbx is written through Blender, which is not on this machine"),
    ],
)
def test_mistakes_leave_nothing(tmp_path, moves, dousa, monkeypatch, options, word):
    monkeypatch.setenv("DOUSA_BLENDER", "")
    monkeypatch.setenv("PATH", "")
    code, _, said = dousa("export", moves, "-o", tmp_path / "out", *options)
    assert code == 2
    assert word in said
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()
