"""The ways of ranking that the experiment compares, made ready for one gallery.

``fused``, ``histogram``, ``leaves``, ``pose`` : see ``ranking``; the forest is trained on the gallery.
``euclidean`` : distance of poses at 32 equally spaced instants.
``dtw`` : dynamic time warping of poses at 30 Hz, exact, without a band, over all clips; the sum along the path divided
    by both lengths, without which it was worse.
``motion_templates`` : Müller and Röder's distance of the query to a category's template orders the categories; the
    clips of the gallery come in the order of theirs. Clips of one category are equal.

The gallery is shuffled by the caller, so that clips which a ranking cannot tell apart come in an order drawn at random.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval._ranking_material import RankingMaterial
from dousa.retrieval.ranking import RANKINGS, RankedClips, RankingQuery, rank_clips

if TYPE_CHECKING:
    from dousa.retrieval.feature_sets import FeatureSet
    from dousa.retrieval.forest import MotionForest
    from dousa.retrieval.templates import MotionTemplates

__all__ = ["RANKING_SYSTEMS", "Ranker", "RankingSettings", "make_rankers"]

RANKING_SYSTEMS: tuple[str, ...] = (*RANKINGS, "euclidean", "dtw", "motion_templates")

Ranker = Callable[[int], NDArray[np.intp]]
"""From the number of a query clip to places in the gallery, the most similar first."""


@dataclass(frozen=True, slots=True)
class RankingSettings:
    """How forests and templates are made."""

    feature_set: FeatureSet
    n_trees: int
    n_jobs: int | None


def make_rankers(
    systems: Sequence[str],
    material: RankingMaterial,
    gallery: NDArray[np.intp],
    settings: RankingSettings,
    seed: int,
) -> tuple[dict[str, Ranker], dict[str, float]]:
    """A ranker for each system, in their order, and the seconds that training took, by what was trained."""
    rankers: dict[str, Ranker] = {}
    seconds: dict[str, float] = {}
    labels = material.categories[gallery].astype(str)
    started = time.perf_counter()
    if set(systems) & set(RANKINGS):
        forest, clips = _train_forest(material, gallery, labels, settings, seed)
        seconds["forest"] = time.perf_counter() - started
        rankers |= {by: partial(_rank_by_forest, by, forest, clips, material) for by in RANKINGS}
    if "euclidean" in systems:
        rankers["euclidean"] = partial(_rank_euclidean, material.resampled[gallery], material)
    if "dtw" in systems:
        rankers["dtw"] = partial(_rank_by_warping, *_join([material.poses[k] for k in gallery]), material)
    if "motion_templates" in systems:
        started = time.perf_counter()
        templates, numbers = _learn_templates(material, gallery, labels, settings)
        seconds["motion_templates"] = time.perf_counter() - started
        rankers["motion_templates"] = partial(_rank_by_template, templates, numbers, material)
    return {system: rankers[system] for system in systems}, seconds


def _train_forest(
    material: RankingMaterial,
    gallery: NDArray[np.intp],
    labels: NDArray[np.str_],
    settings: RankingSettings,
    seed: int,
) -> tuple[MotionForest, RankedClips]:
    from dousa.retrieval.forest import MotionForest

    spec = settings.feature_set
    forest = MotionForest(
        settings.n_trees,
        n_trials=spec.n_trials,
        thresholds=spec.thresholds,
        random_state=seed,
        n_jobs=settings.n_jobs,
    )
    forest.fit(material.features[gallery], labels, feature_set=spec)
    leaves = forest.apply(material.features[gallery])
    poses = np.ascontiguousarray(material.sequences[gallery])
    return forest, RankedClips(forest.histograms_of(leaves), leaves.astype(np.int32), poses.__getitem__)


def _rank_by_forest(
    by: str, forest: MotionForest, clips: RankedClips, material: RankingMaterial, query: int
) -> NDArray[np.intp]:
    leaves = forest.apply(material.features[query : query + 1])
    asked = RankingQuery(
        forest.histograms_of(leaves)[0], leaves[0].astype(np.int32), material.sequences[query]
    )
    return rank_clips(by, asked, clips).order


def _rank_euclidean(gallery: NDArray[np.float32], material: RankingMaterial, query: int) -> NDArray[np.intp]:
    apart = gallery - material.resampled[query]
    return np.argsort(np.einsum("nd,nd->n", apart, apart), kind="stable")


def _join(
    sequences: Sequence[NDArray[np.float32]],
) -> tuple[NDArray[np.float32], NDArray[np.intp], NDArray[np.intp]]:
    stops = np.cumsum([len(one) for one in sequences])
    return np.concatenate(sequences), stops - [len(one) for one in sequences], stops


def _rank_by_warping(
    frames: NDArray[np.float32],
    starts: NDArray[np.intp],
    stops: NDArray[np.intp],
    material: RankingMaterial,
    query: int,
) -> NDArray[np.intp]:
    from dousa.retrieval._pose_distance_kernels import warp_distances

    distances = np.empty(len(starts))
    warp_distances(material.poses[query], frames, starts, stops, np.inf, distances)
    return np.argsort(distances, kind="stable")


def _learn_templates(
    material: RankingMaterial, gallery: NDArray[np.intp], labels: NDArray[np.str_], settings: RankingSettings
) -> tuple[MotionTemplates, NDArray[np.intp]]:
    from dousa.retrieval.templates import MotionTemplates

    templates = MotionTemplates(n_jobs=settings.n_jobs)
    templates.fit_sequences([material.relational[k] for k in gallery], labels)
    return templates, np.searchsorted(templates.classes_, labels)


def _rank_by_template(
    templates: MotionTemplates, numbers: NDArray[np.intp], material: RankingMaterial, query: int
) -> NDArray[np.intp]:
    distances = templates.sequence_distances([material.relational[query]])[0]
    return np.argsort(distances[numbers], kind="stable")
