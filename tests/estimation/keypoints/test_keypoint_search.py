"""A film is looked at once, goes on after an interruption, and is upright and on time; without networks."""

import os
import time
from typing import ClassVar

import numpy as np
import pytest
from oracles.film_files import N_FRAMES, turn_film, write_film
from oracles.made_people import see

from dousa.errors import KeypointError, OptionError
from dousa.estimation import find_keypoints
from dousa.estimation.keypoints import keypoint_search
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.keypoints.keypoint_cache import clear_kept, list_kept
from dousa.estimation.keypoints.people import SIGHTING, PeopleFollower

av = pytest.importorskip("av", reason="PyAV is not installed (dousa[film])")
cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (dousa[film])")


def read_all(path):
    with FilmFrames(path) as film:
        return film.size, list(film.read())


def test_frames_have_their_own_times(tmp_path):
    times = [0, 33, 70, 100, 180, 200, 240]
    size, frames = read_all(write_film(tmp_path / "a.mp4", times))
    assert size == (96, 64)
    np.testing.assert_allclose([time for _, time, _ in frames], np.array(times) / 1000, atol=1e-6)
    assert [number for number, *_ in frames] == list(range(7))


@pytest.mark.parametrize(
    ("matrix", "size"), [((0, 1, -1, 0), (64, 96)), ((0, -1, 1, 0), (64, 96)), ((-1, 0, 0, -1), (96, 64))]
)
def test_turned_films_come_upright_as_players_show_them(tmp_path, matrix, size):
    path = turn_film(write_film(tmp_path / "a.mp4"), tmp_path / "turned.mp4", matrix)
    found, frames = read_all(path)
    assert found == size
    capture = cv2.VideoCapture(str(path))
    good, expected = capture.read()
    capture.release()
    assert good and expected.shape == frames[0][2].shape
    assert np.abs(expected[..., ::-1].astype(int) - frames[0][2]).mean() < 3


def test_a_film_cut_off_ends_early_and_says_so(tmp_path, found_by):
    path = write_film(tmp_path / "a.mkv")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    view = find_keypoints(path, cache=tmp_path / "cache")
    assert 1 < view.n_frames < N_FRAMES
    assert [warning.code for warning in view.warnings] == ["film.truncated"]


