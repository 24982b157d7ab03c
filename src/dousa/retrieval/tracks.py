"""A recording as integrals of its channels: any window of it is described by a few subtractions.

Time runs in two ways. The clock's is that of ``paper``: the cells of a clip are equally long. ``extended`` counts
*motion time*: its seconds are weighed by how fast the body moves, so that the cells of a clip hold equal amounts of
movement. Rest before and after a gesture, and a pause within, then take a small part of the cells only, and a gesture
that one person does fast and another slowly falls into the same cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError
from dousa.retrieval._track_kernels import read_cells
from dousa.retrieval.channels import CHANNEL_RATE, compute_channels, integrate_channels, sample_positions
from dousa.retrieval.feature_sets import FeatureSet
from dousa.retrieval.features import compute_pose_features
from dousa.retrieval.posed_motion import PosedMotion, check_motion

__all__ = ["FeatureTrack", "compute_track"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FeatureTrack:
    """The channels of a recording at ``CHANNEL_RATE``, integrated over time.

    Parameters
    ----------
    feature_set : which channels.
    times : (n + 1,) when each frame begins, and the last ends: frames, or motion time.
    integrals : (n + 1, C) of the channels over these times (eq. 4); with banks (n + 1, 3 C): of the values, of their
        squares, and of the values times the time.
    """

    feature_set: FeatureSet
    times: FloatArray
    integrals: FloatArray

    @property
    def n_frames(self) -> int:
        """n, at ``frame_rate``."""
        return len(self.integrals) - 1

    @property
    def frame_rate(self) -> float:
        """Hz."""
        return CHANNEL_RATE

    def find_edges(self, starts: ArrayLike, stops: ArrayLike, n_cells: int | None = None) -> FloatArray:
        """Where the cells of windows begin and end, in frames.

        Parameters
        ----------
        starts, stops : as in ``describe``, which raises the same errors.
        n_cells : as many as the feature set has, if it is None.

        Returns
        -------
        (N, n_cells + 1)
        """
        first, last = (
            np.atleast_1d(np.asarray(starts, np.float64)),
            np.atleast_1d(np.asarray(stops, np.float64)),
        )
        inside = (first >= 0) & (first < last) & (last <= self.n_frames)
        if first.shape != last.shape or first.ndim != 1 or not inside.all():
            raise InvalidMotionError(
                f"expected windows within 0 ... {self.n_frames} frames, and as many starts as stops, got others"
            )
        frames = np.arange(self.n_frames + 1.0)
        begin, end = np.interp(first, frames, self.times), np.interp(last, frames, self.times)
        parts = np.linspace(0.0, 1.0, (n_cells or self.feature_set.n_frames) + 1)
        edges = np.interp(begin[:, None] + (end - begin)[:, None] * parts, self.times, frames)
        edges[:, 0], edges[:, -1] = first, last
        return edges

    def describe(self, starts: ArrayLike, stops: ArrayLike) -> FloatArray:
        """The features of windows.

        Parameters
        ----------
        starts, stops : (N,) frames of the track, whole or not; 0 <= start < stop <= n_frames.

        Returns
        -------
        (N, T, F) what a forest takes.

        Raises
        ------
        InvalidMotionError : a window outside the recording or without length.
        """
        edges, spec = self.find_edges(starts, stops), self.feature_set
        cells = np.empty((len(edges), spec.n_frames, spec.n_columns))
        if spec.has_banks:
            cells[:, :, len(spec.channels)] = ((edges[:, -1] - edges[:, 0]) / CHANNEL_RATE)[:, None]
        work = np.empty((2, self.integrals.shape[1]))
        read_cells(self.integrals, self.times, edges, len(spec.channels), work, cells)
        return cells


def compute_track(motion: PosedMotion, feature_set: FeatureSet) -> FeatureTrack:
    """Sum the channels of a recording.

    Parameters
    ----------
    motion : of any frame rate and length.
    feature_set : which channels.

    Returns
    -------
    FeatureTrack

    Raises
    ------
    InvalidMotionError : another shape than (n, 20, 3), no frame, positions that are not finite, no body height.

    Source: Hamada et al., eq. 4, with the integrals of squares and of moments beside it.
    """
    sampled = sample_positions(check_motion(motion), motion.frame_rate)
    if not feature_set.has_banks:
        poses = compute_pose_features(sampled, motion.height)
        return FeatureTrack(feature_set, np.arange(len(poses) + 1.0), _integrate(poses))
    times, integrals = integrate_channels(compute_channels(sampled, motion.height))
    return FeatureTrack(feature_set, times, integrals)


def _integrate(values: FloatArray) -> FloatArray:
    summed = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=summed[1:])
    return summed
