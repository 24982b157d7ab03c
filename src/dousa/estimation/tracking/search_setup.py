"""The arrays of the compiled search: a body, its views and the silhouettes of a frame."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Mask
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import place_parts, tree_arrays
from dousa.estimation.cameras.camera import Camera, pack_cameras
from dousa.estimation.raster.rasteriser import Bits, draw_placed, outline_scratch, pack_bits, unpack_bits
from dousa.estimation.silhouettes.cleaning import is_nearly_full
from dousa.estimation.tracking.outlines import shrink_mask
from dousa.estimation.tracking.search_kernels import sweep
from dousa.estimation.tracking.settings import EVIDENCES, READINGS, TrackerSettings


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """The silhouettes of one frame.

    Parameters
    ----------
    bits : (V, H, words) rows of bits; zeros where a view is not seen.
    seen : (V,) views that have an image with a person in it.
    """

    bits: Bits
    seen: NDArray[np.bool_]


def erode(bits: Bits, steps: int) -> Bits:
    """Erode bit images (..., H, words) by ``steps`` pixels with a diamond."""
    one, last = np.uint64(1), np.uint64(63)
    for _ in range(steps):
        left = bits << one
        left[..., 1:] |= bits[..., :-1] >> last
        right = bits >> one
        right[..., :-1] |= bits[..., 1:] << last
        kept = bits & left & right
        kept[..., 1:, :] &= bits[..., :-1, :]
        kept[..., :-1, :] &= bits[..., 1:, :]
        kept[..., 0, :] = 0
        kept[..., -1, :] = 0
        bits = kept
    return bits


class SearchSetup:
    """A body and its cameras as arrays for `search_kernels`.

    Parameters
    ----------
    body, cameras, settings : see `dousa.estimation.tracking.tracker.estimate`.
    frame_rate : Hz.
    area : px, mean area of a silhouette, which scales the evidence.
    """

    def __init__(
        self,
        body: BodyModel,
        cameras: Sequence[Camera],
        settings: TrackerSettings,
        frame_rate: float,
        area: float,
    ) -> None:
        self.body, self.cameras, self.settings, self.frame_rate = body, tuple(cameras), settings, frame_rate
        self.rows = pack_cameras(cameras)
        self.sizes = np.array([(camera.width, camera.height) for camera in cameras], np.int64)
        self.height = int(self.sizes[:, 1].max())
        self.n_words = int(-(-self.sizes[:, 0].max() // 64))
        self.n_axes = 6 + body.n_angles
        subtrees, starts = _list_subtrees(body.parents)
        self.model = (tree_arrays(body), (body.spheres, body.sphere_starts), subtrees, starts)
        self.order = np.arange(body.n_parts)
        self.beam = settings.beam or max(3, 12 // max(1, len(self.cameras)))
        self.whole = settings.candidates == "subtree"
        self.half = settings.n_candidates // 2
        self.half_later = settings.n_candidates_later // 2
        spread, ease = _spread(body, settings, frame_rate), _ease(body, settings.stiffness)
        self.bounds = (spread, ease, np.array(body.angle_limits))
        image = 1.0 / (settings.image_scale * max(area, 1.0))
        reading, evidence = READINGS.index(settings.reading), EVIDENCES.index(settings.evidence)
        self.weights = (reading, evidence, image, settings.inertia)
        self.rim = measure_rim(area)
        self._every = np.zeros((len(self.cameras), self.height, self.n_words), np.uint64)
        self._own = threading.local()

    def own_scratch(self) -> tuple[Any, ...]:
        """Return the scratch of the calling thread."""
        if not hasattr(self._own, "arrays"):
            self._own.arrays = self.make_scratch()
        arrays: tuple[Any, ...] = self._own.arrays
        return arrays

    def make_scratch(self) -> tuple[Any, ...]:
        """Return scratch arrays of the kernels, one set per thread.

        0 outline work, 1 drawn bits, 2 plus, 3 minus, 4 fixed, 5 rotations, 6 positions, 7 -|minus| by view,
        8 trial pose, 9 fixed parts, 10 mismatches, 11 priors, 12 rotations in the parents' axes.
        """
        body, shape = self.body, (len(self.cameras), self.height, self.n_words)
        return (
            outline_scratch(body, self.height),
            np.zeros(shape[1:], np.uint64),
            np.zeros(shape, np.uint64),
            np.zeros(shape, np.uint64),
            np.zeros(shape, np.uint64),
            np.zeros((body.n_parts, 3, 3)),
            np.zeros((body.n_parts, 3)),
            np.zeros(len(self.cameras), np.int64),
            np.zeros(7 + body.n_angles),
            np.zeros(body.n_parts + 1, np.int64),
            np.zeros(TrackerSettings.MOST_CANDIDATES),
            np.zeros(TrackerSettings.MOST_CANDIDATES),
            np.zeros((body.n_parts, 3, 3)),
        )

    def pack(self, masks: Sequence[NDArray[np.bool_] | None]) -> Frame:
        """Pack masks of one frame, of the sizes of the cameras, into bits; an empty mask counts as not seen."""
        bits = np.zeros((len(self.cameras), self.height, self.n_words), np.uint64)
        seen = np.zeros(len(self.cameras), np.bool_)
        for view, mask in enumerate(masks):
            if mask is not None and mask.any():
                packed = pack_bits(mask)
                bits[view, : packed.shape[0], : packed.shape[1]] = packed
                seen[view] = True
        return Frame(bits, seen)

    def find_rims(self, frame: Frame) -> Bits:
        """Return the pixels (V, H, words) by which outlines of bodies and segmentations differ without an error."""
        return ~(erode(frame.bits, self.rim) | erode(~frame.bits, self.rim))

    def views(self, frame: Frame) -> tuple[Any, ...]:
        """Return the ``views`` of the kernels."""
        return self.rows, self.sizes, frame.seen, frame.bits, self._every

    def sweep(
        self,
        pose: FloatArray,
        shift: FloatArray,
        factor: float,
        frame: Frame,
        scratch: tuple[Any, ...],
        half: int | None = None,
        order: NDArray[np.intp] | None = None,
    ) -> float:
        """Run one pass over the parts in ``order``, by default all, in place, and return the log score.

        See `search_kernels.sweep`.
        """
        reach, views = (factor, half or self.half, self.settings.thinning), self.views(frame)
        order = self.order if order is None else order
        order = order if factor else order[:0]
        fixed = (self.weights, self.bounds, self.model, views, scratch)
        return float(sweep(pose, shift, order, self.whole, reach, *fixed, np.zeros((0, 2))))

    def measure_widths(self, pose: FloatArray, frame: Frame, scratch: tuple[Any, ...]) -> FloatArray:
        """Compute how far (6 + A, 2) each degree of freedom moves either way before the image score drops by one.

        Amounts are 0 or more: dR / 32, / 8 or / 2.
        """
        widths = np.zeros((self.n_axes, 2))
        weights, views = (READINGS.index("masked"), *self.weights[1:]), self.views(frame)
        fixed = (weights, self.bounds, self.model, views, scratch)
        sweep(np.array(pose), widths[:, 0].copy(), self.order, True, (1.0, self.half, 1), *fixed, widths)
        return widths

    def score(self, pose: FloatArray, shift: FloatArray, frame: Frame, scratch: tuple[Any, ...]) -> float:
        """Compute the log score of a whole pose."""
        return self.sweep(pose, shift, 0.0, frame, scratch)

    def compare(self, pose: FloatArray, frame: Frame, rims: Bits, scratch: tuple[Any, ...]) -> float:
        """Compute the log score by which very different poses of a frame compare: the image alone.

        The ``rims`` do not count: what a body of other girths leaves there is as much as a limb. Nor does
        ease, which decides what the image leaves open: a raised arm would cost as much as one that is not explained.
        """
        views, still = (*self.views(frame)[:-1], rims), np.zeros(self.n_axes)
        bounds = (self.bounds[0], np.zeros_like(self.bounds[1]), self.bounds[2])
        fixed = (self.weights, bounds, self.model, views, scratch)
        return float(sweep(pose, still, self.order[:0], self.whole, (0.0, self.half, 1), *fixed, np.zeros((0, 2))))


def count_bits(bits: Bits) -> NDArray[np.int64]:
    """Count the bits set in images (..., H, words)."""
    counts = np.bitwise_count(bits).reshape(*bits.shape[:-2], -1)
    return np.asarray(np.add.reduce(counts, axis=-1, dtype=np.int32).astype(np.int64))


def draw_views(setup: SearchSetup, pose: FloatArray, frame: Frame) -> Bits:
    """Draw a pose into the views (V, H, words) that are seen."""
    placed, together = place_parts(setup.body, pose[None]), np.zeros(setup.body.n_parts, np.intp)
    drawn = np.zeros_like(frame.bits)
    for view in np.flatnonzero(frame.seen):
        found = draw_placed(setup.body, placed, setup.rows[view], setup.sizes[view], together, 1)[0, 0]
        drawn[view, : found.shape[0], : found.shape[1]] = found
    return drawn


def compare_views(drawn: Bits, silhouettes: Bits) -> FloatArray:
    """Compute intersection over union (V,) of bits (V, H, words); nan where both are empty."""
    both, either = count_bits(drawn & silhouettes), count_bits(drawn | silhouettes)
    return np.where(either > 0, both / np.maximum(either, 1), np.nan)


def _list_subtrees(parents: NDArray[np.intp]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the parts below each part, itself first, concatenated, and the start of each list."""
    lists: list[list[int]] = [[part] for part in range(len(parents))]
    for below in lists:
        for other in range(below[0] + 1, len(parents)):
            if parents[other] in below:
                below.append(other)
    starts = np.concatenate(([0], np.cumsum([len(below) for below in lists])))
    return np.concatenate(lists).astype(np.int64), starts.astype(np.int64)


