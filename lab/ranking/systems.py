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

from dousa.experiments.runner import Steps, describe_copies, fit_forest, make_forest
from dousa.messages import Message, Progress
from dousa.retrieval.ranking.ranking import RANKINGS
from lab.ranking.dense import Gallery, rank_clips

if TYPE_CHECKING:
    from dousa.retrieval.features.feature_sets import FeatureSet
    from dousa.retrieval.features.posed_motion import LabelledClip, PosedMotion
    from dousa.retrieval.forest.calibration import Copies
    from dousa.retrieval.forest.forest import MotionForest
    from dousa.retrieval.ranking.templates import MotionTemplates

_HEADING_SMOOTHING = 8.0  # frames, standard deviation: that of the extended features; it helps DTW as well
EUCLIDEAN_FRAMES = 32


@dataclass(frozen=True, slots=True)
class RankingMaterial:
    """Descriptions of N clips; empty where no system needs them.

    Parameters
    ----------
    categories : (N,) str objects.
    features, copies : (N, T, F) of the forest, and disturbed copies of the clips, which it learns from too.
    sequences : (N, cells, columns) pose sequences of ours.
    poses : N of (T_i, 60) float32, body-fixed joint positions in body heights at 30 Hz.
    resampled : (N, EUCLIDEAN_FRAMES * 60) float32, the same at equally many instants.
    relational : N of (T_i, 39), of motion templates.
    milliseconds : to describe a clip, mean, by kind.
    """

    categories: NDArray[np.object_]
    features: NDArray[np.float64]
    copies: Copies
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
        clock.start(Message("trial_progress.features"))
        described = [_describe_for_forest(clip, feature_set) for clip in clips]
        features = np.stack([one for one, _ in described])
        sequences = np.stack([two for _, two in described])
        clock.stop("forest")
    copies = describe_copies(clips if set(systems) & set(RANKINGS) else (), feature_set)
    if {"euclidean", "dtw"} & set(systems):
        clock.start(Message("trial_progress.poses"))
        poses = [compute_body_poses(clip) for clip in clips]
        clock.stop("poses")
        resampled = np.stack([_resample(one, EUCLIDEAN_FRAMES).ravel() for one in poses])
    if "motion_templates" in systems:
        from dousa.retrieval.ranking.templates import compute_relational_sequence

        clock.start(Message("trial_progress.relational"))
        relational = [compute_relational_sequence(clip) for clip in clips]
        clock.stop("motion_templates")
    categories = np.array([clip.category for clip in clips], dtype=object)
    return RankingMaterial(categories, features, copies, sequences, poses, resampled, relational, milliseconds)


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
    from dousa.motion.resampling import smooth_gaussian
    from dousa.retrieval.features.channels import sample_positions
    from dousa.retrieval.features.pose_features import find_lateral_axis

    sampled = sample_positions(np.asarray(clip.positions, np.float64), clip.frame_rate)
    points = (sampled - sampled[:, :1]) / clip.height
    left = smooth_gaussian(find_lateral_axis(points), _HEADING_SMOOTHING)
    left /= np.maximum(np.hypot(left[:, 0], left[:, 1]), 1e-9)[:, None]
    across, along = left[:, :1], left[:, 1:]
    x, y, z = np.moveaxis(points, 2, 0)
    turned = np.stack([x * across + z * along, y, z * across - x * along], axis=2)
    return np.ascontiguousarray(turned.reshape(len(turned), -1), dtype=np.float32)


def _describe_for_forest(clip: PosedMotion, feature_set: FeatureSet) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Features and pose sequence; where both come from the same channels, these are computed once."""
    from dousa.retrieval.features.sensor_noise import reduce_noise
    from dousa.retrieval.ranking.ranking import compute_pose_sequence, compute_with_poses

    if not feature_set.has_banks:
        return feature_set.compute(clip), compute_pose_sequence(clip)
    features, poses = compute_with_poses([reduce_noise(clip)], feature_set)
    return features[0], poses[0]


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
        self.milliseconds, self.n_clips, self.steps = milliseconds, n_clips, Steps(progress)
        self.started = 0.0

    def start(self, doing: Message) -> None:
        self.steps.say(doing)
        self.started = time.perf_counter()

    def stop(self, kind: str) -> None:
        self.milliseconds[kind] = 1e3 * (time.perf_counter() - self.started) / self.n_clips


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
) -> tuple[MotionForest, Gallery]:
    features = settings.feature_set
    forest = make_forest(features, settings.n_trees, seed, settings.n_jobs)
    fit_forest(forest, material.features, gallery, labels, material.copies, features)
    leaves = forest.apply(material.features[gallery])
    poses = np.ascontiguousarray(material.sequences[gallery])
    return forest, Gallery(forest.histograms_of(leaves), leaves, poses)


def _rank_by_forest(
    by: str, forest: MotionForest, clips: Gallery, material: RankingMaterial, query: int
) -> NDArray[np.intp]:
    leaves = forest.apply(material.features[query : query + 1])
    asked = forest.histograms_of(leaves)[0], leaves[0], material.sequences[query]
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
    from dousa.retrieval.ranking.ranking import warp_distances

    distances = np.empty(len(starts))
    warp_distances(material.poses[query], frames, starts, stops, np.inf, distances)
    return np.argsort(distances, kind="stable")


def _learn_templates(
    material: RankingMaterial, gallery: NDArray[np.intp], labels: NDArray[np.str_], settings: RankingSettings
) -> tuple[MotionTemplates, NDArray[np.intp]]:
    from dousa.retrieval.ranking.templates import MotionTemplates

    templates = MotionTemplates(n_jobs=settings.n_jobs)
    templates.fit([material.relational[k] for k in gallery], labels)
    return templates, np.searchsorted(templates.classes_, labels)


def _rank_by_template(
    templates: MotionTemplates, numbers: NDArray[np.intp], material: RankingMaterial, query: int
) -> NDArray[np.intp]:
    distances = templates.distances([material.relational[query]])[0]
    return np.argsort(distances[numbers], kind="stable")