def test_a_film_damaged_in_the_middle_says_so_each_time(tmp_path, found_by, monkeypatch):
    path = write_film(tmp_path / "a.mp4")

    def read(self, skip=0):
        for frame, seconds, picture in read_whole(self, skip):
            self.n_damaged = max(self.n_damaged, frame // 10)
            yield frame, seconds, picture

    read_whole = FilmFrames.read
    monkeypatch.setattr(FilmFrames, "read", read)
    for _ in range(2):
        (warning,) = find_keypoints(path, cache=tmp_path / "cache").warnings
        assert str(warning) == "a.mp4: 2 pieces are damaged; pictures there are missing or wrong"


@pytest.mark.parametrize(
    ("content", "code"), [(None, "film.missing"), (b"", "disk.empty"), (b"hello" * 99, "keypoint_film.unreadable")]
)
def test_what_is_no_film_is_one_clear_error(tmp_path, content, code):
    path = tmp_path / "film.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(KeypointError, match=r"film\.mp4") as caught:
        find_keypoints(path, cache=False)
    assert caught.value.code == code
    with pytest.raises(KeypointError):
        find_keypoints(tmp_path, cache=False)


def test_bad_options(tmp_path):
    with pytest.raises(OptionError, match="lite, full or heavy"):
        find_keypoints(tmp_path / "a.mp4", "huge")
    with pytest.raises(OptionError, match="1 to 16"):
        find_keypoints(tmp_path / "a.mp4", most_people=0)


class FakeDetector:
    """Finds nobody."""

    def __init__(self, threads=None):
        self.n_asked = 0

    def find(self, picture, part=None):
        self.n_asked += 1
        return []


class FakeLandmarks:
    """Is asked nothing."""

    def __init__(self, model="full", threads=None):
        self.model = model


class FakeFollower(PeopleFollower):
    """Two people who walk, known from the number of the frame alone."""

    asked: ClassVar[list[int]] = []
    stop_at: int | None = None
    resumed: ClassVar[list[int]] = []

    def see(self, frame, picture):
        if frame == type(self).stop_at:
            raise KeyboardInterrupt
        type(self).asked.append(frame)
        rows = [see(frame, 0, 20 + frame, colour=1, size=60), see(frame, 1, 80 - frame, y=9, colour=2, size=30)]
        return np.array(rows, SIGHTING)

    def resume(self, sightings, last_frame):
        type(self).resumed.append(last_frame)
        super().resume(sightings, last_frame)


@pytest.fixture
def found_by(tmp_path, monkeypatch):
    """The search with made networks; the follower that was used."""
    model = tmp_path / "model.tflite"
    model.write_bytes(b"model")
    monkeypatch.setattr(keypoint_search, "find_pose_model", lambda name: model)
    monkeypatch.setattr(keypoint_search, "PersonDetector", FakeDetector)
    monkeypatch.setattr(keypoint_search, "LandmarkNetwork", FakeLandmarks)
    monkeypatch.setattr(keypoint_search, "PeopleFollower", FakeFollower)
    FakeFollower.asked, FakeFollower.resumed, FakeFollower.stop_at = [], [], None
    return FakeFollower


def assert_same(one, other):
    assert one.n_people == other.n_people and one.size == other.size
    np.testing.assert_array_equal(one.times, other.times)
    for first, second in zip(one.people, other.people, strict=True):
        np.testing.assert_array_equal(first.points, second.points)
        np.testing.assert_array_equal(first.visibility, second.visibility)
        np.testing.assert_array_equal(first.world, second.world)
        np.testing.assert_array_equal(first.masks.packed, second.masks.packed)
        np.testing.assert_array_equal(first.masks.crops, second.masks.crops)


def test_a_film_is_looked_at_once(tmp_path, found_by):
    path, cache = write_film(tmp_path / "a.mp4"), tmp_path / "cache"
    progress = []
    first = find_keypoints(path, cache=cache, progress=lambda done, total, what: progress.append((done, total)))
    assert found_by.asked == list(range(N_FRAMES)) and progress[-1] == (N_FRAMES, N_FRAMES)
    assert first.n_people == 2 and first.n_frames == N_FRAMES
    assert first.people[0].points[3, 0, 0] > first.people[1].points[3, 0, 0] - 100
    moved = tmp_path / "moved.mp4"
    os.rename(path, moved)
    again = find_keypoints(moved, cache=cache)
    assert len(found_by.asked) == N_FRAMES and again.source == str(moved)
    assert_same(first, again)
    find_keypoints(moved, "heavy", cache=cache)
    assert len(found_by.asked) == 2 * N_FRAMES


@pytest.mark.parametrize("stop_at", [1, 7, N_FRAMES - 1])
def test_an_interrupted_search_goes_on(tmp_path, found_by, stop_at):
    path = write_film(tmp_path / "a.mp4")
    whole = find_keypoints(path, cache=False)
    assert found_by.resumed == []
    found_by.asked, found_by.stop_at = [], stop_at
    with pytest.raises(KeyboardInterrupt):
        find_keypoints(path, cache=tmp_path / "cache")
    found_by.stop_at = None
    assert_same(find_keypoints(path, cache=tmp_path / "cache"), whole)
    assert found_by.asked == list(range(N_FRAMES)) and found_by.resumed == [stop_at - 1]
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_what_was_half_written_does_not_count(tmp_path, found_by):
    path, cache = write_film(tmp_path / "a.mp4"), tmp_path / "cache"
    whole = find_keypoints(path, cache=False)
    found_by.stop_at = 9
    with pytest.raises(KeyboardInterrupt):
        find_keypoints(path, cache=cache)
    (left,) = cache.iterdir()
    with open(left / "sightings.bin", "ab") as file:
        file.write(b"\x05" * 100)
    with open(left / "times.bin", "rb+") as file:
        file.truncate(8 * 6 + 3)
    found_by.stop_at, found_by.asked = None, []
    assert_same(find_keypoints(path, cache=cache), whole)
    assert found_by.asked == list(range(6, N_FRAMES))


def test_a_damaged_cache_is_made_anew(tmp_path, found_by):
    path, cache = write_film(tmp_path / "a.mp4"), tmp_path / "cache"
    whole = find_keypoints(path, cache=cache)
    masks = np.array(whole.people[0].masks.packed)
    (kept,) = cache.iterdir()
    (kept / "keypoints.npz").write_bytes(b"PK broken")
    found_by.asked = []
    np.testing.assert_array_equal(find_keypoints(path, cache=cache).people[0].masks.packed, masks)
    assert len(found_by.asked) == N_FRAMES


def test_nobody_in_the_film_is_said(tmp_path, found_by, monkeypatch):
    monkeypatch.setattr(found_by, "see", lambda self, frame, picture: np.zeros(0, SIGHTING))
    view = find_keypoints(write_film(tmp_path / "a.mp4"), cache=tmp_path / "cache")
    assert view.people == () and [warning.code for warning in view.warnings] == ["keypoints.nobody"]
    assert find_keypoints(tmp_path / "a.mp4", cache=tmp_path / "cache").people == ()


def test_what_was_used_least_lately_is_forgotten_first(tmp_path):
    for age, name in enumerate(("new", "middle", "old")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "masks.npy").write_bytes(b"x" * 1000)
        os.utime(tmp_path / name, (time.time() - 1e4 * age,) * 2)
    (tmp_path / "busy.123").mkdir()
    (tmp_path / "busy.123" / "times.bin").write_bytes(b"x" * 10)
    assert [film.path.name for film in list_kept(tmp_path)] == ["busy.123", "new", "middle", "old"]
    assert [film.path.name for film in clear_kept(tmp_path, 2500)] == ["old"]
    assert clear_kept(tmp_path, 2500) == []
    assert [film.path.name for film in clear_kept(tmp_path, but=tmp_path / "middle")] == ["new"]
    assert sorted(film.path.name for film in list_kept(tmp_path)) == ["busy.123", "middle"]
    assert list_kept(tmp_path / "none") == [] and clear_kept(tmp_path / "none") == []
