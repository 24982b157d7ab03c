"""Cleaning of masks (specks, holes, other people), and detection of doubtful masks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Mask
from dousa.errors import OptionError
from dousa.extras import cv2

_MOST_PIECES = 24  # pieces beside the main one that are looked at, the largest first
_PERSON_SHARE = 0.4  # a far piece with so much of the main one's area is another person
_LEAST_REACH = 3.0  # px
_STACKED_REACH = 0.3  # of the larger side of the main piece, which is only half a person then
NEARLY_FULL = 0.9  # of the image: a mask that covers so much shows no person


@dataclass(frozen=True, slots=True)
class MaskState:
    """The state of a mask.

    Parameters
    ----------
    area_share : foreground in shares of the image, 0 to 1.
    n_components : connected pieces of foreground (8 neighbours).
    largest_share : the largest piece in shares of the foreground; 0 if there is none.
    touches_border : foreground reaches the image edge at (left, top, right, bottom), so limbs may be cut off.
    """

    area_share: float
    n_components: int
    largest_share: float
    touches_border: tuple[bool, bool, bool, bool]

    @property
    def is_empty(self) -> bool:
        """Whether the mask has no foreground."""
        return self.n_components == 0

    @property
    def is_full(self) -> bool:
        """Whether at least 0.9 of the image is foreground."""
        return self.area_share >= NEARLY_FULL

    @property
    def is_cut_off(self) -> bool:
        """Whether the foreground reaches an edge of the image."""
        return any(self.touches_border)


def describe_mask(mask: Mask) -> MaskState:
    """Describe a mask (H, W): area, pieces, contact with the image edge."""
    image = np.ascontiguousarray(mask).view(np.uint8)
    count, _, stats, _ = cv2.connectedComponentsWithStats(image, connectivity=8)
    areas = stats[1:count, cv2.CC_STAT_AREA]
    total = int(areas.sum())
    borders = (mask[:, 0], mask[0], mask[:, -1], mask[-1])
    return MaskState(
        area_share=total / mask.size,
        n_components=count - 1,
        largest_share=float(areas.max() / total) if total else 0.0,
        touches_border=tuple(bool(border.any()) for border in borders),  # type: ignore[arg-type]
    )


def clean_mask(
    mask: Mask,
    *,
    speck_share: float = 0.01,
    hole_share: float = 0.004,
    reach: float = 0.03,
    limb_reach: float = 0.12,
    limb_share: float = 0.03,
    previous: Mask | None = None,
) -> Mask:
    """Return the person (H, W) of a mask, without specks, small holes and other people.

    The main piece is the largest, or the one that covers most of the last frame's. Pieces within ``reach`` stay, as a
    hand behind a small gap, and larger ones within ``limb_reach``. Large holes stay, as between an arm and the trunk.

    Parameters
    ----------
    mask : (H, W) bool.
    speck_share : pieces smaller than this share of the main one's area go, unless they lie within reach and have
        a fifth of it.
    hole_share : holes up to this share of the main piece's area are filled; 0 fills none.
    reach : gap in shares of the main piece's larger side over which any piece but a speck is kept.
    limb_reach : the same for pieces of at least ``limb_share`` of the main one's area.
    limb_share : see ``limb_reach``.
    previous : (H, W) bool, the cleaned mask of the frame before: the nearest piece is the person.

    Raises
    ------
    OptionError : a negative share or reach.
    """
    for name, value in (
        ("speck_share", speck_share),
        ("hole_share", hole_share),
        ("reach", reach),
        ("limb_reach", limb_reach),
        ("limb_share", limb_share),
    ):
        if not value >= 0:
            raise OptionError("masks.share", option=name, found=value)
    image = np.ascontiguousarray(mask, bool).view(np.uint8)
    count, pieces, table, _ = cv2.connectedComponentsWithStats(image, connectivity=8)
    labels, stats = np.asarray(pieces, np.int32), np.asarray(table, np.int32)
    person = np.zeros(mask.shape, bool)
    if count == 1:
        return person
    areas = stats[:, cv2.CC_STAT_AREA]
    main = _main_piece(labels, areas, previous)
    kept = np.zeros(count, bool)
    kept[main] = True
    held = _held_pieces(labels, areas, previous)
    # All that can be kept lies around these pieces; the rest of the image need not be looked at.
    large = (held & (areas >= limb_share * areas[main])) | (areas >= _PERSON_SHARE * areas[main])
    large[0] = False
    anchors = stats[large | kept]
    around = _around(anchors, max(reach, limb_reach), mask.shape)
    if count > 2:
        _keep_near(kept, labels[around], stats, main, (speck_share, reach, limb_reach, limb_share), held)
    person[around] = kept[labels[around]]
    if hole_share > 0:
        _fill_holes(person[around], hole_share * float(areas[main]))
    return person


def _around(boxes: NDArray[np.int32], reach: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the image area from which pieces may be kept: three times the reach, and a border."""
    left, top = int(boxes[:, 0].min()), int(boxes[:, 1].min())
    right, bottom = int((boxes[:, 0] + boxes[:, 2]).max()), int((boxes[:, 1] + boxes[:, 3]).max())
    margin = int(3 * max(_LEAST_REACH, reach * max(right - left, bottom - top))) + 2
    return (
        slice(max(0, top - margin), min(shape[0], bottom + margin)),
        slice(max(0, left - margin), min(shape[1], right + margin)),
    )


def count_people(mask: Mask) -> int:
    """Count the pieces of a mask with at least 0.4 of the area of the largest."""
    image = np.ascontiguousarray(mask, bool).view(np.uint8)
    areas = cv2.connectedComponentsWithStats(image, connectivity=8)[2][1:, cv2.CC_STAT_AREA]
    return int((areas >= _PERSON_SHARE * areas.max()).sum()) if len(areas) else 0


