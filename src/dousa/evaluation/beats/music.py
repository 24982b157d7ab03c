"""The beats of a recording of music, by the beat tracker of librosa (the extra ``music``).

Source: D. P. W. Ellis, "Beat tracking by dynamic programming", Journal of New Music Research 36(1), 51-60, 2007, as
`librosa.beat.beat_track` has it. Beats are found on a grid of 12 ms.
"""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError, OptionError
from dousa.evaluation.beats.beat_times import Beats
from dousa.extras import require

_RATE = 22_050  # Hz
_HOP = 256  # samples from one value of the onset curve to the next
_SILENT = 1e-4  # of full scale: nothing louder is silence
_LONGEST_S = 3600.0


def find_beats(path: str | os.PathLike[str]) -> Beats:
    """The beats of a sound file.

    Parameters
    ----------
    path : WAV, FLAC, OGG, MP3 and what else libsndfile reads; up to an hour.

    Raises
    ------
    MissingExtraError : the extra ``music`` is not installed.
    MotionFileError : no sound file, silent, too long, or without a beat.
    """
    librosa, soundfile = require("librosa", "music"), require("soundfile", "music")
    samples, rate = _read(soundfile, path)
    if not len(samples) or float(np.abs(samples).max()) < _SILENT:
        raise MotionFileError(path, "beats.silent", seconds=len(samples) / rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of very short pieces: an error of ours follows
        samples = librosa.resample(samples, orig_sr=rate, target_sr=_RATE)
        onsets = librosa.onset.onset_strength(y=samples, sr=_RATE, hop_length=_HOP, aggregate=np.median)
        _, frames = librosa.beat.beat_track(onset_envelope=onsets, sr=_RATE, hop_length=_HOP, trim=False)
    times = np.asarray(frames, np.float64) * _HOP / _RATE
    try:
        return Beats(times)
    except OptionError:
        raise MotionFileError(path, "beats.no_beat", seconds=len(samples) / _RATE) from None


def _read(soundfile: Any, path: str | os.PathLike[str]) -> tuple[FloatArray, int]:
    """Samples (N,) of all channels in one, and their rate."""
    try:
        with soundfile.SoundFile(os.fspath(path)) as file:
            if file.frames > _LONGEST_S * file.samplerate:
                raise MotionFileError(path, "beats.too_long", minutes=file.frames / file.samplerate / 60.0)
            samples = file.read(dtype="float32", always_2d=True)
            rate = int(file.samplerate)
    except (soundfile.SoundFileError, OSError, ValueError, TypeError) as error:
        raise MotionFileError(path, "beats.not_sound", reason=str(error)) from None
    mono: FloatArray = np.nan_to_num(samples.mean(axis=1))
    return mono, rate
