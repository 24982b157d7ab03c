"""What stands where an answer shall be written: recordings, libraries and other people's tables are not lost."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dousa.app import targets
from dousa.app.pipelines.render import render_file
from dousa.app.requests.estimation import RenderRequest
from dousa.errors import OptionError
from dousa.estimation import ViewKeypoints, make_ring, write_cameras, write_keypoints, write_offsets
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.motion import compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion
from made_clips import write_clips


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """``moves.dousa``, trained with clips of ``clips``; ``take.trc``, ``take.csv`` (Motive) and ``note.txt``."""
    root = tmp_path_factory.mktemp("targets")
    write_clips(root / "clips", ("walk", "squat", "clap"), 3)
    motion = compute_trajectories(make_motion("squat", draw_performer(5), seed=5))
    for name in ("take.trc", "take.csv"):
        write_motion(motion, root / name)
    (root / "note.txt").write_text("Tuesday: two squats")
    with Library.open(root / "moves.dousa", create=True) as library:
        library.add(root / "clips", performer_from=r"name:(p\d)")
        library.train(n_trees=10)
    return root


@pytest.fixture
def folder(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "work"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("take.trc", "--csv {}: this is the file to be read; choose another name"),
        ("moves.dousa", "--csv {}: this is the file to be read; choose another name"),
        ("other.dousa", "--csv {}: this is a library; choose another name"),
        ("take.csv", "--csv {}: this file holds motion; choose another name"),
        ("clips/walk/p0.bvh", "--csv {}: this file holds motion; choose another name"),
    ],
)
def test_a_table_of_labels_is_written_over_no_motion_and_no_library(dousa, folder, name, told):
    shutil.copy(folder / "moves.dousa", folder / "other.dousa")
    before = contents(folder)
    target = folder / name
    code, out, err = dousa("label", folder / "moves.dousa", folder / "take.trc", "--csv", target)
    assert (code, out, err) == (2, "", f"dousa: {told.format(target)}\n")
    assert contents(folder) == before


def test_a_table_of_labels_is_not_written_over_another_one(dousa, folder):
    words = ("label", folder / "moves.dousa", folder / "take.trc", "--csv", folder / "take.labels.csv")
    (folder / "take.labels.csv").write_text("start_s,end_s,category\n0,1,bow\n")
    code, out, err = dousa(*words)
    assert (code, out) == (2, "")
    assert err == f"dousa: --csv {words[-1]}: this file is there already; choose another name, or remove it first\n"
    assert (folder / "take.labels.csv").read_text() == "start_s,end_s,category\n0,1,bow\n"
    (folder / "take.labels.csv").unlink()
    assert dousa(*words)[0] == 0
    assert (folder / "take.labels.csv").read_text().startswith("start_s,end_s,category,confidence")
    assert dousa(*words)[0] == 2  # somebody may have corrected it
    (folder / "empty.csv").touch()
    assert dousa(*words[:-1], folder / "empty.csv")[0] == 0


@pytest.mark.parametrize(
    "words",
    [
        ("convert", "take.trc", "other.csv"),
        ("convert", "take.trc", "note.bvh"),
        ("plot", "take.trc", "-o", "note.png"),
        ("search", "moves.dousa", "take.trc", "--picture", "note.png"),
        ("label", "moves.dousa", "take.trc", "--picture", "note.png"),
        ("plot", "moves.dousa", "-o", "other.csv"),
        ("plot", "moves.dousa", "-o", "note.svg"),
        ("evaluate", "take.trc", "-p", "take.trc", "-o", "report"),
        ("progress", "note.txt", "note.txt", "--picture", "note.png"),
        ("render", "take.trc", "-o", "other.npz"),
        ("estimate", "seen.npz", "--angles", "other.csv"),
        ("estimate", "seen.npz", "-o", "note.bvh"),
        ("keypoints", "other.mp4", "-o", "."),
        ("sync", "other.mp4", "other2.mp4", "-o", "note.toml"),
        ("calibrate", "other.mp4", "other2.mp4", "-o", "note.png"),
    ],
    ids=" ".join,
)
def test_what_another_program_has_written_stays(dousa, folder, monkeypatch, words):
    monkeypatch.chdir(folder)
    for suffix in ("bvh", "png", "svg", "pdf", "toml"):
        Path(f"note.{suffix}").write_text("not one of ours")
    Path("other.csv").write_text("title,composer\nSakura,-\n")
    write_motion(make_motion("bow", draw_performer(1), seed=1), "other.npz")
    Path("report").mkdir()
    Path("report/report.html").write_text("my own page")
    for name in ("other.mp4", "other2.mp4"):
        Path(name).write_bytes(b"no film")
    if words[1] == "seen.npz":
        render_file(RenderRequest(Path("clips/walk/p0.bvh"), Path(words[1]), size=(80, 60)))
    monkeypatch.setattr("dousa.app.pipelines.films.require", lambda *_: None)
    before = contents(folder)
    code, out, err = dousa(*words)
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert "this file is there already, and is no" in err
    assert contents(folder) == before


def test_what_dousa_has_written_is_written_again(dousa, succeed, folder, monkeypatch):
    monkeypatch.chdir(folder)
    for words in (
        ("convert", "take.trc", "new.csv"),
        ("convert", "take.trc", "new.bvh"),
        ("convert", "clips/walk/p0.bvh", "new.npz"),
        ("plot", "take.trc", "-o", "new.png"),
        ("plot", "take.trc", "-o", "new.svg"),
        ("plot", "moves.dousa", "-o", "map.csv"),
        ("render", "take.trc", "-o", "seen.npz", "--frames", "0:2", "--stature", "1.7"),
        ("evaluate", "take.trc", "-p", "take.trc", "-o", "report"),
    ):
        assert [dousa(*words)[0] for _ in range(2)] == [0, 0], words
    _, err = succeed("convert", "take.trc", "note.bvh", "--overwrite")
    assert dousa("convert", "clips/walk/p0.bvh", "take.trc", "--onto", "new.bvh")[0] == 0
    code, _, err = dousa("convert", "take.trc", "new.bvh", "--onto", "new.bvh")
    assert code == 2 and "OUT new.bvh: this is the file to be read" in err


def test_cameras_and_times_are_written_again(tmp_path):
    path = tmp_path / "a.toml"
    found = SimpleNamespace(offsets=[0.0], spreads=[0.0], basis=["reference"])
    for write, kind in (
        (lambda: write_offsets(path, ["left"], found), targets.SYNC),
        (lambda: write_cameras(path, make_ring(2)), targets.CAMERAS),
    ):
        write()
        targets.check_targets({"--output": path}, (), kind)
        path.write_text('[int_cam1_img]\nname = "of another program"\n')
        with pytest.raises(OptionError, match=r"is no \.toml that dousa has written"):
            targets.check_targets({"--output": path}, (), kind)


def test_keypoints_are_written_again_and_no_motion(tmp_path):
    path = tmp_path / "left.npz"
    write_keypoints(path, ViewKeypoints(("nose",), (), np.arange(2) / 30, (640, 480)))
    targets.check_targets({"--output": path}, (), targets.KEYPOINTS)
    write_motion(make_motion("bow", draw_performer(1), seed=1), path)
    with pytest.raises(OptionError):
        targets.check_targets({"--output": path}, (), targets.KEYPOINTS)
