"""Errors of an estimate, joint by joint and frame by frame, and the numbers that sum them up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LOSS_BOUND", "Accuracy", "ImageAccuracy", "list_stretches", "mean_of"]

FloatArray = NDArray[np.float64]
Flags = NDArray[np.bool_]

LOSS_BOUND = 0.15
"""m, mean error of a frame above which the track counts as lost."""


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """How far an estimate is from the truth.

    Parameters
    ----------
    joints : (N,) that both have.
    errors : (T, N) m, distance; NaN where nothing is compared, as in all of these arrays.
    root_errors : (T, N) m, after the hips were moved onto the true ones.
    rigid_errors : (T, N) m, after the best rotation and translation of each frame.
    segments, segment_errors : (L,) and (T, L) rad, between the directions of a segment.
    angles, angle_errors : (A,) and (T, A) rad, of the flexion of elbows and knees.
    acceleration_errors : (T - 2, N) m/s^2, length of the difference of the accelerations: how much the estimate
        trembles.
    n_true : joints times frames that the truth knows.
    frame_rate : Hz.
    loss_bound : m, mean error of a frame above which it counts as lost.
    occluded : (T, N) true where inertia alone placed a joint; None if not known.
    """

    joints: tuple[str, ...]
    errors: FloatArray
    root_errors: FloatArray
    rigid_errors: FloatArray
    segments: tuple[str, ...]
    segment_errors: FloatArray
    angles: tuple[str, ...]
    angle_errors: FloatArray
    acceleration_errors: FloatArray
    n_true: int
    frame_rate: float
    loss_bound: float = LOSS_BOUND
    occluded: Flags | None = None

    @property
    def mean_mm(self) -> float:
        """Mean joint error (MPJPE)."""
        return mean_of(self.errors) * 1e3

    @property
    def root_mm(self) -> float:
        """Mean joint error with the hips in the right place."""
        return mean_of(self.root_errors) * 1e3

    @property
    def rigid_mm(self) -> float:
        """Mean joint error of the posture alone."""
        return mean_of(self.rigid_errors) * 1e3

    @property
    def joint_mm(self) -> dict[str, float]:
        """Mean error of each joint."""
        return {name: mean_of(self.errors[:, k]) * 1e3 for k, name in enumerate(self.joints)}

    @property
    def frame_errors(self) -> FloatArray:
        """(T,) m, mean error of each frame."""
        return np.array([mean_of(row) for row in self.errors])

    @property
    def segment_deg(self) -> float:
        """Mean error of the directions of the segments."""
        return float(np.rad2deg(mean_of(self.segment_errors)))

    @property
    def angle_deg(self) -> float:
        """Mean error of the flexion of elbows and knees."""
        return float(np.rad2deg(mean_of(self.angle_errors)))

    @property
    def jitter(self) -> float:
        """Mean error of the acceleration, m/s^2."""
        return mean_of(self.acceleration_errors)

    @property
    def visible_mm(self) -> float:
        """Mean error of joints that the silhouettes told something about; NaN if not known."""
        return float("nan") if self.occluded is None else mean_of(self.errors[~self.occluded]) * 1e3

    @property
    def occluded_mm(self) -> float:
        """Mean error of joints that inertia alone placed; NaN if there was none, or if not known."""
        return float("nan") if self.occluded is None else mean_of(self.errors[self.occluded]) * 1e3

    @property
    def share_compared(self) -> float:
        """Share of the truth that the estimate has a place for."""
        return float(np.isfinite(self.errors).sum() / self.n_true) if self.n_true else float("nan")

    @property
    def lost(self) -> Flags:
        """(T,) frames whose mean error exceeds the bound."""
        return self.frame_errors > self.loss_bound

    @property
    def loss_rate(self) -> float:
        """Share of the frames compared that are lost."""
        compared = np.isfinite(self.frame_errors)
        return float(self.lost.sum() / compared.sum()) if compared.any() else float("nan")

    @property
    def recovery_s(self) -> float:
        """Mean length in seconds of the stretches of lost frames that the track came back from; NaN without any."""
        ended = [stop - first for first, stop in list_stretches(self.lost) if stop < len(self.errors)]
        return float(np.mean(ended)) / self.frame_rate if ended else float("nan")

    @property
    def is_lost(self) -> bool:
        """Whether the whole is lost: more than half of its frames are, or its last one is."""
        return bool(self.loss_rate > 0.5 or (len(self.errors) and self.lost[-1]))

    def compute_pck(self, bound: float) -> float:
        """Share of correct keypoints, 0 to 1.

        Parameters
        ----------
        bound : m, greatest error of a joint that is correct.
        """
        compared = np.isfinite(self.errors)
        return float((self.errors[compared] <= bound).mean()) if compared.any() else float("nan")

    def to_json(self) -> dict[str, Any]:
        """The numbers that sum it up, in mm, degrees, seconds and m/s^2."""
        return {
            "mean_mm": self.mean_mm,
            "root_mm": self.root_mm,
            "rigid_mm": self.rigid_mm,
            "joints_mm": self.joint_mm,
            "frames_mm": (self.frame_errors * 1e3).tolist(),
            "segment_deg": self.segment_deg,
            "angle_deg": self.angle_deg,
            "angles_deg": {
                name: float(np.rad2deg(mean_of(self.angle_errors[:, k])))
                for k, name in enumerate(self.angles)
            },
            "pck_50": self.compute_pck(0.05),
            "pck_100": self.compute_pck(0.1),
            "loss_bound_mm": self.loss_bound * 1e3,
            "loss_rate": self.loss_rate,
            "is_lost": self.is_lost,
            "recovery_s": self.recovery_s,
            "visible_mm": self.visible_mm,
            "occluded_mm": self.occluded_mm,
            "jitter_m_s2": self.jitter,
            "share_compared": self.share_compared,
        }


@dataclass(frozen=True, slots=True, eq=False)
class ImageAccuracy:
    """How far an estimate is from the truth in the images.

    Parameters
    ----------
    joints : (N,) that both have.
    pixels : (V, T, N) px, NaN where nothing is compared.
    shares : (V, T, N) of the stature as it measures in the image at the depth of the body.
    """

    joints: tuple[str, ...]
    pixels: FloatArray
    shares: FloatArray

    @property
    def mean_px(self) -> float:
        """Mean error in pixels."""
        return mean_of(self.pixels)

    @property
    def mean_percent(self) -> float:
        """Mean error in percent of the stature."""
        return mean_of(self.shares) * 1e2

    @property
    def view_px(self) -> tuple[float, ...]:
        """Mean error in pixels of each view."""
        return tuple(mean_of(view) for view in self.pixels)

    def to_json(self) -> dict[str, Any]:
        """The numbers that sum it up."""
        return {"mean_px": self.mean_px, "percent_of_stature": self.mean_percent, "views_px": self.view_px}


def mean_of(values: FloatArray) -> float:
    """Mean of the numbers that are no NaN; NaN if there is none."""
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if seen.size else float("nan")


def list_stretches(flags: Flags) -> list[tuple[int, int]]:
    """Runs of true values as (first, stop)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.asarray(flags, np.int8), [0]))))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]
