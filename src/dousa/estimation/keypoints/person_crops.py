"""From a picture to the squares that the pose networks see, and back: letterboxes, turned crops, anchors.

The geometry is that of MediaPipe's pose graphs (Bazarevsky and others, "BlazePose", 2020): a square around the
person, turned so that the body stands upright in it, given by the middle of the hips and a second point such that the
circle around the first through the second encloses the body. Pixel centres are at whole numbers here and in the
picture; the networks' own coordinates have pixel 0 from 0 to 1, which is half a pixel more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Image

DETECTOR_SIDE, LANDMARK_SIDE = 224, 256
"""Pixels of the squares that detector and landmark networks take."""

_ENLARGED = 1.25  # of the circle's square: limbs stick out of it
_STRIDES = (8, 16, 32, 32, 32)
_LEAST_SCORE, _OVERLAP = 0.5, 0.3
_LARGEST_LOGIT = 100.0

Part = tuple[int, int, int, int]
"""Left, top, width and height of a part of a picture, in px."""


@dataclass(frozen=True, slots=True)
class PersonCrop:
    """A turned square of the picture with a person in it.

    Parameters
    ----------
    x, y : px, the middle.
    size : px, the side.
    angle : rad, by which the body is turned clockwise in the picture.
    """

    x: float
    y: float
    size: float
    angle: float

    def matrix(self, side: int = LANDMARK_SIDE) -> FloatArray:
        """(2, 3) from pixels of the square at this resolution to pixels of the picture."""
        scale = self.size / side
        cos, sin = scale * math.cos(self.angle), scale * math.sin(self.angle)
        middle = (side - 1) / 2
        return np.array(
            [
                [cos, -sin, self.x - cos * middle + sin * middle],
                [sin, cos, self.y - sin * middle - cos * middle],
            ]
        )


def crop_around(middle: FloatArray, end: FloatArray) -> PersonCrop | None:
    """The square of MediaPipe's two alignment points, in px; None where they are no square of use.

    Parameters
    ----------
    middle : (2,) of the hips.
    end : (2,) a point that lies above the middle in the body's own frame, as far away as the body reaches.
    """
    across, down = (end - middle).tolist()
    size = _ENLARGED * 2 * math.hypot(across, down)
    if not (math.isfinite(size) and size >= 4):
        return None
    angle = math.pi / 2 - math.atan2(-down, across)
    return PersonCrop(float(middle[0]), float(middle[1]), size, math.remainder(angle, 2 * math.pi))


def transform(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 2) by a matrix (2, 3)."""
    return np.asarray(points @ matrix[:, :2].T + matrix[:, 2])


class Shrinker:
    """A picture at halved resolutions, so that crops of large people are sampled without aliasing.

    Parameters
    ----------
    picture : (H, W, 3).
    """

    def __init__(self, picture: Image) -> None:
        self._levels = [picture]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture."""
        return self._levels[0].shape[1], self._levels[0].shape[0]

    def _level(self, level: int) -> Image:
        from dousa.extras import cv2

        while len(self._levels) <= level:
            last = self._levels[-1]
            height, width = last.shape[0] // 2 * 2, last.shape[1] // 2 * 2
            half = cv2.resize(last[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
            self._levels.append(np.asarray(half, np.uint8))
        return self._levels[level]

    def cut(self, crop: PersonCrop, side: int = LANDMARK_SIDE) -> Image:
        """The pixels (side, side, 3) of a crop; beyond the picture its edge is repeated."""
        from dousa.extras import cv2

        smallest = min(self.size)
        level = 0
        while crop.size / 2 ** (level + 1) >= side and smallest >> (level + 1) >= 16:
            level += 1
        matrix = crop.matrix(side)
        shrunk = matrix / 2**level
        shrunk[:, 2] -= (1 - 0.5**level) / 2  # pixel centres
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(self._level(level), shrunk, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        )

    def letterbox(self, part: Part | None = None, side: int = DETECTOR_SIDE) -> tuple[Image, FloatArray]:
        """A part of the picture in a black square (side, side, 3), and the (2, 3) from its pixels to the picture's.

        Parameters
        ----------
        part : left, top, width and height in px, within the picture; the whole by default.
        side : px of the square.
        """
        from dousa.extras import cv2

        x, y, width, height = part or (0, 0, *self.size)
        scale = side / max(width, height)
        wide, high = max(1, round(width * scale)), max(1, round(height * scale))
        left, top = (side - wide) // 2, (side - high) // 2
        square = np.zeros((side, side, 3), np.uint8)
        shown = self._levels[0][y : y + height, x : x + width]
        if part is None and max(width, height) >= 4 * side and min(width, height) >= 4:
            shown = self._level(1)
        square[top : top + high, left : left + wide] = cv2.resize(shown, (wide, high), interpolation=cv2.INTER_AREA)
        across, down = width / wide, height / high
        return square, np.array(
            [[across, 0.0, (0.5 - left) * across - 0.5 + x], [0.0, down, (0.5 - top) * down - 0.5 + y]]
        )


def list_parts(size: tuple[int, int], side: int) -> list[Part]:
    """Squares of a side that cover a picture of this width and height, overlapping by 40 % at least."""
    side = min(side, *size)
    starts = []
    for length in size:
        n_steps = math.ceil((length - side) / (0.6 * side))
        starts.append([round(step * (length - side) / max(1, n_steps)) for step in range(n_steps + 1)])
    return [(x, y, side, side) for y in starts[1] for x in starts[0]]


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A person that the detector found.

    Parameters
    ----------
    score : 0 to 1.
    box : (4,) left, top, right, bottom in px: of face and shoulders, not of the whole body.
    crop : square around the whole body.
    """

    score: float
    box: FloatArray
    crop: PersonCrop


