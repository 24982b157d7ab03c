"""Clips as the rankings of the experiment see them, computed once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval.ranking import RANKINGS

if TYPE_CHECKING:
    from dousa.retrieval._experiment_result import LabelledClip
    from dousa.retrieval.experiment import Progress
    from dousa.retrieval.feature_sets import FeatureSet
    from dousa.retrieval.posed_motion import PosedMotion

__all__ = ["RankingMaterial", "compute_body_poses", "describe_clips"]

_HEADING_SMOOTHING = 8.0  # frames, standard deviation: that of the extended features; it helps DTW as well
EUCLIDEAN_FRAMES = 32


@dataclass(frozen=True, slots=True)
class RankingMaterial:
    """Descriptions of N clips; empty where no system needs them.

    Parameters
    ----------
    categories : (N,) str objects.
    features : (N, T, F) of the forest.
    sequences : (N, cells, columns) pose sequences of ours.
    poses : N of (T_i, 60) float32, body-fixed joint positions in body heights at 30 Hz.
    resampled : (N, EUCLIDEAN_FRAMES * 60) float32, the same at equally many instants.
    relational : N of (T_i, 39), of motion templates.
    milliseconds : to describe a clip, mean, by kind.
    """

    categories: NDArray[np.object_]
    features: NDArray[np.float64]
    sequences: NDArray[np.float32]
    poses: list[NDArray[np.float32]]
    resampled: NDArray[np.float32]
    relational: list[NDArray[np.bool_]]
    milliseconds: dict[str, float]


def describe_clips(
    clips: Sequence[LabelledClip], systems: Sequence[str], feature_set: FeatureSet, progress: Progress | None
) -> RankingMaterial:
    """Compute what the asked systems look at."""
    features, sequences = np.empty((0, 0, 0)), np.empty((0, 0, 0), np.float32)
    poses: list[NDArray[np.float32]] = []
    resampled, relational = np.empty((0, 0), np.float32), []
    milliseconds: dict[str, float] = {}
    clock = _Clock(milliseconds, len(clips), progress)
    if set(systems) & set(RANKINGS):
        clock.start("features of the forest")
        described = [_describe_for_forest(clip, feature_set) for clip in clips]
        features = np.stack([one for one, _ in described])
        sequences = np.stack([two for _, two in described])
        clock.stop("forest")
    if {"euclidean", "dtw"} & set(systems):
        clock.start("poses")
        poses = [compute_body_poses(clip) for clip in clips]
        clock.stop("poses")
        resampled = np.stack([_resample(one, EUCLIDEAN_FRAMES).ravel() for one in poses])
    if "motion_templates" in systems:
        from dousa.retrieval.templates import compute_relational_sequence

        clock.start("relational features")
        relational = [compute_relational_sequence(clip) for clip in clips]
        clock.stop("motion_templates")
    categories = np.array([clip.category for clip in clips], dtype=object)
    return RankingMaterial(categories, features, sequences, poses, resampled, relational, milliseconds)


def compute_body_poses(clip: PosedMotion) -> NDArray[np.float32]:
    """Where the joints are, frame by frame: what the baselines compare.

    Parameters
    ----------
    clip : positions in m, rate in Hz, height in m.

    Returns
    -------
    (T, 60) at 30 Hz, body heights: the 20 joints from the pelvis, to the left, up and forward. The direction to the
    left is that of the hips, smoothed over time, without which Kinect recordings are ranked worse.
    """
    from scipy.ndimage import gaussian_filter1d

    from dousa.retrieval.channels import sample_positions
    from dousa.retrieval.features import find_lateral_axis

    sampled = sample_positions(np.asarray(clip.positions, np.float64), clip.frame_rate)
    points = (sampled - sampled[:, :1]) / clip.height
    left = gaussian_filter1d(find_lateral_axis(points), _HEADING_SMOOTHING, axis=0, mode="nearest")
    left /= np.maximum(np.hypot(left[:, 0], left[:, 1]), 1e-9)[:, None]
    across, along = left[:, :1], left[:, 1:]
    x, y, z = np.moveaxis(points, 2, 0)
    turned = np.stack([x * across + z * along, y, z * across - x * along], axis=2)
    return np.ascontiguousarray(turned.reshape(len(turned), -1), dtype=np.float32)


def _describe_for_forest(
    clip: PosedMotion, feature_set: FeatureSet
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Features and pose sequence; where both come from the same track, it is computed once."""
    from dousa.retrieval.pose_sequences import compute_pose_sequence, compute_window_poses
    from dousa.retrieval.tracks import compute_track

    if not feature_set.has_banks:
        return feature_set.compute(clip), compute_pose_sequence(clip)
    track = compute_track(clip, feature_set)
    whole = [0.0], [float(track.n_frames)]
    return track.describe(*whole)[0], compute_window_poses(track, *whole)[0]


def _resample(poses: NDArray[np.float32], n_frames: int) -> NDArray[np.float32]:
    """(n_frames, D) at equally spaced instants from the first frame to the last, linearly."""
    places = np.linspace(0.0, len(poses) - 1.0, n_frames)
    below = places.astype(np.intp)
    share = (places - below).astype(np.float32)[:, None]
    above = np.minimum(below + 1, len(poses) - 1)
    mixed: NDArray[np.float32] = poses[below] * (1 - share) + poses[above] * share
    return mixed


class _Clock:
    """Times the descriptions and says what is being done."""

    def __init__(self, milliseconds: dict[str, float], n_clips: int, progress: Progress | None) -> None:
        self.milliseconds, self.n_clips, self.progress = milliseconds, n_clips, progress
        self.started = 0.0

    def start(self, doing: str) -> None:
        if self.progress is not None:
            self.progress(0, 0, doing)
        self.started = time.perf_counter()

    def stop(self, kind: str) -> None:
        self.milliseconds[kind] = 1e3 * (time.perf_counter() - self.started) / self.n_clips
