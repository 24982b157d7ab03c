"""The pose networks: people and their landmarks in an image; letterboxes, turned crops and anchors.

The geometry is that of MediaPipe's pose graphs (Bazarevsky and others, "BlazePose", 2020): a square around the
person, turned so that the body is upright in it, given by the middle of the hips and a second point whose circle
around the first encloses the body. Pixel centres are whole numbers here; the networks' coordinates are half a pixel
more.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Image
from dousa.errors import KeypointError
from dousa.estimation.keypoints.pose_models import DETECTOR, find_pose_model
from dousa.extras import require

DETECTOR_SIDE, LANDMARK_SIDE = 224, 256
"""Pixels of the squares that detector and landmark networks take."""

# Of MediaPipe's graphs pose_detection, pose_detection_to_roi and pose_landmark_by_roi (BlazePose, 2020): the share of
# the circle's square that a crop is, the strides of the detector's layers, the least score, the overlap from which
# detections are one, and of landmarks the heatmap's reach (cells) and least confidence.
_ENLARGED, _STRIDES, _LEAST_SCORE, _OVERLAP = 1.25, (8, 16, 32, 32, 32), 0.5, 0.3
_HEATMAP_REACH, _LEAST_CONFIDENT = 3, 0.5

Part = tuple[int, int, int, int]
"""Left, top, width and height of a part of a picture, in px."""


class PersonCrop(NamedTuple):
    """A turned square of the image with a person in it.

    Parameters
    ----------
    x, y : px, the middle.
    size : px, the side.
    angle : rad, by which the body is turned clockwise in the image.
    """

    x: float
    y: float
    size: float
    angle: float

    def matrix(self, side: int = LANDMARK_SIDE) -> FloatArray:
        """Return the matrix (2, 3) from pixels of the square at this resolution to pixels of the image."""
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
    """Return the square of MediaPipe's two alignment points (2,) px; None if it is not finite or too small.

    ``middle`` is that of the hips; ``end`` lies above it in the body's own frame, as far away as the body reaches.
    """
    across, down = (end - middle).tolist()
    size = _ENLARGED * 2 * math.hypot(across, down)
    if not (math.isfinite(size) and size >= 4):
        return None
    angle = math.pi / 2 - math.atan2(-down, across)
    return PersonCrop(float(middle[0]), float(middle[1]), size, math.remainder(angle, 2 * math.pi))


def transform(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Transform points (..., 2) by a matrix (2, 3)."""
    return np.asarray(points @ matrix[:, :2].T + matrix[:, 2])


class Shrinker:
    """An image (H, W, 3) at halved resolutions, so that crops of large people have no aliasing."""

    def __init__(self, picture: Image) -> None:
        self._levels = [picture]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image."""
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
        """Return the pixels (side, side, 3) of a crop; the edge of the image is repeated outside."""
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
        """Return a part of the image in a black square (side, side, 3), and the matrix (2, 3) from it to the image.

        ``part`` is within the image, by default all of it; ``side`` is in px.
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
    """List squares of a side that cover an image of this width and height, overlapping by at least 40 %."""
    side = min(side, *size)
    starts = []
    for length in size:
        n_steps = math.ceil((length - side) / (0.6 * side))
        starts.append([round(step * (length - side) / max(1, n_steps)) for step in range(n_steps + 1)])
    return [(x, y, side, side) for y in starts[1] for x in starts[0]]


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A detected person.

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
    """Return the centres (2254, 2) of the detector's anchors in a unit square, two by cell and layer."""
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
    """Decode the detector's output into people, overlapping ones averaged, highest scores first.

    Parameters
    ----------
    raw : (N, 12) per anchor middle, width and height of the box, and four points x, y, in its square's pixels.
    logits : (N,) of the scores.
    anchors : (N, 2) see `make_anchors`.
    matrix : (2, 3) from the square's pixels to the image's.
    """
    scores = sigmoid(logits)
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
    """Compute intersection over union (N,) of a box (4,) with boxes (N, 4): left, top, right, bottom."""
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=1)
    areas = np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0, None), axis=1)
    own = float(np.prod(np.clip(box[2:] - box[:2], 0, None)))
    return np.asarray(common / np.maximum(areas + own - common, 1e-9))