def _spread(body: BodyModel, settings: TrackerSettings, frame_rate: float) -> FloatArray:
    """Compute dR of every degree of freedom, (6 + A,) m and rad."""
    agility = body.agility if settings.agility == "body" else np.ones(body.n_parts)
    angles = np.repeat(agility, body.n_axes) * settings.max_change
    root = np.repeat((settings.root_change * body.stature, agility[0] * settings.max_change), 3)
    spread: FloatArray = np.concatenate((root, angles)) * (30.0 / frame_rate)
    return spread


def _ease(body: BodyModel, stiffness: float, least: float = 0.1) -> FloatArray:
    """Return neutral value and root of the price per square radian of every degree of freedom, (6 + A, 2).

    Half of a joint's range counts as ``least`` rad at least, so that one that hardly moves is not infinitely stiff.
    """
    ease = np.zeros((6 + body.n_angles, 2))
    limits = body.angle_limits
    half = np.maximum(0.5 * (limits[:, 1] - limits[:, 0]), least)
    used = np.arange(3) < body.n_axes[:, None]
    ease[6:, 0] = body.neutral[used]
    ease[6:, 1] = np.sqrt(stiffness * np.repeat(body.stiffness, body.n_axes)) / half
    return ease


def standing_height(area: float, aspect: float = 0.22) -> float:
    """Compute the height (px) of a standing person whose silhouette of ``area`` px is ``aspect`` of its square."""
    return float(np.sqrt(max(area, 1.0) / aspect))


def measure_rim(area: float, share: float = 0.015) -> int:
    """Compute by how many pixels bodies and segmentations differ without an error: a ``share`` of standing height."""
    return max(1, round(share * standing_height(area)))


class Shrinker:
    """Shrink masks and cameras by a whole factor to about ``height`` px per silhouette; ``area`` is their mean, px."""

    def __init__(self, cameras: Sequence[Camera], area: float, height: int) -> None:
        self.factor = max(1, int(np.ceil(standing_height(area) / height - 0.15)))
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
        """Return masks of one frame at the working size; full ones count as not seen."""
        small: list[Mask | None] = []
        for mask, size in zip(masks, self.sizes, strict=True):
            if mask is None or is_nearly_full(mask):
                small.append(None)
            else:
                small.append(mask if self.factor == 1 else shrink_mask(mask, size))
        return small

    def unpack(self, frame: Frame) -> list[Mask | None]:
        """Return the shrunk masks of a packed frame."""
        return [
            unpack_bits(frame.bits[view, :height], width) if frame.seen[view] else None
            for view, (width, height) in enumerate(self.sizes)
        ]
