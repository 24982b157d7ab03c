"""Linear discriminants of the moments of recordings, which give the probability of each state at a moment.

They are the ridge regression of the state (1 for its own, 0 for others) on all standardised values, in the directions
of Fisher's discriminants. It needs only sums over the moments, so a model without some people is a difference of sums.
Values are clipped to the range of the training moments without the outermost, and kept as bytes.
Source: Hastie, Tibshirani, Friedman, "The elements of statistical learning", 2009, sections 3.4.1 and 4.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.messages import Message
from dousa.retrieval.features.channels import (
    AT_REST,
    CHANNEL_RATE,
    CHANNELS,
    MIRRORED_CHANNELS,
    compute_channels,
    smooth_positions,
)
from dousa.retrieval.forest.forest_file import check
from dousa.retrieval.takes.moment_kernels import describe, integrate, place, place_mirrored

HOP = 6
"""Frames at 30 Hz from one moment to the next: a fifth of a second (docs/takes.md)."""

REACH = 120
"""Frames on either side of a moment that it can depend on: four seconds (docs/takes.md)."""

_SECONDS = np.array([-2.0, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 2.0])  # edges of cells (docs/takes.md)
_FIRST_MOVING = [channel.name for channel in CHANNELS].index("body moving to the left")
_CHUNK = 682 * HOP  # frames, some two minutes (docs/takes.md)

N_VALUES = 3 * (len(_SECONDS) - 1) * len(CHANNELS)
"""F, values of a moment (docs/takes.md)."""


def count_moments(n_frames: int) -> int:
    """Count the moments of a recording at 30 Hz; the last may have fewer than ``HOP`` frames."""
    return -(-n_frames // HOP)


def describe_moments(positions: FloatArray, height: float) -> Iterator[tuple[slice, NDArray[np.float32]]]:
    """Yield the moments of canonical joints (n, 20, 3) m at 30 Hz, Y up, finite: slices, and values (M, F).

    Each slice covers some two minutes; ``height`` in m.
    """
    for first in range(0, len(positions), _CHUNK):
        yield describe_chunk(positions, height, first)


def chunk_starts(n_frames: int) -> range:
    """Return the first frames of the chunks of `describe_chunk`."""
    return range(0, n_frames, _CHUNK)


def describe_chunk(
    positions: FloatArray,
    height: float,
    first: int,
    *,
    smoothing: float = 2.0,
    per_second: float = 3.5,
    padding: int = 60,
    margin: int = REACH + 40,
) -> tuple[slice, NDArray[np.float32]]:
    """Return the slice and the values (M, F) of the moments of the chunk that begins at frame ``first``.

    Parameters
    ----------
    positions, height : as for ``describe_moments``.
    first : frame.
    smoothing : frames, standard deviation.
    per_second : movement of an ordinary action: body heights, summed over head, elbows, hands and feet.
    padding : frames of standing still added before and after.
    margin : frames used on either side of the chunk, as channels are smoothed, headings over 8 frames.
    """
    n = len(positions)
    last = min(first + _CHUNK, n)
    low, high = max(first - margin, 0), min(last + margin, n)
    rows = compute_channels(smooth_positions(positions[low:high], smoothing), height)
    size = len(rows) + 2 * padding + 1
    sums, times = np.zeros((size, 2 * rows.shape[1])), np.zeros(size)
    integrate(rows, padding, _FIRST_MOVING, 7, AT_REST, sums, times)  # seven speeds make motion time
    moments = np.minimum(np.arange(first, last, HOP) + 0.5 * HOP, n - 0.5) - low + padding
    values = np.empty((len(moments), N_VALUES), np.float32)
    seconds, efforts = _SECONDS * CHANNEL_RATE, _SECONDS * per_second * CHANNEL_RATE
    describe(sums, times, moments, seconds, efforts, float(REACH), np.empty_like(sums[:2]), values)
    return slice(first // HOP, first // HOP + len(moments)), values


def mirror_moments(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (M, F) values of the mirror image of a recording from its own."""
    return values[:, MIRRORED_VALUES[0]] * MIRRORED_VALUES[1]


def _list_mirrored() -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    order, signs = MIRRORED_CHANNELS
    same, cells = np.ones(len(signs)), len(_SECONDS) - 1
    all_signs = np.concatenate([*([signs, same] * cells), *([same] * cells)])
    places = np.concatenate([order + len(order) * k for k in range(3 * cells)])
    return places, all_signs.astype(np.float32)


MIRRORED_VALUES: tuple[NDArray[np.intp], NDArray[np.float32]] = _list_mirrored()
"""(F,) each: the value of a moment that gives each value of its mirror image, and the sign."""


Codes = NDArray[np.uint8]
Floats = NDArray[np.float32]

_STEPS = 255.0  # by definition the largest byte


