"""Click tracks of known beats, read by the beat tracker; skipped where the extra ``music`` is not installed."""

import importlib.util
import wave

import numpy as np
import pytest

from dousa.errors import MotionFileError
from dousa.evaluation import find_beats

if importlib.util.find_spec("librosa") is None or importlib.util.find_spec("soundfile") is None:
    pytest.skip("the extra music is not installed", allow_module_level=True)

RATE = 22_050


def write_clicks(path, beats, seconds, loud=0.8):
    """A WAV file with a decaying tone at each beat."""
    samples = np.zeros(round(seconds * RATE))
    t = np.arange(round(0.06 * RATE)) / RATE
    click = loud * np.exp(-t / 0.01) * np.sin(2 * np.pi * 1000.0 * t)
    for beat in beats:
        first = round(beat * RATE)
        part = samples[first : first + len(click)]
        part += click[: len(part)]
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE)
        file.writeframes((samples * 32767).astype("<i2").tobytes())
    return path


@pytest.mark.parametrize("tempo", [96.0, 120.0, 140.0])
def test_clicks_are_the_beats(tmp_path, tempo):
    clicks = 0.4 + np.arange(0.0, 25.0, 60.0 / tempo)
    found = find_beats(write_clicks(tmp_path / "clicks.wav", clicks, 26.0))
    assert found.tempo == pytest.approx(tempo, rel=0.02)
    off = np.abs(found.times[:, None] - clicks).min(axis=1)
    assert np.median(off) <= 0.025
    assert len(found.times) >= 0.9 * len(clicks)


def test_silence(tmp_path):
    with pytest.raises(MotionFileError, match=r"silent\.wav.* silence"):
        find_beats(write_clicks(tmp_path / "silent.wav", [], 5.0))


def test_a_single_click_has_no_beat(tmp_path):
    with pytest.raises(MotionFileError, match="no beat found"):
        find_beats(write_clicks(tmp_path / "click.wav", [0.5], 1.0))


@pytest.mark.parametrize("content", [b"", b"RIFF", b"this is not music\n" * 10])
def test_a_file_without_sound(tmp_path, content):
    path = tmp_path / "song.wav"
    path.write_bytes(content)
    with pytest.raises(MotionFileError, match="cannot be read as sound"):
        find_beats(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(MotionFileError):
        find_beats(tmp_path / "none.wav")