N_LANDMARKS, N_BODY = 39, 33
"""Landmarks of the network, and those of them that are of the body; the next two place the next crop."""
MASK_SIDE = LANDMARK_SIDE // 2
"""Pixels of the masks that are kept, by definition half the network's."""

CroppedMask = tuple[NDArray[np.bool_], PersonCrop]
"""A mask (128, 128) and the crop that it lies in."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """The landmarks of the person in one crop.

    Parameters
    ----------
    score : 0 to 1, that there is a person in the crop.
    points : (33, 2) px of the image.
    visibility : (33,) 0 to 1, that the point is in the image and not hidden.
    world : (33, 3) m about the middle of the hips, axes of the camera.
    crop : the crop.
    next_crop : around the same person, for the next image; None if it is unusable.
    mask : (128, 128) bool, the person in the crop.
    colours : (256, 256, 3) the crop's pixels, red, green, blue.
    """

    score: float
    points: FloatArray
    visibility: FloatArray
    world: FloatArray
    crop: PersonCrop
    next_crop: PersonCrop | None
    mask: NDArray[np.bool_]
    colours: Image


def sigmoid(values: NDArray[np.floating[Any]]) -> FloatArray:
    """Compute 1 / (1 + exp(-values)), for large values too."""
    return np.asarray(1 / (1 + np.exp(-np.clip(values.astype(np.float64), -60, 60))))


_one_at_a_time = threading.Lock()


@contextmanager
def _silence() -> Iterator[None]:
    """Keep what LiteRT writes of itself, which no option of it prevents, from standard error."""
    with _one_at_a_time, ExitStack() as left:  # else a second thread would take nothing for standard error
        with suppress(OSError):  # it is closed
            kept = os.dup(2)
            left.callback(os.close, kept)
            left.callback(os.dup2, kept, 2)
            with open(os.devnull, "wb") as nothing:
                os.dup2(nothing.fileno(), 2)
        yield


class _Network:
    """A loaded tflite model."""

    def __init__(self, path: Path, threads: int | None) -> None:
        module = require("ai_edge_litert.interpreter", "film")
        n_threads = threads or min(4, os.cpu_count() or 1)
        try:
            with _silence():
                self._interpreter = module.Interpreter(model_path=str(path), num_threads=n_threads)
                self._interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise KeypointError("models.unusable", reason=str(error)[:200]).at(path) from error
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = {
            tuple(int(axis) for axis in detail["shape"][1:]): detail["index"]
            for detail in self._interpreter.get_output_details()
        }

    def run(self, square: NDArray[np.float32]) -> dict[tuple[int, ...], NDArray[np.float32]]:
        """Return the outputs by shape, without the batch axis."""
        self._interpreter.set_tensor(self._input, square[None])
        self._interpreter.invoke()
        return {shape: self._interpreter.get_tensor(index)[0] for shape, index in self._outputs.items()}


class PersonDetector:
    """Detect people in an image with ``threads`` threads, by default up to four.

    Raises
    ------
    KeypointError : the model is not installed.
    MissingExtraError : LiteRT is not installed.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._network = _Network(find_pose_model(DETECTOR), threads)
        self._anchors = make_anchors()

    def find(self, picture: Shrinker, part: Part | None = None) -> list[Detection]:
        """Return the people in an image or a part of it, highest scores first."""
        square, matrix = picture.letterbox(part)
        outputs = self._network.run(square.astype(np.float32) / np.float32(127.5) - np.float32(1))
        n_anchors = len(self._anchors)
        return decode_detections(outputs[n_anchors, 12], outputs[n_anchors, 1][:, 0], self._anchors, matrix)


