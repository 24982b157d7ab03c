"""Frames whose silhouette looks doubtful, told from the masks alone: nothing there, parts beside it, a sudden size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dousa.arrays import FloatArray, Mask

DoubtReason = Literal["empty", "parts", "size"]
"""Nothing is foreground; a second part of some size; larger or smaller than the frames around it."""

_LARGE_PART = 0.05  # of the largest part's area
_SUDDEN = 0.35  # change of area against the frames around, in shares
_AROUND = 7  # frames on each side


@dataclass(frozen=True, slots=True)
class MaskMeasure:
    """What is kept of a mask to doubt it.

    Parameters
    ----------
    area : foreground, px.
    second : area of the second largest connected part, in shares of the largest.
    """

    area: float
    second: float


def measure_mask(mask: Mask | None) -> MaskMeasure:
    """Measure a mask (H, W); None is measured like an empty one whose area is unknown."""
    from dousa.extras import cv2

    if mask is None:
        return MaskMeasure(float("nan"), 0.0)
    image = np.ascontiguousarray(mask, bool).view(np.uint8)
    areas = np.sort(cv2.connectedComponentsWithStats(image, connectivity=8)[2][1:, cv2.CC_STAT_AREA])[::-1]
    if not len(areas):
        return MaskMeasure(0.0, 0.0)
    return MaskMeasure(float(areas.sum()), float(areas[1] / areas[0]) if len(areas) > 1 else 0.0)


def doubt_masks(areas: FloatArray, seconds: FloatArray) -> list[tuple[int, DoubtReason]]:
    """The frames of one view whose mask looks doubtful, and why.

    Parameters
    ----------
    areas : (T,) px of foreground, NaN where there is no image.
    seconds : (T,) as of `MaskMeasure`.

    Returns
    -------
    (frame, reason) in the order of frames.
    """
    found: list[tuple[int, DoubtReason]] = []
    for frame, (area, second) in enumerate(zip(areas, seconds, strict=True)):
        if np.isnan(area):
            continue
        around = np.delete(areas[max(0, frame - _AROUND) : frame + _AROUND + 1], min(frame, _AROUND))
        around = around[around > 0]
        usual = float(np.median(around)) if len(around) else float(area)
        if area == 0:
            if len(around):
                found.append((frame, "empty"))
        elif second >= _LARGE_PART:
            found.append((frame, "parts"))
        elif abs(area - usual) > _SUDDEN * usual:
            found.append((frame, "size"))
    return found
