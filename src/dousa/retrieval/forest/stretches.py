"""Stretches of a recording, judged as clips: what each shows, by its trees and by who found it, and how likely that is.

A stretch is cut out at the frame rate of its recording and described as a clip that somebody stored would be. Who found
it has an opinion on what it shows, too; the trees often know better where a sensor is noisy, so both name it together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.posed_motion import PosedMotion, check_shape
from dousa.retrieval.features.sensor_noise import measure_unsteadiness, reduce_noise_of_all
from dousa.retrieval.forest.calibration import Assessor
from dousa.retrieval.forest.evidence import EVIDENCE
from dousa.workers.threads import map_together

# What a category's share by who found a stretch, and by the trees, weigh in the log odds of the categories. Fitted as
# those of `label` are (lab/trials/segment_confidence.py).
_BY_FINDER, _BY_VOTES = 1.06, 2.74
_LEAST_SHARE = 0.02
_MOST_ODDS = 7.0


@dataclass(frozen=True, slots=True, eq=False)
class StretchOpinions:
    """What is thought of N stretches.

    Parameters
    ----------
    judged : (N,) whether the forest knows the category as which it was found; what follows says nothing where not.
    names : N categories that the stretches show most likely.
    leads : (N,) log odds of those against all others.
    typical : (N,) how near the poses are to those of the category, less what is usual (``evidence``).
    unsteady : (N,) unsteadiness of the bones (``measure_unsteadiness``).
    sure : (N,) whether a clip of these frames would be called by this name.
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
    """A forest that is asked about stretches of recordings.

    Parameters
    ----------
    assessor : the forest, and how far it can be trusted.
    feature_set : what it looks at.
    spared : categories of which it is not asked, as it has seen too little of them.
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
    ) -> StretchOpinions:
        """What is thought of stretches.

        Parameters
        ----------
        motion : the recording, of any frame rate.
        spans : from when to when, s; one at least.
        found : the category as which each was found.
        shares : (N, C) how likely each shows each category, by who found it.
        categories : C of them.
        n_jobs : threads; None for one. The result does not depend on it.
        """
        forest = self.assessor.forest

        def look(some: list[tuple[float, float]]) -> Iterator[tuple[FloatArray, float]]:
            parts = reduce_noise_of_all([cut_stretch(motion, *span) for span in some])
            return zip(self.feature_set.compute_quiet_all(parts), map(measure_unsteadiness, parts), strict=True)

        lengths = [stop - start for start, stop in spans]
        described, unsteady = zip(*map_together(look, spans, lengths, n_jobs), strict=True)
        # As stored clips are: what is kept of features is single precision.
        features = np.stack(described).astype(np.float32).astype(np.float64)
        leaves = forest.apply(features)
        votes = forest.histograms_of(leaves.astype(np.int64))
        numbers = {name: number for number, name in enumerate(categories) if name not in self.spared}
        places = np.array([numbers.get(str(name), -1) for name in forest.classes_])
        judged = np.isin(np.array(found), forest.classes_[places >= 0])
        scores = _BY_FINDER * np.log(shares[:, places] + _LEAST_SHARE) + _BY_VOTES * np.log(votes + _LEAST_SHARE)
        scores[:, places < 0] = -np.inf
        scores[~judged] = 0.0
        rows, named = np.arange(len(scores)), scores.argmax(axis=1)
        odds = scores - scores[rows, named][:, None]
        odds[rows, named] = -np.inf
        leads = -np.log(np.maximum(np.exp(odds).sum(axis=1), np.exp(-_MOST_ODDS)))
        seen = self.assessor.assess(leaves, features, named)
        return StretchOpinions(
            judged,
            tuple(str(name) for name in forest.classes_[named]),
            np.maximum(leads, -_MOST_ODDS),
            seen.evidence[:, EVIDENCE.index("typical")],
            np.array(unsteady),
            judged & ~seen.unknown,
            judged & seen.possible,
        )

    def sparing(self, categories: frozenset[str]) -> StretchJudge:
        """The same judge, which is not asked about some categories."""
        return replace(self, spared=self.spared | categories)


@dataclass(frozen=True, slots=True, eq=False)
class CutStretch:
    """A part of a recording."""

    positions: FloatArray
    frame_rate: float
    height: float


def cut_stretch(motion: PosedMotion, start: float, stop: float) -> CutStretch:
    """The frames of a recording from ``start`` to ``stop`` (s), one at least."""
    points = check_shape(motion.positions, motion.height)
    first = min(max(round(start * motion.frame_rate), 0), len(points) - 1)
    last = max(round(stop * motion.frame_rate), first + 1)
    return CutStretch(points[first:last], motion.frame_rate, motion.height)
