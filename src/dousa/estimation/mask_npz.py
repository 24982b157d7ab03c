"""Silhouettes in npz files: packed masks, with or without their cameras and the true joints.

    mask_packed                  (V, T, H, ceil(W / 8)) or, one view, (T, H, ceil(W / 8)) uint8: np.packbits along
                                 the width
    mask or masks                instead: (V, T, H, W) or (T, H, W) of bool or numbers, not packed
    width, height                px; needed with mask_packed
    frame_rate                   Hz; 30 if lacking
    view_names                   (V,) may be lacking
    view_sizes                   (V, 2) width and height of views that are smaller than the array; may be lacking
    present                      (V, T) bool, False where a view has no image; may be lacking
    camera_matrix                (V, 3, 3) px; `dousa.estimation.camera_files` reads the cameras
    world_to_camera_rotation     (V, 3, 3)
    world_to_camera_translation  (V, 3) m
    camera_distortion            (V, 5) k1 k2 p1 p2 k3; may be lacking
    camera_kind                  (V,) "pinhole" or "orthographic"; may be lacking
    stature                      m, of the person; may be lacking
    joint_names, joint_positions (K,), (T, K, 3) m, where the truth is known

Nothing is pickled, and no size is believed before it is compared with a limit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dousa.estimation._mask_writing import write_silhouettes
from dousa.estimation._npz_members import Header, NpzFile, clear_npz_errors, read_exactly
from dousa.estimation.silhouettes import PackedMasks, PackedSilhouettes, checked_rate

__all__ = ["read_silhouettes", "read_stature", "read_true_joints", "write_silhouettes"]

_MOST_PACKED_BYTES = 2_000_000_000  # an hour of one view of 320 x 240 at 30 Hz takes 1.04e9
_LONGEST_SIDE = 65_536
_MOST_PIXELS = 200_000_000
_MOST_VIEWS = 1000
_DEFAULT_RATE = 30.0


def read_silhouettes(path: str | os.PathLike[str], frame_rate: float | None = None) -> PackedSilhouettes:
    """Read the silhouettes of an npz file into memory, one bit a pixel.

    Parameters
    ----------
    path : a file as the module's docstring says.
    frame_rate : Hz; by default what the file says, or 30 with a warning.

    Returns
    -------
    The silhouettes; a single view is named after the file unless it has a name.

    Raises
    ------
    SilhouetteError : missing, damaged, truncated, arrays of another kind or shape, larger than 2 GB packed.
    """
    with clear_npz_errors(path), NpzFile(path) as file:
        packed, sizes = _read_masks(file)
        names = _read_names(file, len(packed))
        sizes = _read_sizes(file, sizes)
        warnings: tuple[str, ...] = ()
        if frame_rate is not None:
            rate = checked_rate(frame_rate)
        elif "frame_rate" in file:
            rate = checked_rate(file.read_number("frame_rate"), file.path)
        else:
            rate = _DEFAULT_RATE
            warnings = (f"{file.path}: the file does not say its frame rate; {rate:g} Hz is assumed",)
        missing = None
        if "present" in file:
            missing = ~file.read("present", "b", 2)
            if missing.shape != (len(packed), len(packed[0])):
                raise file.fail(
                    f"present: expected shape {(len(packed), len(packed[0]))}, got {missing.shape}"
                )
    packed = [
        np.ascontiguousarray(array[:, :height, : (width + 7) // 8])
        for array, (width, height) in zip(packed, sizes, strict=True)
    ]
    with clear_npz_errors(path):
        made = PackedSilhouettes.from_packed(packed, sizes, rate, names, missing)
    made.warnings = (*made.warnings, *warnings)
    return made


def read_stature(path: str | os.PathLike[str]) -> float | None:
    """The stature of the person in an npz file of silhouettes, in m; None where it does not say.

    Raises
    ------
    SilhouetteError : missing or damaged, or a stature outside 0.2 m to 3 m.
    """
    with clear_npz_errors(path), NpzFile(path) as file:
        if "stature" not in file:
            return None
        stature = file.read_number("stature")
        if not 0.2 <= stature <= 3.0:
            raise file.fail(f"expected a stature of 0.2 m to 3 m, got {stature:g}")
        return stature


def read_true_joints(
    path: str | os.PathLike[str],
) -> tuple[tuple[str, ...], NDArray[np.float64]] | None:
    """The true joints in an npz file of silhouettes: names (K,) and positions (T, K, 3) m; None where it has none.

    Raises
    ------
    SilhouetteError : missing or damaged, or names and positions that do not fit.
    """
    with clear_npz_errors(path), NpzFile(path) as file:
        if "joint_names" not in file or "joint_positions" not in file:
            return None
        names = file.read_texts("joint_names")
        positions = file.read("joint_positions", "f", 3).astype(np.float64)
        if positions.shape[1:] != (len(names), 3):
            raise file.fail(f"joint_positions: expected (T, {len(names)}, 3), got {positions.shape}")
        return names, positions


def _read_masks(file: NpzFile) -> tuple[list[PackedMasks], list[tuple[int, int]]]:
    """Per view the packed masks (T, H, bytes), and width and height."""
    if "mask_packed" in file:
        width, height = (_read_side(file, side) for side in ("width", "height"))
        with file.open("mask_packed") as (header, stream):
            shape = _view_shape(file, "mask_packed", header)
            if header.dtype != np.uint8:
                raise file.fail(f"mask_packed: expected bytes (uint8), got {header.dtype}")
            if shape[2:] != (height, (width + 7) // 8):
                raise file.fail(
                    f"mask_packed: expected {height} rows of {(width + 7) // 8} bytes for {width} x {height} pixels, "
                    f" got {shape[2]} of {shape[3]}; pack along the width"
                )
            _check_amount(file, header.n_bytes)
            flat = np.frombuffer(read_exactly(stream, header.n_bytes, file, "mask_packed"), np.uint8)
        masks = flat.reshape(shape) if not header.fortran_order else _from_fortran(flat, header, shape)
        return list(masks), [(width, height)] * shape[0]
    for name in ("mask", "masks"):
        if name in file:
            with file.open(name) as (header, stream):
                return _pack_stream(file, name, header, stream)
    raise file.fail(
        f"expected an array 'mask_packed', 'mask' or 'masks', got {', '.join(file.names)[:200] or 'no array'}"
    )


def _from_fortran(flat: PackedMasks, header: Header, shape: tuple[int, ...]) -> PackedMasks:
    return np.ascontiguousarray(flat.reshape(header.shape, order="F")).reshape(shape)


def _read_side(file: NpzFile, side: str) -> int:
    value = file.read_number(side)
    if not (1 <= value <= _LONGEST_SIDE and value == int(value)):
        raise file.fail(f"expected a {side} of 1 to {_LONGEST_SIDE} pixels, got {value:g}")
    return int(value)


def _view_shape(file: NpzFile, name: str, header: Header) -> tuple[int, int, int, int]:
    """(V, T, H, W) of an array that may lack the axis of the views."""
    shape = header.shape if len(header.shape) == 4 else (1, *header.shape)
    if len(shape) != 4:
        raise file.fail(
            f"{name}: expected the axes (views, frames, height, width) or (frames, height, width), got {header.shape}"
        )
    if min(shape) < 1:
        raise file.fail(f"{name}: expected at least one view, frame and pixel, got {header.shape}")
    if shape[0] > _MOST_VIEWS or max(shape[2:]) > _LONGEST_SIDE or shape[2] * shape[3] > _MOST_PIXELS:
        raise file.fail(f"{name}: declares shape {header.shape}; no recording of a person has such images")
    return shape[0], shape[1], shape[2], shape[3]


def _check_amount(file: NpzFile, n_bytes: int) -> None:
    if n_bytes > _MOST_PACKED_BYTES:
        raise file.fail(
            f"declares {n_bytes / 1e9:.1f} GB of packed masks, at most {_MOST_PACKED_BYTES / 1e9:g} GB are read; "
            "cut the sequence"
        )


def _pack_stream(
    file: NpzFile, name: str, header: Header, stream: IO[bytes]
) -> tuple[list[PackedMasks], list[tuple[int, int]]]:
    """Pack an array of whole pixels an image at a time, so that memory holds one bit a pixel."""
    n_views, n_frames, height, width = _view_shape(file, name, header)
    if header.dtype.kind not in "buif":
        raise file.fail(f"{name}: expected masks of bool or numbers, got {header.dtype}")
    _check_amount(file, n_views * n_frames * height * ((width + 7) // 8))
    if header.fortran_order:
        raise file.fail(f"{name}: the first axis runs fastest; save it with np.ascontiguousarray")
    image_bytes = height * width * header.dtype.itemsize
    rows: list[PackedMasks] = []
    read = _image_reader(stream, image_bytes, header.dtype, (height, width), file, name)
    for _ in range(n_views):
        rows.append(np.stack([np.packbits(read(), axis=1) for _ in range(n_frames)]))
    return rows, [(width, height)] * n_views


def _image_reader(
    stream: IO[bytes],
    n_bytes: int,
    dtype: np.dtype[Any],
    shape: tuple[int, int],
    file: NpzFile,
    name: str,
) -> Callable[[], NDArray[np.bool_]]:
    def read() -> NDArray[np.bool_]:
        data = stream.read(n_bytes)
        if len(data) < n_bytes:
            raise file.fail(f"'{name}' ends early; is the file truncated?")
        return np.frombuffer(data, dtype).reshape(shape).astype(bool)

    return read


def _read_names(file: NpzFile, n_views: int) -> tuple[str, ...] | None:
    if "view_names" in file:
        names = file.read_texts("view_names")
        if len(names) != n_views:
            raise file.fail(f"view_names: expected {n_views} names, got {len(names)}")
        return names
    return (os.path.splitext(os.path.basename(file.path))[0],) if n_views == 1 else None


def _read_sizes(file: NpzFile, sizes: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The sizes of views that were filled up to that of the largest."""
    if "view_sizes" not in file:
        return sizes
    own = file.read("view_sizes", "iu", 2)
    limit = np.array(sizes)
    if own.shape != limit.shape or (own < 1).any() or (own > limit).any():
        raise file.fail(f"view_sizes: expected sizes up to {sizes[0]}, got {own.tolist()}")
    return [(int(width), int(height)) for width, height in own]
