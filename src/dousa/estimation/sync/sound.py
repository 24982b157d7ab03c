"""The sound of films, and the time between two recordings of it.

Generalised cross-correlation with the phase transform (Knapp and Carter, The generalized correlation method for
estimation of time delay, 1976): all frequencies count equally, so that the peak is sharp for any sound. Bands in which
a recording is silent would amplify noise and count less.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError
from dousa.extras import require

_SHORTEST = 0.5  # s of sound that can tell a time, see docs/estimation.md
SOUND_RATE = 8000
"""Hz of the samples of a `Sound`, by its definition."""


@dataclass(frozen=True, slots=True, eq=False)
class Sound:
    """The sound of a film.

    Parameters
    ----------
    samples : (N,) -1 to 1, one channel at `SOUND_RATE`.
    start : s, of the first sample, since the first image of the film.
    """

    samples: FloatArray
    start: float = 0.0


@dataclass(frozen=True, slots=True)
class SoundLag:
    """The time between two recordings of one sound.

    Parameters
    ----------
    lag : s, added to the second film's own time to get that of the first.
    clarity : height of the peak by that of the next one elsewhere; about 1 by chance.
    """

    lag: float
    clarity: float


def read_sound(path: str | os.PathLike[str], longest: float = 1800.0) -> Sound | None:
    """Read the sound of a film, at most ``longest`` s; None if it has none or is silent.

    Raises
    ------
    CalibrationError : missing, or no film.
    MissingExtraError : PyAV is not installed.
    """
    av = require("av", "film")
    if not os.path.isfile(path):
        raise CalibrationError("sync.no_film").at(path)
    try:
        with av.open(os.fspath(path)) as container:
            if not container.streams.audio:
                return None
            pictures = container.decode(video=0) if container.streams.video else ()
            first = next((float(frame.time or 0.0) for frame in pictures), 0.0)
        with av.open(os.fspath(path)) as container:
            return _decode(av, container, first, longest)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise CalibrationError("sync.unreadable", reason=str(error)[:200]).at(path) from error


def _decode(
    av: object, container: object, first: float, longest: float, shortest: float = _SHORTEST, silent: float = 1e-4
) -> Sound | None:
    """Decode the sound; None if it is under ``shortest`` s, or its root mean square under ``silent`` of full scale."""
    resampler = av.AudioResampler(format="flt", layout="mono", rate=SOUND_RATE)  # type: ignore[attr-defined]
    parts: list[FloatArray] = []
    start: float | None = None
    count = 0
    try:
        for frame in container.decode(audio=0):  # type: ignore[attr-defined]
            start = float(frame.time or 0.0) if start is None else start
            for piece in resampler.resample(frame):
                parts.append(np.asarray(piece.to_ndarray(), np.float64).ravel())
                count += len(parts[-1])
            if count > longest * SOUND_RATE:
                break
    except av.error.FFmpegError:  # type: ignore[attr-defined]
        pass  # what was decoded so far counts
    samples = np.concatenate(parts) if parts else np.zeros(0)
    if len(samples) < shortest * SOUND_RATE or np.sqrt(np.mean(samples**2)) < silent:
        return None
    return Sound(samples, (start or 0.0) - first)


def find_sound_lag(
    first: Sound,
    second: Sound,
    *,
    band: tuple[float, float] = (80.0, 3600.0),
    whitening: float = 0.8,
    shortest: float = _SHORTEST,
    around: float = 0.1,
    least_height: float = 7.0,
    least_clarity: float = 1.4,
) -> SoundLag | None:
    """Find the time between two recordings of one sound; None if there is no clear common one.

    Parameters
    ----------
    first, second : the recordings.
    band : Hz; below is wind and hum, above phones differ.
    whitening : 1 is the phase transform.
    shortest : s of a recording.
    around : s about a peak that belong to it: echoes.
    least_height : of a peak, by the spread of the rest.
    least_clarity : see `SoundLag`.
    """
    if min(len(first.samples), len(second.samples)) < shortest * SOUND_RATE:
        return None
    size = 1 << (len(first.samples) + len(second.samples) - 1).bit_length()
    one, two = (np.fft.rfft(sound.samples - sound.samples.mean(), size) for sound in (first, second))
    cross = one * np.conj(two)
    frequencies = np.fft.rfftfreq(size, 1.0 / SOUND_RATE)
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    strength = np.abs(cross)
    floor = 1e-3 * float(strength[inside].mean()) + 1e-12
    cross = np.where(inside, cross / (strength + floor) ** whitening, 0.0)
    correlation = np.fft.irfft(cross, size)
    # Sample i + s of the first is sample i of the second.
    shifts = np.arange(-(len(second.samples) - 1), len(first.samples))
    found = correlation[shifts]
    peak = int(np.argmax(found))
    reach = int(around * SOUND_RATE)
    others = np.delete(found, slice(max(0, peak - reach), peak + reach + 1))
    if not len(others) or found[peak] < least_height * others.std() or found[peak] <= 0:
        return None
    clarity = float(found[peak] / max(1e-12, others.max()))
    if clarity < least_clarity:
        return None
    lag = (shifts[peak] + _refine(found, peak)) / SOUND_RATE + first.start - second.start
    return SoundLag(float(lag), clarity)


def _refine(values: FloatArray, peak: int) -> float:
    """Return the top of a parabola between the samples, -0.5 to 0.5."""
    if not 0 < peak < len(values) - 1:
        return 0.0
    before, top, after = values[peak - 1 : peak + 2]
    bend = before - 2.0 * top + after
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5))
