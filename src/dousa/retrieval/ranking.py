"""Ranking of clips: by their histograms (eq. 8), by the leaves they share, by their poses, and by all three.

``histogram`` the Euclidean distance of the histograms of votes (eq. 8): which category. Clips that a forest learned by
heart have nearly all votes in one category, so it hardly orders the clips of one.

``leaves`` the share of the trees in which two clips end in different leaves: 1 less the proximity of Breiman and
Cutler's random forests. It also tells apart what the forest was never taught.

``pose`` the distance of the poses after an alignment in time, for the best clips of a cheaper order; the others keep
that order behind them.

``fused`` the sum ``histogram / sqrt(2) + leaves / 2 + 8 pose``: each distance on a scale of its own that is the same
for every query, so that the sums of two queries can be compared. An eighth of a body height between the poses counts as
much as votes that disagree altogether. The weights are in docs/ranking.md with what they were chosen by.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, OptionError

__all__ = [
    "DEFAULT_RANKING",
    "N_REFINED",
    "RANKINGS",
    "RankedClips",
    "Ranking",
    "RankingQuery",
    "rank_by_fusion",
    "rank_by_histogram",
    "rank_by_leaves",
    "rank_by_pose",
    "rank_clips",
]

FloatArray = NDArray[np.float64]

RANKINGS: tuple[str, ...] = ("fused", "histogram", "leaves", "pose")
DEFAULT_RANKING = "fused"

N_REFINED = 64
"""Clips whose poses are compared: those that the histograms and leaves put first."""

_HISTOGRAM_SCALE = 2.0**-0.5  # histograms without a common vote are sqrt(2) apart
_LEAVES_WEIGHT = 0.5
_POSE_SCALE = 8.0  # 1 / body heights
_REACH = 2.0  # cells by which an aligned pair may lie off the diagonal, of 16


@dataclass(frozen=True, slots=True, eq=False)
class RankingQuery:
    """What is known of a query.

    Parameters
    ----------
    histogram : (C,) votes or shares of the categories; votes give distances without rounding.
    leaves : (n_trees,) the leaf it reaches in each tree.
    poses : (T, D) its pose sequence, see ``compute_pose_sequence``.
    """

    histogram: NDArray[np.generic]
    leaves: NDArray[np.integer]
    poses: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class RankedClips:
    """What is known of the clips that are put in order.

    Parameters
    ----------
    histograms : (N, C) in the unit of the query's.
    leaves : (N, n_trees)
    read_poses : gives (n, T, D) of the clips with these n places, asked once a query for those that are refined;
        ``array.__getitem__`` of an array (N, T, D) will do.
    """

    histograms: NDArray[np.generic]
    leaves: NDArray[np.integer]
    read_poses: Callable[[NDArray[np.intp]], NDArray[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """Clips in order, and how far each is from the query.

    Parameters
    ----------
    order : (N,) places of the clips, the most similar first.
    distances : (N,) of the clips in the order given, what ``order`` sorts by: ``distances[order]`` ascends. NaN for
        ``pose`` where poses were not compared.
    histogram : (N,) eq. 8 between shares, 0 to sqrt(2).
    leaves : (N,) share of the trees with different leaves, 0 to 1.
    pose : (N,) body heights; NaN where poses were not compared.
    """

    order: NDArray[np.intp]
    distances: FloatArray
    histogram: FloatArray
    leaves: FloatArray
    pose: FloatArray


def rank_by_histogram(query: ArrayLike, histograms: ArrayLike) -> tuple[NDArray[np.intp], FloatArray]:
    """Clips from the most to the least similar, by the Euclidean distance of their histograms.

    Parameters
    ----------
    query : (C,) histogram of the query.
    histograms : (N, C) of the clips.

    Returns
    -------
    order : (N,) indices of the clips, nearest first; equals keep their order.
    distances : (N,) of the clips in the order given: ``distances[order]`` ascends. 0 to sqrt(2) for shares.

    Raises
    ------
    InvalidMotionError : shapes that disagree, or values that are not finite.

    Source: Hamada et al., eq. 8. The paper calls it a similarity and sorts descending; it is a distance.
    """
    distances = _compare_histograms(query, histograms)
    return np.argsort(distances, kind="stable"), distances


def _compare_histograms(query: ArrayLike, histograms: ArrayLike) -> FloatArray:
    from dousa.retrieval._ranking_kernels import measure_distances

    asked = np.asarray(query, dtype=np.float64)
    stored = np.asarray(histograms)
    if asked.ndim != 1 or stored.ndim != 2 or stored.shape[1] != len(asked):
        raise InvalidMotionError(
            f"expected a histogram (C,) and histograms (N, C), got shapes {asked.shape} and {stored.shape}"
        )
    # Votes stay as they are: no copy of a whole library.
    kind = np.int32 if stored.dtype == np.int32 else np.float64
    distances = np.empty(len(stored))
    measure_distances(np.ascontiguousarray(asked), np.ascontiguousarray(stored, kind), distances)
    if not np.isfinite(distances).all():
        raise InvalidMotionError("expected finite histograms, got NaN or infinity")
    return distances


def rank_by_leaves(query: ArrayLike, leaves: ArrayLike) -> tuple[NDArray[np.intp], FloatArray]:
    """Clips from the most to the least similar, by the share of trees in which they end in another leaf.

    Parameters
    ----------
    query : (n_trees,) leaves of the query.
    leaves : (N, n_trees) of the clips.

    Returns
    -------
    order : (N,) indices of the clips, nearest first; equals keep their order.
    distances : (N,) of the clips in the order given, 0 to 1.

    Raises
    ------
    InvalidMotionError : shapes that disagree, or no trees.

    Source: Breiman and Cutler's proximity of random forests, 1 less it.
    """
    distances = _compare_leaves(query, leaves)
    return np.argsort(distances, kind="stable"), distances


def _compare_leaves(query: ArrayLike, leaves: ArrayLike) -> FloatArray:
    from dousa.retrieval._ranking_kernels import count_differences

    asked, stored = np.ascontiguousarray(query, np.int32), np.ascontiguousarray(leaves, np.int32)
    if asked.ndim != 1 or stored.ndim != 2 or stored.shape[1] != len(asked) or not len(asked):
        raise InvalidMotionError(
            f"expected leaves (n_trees,) and (N, n_trees), got shapes {asked.shape} and {stored.shape}"
        )
    counts = np.empty(len(stored), np.int32)
    count_differences(asked, stored, counts)
    distances: FloatArray = counts / len(asked)
    return distances


def rank_by_pose(query: ArrayLike, poses: ArrayLike) -> tuple[NDArray[np.intp], FloatArray]:
    """Clips from the most to the least similar, by the distance of their poses after an alignment in time.

    Parameters
    ----------
    query : (T, D) pose sequence of the query.
    poses : (N, T, D) of the clips.

    Returns
    -------
    order : (N,) indices of the clips, nearest first; equals keep their order.
    distances : (N,) of the clips in the order given, body heights: dynamic time warping within 2 cells of the diagonal,
        the sum over the path divided by 2 T. The mean distance of two poses is up to twice as large.

    Raises
    ------
    InvalidMotionError : shapes that disagree, or values that are not finite.
    """
    from dousa.retrieval._pose_distance_kernels import warp_distances

    asked = np.ascontiguousarray(query, dtype=np.float32)
    stored = np.ascontiguousarray(poses, dtype=np.float32)
    if asked.ndim != 2 or stored.ndim != 3 or stored.shape[1:] != asked.shape or not asked.size:
        raise InvalidMotionError(
            f"expected poses (T, D) and (N, T, D), got shapes {asked.shape} and {stored.shape}"
        )
    starts = np.arange(len(stored)) * len(asked)
    distances = np.empty(len(stored))
    frames = stored.reshape(-1, asked.shape[1])
    warp_distances(asked, frames, starts, starts + len(asked), _REACH, distances)
    if not np.isfinite(distances).all():
        raise InvalidMotionError("expected finite poses, got NaN or infinity")
    return np.argsort(distances, kind="stable"), distances


def rank_by_fusion(query: RankingQuery, clips: RankedClips, n_refined: int = N_REFINED) -> Ranking:
    """Clips from the most to the least similar by histogram, leaves and poses together; see ``rank_clips``."""
    return rank_clips("fused", query, clips, n_refined)


def rank_clips(by: str, query: RankingQuery, clips: RankedClips, n_refined: int = N_REFINED) -> Ranking:
    """Put clips in order by one of ``RANKINGS``.

    Parameters
    ----------
    by : ``"fused"``, ``"histogram"`` (equals by their leaves), ``"leaves"`` (equals by their histograms) or ``"pose"``.
    query, clips : what is known of them. ``"histogram"`` and ``"leaves"`` do not ask for poses.
    n_refined : clips whose poses are compared, 1 or more.

    Returns
    -------
    Ranking. Clips that nothing tells apart keep their order.

    Raises
    ------
    OptionError : an unknown ranking, or nothing to refine.
    InvalidMotionError : arrays whose shapes disagree or that are not finite.
    """
    if by not in RANKINGS:
        raise OptionError(f"ranking: expected {', '.join(RANKINGS)}, got '{by}'")
    if n_refined < 1:
        raise OptionError(f"clips to refine: expected 1 or more, got {n_refined}")
    histogram = _compare_histograms(query.histogram, clips.histograms)
    histogram /= max(float(np.sum(query.histogram)), 1e-300)
    leaves = _compare_leaves(query.leaves, clips.leaves)
    pose = np.full(len(histogram), np.nan)
    if by in ("histogram", "leaves"):
        first, second = (histogram, leaves) if by == "histogram" else (leaves, histogram)
        return Ranking(np.lexsort((second, first)), first, histogram, leaves, pose)
    cheap = histogram * _HISTOGRAM_SCALE + _LEAVES_WEIGHT * leaves
    order = np.argsort(cheap, kind="stable")
    refined = order[:n_refined]
    if len(refined):
        pose[refined] = rank_by_pose(query.poses, clips.read_poses(refined))[1]
    distances = pose if by == "pose" else _fuse(cheap, pose, refined)
    order[:n_refined] = refined[np.argsort(distances[refined], kind="stable")]
    return Ranking(order, distances, histogram, leaves, pose)


def _fuse(cheap: FloatArray, pose: FloatArray, refined: NDArray[np.intp]) -> FloatArray:
    """The sums; where poses were not compared they are taken for as far apart as the farthest that were."""
    worst = float(pose[refined].max(initial=0.0))
    return cheap + _POSE_SCALE * np.where(np.isnan(pose), worst, pose)
