"""What a motion is taken for, and whether it is of a category that the forest knows at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.errors import OptionError
from dousa.library._forests import StoredForest, TreeAnswers
from dousa.library.answers import Verdict
from dousa.motion._types import FloatArray

__all__ = ["Unknown", "judge"]


@dataclass(frozen=True, slots=True)
class Unknown:
    """When a motion is called unknown.

    Parameters
    ----------
    threshold : probability of being known below which it is; None for that of the forest's calibration, 0 for never.

    Raises
    ------
    OptionError : a threshold outside 0 to 1.
    """

    threshold: float | None = None

    def __post_init__(self) -> None:
        if self.threshold is not None and not 0 <= self.threshold <= 1:
            raise OptionError(f"threshold: expected a probability from 0 to 1, got {self.threshold}")


def judge(
    stored: StoredForest, answers: TreeAnswers, features: FloatArray, unknown: Unknown
) -> list[Verdict]:
    """What motions are taken for.

    Parameters
    ----------
    stored : the forest.
    answers, features : what its trees say of N motions, and (N, frames, columns) what they said it of.
    unknown : when a motion is called unknown.
    """
    guesses, shares = answers.predicted(), answers.shares()
    histograms = [order_histogram(stored.categories, own) for own in shares]
    if stored.assessor is None or not guesses:
        return [
            Verdict(guess, guess, None, None, histogram)
            for guess, histogram in zip(guesses, histograms, strict=True)
        ]
    seen = stored.assessor.assess(answers.leaves, features)
    limit = stored.assessor.calibration.threshold if unknown.threshold is None else unknown.threshold
    return [
        Verdict(guess if known >= limit else None, guess, float(known), float(confidence), histogram)
        for guess, known, confidence, histogram in zip(
            guesses, seen.known, seen.confidence, histograms, strict=True
        )
    ]


def order_histogram(categories: Sequence[str], shares: FloatArray) -> dict[str, float]:
    """Share of each category, the largest first, then by name."""
    order = np.argsort(-shares, kind="stable")
    return {categories[index]: float(shares[index]) for index in order}
