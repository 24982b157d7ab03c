"""What is noted down about every settled pose: overlap with the silhouettes, hidden parts, how far to trust it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dousa.estimation._beam import move_pose
from dousa.estimation._working import Frame, Workshop
from dousa.estimation.kinematics import compute_points

__all__ = ["Diary"]

FloatArray = NDArray[np.float64]

_HIDDEN = 0.1  # share of a part's own pixels below which the image does not tell where it is
_LEAST_OVERLAP = 0.35
_LOST_SHARE = 0.7  # of the usual overlap


class Diary:
    """Notes on settled poses, frame by frame.

    Parameters
    ----------
    workshop : body, cameras and settings.
    """

    def __init__(self, workshop: Workshop) -> None:
        self.workshop = workshop
        self._scratch = workshop.make_scratch()
        self._overlap: list[FloatArray] = []
        self._uncertainty: list[FloatArray] = []
        self._occluded: list[NDArray[np.bool_]] = []

    def cover(self, pose: FloatArray, frame: Frame) -> float:
        """Mean overlap of a pose over the views that see somebody; 0 if none does."""
        overlap, _ = self._cover(pose, frame)
        seen = overlap[np.isfinite(overlap)]
        return float(seen.mean()) if len(seen) else 0.0

    def _cover(self, pose: FloatArray, frame: Frame) -> tuple[FloatArray, FloatArray]:
        from dousa.estimation._diagnosis_kernels import cover_views

        overlap, visible = np.empty(len(self.workshop.cameras)), np.empty(self.workshop.body.n_parts)
        cover_views(pose, self.workshop.model, self.workshop.views(frame), self._scratch, overlap, visible)
        return overlap, visible

    def look(self, pose: FloatArray, frame: Frame) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Overlap (V,) of a pose with the silhouettes, NaN where there is none, and hidden parts (P,)."""
        overlap, visible = self._cover(pose, frame)
        return overlap, visible < _HIDDEN

    @property
    def latest(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Overlap (V,) and hidden parts (P,) of the pose noted down last."""
        return self._overlap[-1], self._occluded[-1]

    def write(self, pose: FloatArray, frame: Frame) -> None:
        """Note down a settled pose."""
        overlap, visible = self._cover(pose, frame)
        self._overlap.append(overlap)
        self._occluded.append(visible < _HIDDEN)
        self._uncertainty.append(self._measure_spread(pose, frame))

    def _measure_spread(self, pose: FloatArray, frame: Frame) -> FloatArray:
        """How far (P + K,) m each point moves while the image stays nearly as well explained.

        Each degree of freedom is moved by itself to where the image's score has dropped by one, at most dR; what that
        moves the points by adds up in squares.
        """
        from dousa.estimation._diagnosis_kernels import measure_widths

        shop = self.workshop
        low, high = np.zeros(shop.n_axes), np.zeros(shop.n_axes)
        measure_widths(
            pose, shop.weights, shop.bounds, shop.model, shop.views(frame), self._scratch, low, high
        )
        half = 0.5 * (low + high)
        axes = np.flatnonzero(half)
        if not len(axes):
            return np.zeros(shop.body.n_parts + len(shop.body.tips))
        moved = np.tile(pose, (len(axes), 1))
        for row, axis in zip(moved, axes, strict=True):
            if 3 <= axis < 6:
                row[:] = move_pose(pose, half[axis] * np.eye(shop.n_axes)[axis])
            else:
                row[axis + (axis >= 6)] += half[axis]
        points = compute_points(shop.body, np.concatenate((pose[None], moved)))
        away = np.linalg.norm(points[1:] - points[0], axis=-1)
        return np.asarray(np.sqrt((away * away).sum(axis=0)))

    def is_lost(self, covered: float, usual: float) -> bool:
        """Whether an overlap is that of a track gone wrong."""
        return covered < max(_LEAST_OVERLAP, _LOST_SHARE * usual)

    def find_lost(self, overlap: FloatArray, usual: float) -> NDArray[np.bool_]:
        """(T,) frames whose overlap (T, V) is poor in the mean of the views, or that nobody sees."""
        seen = np.isfinite(overlap)
        count = seen.sum(axis=1)
        mean = np.where(seen, overlap, 0.0).sum(axis=1) / np.maximum(count, 1)
        return np.array(
            [n == 0 or self.is_lost(m, usual) for n, m in zip(count, mean, strict=True)], np.bool_
        )

    def arrays(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Overlap (T, V), uncertainty (T, P + K) m and hidden parts (T, P)."""
        body, n_views = self.workshop.body, len(self.workshop.cameras)
        return (
            np.array(self._overlap).reshape(-1, n_views),
            np.array(self._uncertainty).reshape(-1, body.n_parts + len(body.tips)),
            np.array(self._occluded, np.bool_).reshape(-1, body.n_parts),
        )

    def load(self, overlap: FloatArray, uncertainty: FloatArray, occluded: NDArray[np.bool_]) -> None:
        """Take up the notes of an earlier run."""
        self._overlap, self._uncertainty, self._occluded = list(overlap), list(uncertainty), list(occluded)
