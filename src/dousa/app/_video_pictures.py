"""The pictures of videos at the frames of an estimate, for its overlay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dousa.estimation.silhouettes import Silhouettes

__all__ = ["VideoPictures", "pictures_of"]

Image = NDArray[np.uint8]


def pictures_of(
    sources: Sequence[Path], views: Silhouettes, first_frame: int, mirrored: bool = False
) -> VideoPictures | None:
    """The pictures behind silhouettes; None where the sources are not a video for each view.

    Parameters
    ----------
    sources : files of the views.
    views : silhouettes made from them.
    first_frame : of the sources, the first of the silhouettes.
    mirrored : left and right of the images are exchanged.
    """
    files = all(path.is_file() and path.suffix.lower() != ".npz" for path in sources)
    if not files or len(sources) != views.n_views:
        return None
    return VideoPictures(sources, views.sizes, views.frame_rate, first_frame, mirrored)


class VideoPictures:
    """Pictures of one video for each view, cut and resized as their silhouettes are.

    Parameters
    ----------
    sources : (V,) videos.
    sizes : (V,) width and height of the silhouettes.
    frame_rate : Hz, of the silhouettes.
    first_frame : at this rate, the first wanted.
    mirrored : left and right are exchanged.
    """

    def __init__(
        self,
        sources: Sequence[Path],
        sizes: Sequence[tuple[int, int]],
        frame_rate: float,
        first_frame: int,
        mirrored: bool = False,
    ) -> None:
        from dousa.estimation._images import fit_frame
        from dousa.estimation.video import VideoFile

        self._files = [VideoFile(path) for path in sources]
        self._sizes, self._rate, self._first, self._mirrored = sizes, frame_rate, first_frame, mirrored
        self._parts = []
        for file, size in zip(self._files, sizes, strict=True):
            sample = file.read(0)
            whole = (slice(None), slice(None))
            same = sample is None or file.size == size
            self._parts.append(whole if same else fit_frame(file.size, size, np.asarray(sample)))

    def __call__(self, frame: int) -> tuple[Image | None, ...]:
        """The pictures (height, width, 3) blue, green, red of all views; None where there is none."""
        return tuple(self._read(view, frame) for view in range(len(self._files)))

    def _read(self, view: int, frame: int) -> Image | None:
        import cv2

        file = self._files[view]
        place = math.floor((frame + self._first) / self._rate * file.frame_rate + 0.5)
        image = file.read(min(place, file.n_frames - 1))
        if image is None:
            return None
        return np.asarray(
            cv2.resize(image[self._parts[view]], self._sizes[view], interpolation=cv2.INTER_AREA)
        )

    def close(self) -> None:
        """Let go of the files."""
        for file in self._files:
            file.close()