def _main_piece(labels: NDArray[np.int32], areas: NDArray[np.int32], previous: Mask | None) -> int:
    largest = 1 + int(areas[1:].argmax())
    if previous is None or previous.shape != labels.shape or not previous.any():
        return largest
    overlap = np.bincount(labels[previous], minlength=len(areas))
    overlap[0] = 0
    if overlap.any():
        return int(overlap.argmax())
    return _nearest_piece(labels, areas, previous)


def _nearest_piece(labels: NDArray[np.int32], areas: NDArray[np.int32], previous: Mask) -> int:
    """Return the piece nearest to the last mask among those large enough for a person."""
    distance = cv2.distanceTransform((~previous).view(np.uint8), cv2.DIST_L2, 3)
    candidates = 1 + np.flatnonzero(areas[1:] >= _PERSON_SHARE * areas[1:].max())
    return int(min(candidates, key=lambda piece: float(distance[labels == piece].min())))


def _keep_near(
    kept: NDArray[np.bool_],
    labels: NDArray[np.int32],
    stats: NDArray[np.int32],
    main: int,
    limits: tuple[float, float, float, float],
    held: NDArray[np.bool_],
) -> None:
    """Mark the pieces that belong to the main one."""
    speck_share, reach, limb_reach, limb_share = limits
    areas = stats[:, cv2.CC_STAT_AREA]
    side = float(max(stats[main, cv2.CC_STAT_WIDTH], stats[main, cv2.CC_STAT_HEIGHT]))
    near, far = max(_LEAST_REACH, reach * side), max(_LEAST_REACH, limb_reach * side)
    here = np.bincount(labels.ravel(), minlength=len(areas))
    least = max(1.0, 0.2 * speck_share * areas[main])
    pieces = [
        int(piece)
        for piece in np.argsort(here[1:])[::-1][:_MOST_PIECES] + 1
        if piece != main and here[piece] >= least and here[piece] == areas[piece]
    ]
    grown = True
    while grown and pieces:  # a piece that was kept carries the next one: elbow, wrist, hand
        grown = False
        distance = cv2.distanceTransform((~kept[labels]).view(np.uint8), cv2.DIST_L2, 3)
        for piece in tuple(pieces):
            gap = float(distance[labels == piece].min()) - 1.0
            large = areas[piece] >= max(limb_share, speck_share) * areas[main]
            # A piece as large as a person is another person unless it was there, or stands above or below.
            alone = areas[piece] >= _PERSON_SHARE * areas[main]
            if alone and _share_columns(stats[piece], stats[main]):
                fits = gap <= _STACKED_REACH * side
            else:
                fits = not alone and gap <= far
            if gap <= near or (large and (held[piece] or fits)):
                kept[piece] = grown = True
                pieces.remove(piece)


def _held_pieces(labels: NDArray[np.int32], areas: NDArray[np.int32], previous: Mask | None) -> NDArray[np.bool_]:
    """Return which pieces lie mostly where the person was."""
    if previous is None or previous.shape != labels.shape:
        return np.zeros(len(areas), bool)
    overlap = np.bincount(labels[previous], minlength=len(areas))
    overlap[0] = 0
    return np.asarray(overlap >= 0.5 * areas)


def _share_columns(one: NDArray[np.int32], other: NDArray[np.int32]) -> bool:
    """Return whether two boxes are stacked: a person cut in two by clothes of the background's colour."""
    shared = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    stacked = one[1] >= other[1] + 0.6 * other[3] or other[1] >= one[1] + 0.6 * one[3]
    return bool(shared >= 0.6 * min(one[2], other[2]) and stacked)


def _fill_holes(mask: Mask, most: float) -> None:
    """Fill holes of at most ``most`` pixels, in place."""
    background = (~mask).view(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(background, connectivity=4)
    if count <= 2:
        return
    height, width = mask.shape
    x, y, w, h, area = (stats[:, column] for column in range(5))
    inside = (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    small = inside & (area <= most)
    small[0] = False
    if small.any():
        mask |= small[labels]


DoubtReason = Literal["empty", "parts", "size"]
"""Nothing is foreground; a second part of some size; larger or smaller than the frames around it."""

_LARGE_PART = 0.05  # of the largest part's area
_SUDDEN = 0.35  # change of area against the frames around, in shares
_AROUND = 7  # frames on each side


@dataclass(frozen=True, slots=True)
class MaskMeasure:
    """The numbers of a mask for `doubt_masks`.

    Parameters
    ----------
    area : foreground, px.
    second : area of the second largest connected part, in shares of the largest.
    """

    area: float
    second: float


def measure_mask(mask: Mask | None) -> MaskMeasure:
    """Measure a mask (H, W); for None the area is NaN."""
    if mask is None:
        return MaskMeasure(float("nan"), 0.0)
    image = np.ascontiguousarray(mask, bool).view(np.uint8)
    areas = np.sort(cv2.connectedComponentsWithStats(image, connectivity=8)[2][1:, cv2.CC_STAT_AREA])[::-1]
    if not len(areas):
        return MaskMeasure(0.0, 0.0)
    return MaskMeasure(float(areas.sum()), float(areas[1] / areas[0]) if len(areas) > 1 else 0.0)


def doubt_masks(areas: FloatArray, seconds: FloatArray) -> list[tuple[int, DoubtReason]]:
    """Return (frame, reason) of the doubtful masks of one view, in the order of frames.

    Parameters
    ----------
    areas : (T,) px of foreground, NaN where there is no image.
    seconds : (T,) as of `MaskMeasure`.
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
