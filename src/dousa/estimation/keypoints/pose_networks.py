"""Running the pose networks: a picture in, people and their landmarks out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Image
from dousa.errors import KeypointError
from dousa.estimation.keypoints.person_crops import (
    LANDMARK_SIDE,
    Detection,
    Part,
    PersonCrop,
    Shrinker,
    crop_around,
    decode_detections,
    make_anchors,
    transform,
)
from dousa.estimation.keypoints.pose_models import DETECTOR, find_pose_model
from dousa.extras import require

N_LANDMARKS, N_BODY = 39, 33
"""Landmarks of the network, and those of them that are of the body; the next two place the next crop."""
MASK_SIDE = 128
"""Pixels of the masks that are kept, half the network's."""

CroppedMask = tuple[NDArray[np.bool_], PersonCrop]
"""A mask (128, 128) and the crop that it lies in."""

_HEATMAP_REACH = 3  # cells
_LEAST_CONFIDENT = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """What the landmark network says about one crop.

    Parameters
    ----------
    score : 0 to 1, that there is a person in the crop.
    points : (33, 2) px of the picture.
    visibility : (33,) 0 to 1, that the point is in the picture and not hidden.
    world : (33, 3) m about the middle of the hips, axes of the camera.
    crop : the crop.
    next_crop : around the same person, for the next picture; None where there is no telling.
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
    """1 / (1 + exp(-values)), for large values too."""
    return np.asarray(1 / (1 + np.exp(-np.clip(values.astype(np.float64), -60, 60))))


class _Network:
    """A tflite file that is ready to run."""

    def __init__(self, path: Path, threads: int | None) -> None:
        module = require("ai_edge_litert.interpreter", "film")
        n_threads = threads or min(4, os.cpu_count() or 1)
        try:
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
        """Outputs by their shape, without the axis of the batch."""
        self._interpreter.set_tensor(self._input, square[None])
        self._interpreter.invoke()
        return {shape: self._interpreter.get_tensor(index)[0] for shape, index in self._outputs.items()}


class PersonDetector:
    """Finds people in a whole picture.

    Parameters
    ----------
    threads : of the processor; by default up to four.

    Raises
    ------
    KeypointError : the model is not installed.
    MissingExtraError : LiteRT is not installed.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._network = _Network(find_pose_model(DETECTOR), threads)
        self._anchors = make_anchors()

    def find(self, picture: Shrinker, part: Part | None = None) -> list[Detection]:
        """The people in a picture or a part of it, the surest first."""
        square, matrix = picture.letterbox(part)
        outputs = self._network.run(square.astype(np.float32) / np.float32(127.5) - np.float32(1))
        n_anchors = len(self._anchors)
        return decode_detections(outputs[n_anchors, 12], outputs[n_anchors, 1][:, 0], self._anchors, matrix)


class LandmarkNetwork:
    """Finds the landmarks of the person in a crop.

    Parameters
    ----------
    model : ``"lite"``, ``"full"`` or ``"heavy"``.
    threads : of the processor; by default up to four.

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
        """The landmarks of the person in a crop.

        Parameters
        ----------
        picture : with the person.
        crop : around the person.
        others : people who are known to be in the picture. Where they stand beside the person they are painted over, as
            the network would mix them up.
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
    """A crop (256, 256, 3) in which other people's pixels, not the person's own, have the mean colour of the rest."""
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
    """A mask as it is seen in another crop, (side, side)."""
    from dousa.extras import cv2

    whole = np.concatenate([mask[1].matrix(MASK_SIDE), [[0.0, 0.0, 1.0]]])
    matrix = cv2.invertAffineTransform(crop.matrix(side)) @ whole
    return np.asarray(cv2.warpAffine(mask[0].astype(np.uint8), matrix, (side, side)), bool)


def refine_landmarks(places: FloatArray, heatmaps: NDArray[np.float32]) -> FloatArray:
    """Landmarks moved to the centre of their heatmaps around them, where these are sure.

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
