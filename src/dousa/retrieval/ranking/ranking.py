"""Rank clips by histograms (eq. 8), by shared leaves, by poses, or by all three.

``histogram`` is the Euclidean distance of the histograms of votes (eq. 8). Clips learned by heart have nearly all votes
in one category, so it hardly orders the clips within a category.

``leaves`` is the share of trees in which two clips end in different leaves, 1 less the proximity of Breiman and
Cutler's random forests. It also separates categories that did not train.

``pose`` is the distance of the poses after an alignment in time, for the best clips of a cheaper order; the others
follow in that order.

``fused`` is ``histogram / sqrt(2) + leaves / 2 + 8 pose``, on a scale that is the same for every query. The weights and
their choice are in docs/ranking.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.errors import InvalidMotionError
from dousa.kernels import kernel, part
from dousa.retrieval.features.channels import CHANNELS, WantedMeans
from dousa.retrieval.features.feature_sets import FEATURE_SETS, FeatureSet
from dousa.retrieval.features.posed_motion import PosedMotion
from dousa.retrieval.features.sensor_noise import reduce_noise

POSE_CELLS = 16
"""Cells of a pose sequence (docs/ranking.md)."""

N_JOINTS = 12  # (docs/ranking.md)

POSE_COLUMNS = 3 * N_JOINTS + 4
"""Numbers of a cell: of the joints, and of the body moving in three directions and turning (docs/ranking.md)."""


def compute_pose_sequence(motion: PosedMotion) -> NDArray[np.float32]:
    """Compute the pose sequence (POSE_CELLS, POSE_COLUMNS) of a clip of canonical positions, of any length.

    InvalidMotionError : positions that are not finite, no frame, or no body height.
    """
    sequence: NDArray[np.float32] = compute_with_poses([reduce_noise(motion)], FEATURE_SETS["extended"])[1][0]
    return sequence


def compute_with_poses(
    motions: Sequence[PosedMotion], feature_set: FeatureSet
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Compute features and pose sequences of N clips after noise reduction, with the channels computed once.

    The feature set is ``extended``, whole or without some joints. Returns (N, T, F) and (N, POSE_CELLS, POSE_COLUMNS).
    InvalidMotionError : positions that are not finite, no frame, or no body height.
    """
    wanted = WantedMeans(POSE_CELLS, _COLUMNS, _find_scale(feature_set.hidden))
    features, poses = feature_set.compute_quiet_with(motions, wanted)
    return features, poses.astype(np.float32)


_JOINTS = (
    "head",
    "neck",
    *(f"{side} {joint}" for joint in ("shoulder", "elbow", "hand", "knee", "foot") for side in ("left", "right")),
)
_RELATIONS = (*(f"{joint} and pelvis" for joint in _JOINTS), "body moving", "body turning")


def _find_scale(hidden: Sequence[str], moving_seconds: float = 0.3) -> FloatArray:
    """Return the (POSE_COLUMNS,) scale that keeps distances root mean squares over the joints that are not hidden.

    The body's movement counts for ``moving_seconds`` (docs/ranking.md); 0.2 and 0.4 did as well.
    """
    scale: FloatArray = np.append(np.ones(3 * N_JOINTS), np.full(4, moving_seconds)) / np.sqrt(N_JOINTS)
    n_hidden = sum(joint.replace("_", " ").replace("ankle", "foot") in _JOINTS for joint in hidden)
    return scale * np.sqrt(N_JOINTS / max(N_JOINTS - n_hidden, 1)) if n_hidden else scale


_COLUMNS = np.array([k for k, channel in enumerate(CHANNELS) if channel.relation in _RELATIONS], np.intp)


RANKINGS: tuple[str, ...] = ("fused", "histogram", "leaves", "pose")
DEFAULT_RANKING = "fused"

N_REFINED = 64
"""Clips with compared poses: the first by histograms and leaves (docs/ranking.md)."""

# Histograms without a common vote are sqrt(2) apart (docs/ranking.md).
HISTOGRAM_SCALE, LEAVES_WEIGHT = 2.0**-0.5, 0.5


