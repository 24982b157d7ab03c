"""What the experiment with unknown motions and new categories gives."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["FORESTS", "NewCategories", "NoveltyResult", "UnknownMotions"]

FORESTS: tuple[str, ...] = ("before", "grown", "trained anew")
"""The forests that are compared on new categories."""


@dataclass(frozen=True, slots=True)
class UnknownMotions:
    """How well clips of categories that were held back were told from the others.

    Parameters
    ----------
    auroc, auroc_std : mean over the trials, and standard deviation.
    false_alarms : share of known clips that were called unknown.
    misses : share of unknown clips that were taken for known.
    expected_false_alarms, expected_misses : what the calibrations foretold.
    accuracy : share of known clips whose category was guessed, before any is called unknown.
    curve : rows (threshold, false alarms, misses) for other thresholds.
    train_seconds, calibrate_seconds : mean time for a forest, and for its calibration.
    n_trials : how many were averaged.
    """

    auroc: float
    auroc_std: float
    false_alarms: float
    misses: float
    expected_false_alarms: float
    expected_misses: float
    accuracy: float
    curve: tuple[tuple[float, float, float], ...]
    train_seconds: float
    calibrate_seconds: float
    n_trials: int


@dataclass(frozen=True, slots=True)
class NewCategories:
    """What a forest does with categories that came after its training.

    Parameters
    ----------
    forest : of ``FORESTS``.
    n_new, n_clips : categories that came, and clips of each.
    accuracy : share of all test clips whose category was guessed.
    recall_new, recall_old : the same of those of the new, and of the old categories.
    called_unknown : share of the test clips of the new categories that are called unknown.
    seconds : mean time to grow, or to train.
    """

    forest: str
    n_new: int
    n_clips: int
    accuracy: float
    recall_new: float
    recall_old: float
    called_unknown: float
    seconds: float


@dataclass(frozen=True, slots=True)
class NoveltyResult:
    """Both measurements.

    Parameters
    ----------
    unknown : telling unknown motions.
    new : taking up new categories; a row for each forest and number of categories.
    n_clips, n_categories : of the data.
    split : ``"leave-performer-out"`` or ``"half"``.
    feature_set, n_trees, repeats, random_state : as asked for.
    """

    unknown: UnknownMotions
    new: tuple[NewCategories, ...]
    n_clips: int
    n_categories: int
    split: str
    feature_set: str
    n_trees: int
    repeats: int
    random_state: int

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings, ready for ``json.dumps``."""
        return asdict(self)
