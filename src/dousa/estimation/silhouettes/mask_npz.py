"""Silhouettes in npz files: packed masks, with or without their cameras and the true joints.

    mask_packed                  (V, T, H, ceil(W / 8)) or, one view, (T, H, ceil(W / 8)) uint8: np.packbits along
                                 the width
    mask or masks                instead: (V, T, H, W) or (T, H, W) of bool or numbers, not packed
    width, height                px; needed with mask_packed
    frame_rate                   Hz; optional, 30 by default
    view_names                   (V,); optional
    view_sizes                   (V, 2) width and height of views smaller than the array; optional
    present                      (V, T) bool, False where a view has no image; optional
    camera_matrix                (V, 3, 3) px; `dousa.estimation.cameras.camera_files` reads the cameras
    world_to_camera_rotation     (V, 3, 3)
    world_to_camera_translation  (V, 3) m
    camera_distortion            (V, 5) k1 k2 p1 p2 k3; optional
    camera_kind                  (V,) "pinhole" or "orthographic"; optional
    stature                      m, of the person; optional
    joint_names, joint_positions (K,), (T, K, 3) m, the true joints; optional

Nothing is pickled, and every size is compared with a limit.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import SilhouetteError
from dousa.estimation.cameras.camera import Camera, check_cameras, format_size
from dousa.estimation.cameras.camera_formats import cameras_to_arrays
from dousa.estimation.silhouettes.silhouettes import PackedMasks, PackedSilhouettes, Silhouettes, checked_rate
from dousa.files.disk import atomic_write
from dousa.files.npz_arrays import Header, NpzFile, open_npz
from dousa.messages import Message, Progress


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
    """Write silhouettes and optional data as one npz file.

    Frames are read and packed one at a time. Smaller views are padded at the right and below; `read_silhouettes` crops
    them again.

    Parameters
    ----------
    path : the file to write.
    masks : silhouettes; or (V, T, H, W) bool, or one (T, H, W) per view, with ``frame_rate``.
    cameras : (V,) one per view, of the size of its masks; optional.
    frame_rate : Hz; by default that of the silhouettes.
    stature : m, of the person.
    truth : names (K,) and positions (T, K, 3) m of the true joints.
    progress : called with (frames done, frames in all, what).

    Raises
    ------
    SilhouetteError : inconsistent shapes, or no frame rate.
    CalibrationError : not one camera per view, or of another size.
    MotionWriteError : the file cannot be written; no partial file stays.
    """
    if isinstance(masks, Silhouettes):
        source = masks
    elif frame_rate is None:
        raise SilhouetteError("masks.no_rate")
    else:
        source = PackedSilhouettes(masks, frame_rate)
    beside = _collect(source, cameras, frame_rate, stature, truth)
    width = max(size[0] for size in source.sizes)
    height = max(size[1] for size in source.sizes)
    shape = (source.n_views, source.n_frames, height, (width + 7) // 8)
    beside |= {"width": np.array(width), "height": np.array(height)}
    with tempfile.TemporaryFile(prefix="dousa-") as spool:
        present = _spool(source, spool, shape[2:], progress)
        if not present.all():
            beside["present"] = present
        with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            header = {"descr": "|u1", "fortran_order": False, "shape": shape}
            with archive.open("mask_packed.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(member, header)
                spool.seek(0)
                shutil.copyfileobj(spool, member, 1 << 20)
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
    arrays: dict[str, NDArray[np.generic]] = {
        "frame_rate": np.array(source.frame_rate if frame_rate is None else checked_rate(frame_rate)),
        "view_names": np.array(source.names),
    }
    if len(set(source.sizes)) > 1:
        arrays["view_sizes"] = np.array(source.sizes, np.int64)
    if cameras is not None:
        check_cameras(cameras, source.names, source.sizes)
        arrays |= cameras_to_arrays(cameras)
    if stature is not None:
        arrays["stature"] = np.array(float(stature))
    if truth is not None:
        names, positions = tuple(truth[0]), np.asarray(truth[1], np.float64)
        if positions.shape != (source.n_frames, len(names), 3):
            raise SilhouetteError(
                "mask_npz.truth", frames=source.n_frames, joints=len(names), found=str(positions.shape)
            )
        arrays["joint_names"], arrays["joint_positions"] = np.array(names), positions
    return arrays


def _spool(
    source: Silhouettes, spool: IO[bytes], size: tuple[int, int], progress: Progress | None
) -> NDArray[np.bool_]:
    """Pack every frame into a file in the order of the array, by view and frame, as silhouettes are read by frame."""
    height, n_bytes = size
    present = np.ones((source.n_views, source.n_frames), bool)
    for frame in range(source.n_frames):
        for view, mask in enumerate(source.read(frame)):
            canvas = np.zeros((height, 8 * n_bytes), bool)
            if mask is None:
                present[view, frame] = False
            else:
                canvas[: mask.shape[0], : mask.shape[1]] = mask
            spool.seek((view * source.n_frames + frame) * height * n_bytes)
            spool.write(np.packbits(canvas, axis=1).tobytes())
        if progress is not None:
            progress(frame + 1, source.n_frames, Message("mask_npz.writing"))
    return present


def read_silhouettes(path: str | os.PathLike[str], frame_rate: float | None = None) -> PackedSilhouettes:
    """Read the silhouettes of an npz file into memory, one bit a pixel.

    A single view without a name takes the name of the file. ``frame_rate`` (Hz) is by default that of the file, or 30
    with a warning.

    Raises
    ------
    SilhouetteError : missing, damaged, truncated, arrays of another kind or shape, larger than 2 GB packed.
    """
    with _open(path) as file:
        packed, sizes = _read_masks(file)
        names = _read_names(file, path, len(packed))
        sizes = _read_sizes(file, sizes)
        warnings: tuple[Message, ...] = ()
        if frame_rate is not None:
            rate = checked_rate(frame_rate)
        elif "frame_rate" in file:
            rate = checked_rate(file.read_number("frame_rate"))
        else:
            rate = 30.0
            warnings = (Message("mask_npz.rate", path=path, rate=rate),)
        missing = None
        if "present" in file:
            missing, expected = ~file.read("present", "b", 2), (len(packed), len(packed[0]))
            if missing.shape != expected:
                raise SilhouetteError("npz.shape", array="present", expected=str(expected), found=str(missing.shape))
        packed = [
            np.ascontiguousarray(array[:, :height, : (width + 7) // 8])
            for array, (width, height) in zip(packed, sizes, strict=True)
        ]
        made = PackedSilhouettes.from_packed(packed, sizes, rate, names, missing)
    made.warnings = (*made.warnings, *warnings)
    return made


@contextmanager
def _open(path: str | os.PathLike[str]) -> Iterator[NpzFile]:
    """Open the arrays of a file; errors inside the block name the file."""
    try:
        with open_npz(path, SilhouetteError) as file:
            yield file
    except SilhouetteError as error:
        error.at(path)
        raise


def read_stature(path: str | os.PathLike[str]) -> float | None:
    """Return the stature (m) of the person in an npz file of silhouettes; None if absent.

    SilhouetteError : missing or damaged, or a stature outside 0.2 m to 3 m.
    """
    with _open(path) as file:
        if "stature" not in file:
            return None
        stature = file.read_number("stature")
        if not 0.2 <= stature <= 3.0:
            raise SilhouetteError("mask_npz.stature", found=stature)
        return stature


def read_true_joints(path: str | os.PathLike[str]) -> tuple[tuple[str, ...], NDArray[np.float64]] | None:
    """Return names (K,) and positions (T, K, 3) m of the true joints in an npz file of silhouettes; None if absent.

    SilhouetteError : missing or damaged, or inconsistent names and positions.
    """
    with _open(path) as file:
        if "joint_names" not in file or "joint_positions" not in file:
            return None
        names = file.read_texts("joint_names")
        positions = file.read("joint_positions", "f", 3).astype(np.float64)
        if positions.shape[1:] != (len(names), 3):
            expected = f"(T, {len(names)}, 3)"
            raise SilhouetteError("npz.shape", array="joint_positions", expected=expected, found=str(positions.shape))
        return names, positions


def _read_masks(file: NpzFile) -> tuple[list[PackedMasks], list[tuple[int, int]]]:
    """Return per view the packed masks (T, H, bytes), and width and height."""
    if "mask_packed" in file:
        width, height = (_read_side(file, side) for side in ("width", "height"))
        with file.open("mask_packed") as (header, stream):
            shape = _view_shape("mask_packed", header)
            if header.dtype != np.uint8:
                raise SilhouetteError("mask_npz.packed_kind", found=str(header.dtype))
            if shape[2:] != (height, (width + 7) // 8):
                raise SilhouetteError(
                    "mask_npz.packed_shape",
                    bytes=(width + 7) // 8,
                    size=format_size((width, height)),
                    height=height,
                    found_rows=shape[2],
                    found_bytes=shape[3],
                )
            _check_amount(header.n_bytes, header)
            masks = file.read_data("mask_packed", header, stream)
        return list(np.ascontiguousarray(masks).reshape(shape)), [(width, height)] * shape[0]
    for name in ("mask", "masks"):
        if name in file:
            with file.open(name) as (header, stream):
                return _pack_stream(name, header, stream)
    raise SilhouetteError("mask_npz.no_masks", found=file.names)


def _read_side(file: NpzFile, side: str, most: int = 65_536) -> int:
    """Return the width or height, at most ``most`` px."""
    value = file.read_number(side)
    if not (1 <= value <= most and value == int(value)):
        raise SilhouetteError("mask_npz.side", side=side, most=most, found=value)
    return int(value)


def _view_shape(
    name: str, header: Header, *, most_views: int = 1000, most_pixels: int = 200_000_000, longest_side: int = 65_536
) -> tuple[int, int, int, int]:
    """Return (V, T, H, W) of an array that may lack the axis of the views, within limits of views and of an image."""
    shape = header.shape if len(header.shape) == 4 else (1, *header.shape)
    if len(shape) != 4:
        raise SilhouetteError("mask_npz.axes", array=name, found=str(header.shape))
    if min(shape) < 1:
        raise SilhouetteError("mask_npz.empty", array=name, found=str(header.shape))
    if shape[0] > most_views or max(shape[2:]) > longest_side or shape[2] * shape[3] > most_pixels:
        raise SilhouetteError("mask_npz.huge", array=name, found=str(header.shape))
    return shape[0], shape[1], shape[2], shape[3]


def _check_amount(
    n_bytes: int, header: Header, most: int = 2_000_000_000, harmless: int = 200_000_000, densest: int = 300
) -> None:
    """Raise SilhouetteError for more packed masks than the file can plausibly hold.

    An hour of one view of 320 x 240 px at 30 Hz has 1.04e9 bytes, of ``most``. What is more than ``harmless`` has at
    most ``densest`` times the bytes of the file: a person has 12 to 31, nothing at all 1030.
    """
    if n_bytes > most:
        raise SilhouetteError("mask_npz.amount", size=n_bytes / 1e9, most=most / 1e9)
    if n_bytes > max(harmless, densest * header.n_packed):
        raise SilhouetteError("mask_npz.bomb", size=n_bytes / 1e6, packed=header.n_packed / 1e6)


def _pack_stream(name: str, header: Header, stream: IO[bytes]) -> tuple[list[PackedMasks], list[tuple[int, int]]]:
    """Pack an array of whole pixels one image at a time, to save memory."""
    n_views, n_frames, height, width = _view_shape(name, header)
    if header.dtype.kind not in "buif":
        raise SilhouetteError("mask_npz.kind", array=name, found=str(header.dtype))
    _check_amount(n_views * n_frames * height * ((width + 7) // 8), header)
    if header.order == "F":
        raise SilhouetteError("mask_npz.order", array=name)
    image_bytes = height * width * header.dtype.itemsize

    def pack_next() -> PackedMasks:
        data = stream.read(image_bytes)
        if len(data) < image_bytes:
            raise SilhouetteError("npz.ends", array=name)
        return np.packbits(np.frombuffer(data, header.dtype).reshape(height, width).astype(bool), axis=1)

    rows = [np.stack([pack_next() for _ in range(n_frames)]) for _ in range(n_views)]
    return rows, [(width, height)] * n_views


def _read_names(file: NpzFile, path: str | os.PathLike[str], n_views: int) -> tuple[str, ...] | None:
    if "view_names" in file:
        names = file.read_texts("view_names")
        if len(names) != n_views:
            raise SilhouetteError("mask_npz.view_names", expected=n_views, found=len(names))
        return names
    return (os.path.splitext(os.path.basename(path))[0],) if n_views == 1 else None


def _read_sizes(file: NpzFile, sizes: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the original sizes of padded views."""
    if "view_sizes" not in file:
        return sizes
    own = file.read("view_sizes", "iu", 2)
    limit = np.array(sizes)
    if own.shape != limit.shape or (own < 1).any() or (own > limit).any():
        raise SilhouetteError("mask_npz.view_sizes", size=format_size(sizes[0]), found=str(own.tolist()))
    return [(int(width), int(height)) for width, height in own]
