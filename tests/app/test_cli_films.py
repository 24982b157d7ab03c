"""`dousa sync` and `dousa calibrate`: what a person or a program is told about the times and the cameras of films."""

from __future__ import annotations

import json

import numpy as np
import pytest
from oracles.made_films import Performance, film, make_cameras

from dousa.estimation import read_cameras, read_offsets, write_cameras, write_keypoints


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("films")
    performance, cameras = Performance(("punch", "turn_around", "kick_left")), make_cameras(2)
    for camera, begin, rate in zip(cameras, (0.3, 0.95), (30.0, 25.0), strict=True):
        write_keypoints(folder / f"{camera.name}.npz", film(performance, camera, begin, 3.0, rate))
    write_cameras(folder / "calib.toml", cameras)
    return folder


def test_offsets_are_said_and_written(dousa, scene, tmp_path):
    films = [str(scene / "film1.npz"), str(scene / "film2.npz")]
    target = tmp_path / "sync.toml"
    code, out, error = dousa("sync", *films, "-o", str(target), "--cameras", str(scene / "calib.toml"), "--json")
    assert (code, error) == (0, "")
    answer = json.loads(out)
    assert [row["name"] for row in answer["films"]] == ["film1", "film2"]
    assert answer["films"][1]["offset"] == pytest.approx(0.65, abs=0.01)
    assert answer["films"][1]["basis"] == "movement" and answer["films"][1]["by_sound"] is None
    assert answer["warnings"] == [] and answer["output"] == str(target)
    assert read_offsets(target, ["film2"])[0] == pytest.approx(answer["films"][1]["offset"], abs=1e-6)
    code, out, _ = dousa("sync", *films, "--cameras", str(scene / "calib.toml"))
    assert code == 0 and "film1: +0.0000 s, the first film" in out and "by movement" in out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("{0}/film1.npz",), "two films or more"),
        (("{0}/film1.npz", "{0}/none.npz"), "none.npz"),
        (("{0}/film1.npz", "{0}/film1.npz"), "'film1', 'film1'|twice"),
        (("{0}/film1.npz", "{0}/calib.toml"), "calib.toml"),
        (("{0}/film1.npz", "{0}/film2.npz", "--cameras", "{0}/film1.npz"), "film1.npz"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(dousa, scene, tmp_path, words, says):
    target = tmp_path / "sync.toml"
    code, out, error = dousa("sync", *(word.format(scene) for word in words), "-o", str(target))
    assert (code, out, error.count("\n")) == (2, "", 1), error
    assert any(part in error for part in says.split("|")), error
    assert not target.exists()


def test_cameras_are_said_written_and_drawn(dousa, scene, tmp_path):
    films = [str(scene / "film1.npz"), str(scene / "film2.npz")]
    target, picture, times = tmp_path / "calib.toml", tmp_path / "cameras.png", tmp_path / "sync.toml"
    times.write_text('[[film]]\nname = "film1"\noffset = 0.0\n[[film]]\nname = "film2"\noffset = 0.65\n')
    words = ("calibrate", *films, "--stature", "1.7", "--cameras", str(scene / "calib.toml"), "--offsets", str(times))
    code, out, error = dousa(*words, "-o", str(target), "-o", str(picture), "--json")
    assert (code, error) == (0, "")
    answer = json.loads(out)
    assert [row["name"] for row in answer["cameras"]] == ["film1", "film2"]
    assert all(row["focal"] == pytest.approx(1500) and row["share"] > 0.8 for row in answer["cameras"])
    assert answer["parallax_degrees"] == pytest.approx(75, abs=15) and answer["offsets"] is None
    made, true = read_cameras(target), read_cameras(scene / "calib.toml")
    apart = [float(np.linalg.norm(a.position - b.position)) for a, b in (made, true)]
    assert apart[0] == pytest.approx(apart[1], rel=0.2)
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, out, _ = dousa(*words)
    assert code == 0 and "film2: at (" in out and "between the lines of sight" in out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("{0}/film1.npz", "{0}/film2.npz"), "either --stature"),
        (("{0}/film1.npz", "{0}/film2.npz", "--stature", "1.7", "--board", "charuco:5x7:4cm:3cm"), "either --stature"),
        (("{0}/film1.npz", "--stature", "1.7"), "two films or more"),
        (("{0}/film1.npz", "{0}/film2.npz", "--stature", "175", "--offsets", "none"), "0.5 to 2.6 m"),
        (
            ("{0}/film1.npz", "{0}/film2.npz", "--stature", "1.7", "--focal-length", "3", "--offsets", "none"),
            "focal length",
        ),
        (("{0}/film1.npz", "{0}/film2.npz", "--stature", "1.7", "--offsets", "{0}/none.toml"), "none.toml"),
        (("{0}/film1.npz", "{0}/film2.npz", "--stature", "1.7", "-o", "b.toml"), "of the same kind"),
        (("{0}/film1.npz", "{0}/film2.npz", "--board", "9x6"), "chessboard:9x6:25mm"),
        (("{0}/calib.toml", "{0}/film2.npz", "--board", "charuco:5x7:40mm:30mm"), "calib.toml"),
    ],
)
def test_mistakes_about_cameras_are_one_line(dousa, scene, tmp_path, words, says):
    target = tmp_path / "calib.toml"
    code, out, error = dousa("calibrate", *(word.format(scene) for word in words), "-o", str(target))
    assert (code, out, error.count("\n")) == (2, "", 1), error
    assert says in error and not target.exists()
