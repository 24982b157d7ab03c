"""Clips ranked with all their histograms, leaves and poses in memory: what `Library.search` finds by an index."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval.ranking.ranking import N_REFINED, add_up, fuse, rank_by_pose


@dataclass(frozen=True, slots=True, eq=False)
class Gallery:
    """N clips: histograms (N, C) of shares, leaves (N, n_trees) and pose sequences (N, T, D)."""

    histograms: NDArray[np.float64]
    leaves: NDArray[np.integer]
    poses: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """Places of the clips, the most similar first, and their distances; those of poses NaN where not compared."""

    order: NDArray[np.intp]
    histogram: NDArray[np.float64]
    leaves: NDArray[np.float64]
    pose: NDArray[np.float64]


def rank_clips(
    by: str,
    query: tuple[NDArray[np.float64], NDArray[np.integer], NDArray[np.float32]],
    clips: Gallery,
    n_refined: int = N_REFINED,
) -> Ranking:
    """Rank clips by one of `RANKINGS`, of a query's histogram, leaves and poses; equals keep their order."""
    shares, own, poses = query
    histogram = np.linalg.norm(clips.histograms - shares, axis=1)
    leaves = (clips.leaves != own).mean(axis=1)
    pose = np.full(len(histogram), np.nan)
    if by in ("histogram", "leaves"):
        first, second = (histogram, leaves) if by == "histogram" else (leaves, histogram)
        return Ranking(np.lexsort((second, first)), histogram, leaves, pose)
    cheap = add_up(histogram, leaves, None)
    order = np.argsort(cheap, kind="stable")
    refined = order[:n_refined]
    if len(refined):
        pose[refined] = rank_by_pose(poses, clips.poses[refined])[1]
    distances = pose if by == "pose" else fuse(cheap, pose, refined)
    order[:n_refined] = refined[np.argsort(distances[refined], kind="stable")]
    return Ranking(order, histogram, leaves, pose)
