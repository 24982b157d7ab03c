"""Silhouettes from folders of images: one folder a view, one image a frame."""

from __future__ import annotations

import math
import os
import re
from itertools import pairwise

import numpy as np

from dousa.errors import SilhouetteError
from dousa.estimation._images import mask_from_image, read_image, resize_mask
from dousa.estimation.silhouettes import Mask, checked_frame, checked_rate
from dousa.estimation.views import View

__all__ = ["IMAGE_ENDINGS", "MaskFolder", "find_mask_folders"]

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_LOSSY = (".jpg", ".jpeg")
_MOST_GAPS = 3.0  # times more numbers than images: they are no frame numbers
_DEFAULT_RATE = 30.0


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Order in which frame 10 comes after frame 9."""
    parts = re.split(r"(\d+)", name.lower())
    return tuple((0, int(part), "") if part.isdigit() and part.isascii() else (1, 0, part) for part in parts)


def _list(path: str | os.PathLike[str]) -> list[str]:
    try:
        return sorted(os.listdir(path), key=natural_key)
    except FileNotFoundError:
        raise SilhouetteError(f"{os.fspath(path)}: no such folder; check the name") from None
    except OSError as error:
        raise SilhouetteError(f"{os.fspath(path)}: the folder cannot be read: {error.strerror}") from error


def list_images(path: str | os.PathLike[str]) -> list[str]:
    """Names of the images in a folder in natural order."""
    return [name for name in _list(path) if not name.startswith(".") and name.lower().endswith(IMAGE_ENDINGS)]


def find_mask_folders(path: str | os.PathLike[str]) -> list[str]:
    """The views in a folder: itself if it holds images, else its folders that do, in natural order.

    Raises
    ------
    SilhouetteError : no images in it.
    """
    base = os.fspath(path)
    if list_images(base):
        return [base]
    inside = [os.path.join(base, name) for name in _list(base) if not name.startswith(".")]
    folders = [folder for folder in inside if os.path.isdir(folder) and list_images(folder)]
    if not folders:
        endings = ", ".join(ending[1:] for ending in IMAGE_ENDINGS)
        raise SilhouetteError(f"{base}: expected images ({endings}) or folders of images, found none")
    return folders


class MaskFolder(View):
    """A folder of mask images: the person is brighter than half of the range, or has a label other than 0.

    Numbers in the names are frames: where frame_0001 and frame_0003 exist, frame 2 is missing. If all are multiples of
    a step, the step is a frame.

    Parameters
    ----------
    path : the folder.
    frame_rate : Hz; 30 by default, with a warning.
    size : width and height of the masks; by default those of the first image.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        frame_rate: float | None = None,
        size: tuple[int, int] | None = None,
    ) -> None:
        self._folder = os.fspath(path)
        names = list_images(path)
        if not names:
            raise SilhouetteError(f"{self._folder}: expected images, found none")
        self.name = os.path.basename(os.path.normpath(self._folder))
        self.frame_rate = _DEFAULT_RATE if frame_rate is None else checked_rate(frame_rate, self._folder)
        self._frames = number_frames(names)
        self.n_frames = max(self._frames) + 1
        first = read_image(os.path.join(self._folder, names[0]))
        self._stored_size = (first.shape[1], first.shape[0])
        self.size = size or self._stored_size
        notes = []
        if frame_rate is None:
            notes.append(
                f"{self.name}: images do not say their frame rate; {self.frame_rate:g} Hz is assumed"
            )
        if len(self._frames) < self.n_frames:
            notes.append(
                f"{self.name}: {self.n_frames - len(self._frames)} of {self.n_frames} frames are missing by their "
                "numbers"
            )
        if float(np.mean(mask_from_image(first, not names[0].lower().endswith(_LOSSY)))) > 0.6:
            notes.append(
                f"{self.name}: most of the first image is foreground; the person must be bright on dark"
            )
        self.warnings = tuple(notes)

    def read(self, frame: int) -> Mask | None:
        """The mask (height, width) of a frame; None where there is no image."""
        name = self._frames.get(checked_frame(frame, self.n_frames))
        if name is None:
            return None
        path = os.path.join(self._folder, name)
        image = read_image(path)
        if (image.shape[1], image.shape[0]) != self._stored_size:
            raise SilhouetteError(
                f"{path}: expected {self._stored_size[0]} x {self._stored_size[1]} pixels like the first image, "
                f"got {image.shape[1]} x {image.shape[0]}"
            )
        return resize_mask(mask_from_image(image, not name.lower().endswith(_LOSSY)), self.size)


def number_frames(names: list[str]) -> dict[int, str]:
    """Frame of each image by the number in its name; by order where the numbers are no frame numbers."""
    by_order = dict(enumerate(names))
    parts = [re.fullmatch(r"(.*?)(\d{1,12})(\D*)", name, re.ASCII) for name in names]
    if len(names) < 2 or any(part is None for part in parts):
        return by_order
    if len({(part[1], part[3].lower()) for part in parts if part}) > 1:
        return by_order
    numbers = [int(part[2]) for part in parts if part]
    steps = [after - before for before, after in pairwise(numbers)]
    if min(steps) < 1:
        return by_order
    step = math.gcd(*steps)
    frames = [(number - numbers[0]) // step for number in numbers]
    if frames[-1] + 1 > _MOST_GAPS * len(names):
        return by_order
    return dict(zip(frames, names, strict=True))
