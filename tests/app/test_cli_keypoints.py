"""`dousa keypoints`: the models, and what is found in films."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dousa.errors import KeypointError
from dousa.estimation import (
    MEDIAPIPE_NAMES,
    PersonMasks,
    PersonTrack,
    ViewKeypoints,
    find_keypoints,
    read_keypoints,
)
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.keypoints.person_crops import PersonCrop


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


def test_models_are_listed(dousa, folder):
    code, out, _ = dousa("keypoints", "--json")
    answer = json.loads(out)
    assert code == 0 and answer["folder"] == str(folder)
    assert {name: row["state"] for name, row in answer["models"].items()} == dict.fromkeys(
        ("detector", "lite", "full", "heavy"), "missing"
    )
    code, out, _ = dousa("keypoints")
    assert code == 0 and str(folder) in out and out.count("not installed") == 4 and "Apache-2.0" in out
    assert not folder.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--install", "none.tgz"), "none.tgz: no such file"),
        (("--install", "a.tgz", "b.tgz"), "one package or model"),
        (("--clear-cache", "walk.mp4"), "one package or model"),
    ],
)
def test_mistakes_are_one_line(dousa, folder, words, says):
    code, out, error = dousa("keypoints", *words)
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert says in error
    assert not folder.exists()


@pytest.fixture
def film(tmp_path, monkeypatch):
    """A film in which somebody was found who walks to the right."""
    av = pytest.importorskip("av", reason="PyAV is not installed (dousa[film])")
    pytest.importorskip("cv2", reason="OpenCV is not installed (dousa[film])")
    pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed (dousa[film])")
    path = tmp_path / "walk.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 160, 120, "yuv420p"
        for number in range(12):
            picture = np.full((120, 160, 3), 10 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    rng = np.random.default_rng(0)
    points = rng.uniform(20, 90, (33, 2)) + np.arange(12)[:, None, None]
    mask = np.zeros((12, 128, 128), bool)
    mask[:, 30:90, 40:80] = True
    masks = PersonMasks(np.packbits(mask, axis=2), np.tile(PersonCrop(60, 60, 100, 0).matrix(128), (12, 1, 1)))
    person = PersonTrack(points, np.full((12, 33), 0.9), None, masks)
    found = ViewKeypoints(MEDIAPIPE_NAMES, (person,), np.arange(12) / 25, (160, 120), str(path))
    monkeypatch.setattr("dousa.estimation.find_keypoints", lambda *args, **options: found)
    return path


def test_keypoints_are_written_with_pictures(dousa, film, tmp_path):
    out = tmp_path / "out"
    code, answer, _ = dousa("keypoints", film, "-o", out, "--overlay", "--sheet", "--json")
    assert code == 0
    (told,) = json.loads(answer)["films"]
    assert told["n_frames"] == 12 and told["frame_rate"] == pytest.approx(25) and len(told["people"]) == 1
    expected = {"n_frames": 12, "first_frame": 0, "mean_visibility": 0.9, "visible": 1.0}
    assert told["people"][0] == pytest.approx(expected)
    assert sorted(path.name for path in out.iterdir()) == ["walk.npz", "walk_keypoints.mp4", "walk_keypoints.png"]
    assert read_keypoints(out / "walk.npz").people[0].masks is not None
    sheet, (_, overlay) = read_image(out / "walk_keypoints.png"), list(read_video(out / "walk_keypoints.mp4"))[-2:]
    assert sheet.shape == (360, 640, 3) and overlay.shape == (120, 160, 3)
    assert np.ptp(overlay[:60].astype(int), axis=2).max() > 60  # the colour of the person


def read_image(path):
    import cv2

    return cv2.imread(str(path))


def read_video(path):
    with FilmFrames(path) as frames:
        assert frames.n_stated == 12
        yield from (picture for *_, picture in frames.read())


def test_keypoints_in_words(dousa, film, tmp_path):
    code, out, error = dousa("keypoints", film, "-o", tmp_path / "out")
    assert (code, error) == (0, "")
    assert "12 frames at 25 Hz, 1 person" in out and "person 1: in 12 frames, 100% of the points visible" in out


def test_mistaken_films_are_one_line(dousa, tmp_path, folder):
    pytest.importorskip("av", reason="PyAV is not installed (dousa[film])")
    pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed (dousa[film])")
    (tmp_path / "text.mp4").write_text("hello", encoding="utf-8")
    for words, says in (
        ((tmp_path / "none.mp4",), "none.mp4: no such file"),
        ((tmp_path / "text.mp4",), "text.mp4: cannot be opened as a film"),
        ((tmp_path / "a.mp4", tmp_path / "b" / "a.mp4"), "'a'"),
    ):
        code, out, error = dousa("keypoints", *words, "-o", tmp_path / "out")
        assert (code, out, error.count("\n")) == (2, "", 1)
        assert says in error


def test_a_missing_model_is_one_line_with_the_command(dousa, film, tmp_path, folder, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setenv("DOUSA_MODELS", str(folder))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("sys.argv", ["dousa", "keypoints", str(film), "-o", str(tmp_path / "out")])
    with pytest.raises(KeypointError, match="run: dousa keypoints --install"):
        find_keypoints(film, cache=tmp_path / "cache")