def rank_by_pose(query: ArrayLike, poses: ArrayLike, reach: float = 2.0) -> tuple[IndexArray, FloatArray]:
    """Rank clips (N, T, D) by the distance of their poses from those of the query (T, D) after an alignment in time.

    Returns indices, nearest first (equals keep their order), and distances in the given order, in body heights: dynamic
    time warping within ``reach`` cells of the diagonal, the sum over the path divided by 2 T (docs/ranking.md).
    InvalidMotionError : shapes that disagree, or values that are not finite.
    """
    asked = np.ascontiguousarray(query, dtype=np.float32)
    stored = np.ascontiguousarray(poses, dtype=np.float32)
    if asked.ndim != 2 or stored.ndim != 3 or stored.shape[1:] != asked.shape or not asked.size:
        raise InvalidMotionError("ranking.poses", asked=asked.shape, stored=stored.shape)
    starts = np.arange(len(stored)) * len(asked)
    distances = np.empty(len(stored))
    frames = stored.reshape(-1, asked.shape[1])
    warp_distances(asked, frames, starts, starts + len(asked), reach, distances)
    if not np.isfinite(distances).all():
        raise InvalidMotionError("ranking.poses_not_finite")
    return np.argsort(distances, kind="stable"), distances


def add_up(histogram: FloatArray, leaves: FloatArray, cosines: NDArray[np.floating] | None) -> FloatArray:
    """Add the distances of histograms, leaves and, if known, angles, each on its scale: (N,)."""
    cheap: FloatArray = histogram * HISTOGRAM_SCALE + LEAVES_WEIGHT * leaves
    if cosines is not None:
        cheap += 0.5 * (1.0 - cosines)
    return cheap


def fuse(cheap: FloatArray, pose: FloatArray, refined: IndexArray, scale: float = 8.0) -> FloatArray:
    """Add the pose distances times ``scale`` (1 / body heights); clips not compared count as the farthest that were."""
    worst = float(pose[refined].max(initial=0.0))
    return cheap + scale * np.where(np.isnan(pose), worst, pose)


@part
def _measure(query: NDArray[np.float32], i: int, frames: NDArray[np.float32], j: int) -> Any:
    """Euclidean distance of rows i and j, added up in their order: the same on every processor, and interpreted."""
    square = np.float32(0.0)
    for k in range(query.shape[1]):
        difference = query[i, k] - frames[j, k]
        square += difference * difference
    return np.sqrt(square)


@part
def _warp(
    query: NDArray[np.float32],
    frames: NDArray[np.float32],
    start: int,
    m: int,
    reach: float,
    before: NDArray[np.float32],
    now: NDArray[np.float32],
) -> Any:
    """Cost of the cheapest path between query (n, D) and m rows of frames; ``before``, ``now`` hold m + 1."""
    n = len(query)
    slope = (m - 1) / (n - 1) if n > 1 else 0.0
    width = min(max(reach, slope, 1.0), float(m)) + 1e-9 if n > 1 else float(m)  # an edge may round either way
    far = np.float32(1e30)
    for j in range(m + 1):
        before[j] = now[j] = far  # index j + 1, so that j - 1 exists for j = 0
    before[0] = np.float32(0.0)
    for i in range(n):
        first = max(0, int(np.ceil(i * slope - width)))
        last = min(m - 1, int(np.floor(i * slope + width)))
        for j in range(first, last + 1):
            now[j + 1] = _measure(query, i, frames, start + j)
        now[first] = left = far
        for j in range(first, last + 1):
            left = now[j + 1] + min(left, before[j], before[j + 1])
            now[j + 1] = left
        for j in range(last + 1, min(m, last + 2 + int(slope))):  # the next band goes further
            now[j + 1] = far
        before, now = now, before
    return before[m]


def warp_distances(
    query: NDArray[np.float32],
    frames: NDArray[np.float32],
    starts: IntArray,
    stops: IntArray,
    reach: float,
    distances: FloatArray,
) -> None:
    """Compute the warping distances of one sequence from many.

    Parameters
    ----------
    query : (n, D) float32.
    frames : (M, D) float32, the other sequences one after the other.
    starts, stops : (N,) rows of ``frames`` where each begins and ends.
    reach : frames by which a pair may lie off the diagonal (Sakoe and Chiba), widened for unequal lengths;
        infinity for no band.
    distances : (N,) float64, filled.
    """
    costs = np.empty((2, (stops - starts).max(initial=0) + 1), np.float32)
    _warp_all(query, frames, starts, stops, reach, costs, distances)


@kernel(linear=True)
def _warp_all(query, frames, starts, stops, reach, costs, distances):  # type: ignore[no-untyped-def]
    for k in range(len(starts)):
        m = stops[k] - starts[k]
        distances[k] = _warp(query, frames, starts[k], m, reach, costs[0], costs[1]) / (len(query) + m)
