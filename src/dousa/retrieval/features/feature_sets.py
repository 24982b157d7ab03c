"""The feature sets of a forest, by name: what is computed, and the tests that a tree may use.

``paper``: means of the 56 pose features over intervals of a clip thinned to 10 frames, split where the gain is largest
(eq. 7).

``extended``: means, spreads (standard deviations) and trends (the change along the fitted line) of ``channels`` over
intervals of a clip cut into 10 cells of equal movement (``compute_track``), and the clip's duration; split at random
thresholds.

A set without some joints (``extended without left_hand``) sets the channels that need them to 0 and never tests them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import BoolArray, FloatArray, IndexArray, IntArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.retrieval.features.channel_kernels import find_edges, read_cells
from dousa.retrieval.features.channels import (
    CHANNEL_RATE,
    CHANNELS,
    Channel,
    WantedMeans,
    compute_channels,
    describe_clips,
    integrate_channels,
    sample_positions,
)
from dousa.retrieval.features.pose_features import FEATURES, Feature, compute_clip_features, compute_pose_features
from dousa.retrieval.features.posed_motion import (
    FRAME_JOINTS,
    PlainMotion,
    PosedMotion,
    check_shape,
    complete_positions,
    order_joints,
)
from dousa.retrieval.features.sensor_noise import reduce_noise

MEAN, SPREAD, TREND = 0, 1, 2
"""Kinds of tests: mean of a column over an interval, standard deviation, change along the fitted line."""


def integrate(features: ArrayLike) -> FloatArray:
    """Compute running sums of pose features: every mean over an interval is one subtraction.

    ``features``: (N, T, F) pose features of N clips, thinned to T frames. Returns (N, F, T + 1) with ``g[..., 0] = 0``
    and ``g[..., t] = g[..., t - 1] + p[..., t]``. Raises InvalidMotionError: not three axes, or an axis of length 0
    other than the first.

    Source: Hamada et al., eq. 4.
    """
    pose = np.asarray(features, dtype=np.float64)
    if pose.ndim != 3 or 0 in pose.shape[1:]:
        raise InvalidMotionError("features.shape", shape=pose.shape)
    clips, frames, count = pose.shape
    integrals = np.zeros((clips, count, frames + 1))
    np.cumsum(pose.transpose(0, 2, 1), axis=2, out=integrals[:, :, 1:])
    return integrals


def list_tests(n_features: int, n_frames: int) -> IntArray:
    """List every mean that a tree may test: the set R of the paper.

    ``n_features``, ``n_frames``: F and T, at least 1. Returns (F T (T + 1) / 2, 5) rows (kind, i, i, t0, t1) with the
    kind 0, a mean; 3,080 for 56 features and 10 frames. Longer intervals come first, then earlier ones: of equally good
    tests, a tree without randomness takes the first.
    """
    columns = np.arange(n_features)
    return list_interval_tests([(0, columns, columns)], n_frames)


def list_interval_tests(kinds: Sequence[tuple[int, IndexArray, IndexArray]], n_frames: int) -> IntArray:
    """List tests of several kinds over every interval, in the order of ``list_tests``.

    Parameters
    ----------
    kinds : for each kind its number, the columns to test, and the partner of each column.
    n_frames : T.

    Returns (R, 5) rows (kind, column, partner, t0, t1).
    """
    starts, stops = np.triu_indices(n_frames + 1, k=1)
    order = np.lexsort((starts, starts - stops))
    asked = np.concatenate(
        [np.stack([np.full(len(columns), kind), columns, partners], axis=1) for kind, columns, partners in kinds]
    )
    tests = np.empty((len(starts), len(asked), 5), np.int64)
    tests[:, :, :3] = asked
    tests[:, :, 3] = starts[order, None]
    tests[:, :, 4] = stops[order, None]
    return tests.reshape(-1, 5)


N_CELLS = 10  # of a clip, as in the paper (section 2.3)
DURATION = Channel("duration", "duration", "s")


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """The columns and tests of a forest.

    Parameters
    ----------
    name : for people and files.
    channels : values of every frame.
    n_frames : T, cells that a clip is cut into.
    kinds : of tests of a channel over an interval of cells.
    thresholds : how trees are grown on it, see ``MotionForest``.
    hidden : canonical joints of the whole set that this one leaves out.
    """

    name: str
    channels: tuple[Channel, ...]
    n_frames: int
    kinds: tuple[str, ...]
    thresholds: Literal["best", "random"]
    hidden: tuple[str, ...] = ()

    @property
    def base(self) -> str:
        """Return the name of the whole set."""
        return self.name.partition(_WITHOUT)[0]

    @property
    def answered(self) -> BoolArray:
        """Return (C,) which channels need no hidden joint."""
        return _list_answered(self)

    @property
    def needed(self) -> frozenset[str]:
        """Return the joints that must have a place."""
        return _list_needed(self)

    def without(self, joints: Iterable[str]) -> FeatureSet:
        """Return the set for bodies without some joints; the same set if it uses none of them.

        ``joints``: canonical joints, beside those hidden already. Raises OptionError: an unknown joint.
        """
        more = set(joints)
        return _hide(self.base, order_joints(more.union(self.hidden))) if more else self

    @property
    def has_banks(self) -> bool:
        """Return whether columns of squares and of values times time follow the means."""
        return len(self.kinds) > 1

    @property
    def column_names(self) -> tuple[str, ...]:
        """Return (F,) names of the columns."""
        names = tuple(channel.name for channel in self.channels)
        if not self.has_banks:
            return names
        squares = tuple(f"{name}, squared" for name in names)
        return (*names, DURATION.name, *squares, *(f"{name}, times time" for name in names))

    @property
    def n_columns(self) -> int:
        return 3 * len(self.channels) + 1 if self.has_banks else len(self.channels)

    @property
    def tests(self) -> IntArray:
        """Return (R, 5) all tests, see ``list_interval_tests``."""
        count = len(self.channels)
        columns = np.flatnonzero(self.answered)
        if not self.has_banks:
            return list_interval_tests([(MEAN, columns, columns)], self.n_frames)
        kinds = [
            (MEAN, columns, columns),
            (SPREAD, columns, columns + count + 1),
            (TREND, columns, columns + 2 * count + 1),
        ]
        duration = np.array([[MEAN, count, count, 0, self.n_frames]])
        return np.concatenate([duration, list_interval_tests(kinds, self.n_frames)])

    def compute(self, motion: PosedMotion, samples_per_frame: int = 8) -> FloatArray:
        """Compute the features (T, F) of a clip; with banks, after its sensor's noise is reduced.

        Parameters
        ----------
        motion : the clip.
        samples_per_frame : poses averaged for a frame of ``paper``, see ``compute_clip_features``.

        Raises InvalidMotionError: positions that are not finite, or no body height.
        """
        if not self.has_banks:
            return self.blank(compute_clip_features(self.complete(motion), self.n_frames, samples_per_frame))
        cells: FloatArray = self.compute_quiet_all([reduce_noise(motion)])[0]
        return cells

    def compute_quiet_all(self, motions: Sequence[PosedMotion]) -> FloatArray:
        """Compute the same (N, T, F) of several clips, faster."""
        if not self.has_banks:
            shape = len(motions), self.n_frames, self.n_columns
            return np.array([self.compute(motion) for motion in motions], np.float64).reshape(shape)
        return self.compute_quiet_with(motions, WantedMeans(0, np.empty(0, np.intp), np.empty(0)))[0]

    def compute_quiet_with(self, motions: Sequence[PosedMotion], wanted: WantedMeans) -> tuple[FloatArray, FloatArray]:
        """Compute the same for a set with banks, and (N, cells, K) the ``wanted`` means of channels."""
        if not motions:
            return np.empty((0, self.n_frames, self.n_columns)), np.empty((0, wanted.n_cells, len(wanted.columns)))
        points = [self._sample(motion) for motion in motions]
        heights = np.array([motion.height for motion in motions], np.float64)
        return describe_clips(points, heights, self.answered, self.n_frames, wanted)

    def _sample(self, motion: PosedMotion) -> FloatArray:
        return sample_positions(self.complete(motion).positions, motion.frame_rate)

    def complete(self, motion: PosedMotion) -> PosedMotion:
        """Return a motion without gaps; hidden joints lie on the pelvis."""
        points = complete_positions(
            check_shape(motion.positions, motion.height), motion.height, self.hidden, self.needed
        )
        return PlainMotion(points, motion.frame_rate, motion.height)

    def blank(self, values: FloatArray) -> FloatArray:
        """Set values (..., C) of channels of hidden joints to 0, in place."""
        if self.hidden:
            values[..., ~self.answered] = 0.0
        return values


def _list_joints(feature: Feature) -> tuple[str, ...]:
    """List the joints of a pose feature; a position leaves out the pelvis, which every body has or gets."""
    return feature.joints[:1] if feature.kind == "position" else feature.joints


_WITHOUT = " without "
_PAPER_CHANNELS = tuple(
    Channel(feature.name, feature.name, feature.unit, _list_joints(feature)) for feature in FEATURES
)

FEATURE_SETS: dict[str, FeatureSet] = {
    "paper": FeatureSet("paper", _PAPER_CHANNELS, N_CELLS, ("mean",), "best"),
    "extended": FeatureSet("extended", CHANNELS, N_CELLS, ("mean", "spread", "trend"), "random"),
}
"""The sets by name."""

DEFAULT_FEATURE_SET = "extended"
"""The set that ``dousa train`` uses."""


def get_feature_set(name: str) -> FeatureSet:
    """Return the set of a name, whole or without some joints; OptionError for an unknown one."""
    base, _, hidden = name.partition(_WITHOUT)
    if base not in FEATURE_SETS:
        raise OptionError("features.unknown", known=tuple(FEATURE_SETS), name=name)
    return _hide(base, order_joints(hidden.split())) if hidden else FEATURE_SETS[base]


_OF_POSES = frozenset(joint for channel in CHANNELS for joint in channel.joints)


@lru_cache(maxsize=256)
def _list_answered(feature_set: FeatureSet) -> BoolArray:
    answered = np.array([not set(channel.joints) & set(feature_set.hidden) for channel in feature_set.channels], bool)
    answered.flags.writeable = False
    return answered


@lru_cache(maxsize=256)
def _list_needed(feature_set: FeatureSet) -> frozenset[str]:
    asked = _OF_POSES.union(FRAME_JOINTS, *(channel.joints for channel in feature_set.channels))
    return asked.difference(feature_set.hidden)


def _hide(base: str, joints: tuple[str, ...]) -> FeatureSet:
    """Return the set without those joints that it, or the alignment of clips, uses."""
    hidden = tuple(joint for joint in joints if joint in FEATURE_SETS[base].needed)
    return _restrict(base, hidden) if hidden else FEATURE_SETS[base]


@lru_cache(maxsize=256)
def _restrict(base: str, hidden: tuple[str, ...]) -> FeatureSet:
    """Return one object for each set, so that sets can be compared by identity."""
    return replace(FEATURE_SETS[base], name=f"{base}{_WITHOUT}{' '.join(hidden)}", hidden=hidden)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureTrack:
    """The channels of a recording at ``CHANNEL_RATE``, integrated over time.

    Parameters
    ----------
    feature_set : defines the channels.
    times : (n + 1,) start of each frame, and end of the last: frames, or motion time.
    integrals : (n + 1, C) of the channels over these times (eq. 4); with banks (n + 1, 3 C): of the values, of their
        squares, and of the values times the time.
    """

    feature_set: FeatureSet
    times: FloatArray
    integrals: FloatArray

    @property
    def n_frames(self) -> int:
        return len(self.integrals) - 1

    @property
    def frame_rate(self) -> float:
        """Return the frame rate, Hz."""
        return CHANNEL_RATE

    def find_edges(self, starts: ArrayLike, stops: ArrayLike) -> FloatArray:
        """Return (N, n_frames + 1) the edges of the feature set's cells in windows, in frames.

        ``starts``, ``stops`` and errors are as in ``describe``.
        """
        first, last = (np.atleast_1d(np.asarray(given, np.float64)) for given in (starts, stops))
        inside = (first >= 0) & (first < last) & (last <= self.n_frames)
        if first.shape != last.shape or first.ndim != 1 or not inside.all():
            raise InvalidMotionError("features.windows", frames=self.n_frames)
        parts = np.linspace(0.0, 1.0, self.feature_set.n_frames + 1)
        edges = np.empty((len(first), len(parts)))
        find_edges(self.times, first, last, parts, edges)
        return edges

    def describe(self, starts: ArrayLike, stops: ArrayLike) -> FloatArray:
        """Compute the features (N, T, F) of windows.

        ``starts``, ``stops``: (N,) frames of the track, whole or not; 0 <= start < stop <= n_frames. Raises
        InvalidMotionError: a window outside the recording or without length.
        """
        edges, spec = self.find_edges(starts, stops), self.feature_set
        cells = np.empty((len(edges), spec.n_frames, spec.n_columns))
        if spec.has_banks:
            cells[:, :, len(spec.channels)] = ((edges[:, -1] - edges[:, 0]) / CHANNEL_RATE)[:, None]
        work = np.empty((2, self.integrals.shape[1]))
        read_cells(self.integrals, self.times, edges, len(spec.channels), work, cells)
        return cells


def compute_track(motion: PosedMotion, feature_set: FeatureSet) -> FeatureTrack:
    """Integrate the channels of a recording.

    Parameters
    ----------
    motion : of any frame rate and length.
    feature_set : defines the channels.

    Raises InvalidMotionError: another shape than (n, 20, 3), no frame, positions that are not finite, no body height.

    Source: Hamada et al., eq. 4, with the integrals of squares and of moments beside it.
    """
    points = complete_positions(
        check_shape(motion.positions, motion.height), motion.height, feature_set.hidden, feature_set.needed
    )
    sampled = sample_positions(points, motion.frame_rate)
    if not feature_set.has_banks:
        poses = feature_set.blank(compute_pose_features(sampled, motion.height))
        return FeatureTrack(feature_set, np.arange(len(poses) + 1.0), np.ascontiguousarray(integrate(poses[None])[0].T))
    times, integrals = integrate_channels(feature_set.blank(compute_channels(sampled, motion.height)))
    return FeatureTrack(feature_set, times, integrals)
