"""Stretches of a recording, judged as clips: their most likely category, and how certain it is.

A stretch is described as a stored clip would be; the category comes from its finder's shares and the trees' votes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.posed_motion import PlainMotion, PosedMotion, check_shape
from dousa.retrieval.features.sensor_noise import measure_unsteadiness, reduce_noise_of_all
from dousa.retrieval.forest.calibration import Assessor
from dousa.retrieval.forest.evidence import EVIDENCE
from dousa.workers.threads import map_together

# Weights, in the log odds of the categories, of the finder's shares and of the trees' votes. Fitted like those of
# `label` (lab/trials/segment_confidence.py).
_BY_FINDER, _BY_VOTES = 1.07, 2.75


@dataclass(frozen=True, slots=True, eq=False)
class StretchOpinions:
    """The judgement of N stretches.

    Parameters
    ----------
    judged : (N,) whether the forest knows the category found; the other fields mean nothing where it does not.
    names : N most likely categories.
    leads : (N,) log odds of those against all others.
    typical : (N,) how near the poses are to those of the category, less the usual value (``evidence``).
    unsteady : (N,) unsteadiness of the bones (``measure_unsteadiness``).
    sure : (N,) whether a clip of these frames would be given this name.
    possible : (N,) whether it would be, or perhaps.
    """

    judged: BoolArray
    names: tuple[str, ...]
    leads: FloatArray
    typical: FloatArray
    unsteady: FloatArray
    sure: BoolArray
    possible: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class StretchJudge:
    """A forest that judges stretches of recordings.

    Parameters
    ----------
    assessor : the forest and its calibration.
    feature_set : that of the forest.
    spared : categories that are not judged, as the forest has seen too few clips of them.
    """

    assessor: Assessor
    feature_set: FeatureSet
    spared: frozenset[str] = frozenset()

    def judge(
        self,
        motion: PosedMotion,
        spans: Sequence[tuple[float, float]],
        found: Sequence[str],
        shares: FloatArray,
        categories: Sequence[str],
        n_jobs: int | None = None,
        least_share: float = 0.02,
        most_odds: float = 7.0,
    ) -> StretchOpinions:
        """Judge stretches of a recording.

        Parameters
        ----------
        motion : the recording, of any frame rate.
        spans : start and stop of each, s; at least one.
        found : the category as which each was found.
        shares : (N, C) how likely each shows each category, by its finder.
        categories : C of them.
        n_jobs : threads; None for one. The result does not depend on it.
        least_share : added to shares before their logarithm.
        most_odds : bound of the log odds.
        """
        forest = self.assessor.forest

        def look(some: list[tuple[float, float]]) -> Iterator[tuple[FloatArray, float]]:
            parts = reduce_noise_of_all([cut_stretch(motion, *span) for span in some])
            return zip(self.feature_set.compute_quiet_all(parts), map(measure_unsteadiness, parts), strict=True)

        lengths = [stop - start for start, stop in spans]
        described, unsteady = zip(*map_together(look, spans, lengths, n_jobs), strict=True)
        # Rounded to single precision, as features are stored.
        features = np.stack(described).astype(np.float32).astype(np.float64)
        leaves = forest.apply(features)
        votes = forest.histograms_of(leaves.astype(np.int64))
        numbers = {name: number for number, name in enumerate(categories) if name not in self.spared}
        places = np.array([numbers.get(str(name), -1) for name in forest.classes_])
        judged = np.isin(np.array(found), forest.classes_[places >= 0])
        scores = _BY_FINDER * np.log(shares[:, places] + least_share) + _BY_VOTES * np.log(votes + least_share)
        scores[:, places < 0] = -np.inf
        scores[~judged] = 0.0
        rows, named = np.arange(len(scores)), scores.argmax(axis=1)
        odds = scores - scores[rows, named][:, None]
        odds[rows, named] = -np.inf
        leads = -np.log(np.maximum(np.exp(odds).sum(axis=1), np.exp(-most_odds)))
        seen = self.assessor.assess(leaves, features, named)
        return StretchOpinions(
            judged,
            tuple(str(name) for name in forest.classes_[named]),
            np.maximum(leads, -most_odds),
            seen.evidence[:, EVIDENCE.index("typical")],
            np.array(unsteady),
            judged & ~seen.unknown,
            judged & seen.possible,
        )

    def sparing(self, categories: frozenset[str]) -> StretchJudge:
        """Return the same judge with more categories spared."""
        return replace(self, spared=self.spared | categories)


def cut_stretch(motion: PosedMotion, start: float, stop: float) -> PlainMotion:
    """Return the frames of a recording from ``start`` to ``stop`` (s), at least one."""
    points = check_shape(motion.positions, motion.height)
    first = min(max(round(start * motion.frame_rate), 0), len(points) - 1)
    last = max(round(stop * motion.frame_rate), first + 1)
    return PlainMotion(points[first:last], motion.frame_rate, motion.height)
