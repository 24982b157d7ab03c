"""A film with a cut, or of a camera that moves, is refused; people, light and a covered lens do neither."""

import numpy as np
import pytest

from dousa.errors import CalibrationError
from dousa.estimation.cameras.steadiness import check_steady

SIZE = (320, 240)


def make_room(seed):
    """A wall of bright and dark patches, larger than the picture."""
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(seed)
    return cv2.resize(rng.integers(30, 220, (48, 60), np.uint8), (480, 360), interpolation=cv2.INTER_CUBIC)


def look(room, x=0.0, y=0.0):
    """The picture of a camera that looks x and y px beside the middle of a room."""
    cv2 = pytest.importorskip("cv2")
    shift = np.array([[1.0, 0.0, -80.0 - x], [0.0, 1.0, -60.0 - y]])
    return cv2.warpAffine(room, shift, SIZE)


def write_film(path, pictures, rate=20, keys=12):
    av = pytest.importorskip("av")
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height = SIZE
        stream.bit_rate, stream.gop_size = 4_000_000, keys
        for picture in pictures:
            noisy = np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(noisy[..., None].repeat(3, axis=2), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def walk(picture, place, width=70):
    """Somebody in stripes walks through a picture."""
    shown = picture.copy()
    left, right = max(0, int(place)), max(0, int(place) + width)
    shown[40:230, left:right] = 90 + 60 * (np.arange(190)[:, None] // 12 % 2)
    return shown


@pytest.mark.parametrize(
    "change",
    [
        lambda room, n: walk(look(room), 8 * n - 80),
        lambda room, n: look(room) * (1.0 if n < 17 else 0.5),
        lambda room, n: look(room, 1.5 * np.sin(n)),
        lambda room, n: walk(look(room), 30 * n - 400, 400) if n < 40 else look(room),
        lambda room, n: np.full(SIZE[::-1], 200.0),
    ],
    ids=["walk", "light", "shaking floor", "lens covered for a while", "blank"],
)
def test_a_camera_that_stands_still_is_taken(tmp_path, change):
    room = make_room(1)
    check_steady(write_film(tmp_path / "film.mp4", [change(room, n) for n in range(45)]))


@pytest.mark.parametrize("stop", [100, 33])
def test_a_cut_is_told_to_the_picture(tmp_path, stop):
    rooms = make_room(1), make_room(2)
    pictures = [walk(look(rooms[23 <= n < stop]), 8 * n - 80) for n in range(45)]
    with pytest.raises(CalibrationError) as caught:
        check_steady(write_film(tmp_path / "film.mp4", pictures))
    assert caught.value.code == "steady.cut" and "cut at 1.1 s" in str(caught.value) and "film.mp4" in str(caught.value)


@pytest.mark.parametrize(
    "move",
    [lambda n: (0.4 * n, 0.0), lambda n: (6.0 * n - 40, 0.0), lambda n: (12.0 * (n > 25), 0.0),
     lambda n: (8 * np.sin(0.5 * n), 6 * np.sin(0.3 * n))],
    ids=["drift", "pan", "knock", "hand"],
)  # fmt: skip
def test_a_camera_that_moves_is_refused(tmp_path, move):
    room = make_room(1)
    pictures = [walk(look(room, *move(n)), 8 * n - 80) for n in range(45)]
    with pytest.raises(CalibrationError) as caught:
        check_steady(write_film(tmp_path / "film.mp4", pictures))
    assert caught.value.code == "steady.moves" and "stands still" in str(caught.value)


def test_of_long_films_key_pictures_are_enough_and_a_cut_is_told_to_the_picture(tmp_path):
    rooms = make_room(1), make_room(2)
    pictures = [walk(look(rooms[n >= 300]), n % 300) for n in range(370)]
    with pytest.raises(CalibrationError, match=r"cut at 60\.0 s"):
        check_steady(write_film(tmp_path / "film.mp4", pictures, rate=5, keys=40))


def test_what_is_no_film_is_left_to_its_reader(tmp_path):
    (tmp_path / "film.mp4").write_text("no film")
    check_steady(tmp_path / "film.mp4")
    check_steady(tmp_path / "none.mp4")
