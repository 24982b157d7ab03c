"""Large silhouettes are shrunk before the search: what counts is pixels per person, not pixels per image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dousa.estimation._working import Frame
from dousa.estimation.camera import Camera
from dousa.estimation.cleaning import NEARLY_FULL
from dousa.estimation.rasteriser import unpack_bits

__all__ = ["Shrinker"]

Mask = NDArray[np.bool_]

_ASPECT = 0.22  # area of a standing person's silhouette over the square of its height


class Shrinker:
    """Shrinks masks by a whole factor, and the cameras with them.

    Parameters
    ----------
    cameras : (V,) of the masks as they come.
    area : px, mean area of a silhouette.
    height : px, how tall a silhouette may stay.
    """

    def __init__(self, cameras: Sequence[Camera], area: float, height: int) -> None:
        tall = np.sqrt(max(area, 1.0) / _ASPECT)
        self.factor = max(1, int(np.ceil(tall / height - 0.15)))
        self.sizes = [
            (max(1, round(camera.width / self.factor)), max(1, round(camera.height / self.factor)))
            for camera in cameras
        ]
        self.cameras = tuple(
            camera if self.factor == 1 else camera.resized(*size)
            for camera, size in zip(cameras, self.sizes, strict=True)
        )

    @property
    def area_share(self) -> float:
        """Area of a shrunk silhouette as a share of the whole one."""
        return 1.0 / self.factor**2

    def shrink(self, masks: Sequence[Mask | None]) -> list[Mask | None]:
        """Masks of one frame at the working size; full ones count as not seen."""
        small: list[Mask | None] = []
        for mask, size in zip(masks, self.sizes, strict=True):
            if mask is None or mask.mean() >= NEARLY_FULL:
                small.append(None)
            elif self.factor == 1:
                small.append(mask)
            else:
                import cv2

                shrunk = cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
                small.append(shrunk >= 128)
        return small

    def unpack(self, frame: Frame) -> list[Mask | None]:
        """The shrunk masks of a packed frame."""
        return [
            unpack_bits(frame.bits[view, :height], width) if frame.seen[view] else None
            for view, (width, height) in enumerate(self.sizes)
        ]
