"""What lies around a moment of a recording: the channels in cells of seconds, and in cells of movement.

Every fifth of a second is a moment. Around each lie eight cells of 0.25 to 1 s, and eight cells of equal movement,
which a quick and a slow performer fill alike. From running sums come the spread of all channels in each cell, and in
the cells of seconds their mean; means over cells of movement say nothing more. The positions are smoothed more than for
clips: a labeller shall not hear the noise of a sensor.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.retrieval.features.channels import (
    CHANNEL_RATE,
    CHANNELS,
    MIRRORED_CHANNELS,
    compute_channels,
    smooth_positions,
)

HOP = 6
"""Frames at 30 Hz from one moment to the next."""

REACH = 120
"""Frames on either side of a moment beyond which nothing of it is seen."""

_SMOOTHING = 2.0  # frames, standard deviation
_SECONDS = np.array([-2.0, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 2.0])
_PER_SECOND = 3.5  # movement of a second of an ordinary action: body heights, summed over head, elbows, hands and feet
_AT_REST = 0.5  # body heights a second, as in the motion time of clips
_FIRST_MOVING = [channel.name for channel in CHANNELS].index("body moving to the left")
_N_SPEEDS = 7
_PADDING = 60  # frames that the body stands still before and after a recording
_MARGIN = REACH + 40  # frames on either side of a chunk: channels are smoothed over time, headings with 8 frames
_CHUNK = 4092  # frames, a multiple of the hop

N_VALUES = 3 * (len(_SECONDS) - 1) * len(CHANNELS)
"""F, numbers that describe a moment."""


def count_moments(n_frames: int) -> int:
    """Moments of a recording of so many frames at 30 Hz; the last one may stand for fewer than ``HOP`` frames."""
    return -(-n_frames // HOP)


def describe_moments(positions: FloatArray, height: float) -> Iterator[tuple[slice, NDArray[np.float32]]]:
    """The moments of a recording, some two minutes at a time.

    Parameters
    ----------
    positions : (n, 20, 3) m, canonical joints at 30 Hz, Y up, finite.
    height : m.

    Returns
    -------
    Which moments, and (M, F) their values.
    """
    for first in range(0, len(positions), _CHUNK):
        yield describe_chunk(positions, height, first)


def chunk_starts(n_frames: int) -> range:
    """Where the chunks of a recording begin that `describe_chunk` describes."""
    return range(0, n_frames, _CHUNK)


def describe_chunk(positions: FloatArray, height: float, first: int) -> tuple[slice, NDArray[np.float32]]:
    """The moments of the chunk that begins at a frame: which, and (M, F) their values."""
    from dousa.retrieval.takes.moment_kernels import describe, integrate

    n = len(positions)
    last = min(first + _CHUNK, n)
    low, high = max(first - _MARGIN, 0), min(last + _MARGIN, n)
    rows = compute_channels(smooth_positions(positions[low:high], _SMOOTHING), height)
    size = len(rows) + 2 * _PADDING + 1
    sums, times = np.zeros((size, 2 * rows.shape[1])), np.zeros(size)
    integrate(rows, _PADDING, _FIRST_MOVING, _N_SPEEDS, _AT_REST, sums, times)
    moments = np.minimum(np.arange(first, last, HOP) + 0.5 * HOP, n - 0.5) - low + _PADDING
    values = np.empty((len(moments), N_VALUES), np.float32)
    seconds, efforts = _SECONDS * CHANNEL_RATE, _SECONDS * _PER_SECOND * CHANNEL_RATE
    describe(sums, times, moments, seconds, efforts, float(REACH), values)
    return slice(first // HOP, first // HOP + len(moments)), values


def mirror_moments(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M, F) values of the moments of the mirror image of a recording, from its own."""
    return values[:, MIRRORED_VALUES[0]] * MIRRORED_VALUES[1]


def _list_mirrored() -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Means and spreads of the channels in each cell of seconds, then spreads in each cell of movement."""
    order, signs = MIRRORED_CHANNELS
    alike, cells = np.ones(len(signs)), len(_SECONDS) - 1
    all_signs = np.concatenate([*([signs, alike] * cells), *([alike] * cells)])
    places = np.concatenate([order + len(order) * k for k in range(3 * cells)])
    return places, all_signs.astype(np.float32)


MIRRORED_VALUES: tuple[NDArray[np.intp], NDArray[np.float32]] = _list_mirrored()
"""(F,) each: which value of a moment is which one of its mirror image, and its sign there."""
