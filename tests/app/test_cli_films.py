"""`dousa sync`: what a person or a program is told about the times of films."""

from __future__ import annotations

import json

import pytest
from oracles.made_films import Performance, film, make_cameras

from dousa.estimation import read_offsets, write_cameras, write_keypoints


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
