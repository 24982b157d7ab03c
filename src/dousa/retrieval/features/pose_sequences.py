"""Short sequences of poses: what clips are compared by when their poses are aligned in time.

A clip is cut into 16 cells that are equally long in motion time (see ``tracks``). Each cell holds the mean, over its
time, of the places of 12 joints in the body-fixed system, and of how fast the body moves and turns, all in body heights
and seconds. The numbers are scaled so that the Euclidean distance of two cells is the root mean square over the joints
(those that are looked at) of how far apart they are, in body heights; a movement counts by how far it goes in 0.3 s, a
turn by its radians in that time.

All of it is read from the integrals of a ``FeatureTrack``, so a window of a long recording costs no more than a clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import OptionError
from dousa.retrieval.features.channel_kernels import read_means
from dousa.retrieval.features.channels import CHANNELS, WantedMeans

if TYPE_CHECKING:
    from dousa.retrieval.features.feature_sets import FeatureSet, FeatureTrack
    from dousa.retrieval.features.posed_motion import PosedMotion

POSE_CELLS = 16
"""Cells of a sequence."""

N_JOINTS = 12
N_MOVING = 4  # the body moving in three directions, and turning
MOVING_SECONDS = 0.3  # 0.2 and 0.4 did as well

POSE_COLUMNS = 3 * N_JOINTS + N_MOVING
"""Numbers of a cell."""


def compute_pose_sequence(motion: PosedMotion) -> NDArray[np.float32]:
    """The sequence of a clip.

    Parameters
    ----------
    motion : canonical positions in m, rate in Hz, height in m; of any length.

    Returns
    -------
    (POSE_CELLS, POSE_COLUMNS)

    Raises
    ------
    InvalidMotionError : positions that are not finite, no frame, or no body height.
    """
    from dousa.retrieval.features.feature_sets import FEATURE_SETS
    from dousa.retrieval.features.sensor_noise import reduce_noise

    sequence: NDArray[np.float32] = compute_with_poses([reduce_noise(motion)], FEATURE_SETS["extended"])[1][0]
    return sequence


def compute_with_poses(
    motions: Sequence[PosedMotion], feature_set: FeatureSet
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Features and sequences of clips whose noise has been taken off; the channels are computed once for both.

    Parameters
    ----------
    motions : N clips.
    feature_set : ``extended``, whole or without some joints.

    Returns
    -------
    features : (N, T, F).
    poses : (N, POSE_CELLS, POSE_COLUMNS).

    Raises
    ------
    InvalidMotionError : positions that are not finite, no frame, or no body height.
    """
    wanted = WantedMeans(POSE_CELLS, _COLUMNS, _find_scale(feature_set.hidden))
    features, poses = feature_set.compute_quiet_with(motions, wanted)
    return features, poses.astype(np.float32)


def compute_window_poses(track: FeatureTrack, starts: ArrayLike, stops: ArrayLike) -> NDArray[np.float32]:
    """The sequences of windows of a recording.

    Parameters
    ----------
    track : of the ``extended`` features.
    starts, stops : (N,) frames of the track, whole or not; 0 <= start < stop <= n_frames.

    Returns
    -------
    (N, POSE_CELLS, POSE_COLUMNS)

    Raises
    ------
    OptionError : a track of other features, which has no places of joints.
    InvalidMotionError : a window outside the recording or without length.
    """
    columns = _find_columns(track)
    edges = track.find_edges(starts, stops, POSE_CELLS)
    means = np.empty((len(edges), POSE_CELLS, POSE_COLUMNS))
    read_means(track.integrals, track.times, edges, columns, _find_scale(track.feature_set.hidden), means)
    found: NDArray[np.float32] = means.astype(np.float32)
    return found


_JOINTS = (
    "head",
    "neck",
    *(f"{side} {joint}" for joint in ("shoulder", "elbow", "hand", "knee", "foot") for side in ("left", "right")),
)
_RELATIONS = (*(f"{joint} and pelvis" for joint in _JOINTS), "body moving", "body turning")
_SCALE = np.append(np.ones(3 * N_JOINTS), np.full(N_MOVING, MOVING_SECONDS)) / np.sqrt(N_JOINTS)


def _find_scale(hidden: Sequence[str]) -> FloatArray:
    """(POSE_COLUMNS,) so that distances stay root mean squares over the joints that are looked at."""
    n_hidden = sum(joint.replace("_", " ").replace("ankle", "foot") in _JOINTS for joint in hidden)
    scale: FloatArray = _SCALE * np.sqrt(N_JOINTS / max(N_JOINTS - n_hidden, 1)) if n_hidden else _SCALE
    return scale


def _find_columns(track: FeatureTrack) -> IndexArray:
    if not track.feature_set.has_banks:
        raise OptionError("features.not_extended", name=track.feature_set.name)
    return _COLUMNS


_COLUMNS = np.array([k for k, channel in enumerate(CHANNELS) if channel.relation in _RELATIONS], np.intp)