@dataclass(frozen=True, slots=True)
class Scale:
    """A conversion of values to bytes, and of bytes to standard scores.

    Parameters
    ----------
    lows : (F,) float32, values at 0.
    scales : (F,) float32, steps per unit.
    means, spreads : (F,) float32, in steps.
    """

    lows: Floats
    scales: Floats
    means: Floats
    spreads: Floats

    def encode(self, values: Floats) -> Codes:
        """Return the (M, F) bytes of the values of moments."""
        return np.rint(self.place(values)).astype(np.uint8)

    def standardise(self, codes: Codes) -> Floats:
        """Return (M, F + 1) standard scores of bytes, and a column of ones."""
        scores = np.ones((len(codes), codes.shape[1] + 1), np.float32)
        np.subtract(codes, self.means, out=scores[:, :-1])
        scores[:, :-1] /= self.spreads
        return scores

    def place(self, values: Floats) -> Floats:
        """Return (M, F) steps from 0 to 255, not rounded."""
        placed = np.empty(values.shape, np.float32)
        place(values, self.lows, self.scales, np.float32(_STEPS), placed)
        return placed

    def place_mirrored(self, values: Floats, order: IntArray, signs: Floats) -> Floats:
        """Return the same of mirror images: value ``order`` (F,) times ``signs`` (F,) gives that of the image."""
        placed = np.empty(values.shape, np.float32)
        place_mirrored(values, order, signs, self.lows, self.scales, np.float32(_STEPS), placed)
        return placed


def choose_scale(values: Floats) -> Scale:
    """Choose the scale that covers moments (M, F) from the 1st to the 99th percentile."""
    low, high = np.percentile(values, (1.0, 99.0), axis=0).astype(np.float32)
    scales = (_STEPS / np.maximum(high - low, 1e-6)).astype(np.float32)
    placed = np.clip((values - low) * scales, 0.0, _STEPS)
    return Scale(low, scales, placed.mean(axis=0), placed.std(axis=0) + np.float32(1.0))


@dataclass(frozen=True, slots=True, eq=False)
class MomentModel:
    """Discriminants of the states of moments.

    Parameters
    ----------
    scale : of the values.
    weights : (F + 1, S) of the standard scores; the last row is the offset.
    sharpness : factor from a difference of discriminants to one of log probabilities.
    """

    scale: Scale
    weights: Floats
    sharpness: float
    _folded: Floats = field(init=False, repr=False)
    _added: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        folded = self.weights[:-1] / self.scale.spreads[:, None]
        object.__setattr__(self, "_added", self.weights[-1] - self.scale.means @ folded)
        object.__setattr__(self, "_folded", folded)

    def judge(self, values: Floats) -> Floats:
        """Return the (M, S) discriminants of the states at moments, from their values (M, F)."""
        return self._weigh(self.scale.place(values))

    def judge_mirrored(self, values: Floats) -> Floats:
        """Return the same of the mirror images."""
        return self._weigh(self.scale.place_mirrored(values, *MIRRORED_VALUES))

    def _weigh(self, placed: Floats) -> Floats:
        scores: Floats = placed @ self._folded
        scores += self._added
        return scores

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays by name."""
        scale = self.scale
        return {
            "lows": scale.lows,
            "scales": scale.scales,
            "means": scale.means,
            "deviations": scale.spreads,
            "discriminants": self.weights,
            "sharpness": np.array(self.sharpness, np.float64),
        }


MODEL_ARRAYS = ("lows", "scales", "means", "deviations", "discriminants", "sharpness")
"""Names of the arrays of a model."""


def read_moment_model(arrays: dict[str, NDArray[Any]], n_states: int, n_values: int, what: Message) -> MomentModel:
    """Read the model of stored arrays; DousaError that ``what`` is damaged if they are invalid."""
    lows, scales, means, spreads, weights, sharpness = (arrays[name] for name in MODEL_ARRAYS)
    rows = lows, scales, means, spreads
    right = all(one.shape == (n_values,) and one.dtype == np.float32 and bool(np.isfinite(one).all()) for one in rows)
    check(right and bool((spreads > 0.5).all()), what, "bad scale")
    right = weights.shape == (n_values + 1, n_states) and weights.dtype == np.float32
    check(right and bool((np.abs(weights) < 1e6).all()), what, "bad discriminants")
    right = sharpness.shape == () and sharpness.dtype == np.float64 and bool(np.isfinite(sharpness))
    check(right and 0 < float(sharpness) < 1e3, what, "bad sharpness")
    return MomentModel(Scale(lows, scales, means, spreads), weights, float(sharpness))


def are_mirrored(
    scale: Scale, values: Floats, images: Floats, categories: NDArray[np.integer[Any]], least: float = 0.55
) -> bool:
    """Return whether two categories are each most similar to the mirror image of the other, above a ``least`` cosine.

    ``values`` and ``images`` (N, F) are of moments and their mirror images, ``categories`` (N,) of the moments.
    """
    there = np.unique(categories)
    if len(there) < 2:
        return False
    means = []
    for some in (values, images):
        scores = scale.standardise(scale.encode(some))[:, :-1]
        means.append(np.stack([scores[categories == one].mean(axis=0, dtype=np.float64) for one in there]))
    own, mirrored = means
    products = mirrored @ own.T
    sizes = (mirrored**2).sum(axis=1)[:, None], (own**2).sum(axis=1)
    cosines = products / np.maximum(np.sqrt(sizes[0] * sizes[1]), 1e-12)
    nearest = (sizes[0] + sizes[1] - 2.0 * products).argmin(axis=1)
    places = np.arange(len(there))
    mutual = (nearest != places) & (nearest[nearest] == places)
    return bool((cosines[places, nearest][mutual] > least).any())


def sharpen(scores: Floats, sharpness: float) -> Floats:
    """Return (M, S) probabilities from discriminants (M, S)."""
    shares: Floats = scores - scores.max(axis=1, keepdims=True)
    shares *= np.float32(sharpness)
    np.exp(shares, out=shares)
    shares /= shares.sum(axis=1, keepdims=True)
    return shares
