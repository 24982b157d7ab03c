"""Writing silhouettes with their cameras as one npz file, as `dousa.estimation.mask_npz` reads it."""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from typing import IO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa._files import atomic_write
from dousa.errors import SilhouetteError
from dousa.estimation._camera_npz import cameras_to_arrays
from dousa.estimation.camera import Camera
from dousa.estimation.silhouettes import PackedSilhouettes, Silhouettes, checked_rate

__all__ = ["write_silhouettes"]

Progress = Callable[[int, int, str], None]


def write_silhouettes(
    path: str | os.PathLike[str],
    masks: Silhouettes | ArrayLike,
    cameras: Sequence[Camera] | None = None,
    frame_rate: float | None = None,
    *,
    stature: float | None = None,
    truth: tuple[Sequence[str], ArrayLike] | None = None,
    progress: Progress | None = None,
) -> None:
    """Write silhouettes, and what is known beside them, as one npz file.

    Frames are read and packed one at a time, so the length does not matter. Views of different sizes are filled up at
    the right and below, which changes no camera, and `read_silhouettes` cuts them again.

    Parameters
    ----------
    path : the file to write.
    masks : silhouettes; or (V, T, H, W) bool, or one (T, H, W) per view, with ``frame_rate``.
    cameras : (V,) one per view, of the size of its masks; may be left out.
    frame_rate : Hz; by default that of the silhouettes.
    stature : m, of the person.
    truth : names (K,) and positions (T, K, 3) m of the true joints, where they are known.
    progress : called with (frames done, frames in all, what).

    Raises
    ------
    SilhouetteError : numbers that do not fit each other.
    MotionWriteError : the disk refuses; nothing is left behind.
    """
    if isinstance(masks, Silhouettes):
        source = masks
    elif frame_rate is None:
        raise SilhouetteError("expected the frame rate of the masks in Hz")
    else:
        source = PackedSilhouettes(masks, frame_rate)  # type: ignore[arg-type]
    beside = _collect(source, cameras, frame_rate, stature, truth)
    width = max(size[0] for size in source.sizes)
    height = max(size[1] for size in source.sizes)
    shape = (source.n_views, source.n_frames, height, (width + 7) // 8)
    beside |= {"width": np.array(width), "height": np.array(height)}
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        spools = [os.path.join(folder, str(view)) for view in range(source.n_views)]
        beside["present"] = _spool(source, spools, (width, height), progress)
        if beside["present"].all():
            del beside["present"]
        with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            _write_masks(archive, spools, shape)
            for name, values in beside.items():
                with archive.open(f"{name}.npy", "w") as member:
                    np.lib.format.write_array(member, np.asanyarray(values), allow_pickle=False)


def _collect(
    source: Silhouettes,
    cameras: Sequence[Camera] | None,
    frame_rate: float | None,
    stature: float | None,
    truth: tuple[Sequence[str], ArrayLike] | None,
) -> dict[str, NDArray[np.generic]]:
    """The arrays beside the masks."""
    arrays: dict[str, NDArray[np.generic]] = {
        "frame_rate": np.array(source.frame_rate if frame_rate is None else checked_rate(frame_rate)),
        "view_names": np.array(source.names),
    }
    if len(set(source.sizes)) > 1:
        arrays["view_sizes"] = np.array(source.sizes, np.int64)
    if cameras is not None:
        arrays |= _camera_arrays(source, cameras)
    if stature is not None:
        arrays["stature"] = np.array(float(stature))
    if truth is not None:
        names, positions = tuple(truth[0]), np.asarray(truth[1], np.float64)
        if positions.shape != (source.n_frames, len(names), 3):
            raise SilhouetteError(
                f"expected joint positions of shape ({source.n_frames}, {len(names)}, 3), got {positions.shape}"
            )
        arrays["joint_names"], arrays["joint_positions"] = np.array(names), positions
    return arrays


def _camera_arrays(source: Silhouettes, cameras: Sequence[Camera]) -> dict[str, NDArray[np.generic]]:
    if len(cameras) != source.n_views:
        raise SilhouetteError(f"expected {source.n_views} cameras, one per view, got {len(cameras)}")
    for camera, name, size in zip(cameras, source.names, source.sizes, strict=True):
        if (camera.width, camera.height) != size:
            raise SilhouetteError(
                f"view '{name}': masks of {size[0]} x {size[1]} pixels, camera '{camera.name}' of "
                f"{camera.width} x {camera.height}; scale the camera"
            )
    return cameras_to_arrays(cameras)


def _spool(
    source: Silhouettes, spools: Sequence[str], size: tuple[int, int], progress: Progress | None
) -> NDArray[np.bool_]:
    """Pack every frame into one file per view: the array is stored view by view, but read frame by frame."""
    width, height = size
    present = np.ones((source.n_views, source.n_frames), bool)
    files: list[IO[bytes]] = []
    try:
        for path in spools:
            files.append(open(path, "wb"))  # noqa: SIM115 - closed below
        for frame in range(source.n_frames):
            for view, mask in enumerate(source.read(frame)):
                canvas = np.zeros((height, width), bool)
                if mask is None:
                    present[view, frame] = False
                else:
                    canvas[: mask.shape[0], : mask.shape[1]] = mask
                files[view].write(np.packbits(canvas, axis=1).tobytes())
            if progress is not None:
                progress(frame + 1, source.n_frames, "writing silhouettes")
    finally:
        for file in files:
            file.close()
    return present


def _write_masks(archive: zipfile.ZipFile, spools: Sequence[str], shape: tuple[int, ...]) -> None:
    header = {"descr": "|u1", "fortran_order": False, "shape": shape}
    with archive.open("mask_packed.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, header)
        for path in spools:
            with open(path, "rb") as file:
                shutil.copyfileobj(file, member, 1 << 20)
