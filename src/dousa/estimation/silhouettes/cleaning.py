"""Cleaning of masks (specks, holes, other people), and detection of doubtful masks."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Mask
from dousa.errors import OptionError
from dousa.extras import cv2

_PERSON_SHARE = 0.4  # a far piece with so much of the main one's area is another person, see docs/silhouettes.md


def is_nearly_full(mask: Mask, share: float = 0.9) -> bool:
    """Return whether at least this share of the image is foreground, which shows no person."""
    return bool(mask.mean() >= share)


def label_pieces(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the connected piece (8 neighbours) of each pixel, 0 for the background, and OpenCV's table of them."""
    image = np.ascontiguousarray(mask, bool).view(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(image, connectivity=8)
    return np.asarray(labels, np.int32), np.asarray(stats, np.int32)


def clean_mask(
    mask: Mask,
    *,
    speck_share: float = 0.01,
    hole_share: float = 0.004,
    reach: float = 0.03,
    limb_reach: float = 0.12,
    limb_share: float = 0.03,
    least_reach: float = 3.0,
    person_share: float = _PERSON_SHARE,
    previous: Mask | None = None,
) -> Mask:
    """Return the person (H, W) of a mask, without specks, small holes and other people.

    Pieces within ``reach`` stay, as a hand behind a small gap, and larger ones within ``limb_reach``. Large holes stay.

    Parameters
    ----------
    mask : (H, W) bool.
    speck_share : pieces below this share of the main one's area go, unless within reach and a fifth as large.
    hole_share : holes up to this share of the main piece's area are filled; 0 fills none.
    reach : gap in shares of the main piece's larger side over which any piece but a speck is kept.
    limb_reach : the same for pieces of at least ``limb_share`` of the main one's area.
    limb_share : see ``limb_reach``.
    least_reach : px, of any reach.
    person_share : a far piece with so much of the main one's area is another person.
    previous : (H, W) bool, the cleaned mask before: the main piece covers most of it, or is nearest; else the largest.

    Raises
    ------
    OptionError : a negative share or reach.
    """
    shares = {"speck_share": speck_share, "hole_share": hole_share, "reach": reach}
    for name, value in (shares | {"limb_reach": limb_reach, "limb_share": limb_share}).items():
        if not value >= 0:
            raise OptionError("masks.share", option=name, found=value)
    labels, stats = label_pieces(mask)
    person, areas = np.zeros(mask.shape, bool), stats[:, cv2.CC_STAT_AREA]
    if len(areas) == 1:
        return person
    overlap = np.zeros(len(areas), np.intp)
    if previous is not None and previous.shape == mask.shape:
        overlap = np.bincount(labels[previous], minlength=len(areas))
        overlap[0] = 0
    main = _main_piece(labels, areas, overlap, previous, person_share)
    kept = np.arange(len(areas)) == main
    held = overlap >= 0.5 * areas  # the piece lies mostly where the person was
    # All that can be kept lies around these pieces; the rest of the image need not be looked at.
    large = (held & (areas >= limb_share * areas[main])) | (areas >= person_share * areas[main])
    large[0] = False
    around = _around(stats[large | kept], max(reach, limb_reach), mask.shape, least_reach)
    if len(areas) > 2:
        side = float(max(stats[main, cv2.CC_STAT_WIDTH], stats[main, cv2.CC_STAT_HEIGHT]))
        gaps = max(least_reach, reach * side), max(least_reach, limb_reach * side)
        sizes = speck_share, max(limb_share, speck_share), person_share
        _keep_near(kept, labels[around], stats, main, held, side, gaps, sizes)
    person[around] = kept[labels[around]]
    if hole_share > 0:
        _fill_holes(person[around], hole_share * float(areas[main]))
    return person


def _around(boxes: NDArray[np.int32], reach: float, shape: tuple[int, ...], least_reach: float) -> tuple[slice, slice]:
    """Return the image area from which pieces may be kept: three times the reach, and a border."""
    left, top = int(boxes[:, 0].min()), int(boxes[:, 1].min())
    right, bottom = int((boxes[:, 0] + boxes[:, 2]).max()), int((boxes[:, 1] + boxes[:, 3]).max())
    margin = int(3 * max(least_reach, reach * max(right - left, bottom - top))) + 2
    return (
        slice(max(0, top - margin), min(shape[0], bottom + margin)),
        slice(max(0, left - margin), min(shape[1], right + margin)),
    )


def count_people(mask: Mask, person_share: float = _PERSON_SHARE) -> int:
    """Count the pieces of a mask with at least this share of the area of the largest."""
    areas = label_pieces(mask)[1][1:, cv2.CC_STAT_AREA]
    return int((areas >= person_share * areas.max()).sum()) if len(areas) else 0


def _main_piece(
    labels: NDArray[np.int32],
    areas: NDArray[np.int32],
    overlap: NDArray[np.intp],
    previous: Mask | None,
    person_share: float,
) -> int:
    """Return the piece that is most of the last mask, the nearest that is large enough for a person, or the largest."""
    if overlap.any():
        return int(overlap.argmax())
    if previous is None or previous.shape != labels.shape or not previous.any():
        return 1 + int(areas[1:].argmax())
    distance = cv2.distanceTransform((~previous).view(np.uint8), cv2.DIST_L2, 3)
    candidates = 1 + np.flatnonzero(areas[1:] >= person_share * areas[1:].max())
    return int(min(candidates, key=lambda piece: float(distance[labels == piece].min())))


def _keep_near(
    kept: NDArray[np.bool_],
    labels: NDArray[np.int32],
    stats: NDArray[np.int32],
    main: int,
    held: NDArray[np.bool_],
    side: float,
    gaps: tuple[float, float],
    sizes: tuple[float, float, float],
    *,
    stacked_reach: float = 0.3,
    most_pieces: int = 24,
) -> None:
    """Mark the pieces that belong to the main one, of the ``most_pieces`` largest beside it.

    ``gaps`` (px) keep any piece and a limb; ``sizes`` of specks, limbs and persons are shares of the main piece's area,
    whose larger ``side`` is in px. The other half of a person may be farther away: ``stacked_reach`` of that side.
    """
    areas = stats[:, cv2.CC_STAT_AREA]
    (near, far), (speck_share, limb_share, person_share) = gaps, sizes
    here = np.bincount(labels.ravel(), minlength=len(areas))
    least = max(1.0, 0.2 * speck_share * areas[main])
    pieces = [
        int(piece)
        for piece in np.argsort(here[1:])[::-1][:most_pieces] + 1
        if piece != main and here[piece] >= least and here[piece] == areas[piece]
    ]
    grown = True
    while grown and pieces:  # a piece that was kept carries the next one: elbow, wrist, hand
        grown = False
        distance = cv2.distanceTransform((~kept[labels]).view(np.uint8), cv2.DIST_L2, 3)
        for piece in tuple(pieces):
            gap = float(distance[labels == piece].min()) - 1.0
            large = areas[piece] >= limb_share * areas[main]
            # A piece as large as a person is another person unless it was there, or stands above or below.
            alone = areas[piece] >= person_share * areas[main]
            if alone and _share_columns(stats[piece], stats[main]):
                fits = gap <= stacked_reach * side
            else:
                fits = not alone and gap <= far
            if gap <= near or (large and (held[piece] or fits)):
                kept[piece] = grown = True
                pieces.remove(piece)


def _share_columns(one: NDArray[np.int32], other: NDArray[np.int32]) -> bool:
    """Return whether two boxes are stacked: a person cut in two by clothes of the background's colour."""
    shared = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    stacked = one[1] >= other[1] + 0.6 * other[3] or other[1] >= one[1] + 0.6 * one[3]
    return bool(shared >= 0.6 * min(one[2], other[2]) and stacked)


def _fill_holes(mask: Mask, most: float) -> None:
    """Fill holes of at most ``most`` pixels, in place."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).view(np.uint8), connectivity=4)
    height, width = mask.shape
    x, y, w, h, area = (stats[:, column] for column in range(5))
    inside = (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    small = inside & (area <= most)
    small[0] = False
    if small.any():
        mask |= small[labels]


DoubtReason = Literal["empty", "parts", "size"]
"""Nothing is foreground; a second part of some size; larger or smaller than the frames around it."""


def measure_mask(mask: Mask | None) -> tuple[float, float]:
    """Return the foreground (px) of a mask, NaN for None, and the second largest piece in shares of the largest."""
    if mask is None:
        return float("nan"), 0.0
    areas = np.sort(label_pieces(mask)[1][1:, cv2.CC_STAT_AREA])[::-1]
    return float(areas.sum()), float(areas[1] / areas[0]) if len(areas) > 1 else 0.0


def doubt_masks(
    areas: FloatArray, seconds: FloatArray, *, large_part: float = 0.05, sudden: float = 0.35, reach: int = 7
) -> list[tuple[int, DoubtReason]]:
    """Return (frame, reason) of the doubtful masks of one view, in the order of frames.

    Parameters
    ----------
    areas, seconds : (T,) of `measure_mask`.
    large_part : least second piece of a doubtful mask, in shares of the largest.
    sudden : change of the area, in shares of its median over ``reach`` frames on either side.
    """
    found: list[tuple[int, DoubtReason]] = []
    for frame, (area, second) in enumerate(zip(areas, seconds, strict=True)):
        if np.isnan(area):
            continue
        around = np.delete(areas[max(0, frame - reach) : frame + reach + 1], min(frame, reach))
        around = around[around > 0]
        usual = float(np.median(around)) if len(around) else float(area)
        if area == 0:
            if len(around):
                found.append((frame, "empty"))
        elif second >= large_part:
            found.append((frame, "parts"))
        elif abs(area - usual) > sudden * usual:
            found.append((frame, "size"))
    return found
