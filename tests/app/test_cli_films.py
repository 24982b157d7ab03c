"""`dousa sync`, `dousa calibrate` and `dousa keypoints`: times, cameras and people of films."""

import json

import numpy as np
import pytest
from oracles.made_films import Performance, make_cameras
from oracles.made_films import film as make_film

from dousa.errors import KeypointError
from dousa.estimation import (
    MEDIAPIPE_NAMES,
    PersonMasks,
    PersonTrack,
    ViewKeypoints,
    find_keypoints,
    read_cameras,
    read_keypoints,
    read_offsets,
    write_cameras,
    write_keypoints,
)
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.keypoints.pose_networks import PersonCrop


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("films")
    performance, cameras = Performance(("punch", "turn_around", "kick_left")), make_cameras(2)
    for camera, begin, rate in zip(cameras, (0.3, 0.95), (30.0, 25.0), strict=True):
        write_keypoints(folder / f"{camera.name}.npz", make_film(performance, camera, begin, 3.0, rate))
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
        (("{0}/film1.npz", "{0}/film2.npz", "--stature", "175", "--offsets", "none"), "write 1.75"),
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


def test_keypoints_are_written_with_pictures(succeed, film, tmp_path):
    out = tmp_path / "out"
    answer, _ = succeed("keypoints", film, "-o", out, "--overlay", "--json")
    (told,) = json.loads(answer)["films"]
    assert told["n_frames"] == 12 and told["frame_rate"] == pytest.approx(25) and len(told["people"]) == 1
    expected = {"n_frames": 12, "first_frame": 0, "mean_visibility": 0.9, "visible": 1.0}
    assert told["people"][0] == pytest.approx(expected)
    assert sorted(path.name for path in out.iterdir()) == ["walk.npz", "walk_keypoints.mp4"]
    assert read_keypoints(out / "walk.npz").people[0].masks is not None
    overlay = list(read_video(out / "walk_keypoints.mp4"))[-1]
    assert overlay.shape == (120, 160, 3)
    assert np.ptp(overlay[:60].astype(int), axis=2).max() > 60  # the colour of the person


def test_keypoints_in_words(dousa, film, tmp_path):
    code, out, error = dousa("keypoints", film, "-o", tmp_path / "out")
    assert (code, error) == (0, "")
    assert "12 frames at 25 Hz, 1 person" in out and "person 1: in 12 frames, 100% of the points visible" in out


def read_image(path):
    import cv2

    return cv2.imread(str(path))


def read_video(path):
    with FilmFrames(path) as frames:
        assert frames.n_stated == 12
        yield from (picture for *_, picture in frames.read())


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


@pytest.mark.parametrize("words", [("sync",), ("estimate", "--cues", "silhouettes", "-o", "{0}/x.bvh")])
def test_a_film_with_a_cut_is_refused_with_its_time(dousa, scene, tmp_path, words):
    av, cv2 = pytest.importorskip("av"), pytest.importorskip("cv2")
    rng = np.random.default_rng(0)
    rooms = [cv2.resize(rng.integers(30, 220, (24, 32, 3), np.uint8), (320, 240)) for _ in range(2)]
    for name in ("film1", "film2"):
        with av.open(str(tmp_path / f"{name}.mp4"), "w") as container:
            stream = container.add_stream("mpeg4", rate=20)
            stream.width, stream.height, stream.bit_rate = 320, 240, 2_000_000
            for number in range(30):
                frame = av.VideoFrame.from_ndarray(rooms[number >= 14 and name == "film2"], format="rgb24")
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    films = [str(tmp_path / f"{name}.mp4") for name in ("film1", "film2")]
    more = [word.format(tmp_path) for word in words[1:]]
    code, _, error = dousa(words[0], *films, "--cameras", str(scene / "calib.toml"), *more)
    assert code == 2 and "film2.mp4: the film is cut at 0.7 s" in error and len(error.splitlines()) == 1
