"""The sound of films: read with its place in time, and compared."""

import fractions

import numpy as np
import pytest

from dousa.errors import CalibrationError
from dousa.estimation import Sound, read_sound
from dousa.estimation.sync.sound import SOUND_RATE, find_sound_lag


def make_room(seconds: float, seed: int = 0):
    """Claps in a room with echoes, at 48 kHz."""
    rng = np.random.default_rng(seed)
    sound = np.zeros(int(48000 * seconds))
    for place in rng.integers(0, len(sound) - 4800, int(3 * seconds)):
        sound[place : place + 2400] += rng.normal(0, 0.4, 2400) * np.exp(-np.arange(2400) / 300)
    for delay, gain in ((480, 0.5), (1100, 0.3), (2900, 0.2)):
        sound[delay:] += gain * sound[:-delay]
    return sound


def hear(sound, first, seconds, rng):
    """A phone's recording at 8 kHz, with its own noise."""
    cut = sound[int(first * 48000) : int((first + seconds) * 48000)]
    low = cut[: len(cut) // 6 * 6].reshape(-1, 6).mean(axis=1)
    return Sound(low + rng.normal(0, 0.01, len(low)))


@pytest.mark.parametrize("begin", [0.0, 0.73125, 2.5])
def test_the_lag_of_two_recordings_is_found_to_a_millisecond(begin):
    rng = np.random.default_rng(1)
    sound = make_room(8.0)
    lag = find_sound_lag(hear(sound, 1.0, 5.0, rng), hear(sound, begin, 4.0, rng))
    assert lag is not None and lag.lag == pytest.approx(begin - 1.0, abs=1e-3)


def test_where_recordings_begin_counts():
    rng = np.random.default_rng(1)
    sound = make_room(6.0)
    first, second = hear(sound, 0.0, 4.0, rng), hear(sound, 1.0, 4.0, rng)
    lag = find_sound_lag(Sound(first.samples, 0.1), Sound(second.samples, -0.2))
    assert lag is not None and lag.lag == pytest.approx(1.0 + 0.1 + 0.2, abs=1e-3)


def test_different_rooms_have_no_common_sound():
    rng = np.random.default_rng(2)
    assert find_sound_lag(hear(make_room(6, 1), 0, 5, rng), hear(make_room(6, 2), 0, 5, rng)) is None
    assert find_sound_lag(Sound(np.zeros(100)), Sound(np.zeros(100))) is None
    assert find_sound_lag(Sound(np.zeros(8000)), Sound(np.zeros(8000))) is None


def write_film(path, sound, late, pictures=True):
    """A film whose sound begins ``late`` s after its first picture."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        if pictures:
            video = container.add_stream("mpeg4", rate=25)
            video.width = video.height = 64
        audio = container.add_stream("aac", rate=48000, layout="mono")
        audio.time_base = fractions.Fraction(1, 48000)
        if pictures:
            for number in range(50):
                frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), number, np.uint8), format="rgb24")
                frame.pts = number
                container.mux(video.encode(frame))
            container.mux(video.encode(None))
        if sound is not None:
            for place in range(0, len(sound) - 1024, 1024):
                piece = np.clip(sound[None, place : place + 1024], -1, 1).astype(np.float32)
                frame = av.AudioFrame.from_ndarray(piece, format="fltp", layout="mono")
                frame.sample_rate, frame.time_base = 48000, fractions.Fraction(1, 48000)
                frame.pts = place + int(late * 48000)
                container.mux(audio.encode(frame))
            container.mux(audio.encode(None))


def test_sound_of_films_keeps_its_place(tmp_path):
    sound = make_room(5.0)
    write_film(tmp_path / "a.mp4", sound[: 48000 * 4], 0.0)
    write_film(tmp_path / "b.mp4", sound[48000 : 48000 * 5], 0.5)
    first, second = read_sound(tmp_path / "a.mp4"), read_sound(tmp_path / "b.mp4")
    assert len(first.samples) == pytest.approx(4 * SOUND_RATE, rel=0.05)
    lag = find_sound_lag(first, second)
    assert lag.lag == pytest.approx(1.0 - 0.5, abs=0.005)  # the second film's own time 0.5 is 1.0 of the sound


def test_films_without_sound_and_files_that_are_none(tmp_path):
    write_film(tmp_path / "silent.mp4", np.zeros(48000), 0.0)
    assert read_sound(tmp_path / "silent.mp4") is None
    with pytest.raises(CalibrationError, match="no such film"):
        read_sound(tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("this is no film")
    with pytest.raises(CalibrationError, match=r"text\.mp4: the sound of the film cannot be read"):
        read_sound(tmp_path / "text.mp4")
