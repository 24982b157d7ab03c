"""The beats of a piece of music: a list of times, from a text file or from elsewhere, checked once.

A beats file has one time in seconds a line. What follows on the line, after a comma, semicolon, space or tab, is a
label: so Sonic Visualiser, madmom and ``librosa`` write beats, and Audacity its label tracks (start, end, label). A
heading, empty lines, lines that begin with ``#`` and Audacity's lines of frequencies (``\\``) are passed over.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError, OptionError
from dousa.files.disk import read_small_text

_FEWEST = 4  # beats: of fewer no tempo can be told
_CLOSEST_S = 0.1  # apart: 600 a minute
_SHOWN = 40  # letters of a wrong line in a message
_SEPARATOR = re.compile(r"[\s,;]+")


@dataclass(frozen=True, slots=True, eq=False)
class Beats:
    """Beats of a piece of music.

    Parameters
    ----------
    times : (B,) s from the beginning of the music, rising.
    """

    times: FloatArray

    def __post_init__(self) -> None:
        times = np.array(self.times, np.float64)
        if times.ndim != 1 or len(times) < _FEWEST:
            raise OptionError("beats.too_few", least=_FEWEST, n=times.size)
        if not np.isfinite(times).all():
            raise OptionError("beats.not_finite", number=int(np.flatnonzero(~np.isfinite(times))[0]) + 1)
        close = np.flatnonzero(np.diff(times) < _CLOSEST_S)
        if len(close):
            first = int(close[0])
            code = "beats.unsorted" if times[first + 1] <= times[first] else "beats.too_close"
            raise OptionError(code, number=first + 2, time=float(times[first + 1]), before=float(times[first]))
        times.flags.writeable = False
        object.__setattr__(self, "times", times)

    @property
    def period_s(self) -> float:
        """Median time from one beat to the next."""
        return float(np.median(np.diff(self.times)))

    @property
    def tempo(self) -> float:
        """Beats a minute."""
        return 60.0 / self.period_s


def to_beats(beats: Beats | ArrayLike) -> Beats:
    """Beats from times in seconds.

    Raises
    ------
    OptionError : fewer than four, not in order, closer than 0.1 s, or not finite.
    """
    if isinstance(beats, Beats):
        return beats
    try:
        times = np.asarray(beats, np.float64)
    except (TypeError, ValueError) as error:
        raise OptionError("beats.no_numbers") from error
    return Beats(times)


def read_beats(path: str | os.PathLike[str]) -> Beats:
    """Read the beats of a text file.

    Parameters
    ----------
    path : text as the module's docstring says.

    Raises
    ------
    MotionFileError : the file cannot be read; a line without a time; what `to_beats` does not take.
    """
    times: list[float] = []
    heading = False
    for number, line in enumerate(read_small_text(path).splitlines(), 1):
        content = line.strip()
        if not content or content[0] in "#\\":
            continue
        try:
            time = float(_SEPARATOR.split(content, maxsplit=1)[0].strip("\"'"))
        except ValueError:
            if times or heading:
                raise MotionFileError(path, "beats.no_time", line=number, found=repr(content[:_SHOWN])) from None
            heading = True
            continue
        if not np.isfinite(time):
            raise MotionFileError(path, "beats.no_time", line=number, found=repr(content[:_SHOWN]))
        times.append(time)
    try:
        return Beats(np.array(times))
    except OptionError as error:
        raise MotionFileError(path, error.message) from None
