"""Images read by OpenCV, masks from images, and folders of masks."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import Mask
from dousa.errors import MotionFileError, SilhouetteError
from dousa.estimation.cameras.camera import format_size
from dousa.estimation.silhouettes.silhouettes import View, checked_frame, checked_rate
from dousa.extras import cv2, require
from dousa.files.disk import read_bytes
from dousa.files.frame_files import natural_key, number_frames
from dousa.messages import Message

_PNG = b"\x89PNG\r\n\x1a\n"


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """Silence OpenCV and FFmpeg; the error that follows is enough."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read by OpenCV when it first opens a video
    require("cv2", "film")
    from cv2.utils import logging

    before = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(before)


def read_image(path: str | os.PathLike[str], most_pixels: int = 200_000_000) -> NDArray[Any]:
    """Read an image as it is stored: (H, W) or (H, W, channels), 8 or 16 bit or float; blue, green, red.

    A PNG says its size before it is decoded, and is refused beyond ``most_pixels``.

    Raises
    ------
    SilhouetteError : missing, damaged, no image, too large.
    """
    try:
        data = read_bytes(path)
    except MotionFileError as error:
        raise SilhouetteError(error.message).at(path) from None
    if data[:8] == _PNG and len(data) >= 24:
        width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
        if width * height > most_pixels:
            raise SilhouetteError("mask_files.pixels", size=format_size((width, height))).at(path)
    try:
        with quiet_opencv():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise SilhouetteError("mask_files.undecodable", reason=error.err).at(path) from error
    if image is None:
        raise SilhouetteError("mask_files.no_image").at(path)
    return np.asarray(image)


