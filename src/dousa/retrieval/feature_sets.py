"""The sets of features a forest can be trained on, by name: what is computed, and what a tree may ask of it.

``paper``: the means of the 56 pose features over intervals of a clip that is thinned to 10 frames, split where the gain
is largest (eq. 7).

``extended``: means, spreads (standard deviations) and trends (the change along the fitted line) of the channels of
``channels`` over intervals of a clip that is cut into 10 cells of equal movement (see ``tracks``), and the clip's
duration; split at random thresholds. All three kinds come from integral features: of the values, of their squares, and
of the values times the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError
from dousa.retrieval.channels import CHANNELS, Channel
from dousa.retrieval.features import FEATURES
from dousa.retrieval.integral import MEAN, SPREAD, TREND, list_interval_tests
from dousa.retrieval.posed_motion import PosedMotion

__all__ = ["DEFAULT_FEATURE_SET", "FEATURE_SETS", "FeatureSet", "get_feature_set"]

N_CELLS = 10
DURATION = Channel("duration", "duration", "s")


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """What forests look at.

    Parameters
    ----------
    name : for people and files.
    channels : what is known of every frame.
    n_frames : T, cells that a clip is cut into.
    kinds : what a tree may ask of a channel over an interval of cells.
    thresholds, n_trials : how trees are grown on it, see ``MotionForest``.
    """

    name: str
    channels: tuple[Channel, ...]
    n_frames: int
    kinds: tuple[str, ...]
    thresholds: Literal["best", "random"]
    n_trials: int | Literal["all", "sqrt"] | None

    @property
    def has_banks(self) -> bool:
        """Whether columns of squares and of values times time stand behind the means."""
        return len(self.kinds) > 1

    @property
    def column_names(self) -> tuple[str, ...]:
        """(F,) names of the columns."""
        names = tuple(channel.name for channel in self.channels)
        if not self.has_banks:
            return names
        squares = tuple(f"{name}, squared" for name in names)
        return (*names, DURATION.name, *squares, *(f"{name}, times time" for name in names))

    @property
    def n_columns(self) -> int:
        """F."""
        return 3 * len(self.channels) + 1 if self.has_banks else len(self.channels)

    @property
    def tests(self) -> NDArray[np.int64]:
        """(R, 5) everything a tree may ask, see ``list_interval_tests``."""
        count = len(self.channels)
        columns = np.arange(count)
        if not self.has_banks:
            return list_interval_tests([(MEAN, columns, columns)], self.n_frames)
        kinds = [
            (MEAN, columns, columns),
            (SPREAD, columns, columns + count + 1),
            (TREND, columns, columns + 2 * count + 1),
        ]
        duration = np.array([[MEAN, count, count, 0, self.n_frames]])
        return np.concatenate([duration, list_interval_tests(kinds, self.n_frames)])

    def compute(self, motion: PosedMotion, samples_per_frame: int = 8) -> NDArray[np.float64]:
        """The features of a clip.

        Parameters
        ----------
        motion : the clip.
        samples_per_frame : poses whose mean stands for a frame of ``paper``, see ``compute_clip_features``.

        Returns
        -------
        (T, F)

        Raises
        ------
        InvalidMotionError : positions that are not finite, or no body height.
        """
        if not self.has_banks:
            from dousa.retrieval.features import compute_clip_features

            return compute_clip_features(motion, self.n_frames, samples_per_frame)
        from dousa.retrieval.tracks import compute_track

        track = compute_track(motion, self)
        cells: NDArray[np.float64] = track.describe([0.0], [track.n_frames])[0]
        return cells


_PAPER_CHANNELS = tuple(Channel(feature.name, feature.name, feature.unit) for feature in FEATURES)

FEATURE_SETS: dict[str, FeatureSet] = {
    "paper": FeatureSet("paper", _PAPER_CHANNELS, N_CELLS, ("mean",), "best", None),
    "extended": FeatureSet("extended", CHANNELS, N_CELLS, ("mean", "spread", "trend"), "random", "sqrt"),
}
"""The sets by name."""

DEFAULT_FEATURE_SET = "extended"
"""What ``dousa train`` takes."""


def get_feature_set(name: str) -> FeatureSet:
    """The set of a name; OptionError for one that does not exist."""
    if name not in FEATURE_SETS:
        raise OptionError(f"features: expected {' or '.join(FEATURE_SETS)}, got '{name}'")
    return FEATURE_SETS[name]
