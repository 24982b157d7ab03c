"""Cameras as arrays, as they lie beside the masks in an npz sequence.

``camera_matrix`` (V, 3, 3), ``world_to_camera_rotation`` (V, 3, 3), ``world_to_camera_translation`` (V, 3) m with Y up,
``width`` and ``height`` of the largest image; where needed ``camera_distortion`` (V, 5), ``camera_kind`` (V,),
``view_names`` (V,) and, for images of several sizes, ``view_sizes`` (V, 2). See also `dousa.estimation.mask_npz`.
"""

from __future__ import annotations

import io
import os
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dousa.errors import CalibrationError
from dousa.estimation._camera_raw import RawCamera, read_numbers
from dousa.estimation.camera import Camera

__all__ = ["CAMERA_KEYS", "cameras_to_arrays", "raw_from_arrays", "read_npz_cameras"]

_NEEDED = ("camera_matrix", "world_to_camera_rotation", "world_to_camera_translation")
CAMERA_KEYS = (*_NEEDED, "width", "height", "camera_distortion", "camera_kind", "view_names", "view_sizes")
"""Names of the arrays that hold cameras."""

_MOST_BYTES = 1_000_000  # of one array; a thousand cameras need less


def read_npz_cameras(path: str | os.PathLike[str]) -> list[RawCamera]:
    """Cameras of an npz file; nothing but their arrays is loaded.

    Raises
    ------
    CalibrationError : damaged, without cameras, or arrays that disagree.
    """
    arrays: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for key in CAMERA_KEYS:
                if f"{key}.npy" not in archive.namelist():
                    continue
                with archive.open(f"{key}.npy") as member:
                    data = member.read(_MOST_BYTES + 1)
                if len(data) > _MOST_BYTES:
                    raise CalibrationError(f"{key}: expected an array of cameras, got over 1 MB")
                arrays[key] = np.load(io.BytesIO(data), allow_pickle=False)
    except (
        OSError,
        ValueError,
        EOFError,
        RuntimeError,  # a password
        NotImplementedError,
        MemoryError,
        SyntaxError,  # a damaged header of an array
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        if isinstance(error, CalibrationError):
            raise
        raise CalibrationError(f"not a whole npz file ({error}); is it truncated?") from error
    return raw_from_arrays(arrays)


def raw_from_arrays(arrays: Mapping[str, Any]) -> list[RawCamera]:
    """Cameras from arrays by name, see `CAMERA_KEYS`.

    Raises
    ------
    CalibrationError : an array is missing or of another shape.
    """
    for key in _NEEDED:
        if key not in arrays:
            raise CalibrationError(f"expected the array {key}, got none; the npz has no cameras")
    count = len(np.atleast_1d(arrays["camera_matrix"]))
    if not 1 <= count <= 1000:
        raise CalibrationError(f"camera_matrix: expected 1 to 1000 cameras, got {count}")
    matrices = read_numbers(arrays["camera_matrix"], (count, 3, 3), "camera_matrix")
    rotations = read_numbers(arrays["world_to_camera_rotation"], (count, 3, 3), "world_to_camera_rotation")
    translations = read_numbers(
        arrays["world_to_camera_translation"], (count, 3), "world_to_camera_translation"
    )
    distortions = read_numbers(
        arrays.get("camera_distortion", np.zeros((count, 5))), (count, 5), "camera_distortion"
    )
    kinds = _texts(arrays, "camera_kind", ["pinhole"] * count)
    names = _texts(arrays, "view_names", [f"view{view + 1}" for view in range(count)])
    sizes: list[tuple[int, int] | None] = [None] * count
    if "view_sizes" in arrays:
        rows = read_numbers(arrays["view_sizes"], (count, 2), "view_sizes")
        sizes = [(round(width), round(height)) for width, height in rows.tolist()]
    elif "width" in arrays and "height" in arrays:
        width, height = (float(read_numbers(arrays[key], (1,), key)[0]) for key in ("width", "height"))
        sizes = [(round(width), round(height))] * count
    return [
        RawCamera(*row)
        for row in zip(names, sizes, matrices, rotations, translations, distortions, kinds, strict=True)
    ]


def _texts(arrays: Mapping[str, Any], key: str, otherwise: list[str]) -> list[str]:
    if key not in arrays:
        return otherwise
    texts = [str(text) for text in np.atleast_1d(arrays[key]).ravel()]
    if len(texts) != len(otherwise):
        raise CalibrationError(f"{key}: expected {len(otherwise)} words, got {len(texts)}")
    return texts


def cameras_to_arrays(cameras: Sequence[Camera]) -> dict[str, np.ndarray]:
    """Arrays by name, see `CAMERA_KEYS`, that `read_cameras` understands in an npz file.

    Parameters
    ----------
    cameras : one or more; distortion and kind are left out where no camera has any but the usual.
    """
    sizes = np.array([camera.size for camera in cameras], np.int64)
    arrays = {
        "camera_matrix": np.stack([camera.matrix for camera in cameras]),
        "world_to_camera_rotation": np.stack([camera.rotation for camera in cameras]),
        "world_to_camera_translation": np.stack([camera.translation for camera in cameras]),
        "view_names": np.array([camera.name for camera in cameras]),
        "width": sizes[:, 0].max(),
        "height": sizes[:, 1].max(),
    }
    if (sizes != sizes[0]).any():
        arrays["view_sizes"] = sizes
    if any(camera.distortion.any() for camera in cameras):
        arrays["camera_distortion"] = np.stack([camera.distortion for camera in cameras])
    if any(camera.kind != "pinhole" for camera in cameras):
        arrays["camera_kind"] = np.array([camera.kind for camera in cameras])
    return arrays
