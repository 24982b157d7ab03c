"""Stretches of a recording, judged as clips: what the trees make of each, and how likely a category is right.

A stretch is cut out at the frame rate of its recording and described as a clip that somebody stored would be. So its
confidence is that of a clip, from the same evidence and the same curves (``calibration``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.posed_motion import PosedMotion, check_shape
from dousa.retrieval.forest.calibration import Assessor


@dataclass(frozen=True, slots=True, eq=False)
class StretchOpinions:
    """What a forest thinks of N stretches.

    Parameters
    ----------
    judged : (N,) whether the forest knows the category that was asked about.
    chances : (N,) probability that this category is right; 0 where it does not know it.
    guesses : N categories that most trees vote for.
    guess_chances : (N,) probability that those are right.
    """

    judged: BoolArray
    chances: FloatArray
    guesses: tuple[str, ...]
    guess_chances: FloatArray


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
        self, motion: PosedMotion, spans: Sequence[tuple[float, float]], categories: Sequence[str]
    ) -> StretchOpinions:
        """What is thought of stretches.

        Parameters
        ----------
        motion : the recording, of any frame rate.
        spans : from when to when, s.
        categories : of each stretch, the one that is asked about.
        """
        if not spans:
            return StretchOpinions(np.zeros(0, bool), np.zeros(0), (), np.zeros(0))
        features = np.stack([self.feature_set.compute(cut_stretch(motion, *span)) for span in spans])
        # As stored clips are: what is kept of features is single precision.
        features = features.astype(np.float32).astype(np.float64)
        leaves = self.assessor.forest.apply(features)
        names = {str(name): number for number, name in enumerate(self.assessor.forest.classes_)}
        judged = np.array([name in names and name not in self.spared for name in categories], bool)
        asked = np.array([names.get(name, 0) for name in categories], np.intp)
        own = self.assessor.assess(leaves, features, asked)
        best = self.assessor.assess(leaves, features)
        guesses = tuple(str(name) for name in self.assessor.forest.classes_[best.guess])
        return StretchOpinions(judged, np.where(judged, own.confidence, 0.0), guesses, best.confidence)

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