def make_anchors() -> FloatArray:
    """(2254, 2) centres of the detector's anchors, of its square with sides of 1: two a cell and layer."""
    rows = []
    for stride, layers in {stride: _STRIDES.count(stride) for stride in _STRIDES}.items():
        n_cells = math.ceil(DETECTOR_SIDE / stride)
        middles = (np.arange(n_cells) + 0.5) / n_cells
        cells = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
        rows.append(np.repeat(cells, 2 * layers, axis=0))
    return np.concatenate(rows)


def decode_detections(
    raw: NDArray[np.float32], logits: NDArray[np.float32], anchors: FloatArray, matrix: FloatArray
) -> list[Detection]:
    """People from what the detector returns, overlapping ones averaged, the surest first.

    Parameters
    ----------
    raw : (N, 12) per anchor middle, width and height of the box, and four points x, y, in its square's pixels.
    logits : (N,) of the scores.
    anchors : (N, 2) see `make_anchors`.
    matrix : (2, 3) from the square's pixels to the picture's.
    """
    scores = 1 / (1 + np.exp(-np.clip(logits.astype(np.float64), -_LARGEST_LOGIT, _LARGEST_LOGIT)))
    kept = np.flatnonzero(scores >= _LEAST_SCORE)
    kept = kept[np.argsort(-scores[kept], kind="stable")]
    values = raw[kept].astype(np.float64)
    origin = anchors[kept] * DETECTOR_SIDE
    middle, half = origin + values[:, :2], values[:, 2:4] / 2
    points = origin[:, None] + values[:, 4:].reshape(-1, 4, 2)
    # corners, then the four points: (N, 6, 2) in the network's coordinates
    corners = np.concatenate([(middle - half)[:, None], (middle + half)[:, None], points], axis=1)
    found = []
    left = np.arange(len(kept))
    while len(left):
        overlap = measure_overlap(corners[left[0], :2].reshape(4), corners[left, :2].reshape(-1, 4))
        same = left[(overlap > _OVERLAP) | (left == left[0])]
        weights = scores[kept[same]]
        merged = transform(matrix, np.tensordot(weights, corners[same], axes=1) / weights.sum() - 0.5)
        crop = crop_around(merged[2], merged[3])
        if crop is not None:
            found.append(Detection(float(weights[0]), merged[:2].reshape(4), crop))
        left = np.setdiff1d(left, same, assume_unique=True)
    return found


def measure_overlap(box: FloatArray, boxes: FloatArray) -> FloatArray:
    """(N,) intersection over union of a box (4,) with boxes (N, 4): left, top, right, bottom."""
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=1)
    areas = np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0, None), axis=1)
    own = float(np.prod(np.clip(box[2:] - box[:2], 0, None)))
    return np.asarray(common / np.maximum(areas + own - common, 1e-9))