def read_colour_image(path: str | os.PathLike[str]) -> NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8 blue, green, red; alpha is ignored."""
    image = read_image(path)
    if image.dtype == np.uint16:
        image = (image // 257).astype(np.uint8)
    if image.dtype != np.uint8:
        raise SilhouetteError("mask_files.depth", found=str(image.dtype)).at(path)
    if image.ndim == 2:
        image = image[..., None].repeat(3, axis=2)
    return np.ascontiguousarray(image[..., :3], np.uint8)


def mask_from_image(image: NDArray[Any], lossless: bool = True, highest_label: int = 15) -> Mask:
    """Return the foreground of a mask image: brighter than half, or not 0 where the values are labels (0, 1, 2 ...).

    Parameters
    ----------
    image : (H, W) or (H, W, channels); alpha is ignored, the brightest colour counts.
    lossless : whether small values are reliable; in JPEG they are not.
    highest_label : images with higher values hold grey levels.
    """
    if image.ndim == 3:
        colours = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
        image = colours.max(axis=2)
    peak = float(image.max())
    if image.dtype.kind == "f":
        return np.asarray(image > (0.5 if peak <= 1.0 else 127.5))
    if lossless and peak <= highest_label:
        return np.asarray(image > 0)
    full = 255 if image.dtype == np.uint8 or peak <= 255 else 65535
    return np.asarray(image > full // 2)


def resize_mask(mask: Mask, size: tuple[int, int]) -> Mask:
    """Resize a mask to (width, height): a pixel is foreground if more than half of its area is."""
    if (mask.shape[1], mask.shape[0]) == size:
        return mask
    image = np.ascontiguousarray(mask).view(np.uint8) * np.uint8(255)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA) > 127)


def fit_frame(size: tuple[int, int], target: tuple[int, int], sample: NDArray[np.uint8]) -> tuple[slice, slice]:
    """Return the rows and columns of a frame without the black bars of a format conversion.

    A video of 1080 x 1920 made from images of 1088 x 1920 has such bars; stretching it shifts rows by up to 7.

    Parameters
    ----------
    size, target : width and height of the frames, and wanted.
    sample : (H, W, 3) grey levels, a typical frame.
    """
    (width, height), (wide, high) = size, target
    whole = (slice(0, height), slice(0, width))
    rows, columns = (height - width * high / wide) / 2, (width - height * wide / high) / 2
    grey = sample.mean(axis=2)
    if rows >= 1 and _has_bars(grey.mean(axis=1), round(rows)):
        return slice(round(rows), height - round(rows)), slice(0, width)
    if columns >= 1 and _has_bars(grey.mean(axis=0), round(columns)):
        return slice(0, height), slice(round(columns), width - round(columns))
    return whole


def _has_bars(profile: NDArray[np.floating[Any]], depth: int, black: float = 40.0) -> bool:
    """Return whether ``depth`` lines at both ends are below the grey level ``black`` and the scene behind is not."""
    if 4 * depth > len(profile):
        return False
    sure = max(1, depth - 1)  # the last line of a bar is blurred by compression
    outside = max(profile[:sure].max(), profile[-sure:].max())
    inside = min(profile[depth + 1 : 3 * depth + 4].mean(), profile[-3 * depth - 4 : -depth - 1].mean())
    return bool(outside < black and inside > outside + 20)


def is_stretched(size: tuple[int, int], target: tuple[int, int], least: float = 0.02) -> bool:
    """Return whether a resize changes the aspect ratio by more than the share ``least``."""
    return abs(size[0] * target[1] / (size[1] * target[0]) - 1) > least


IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_LOSSY = (".jpg", ".jpeg")


def _list(path: str | os.PathLike[str]) -> list[str]:
    try:
        return sorted(os.listdir(path), key=natural_key)
    except FileNotFoundError:
        raise SilhouetteError("mask_files.no_folder").at(path) from None
    except OSError as error:
        raise SilhouetteError("mask_files.folder_unreadable", reason=error).at(path) from error


def list_images(path: str | os.PathLike[str]) -> list[str]:
    """List the images in a folder in natural order."""
    return [name for name in _list(path) if not name.startswith(".") and name.lower().endswith(IMAGE_ENDINGS)]


def find_mask_folders(path: str | os.PathLike[str]) -> list[str]:
    """List the views in a folder: itself if it holds images, else its subfolders with images, in natural order.

    SilhouetteError : no images in it.
    """
    base = os.fspath(path)
    if list_images(base):
        return [base]
    inside = [os.path.join(base, name) for name in _list(base) if not name.startswith(".")]
    folders = [folder for folder in inside if os.path.isdir(folder) and list_images(folder)]
    if not folders:
        raise SilhouetteError("mask_files.no_images", endings=tuple(ending[1:] for ending in IMAGE_ENDINGS)).at(base)
    return folders


class MaskFolder(View):
    """A folder of mask images: the person is brighter than half of the range, or has a label other than 0.

    Numbers in the names are frames: with frame_0001 and frame_0003, frame 2 is missing. A common step of all numbers
    counts as one frame.

    Parameters
    ----------
    path : the folder.
    frame_rate : Hz; 30 by default, with a warning.
    size : width and height of the masks; by default those of the first image.
    """

    def __init__(
        self, path: str | os.PathLike[str], frame_rate: float | None = None, size: tuple[int, int] | None = None
    ) -> None:
        self._folder = os.fspath(path)
        names = list_images(path)
        if not names:
            raise SilhouetteError("mask_files.empty_folder").at(self._folder)
        self.name = os.path.basename(os.path.normpath(self._folder))
        self.frame_rate = 30.0 if frame_rate is None else checked_rate(frame_rate, self._folder)
        self._frames = number_frames(names)
        self.n_frames = max(self._frames) + 1
        first = read_image(os.path.join(self._folder, names[0]))
        self._stored_size = (first.shape[1], first.shape[0])
        self.size = size or self._stored_size
        self.warnings: list[Message] = []
        if frame_rate is None:
            self.warnings.append(Message("mask_files.images_rate", view=self.name, rate=self.frame_rate))
        if len(self._frames) < self.n_frames:
            missing = self.n_frames - len(self._frames)
            self.warnings.append(
                Message("mask_files.missing_frames", view=self.name, missing=missing, frames=self.n_frames)
            )
        if float(np.mean(mask_from_image(first, not names[0].lower().endswith(_LOSSY)))) > 0.6:
            self.warnings.append(Message("mask_files.inverted", view=self.name))

    def read(self, frame: int) -> Mask | None:
        """Return the mask (height, width) of a frame; None where there is no image."""
        name = self._frames.get(checked_frame(frame, self.n_frames))
        if name is None:
            return None
        path = os.path.join(self._folder, name)
        image = read_image(path)
        if (image.shape[1], image.shape[0]) != self._stored_size:
            sizes = {"size": format_size(self._stored_size), "other": format_size(image.shape[1::-1])}
            raise SilhouetteError("mask_files.image_size", **sizes).at(path)
        return resize_mask(mask_from_image(image, not name.lower().endswith(_LOSSY)), self.size)
