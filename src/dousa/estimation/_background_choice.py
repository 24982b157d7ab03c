"""Which source shows the true background where the person hides it: the plate, or a colour that the video had.

A plate from another moment may show somebody itself. Where the video never agrees with it there are two cases: the
person of the video stands there all the time and the plate is right, or the plate is wrong and a colour of the video is
the background. The right choice leaves no edges: a background without people is continuous, and whoever is
in it has an outline. So each pixel gets the source that makes the least edges, the pixels around being known;
min-sum belief propagation finds the labels. (The classical ghost test compares the same edges object by object.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["UNUSABLE", "choose_sources"]

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

_SIDE = 240  # px, longer side of the image on which sources are chosen
_ROUNDS = 150
_EDGE_LIMIT = 60.0  # grey levels; an edge costs no more
UNUSABLE = 1000.0
"""Cost of a source that has nothing to offer."""
_SEEN_EDGE = 0.1  # share of an edge's cost inside a colour of the video; edges inside the plate are its own


def choose_sources(
    sources: FloatArray, costs: FloatArray, open_pixels: BoolArray, known: FloatArray
) -> NDArray[np.uint8]:
    """The source of each open pixel.

    Parameters
    ----------
    sources : (3, H, W, 3) grey levels: plate, first and second colour of the video.
    costs : (3, H, W) grey levels, what speaks against a source at a pixel, in the coin of an edge; `UNUSABLE` where
        it has nothing to offer. The first colour of the video is usable everywhere.
    open_pixels : (H, W) where to choose.
    known : (H, W, 3) grey levels, the background elsewhere.

    Returns
    -------
    (H, W) 0, 1 or 2; without meaning outside the open pixels.
    """
    import cv2

    height, width = open_pixels.shape
    step = max(1, round(max(height, width) / _SIDE))
    size = (max(1, width // step), max(1, height // step))

    def shrink(array: NDArray[np.float32]) -> FloatArray:
        return np.asarray(cv2.resize(array, size, interpolation=cv2.INTER_AREA), np.float32)

    share = shrink(open_pixels.astype(np.float32))
    weight = share[..., None] + 1e-6
    masked = open_pixels[..., None]
    small = np.stack([shrink(np.where(masked, source, np.float32(0))) / weight for source in sources])
    around = shrink(np.where(masked, np.float32(0), known)) / (1 - share[..., None] + 1e-6)
    prices = np.stack([shrink(np.where(open_pixels, cost, np.float32(0))) / weight[..., 0] for cost in costs])
    chosen = _propagate(small, prices, share > 0.25, around).astype(np.uint8)
    labels = np.asarray(cv2.resize(chosen, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
    price = np.take_along_axis(costs, labels[None].astype(np.intp), 0)[0]
    labels[price >= UNUSABLE] = 1
    return labels


def _propagate(
    sources: FloatArray, prices: FloatArray, open_pixels: BoolArray, known: FloatArray
) -> NDArray[np.intp]:
    """Labels (H, W) of least cost, by min-sum belief propagation on the grid."""
    unary = np.where(open_pixels, prices, np.float32(0))
    sources = np.where(open_pixels[..., None], sources, known)
    across = _edge_costs(sources[:, :, :-1], sources[:, :, 1:], open_pixels[:, :-1] & open_pixels[:, 1:])
    down = _edge_costs(sources[:, :-1], sources[:, 1:], open_pixels[:-1] & open_pixels[1:])
    to_right, to_left, to_below, to_above = (np.zeros_like(unary) for _ in range(4))
    for _ in range(_ROUNDS):
        belief = unary + to_right + to_left + to_below + to_above
        sent = (
            (to_right[:, :, 1:], _message((belief - to_left)[:, :, :-1], across)),
            (to_left[:, :, :-1], _message((belief - to_right)[:, :, 1:], across.swapaxes(0, 1))),
            (to_below[:, 1:], _message((belief - to_above)[:, :-1], down)),
            (to_above[:, :-1], _message((belief - to_below)[:, 1:], down.swapaxes(0, 1))),
        )
        for place, message in sent:  # half old, half new: it settles instead of swinging
            place[...] = 0.5 * (place + message)
    return (unary + to_right + to_left + to_below + to_above).argmin(axis=0)


def _edge_costs(one: FloatArray, other: FloatArray, both_open: BoolArray) -> FloatArray:
    """Cost (3, 3, H, W) of an edge between neighbours by the sources of both."""
    costs = np.minimum(np.abs(one[:, None] - other[None]).max(axis=4), np.float32(_EDGE_LIMIT))
    for label in range(len(one)):
        costs[label, label][both_open] *= 0.0 if label == 0 else _SEEN_EDGE
    return costs


def _message(sender: FloatArray, costs: FloatArray) -> FloatArray:
    message = (sender[:, None] + costs).min(axis=0)
    return np.asarray(message - message.min(axis=0), np.float32)