class LandmarkNetwork:
    """Find the landmarks of the person in a crop.

    Parameters
    ----------
    model : ``"lite"``, ``"full"`` or ``"heavy"``.
    threads : by default up to four.

    Raises
    ------
    KeypointError : the model is not installed.
    MissingExtraError : LiteRT is not installed.
    """

    def __init__(self, model: str, threads: int | None = None) -> None:
        self._network = _Network(find_pose_model(model), threads)

    def find(
        self, picture: Shrinker, crop: PersonCrop, others: Sequence[CroppedMask] = (), own: CroppedMask | None = None
    ) -> Landmarks:
        """Return the landmarks of the person in a crop.

        Parameters
        ----------
        picture : with the person.
        crop : around the person.
        others : other people in the image, painted over because the network would mix them up.
        own : the person's own pixels, which are not painted over.
        """
        from dousa.extras import cv2

        colours = picture.cut(crop)
        shown = colours if not others else paint_over(colours, crop, others, own)
        outputs = self._network.run(shown.astype(np.float32) / np.float32(255))
        raw = outputs[5 * N_LANDMARKS,].reshape(N_LANDMARKS, 5).astype(np.float64)
        places = refine_landmarks(raw[:, :2], outputs[64, 64, N_LANDMARKS])
        points = transform(crop.matrix(), places - 0.5)
        world = outputs[3 * N_LANDMARKS,].reshape(N_LANDMARKS, 3)[:N_BODY].astype(np.float64)
        cos, sin = np.cos(crop.angle), np.sin(crop.angle)
        world[:, :2] = world[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        logits = cv2.resize(
            outputs[LANDMARK_SIDE, LANDMARK_SIDE, 1], (MASK_SIDE, MASK_SIDE), interpolation=cv2.INTER_AREA
        )
        return Landmarks(
            float(outputs[1,][0]),
            points[:N_BODY],
            np.minimum(sigmoid(raw[:N_BODY, 3]), sigmoid(raw[:N_BODY, 4])),
            world,
            crop,
            crop_around(points[N_BODY], points[N_BODY + 1]),
            np.asarray(logits > 0),
            colours,
        )


def paint_over(
    colours: Image, crop: PersonCrop, others: Sequence[CroppedMask], own: CroppedMask | None = None
) -> Image:
    """Return a crop (256, 256, 3) with other people's pixels in the mean colour of the rest."""
    hidden = np.zeros(colours.shape[:2], bool)
    for other in others:
        hidden |= redraw_mask(other, crop)
    if own is not None:
        hidden &= ~redraw_mask(own, crop)
    if not hidden.any() or hidden.all():
        return colours
    painted = colours.copy()
    painted[hidden] = colours[~hidden].mean(axis=0)
    return painted


def redraw_mask(mask: CroppedMask, crop: PersonCrop, side: int = LANDMARK_SIDE) -> NDArray[np.bool_]:
    """Return a mask (side, side) as seen in another crop."""
    from dousa.extras import cv2

    whole = np.concatenate([mask[1].matrix(MASK_SIDE), [[0.0, 0.0, 1.0]]])
    matrix = cv2.invertAffineTransform(crop.matrix(side)) @ whole
    return np.asarray(cv2.warpAffine(mask[0].astype(np.uint8), matrix, (side, side)), bool)


def refine_landmarks(places: FloatArray, heatmaps: NDArray[np.float32]) -> FloatArray:
    """Move landmarks to the local centre of their heatmaps, where these are confident.

    Parameters
    ----------
    places : (K, 2) x, y in pixels of the crop, 0 to 256.
    heatmaps : (64, 64, K) logits.
    """
    n_rows, n_columns = heatmaps.shape[:2]
    cells = places * (n_columns / LANDMARK_SIDE)
    refined = places.copy()
    for point, (x, y) in enumerate(np.floor(cells).astype(int)):
        if not (0 <= x < n_columns and 0 <= y < n_rows):
            continue
        left, top = max(0, x - _HEATMAP_REACH), max(0, y - _HEATMAP_REACH)
        part = sigmoid(heatmaps[top : y + _HEATMAP_REACH + 1, left : x + _HEATMAP_REACH + 1, point])
        if part.max() < _LEAST_CONFIDENT:
            continue
        rows, columns = np.indices(part.shape)
        total = part.sum()
        refined[point] = ((columns * part).sum() / total + left, (rows * part).sum() / total + top)
        refined[point] *= LANDMARK_SIDE / n_columns
    return refined
