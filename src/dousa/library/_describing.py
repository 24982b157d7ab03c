"""What the library computes of a motion.

Everything is computed from positions rounded as they are stored, so that a file and the clip that was made of it
agree to the last bit, and so that a stored clip can be described anew without its file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import LibraryDamagedError, LibraryVersionError
from dousa.library import schema
from dousa.library._arrays import unpack
from dousa.library.selection import portions
from dousa.motion import CANONICAL_JOINTS
from dousa.retrieval.posed_motion import SLOWEST_RATE

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion
    from dousa.motion._types import FloatArray
    from dousa.retrieval.feature_sets import FeatureSet

BEYOND_MEASURE = 1e9
"""Metres, body heights and hertz beyond which nothing is a motion."""

__all__ = [
    "BEYOND_MEASURE",
    "Description",
    "StoredMotion",
    "describe_clip",
    "find_feature_set",
    "load_motions",
    "round_positions",
]


@dataclass(frozen=True, slots=True, eq=False)
class StoredMotion:
    """A motion as the library keeps it: canonical joints, without where they came from.

    Parameters
    ----------
    positions : (T, 20, 3) m, of float32 precision.
    frame_rate : Hz.
    height : m, body height.
    """

    positions: FloatArray
    frame_rate: float
    height: float

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.positions)

    @property
    def duration(self) -> float:
        """Seconds from the first pose to the end of the last."""
        return self.n_frames / self.frame_rate

    def mirror(self) -> StoredMotion:
        """Its mirror image."""
        from dousa.motion.mirroring import mirror_positions

        return StoredMotion(mirror_positions(self.positions), self.frame_rate, self.height)


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """What is computed of a clip before the forest is asked.

    Parameters
    ----------
    feature_set : name of the features.
    features : (frames, columns) of this set.
    poses : its pose sequence, see ``dousa.retrieval.pose_sequences``.
    """

    feature_set: str
    features: FloatArray
    poses: NDArray[np.float32]


def round_positions(motion: CanonicalMotion | StoredMotion) -> StoredMotion:
    """The motion as it would be stored; infinite where a position is beyond float32."""
    with np.errstate(over="ignore"):
        positions = motion.positions.astype(np.float32).astype(np.float64)
    return StoredMotion(positions, motion.frame_rate, motion.height)


def find_feature_set(name: str) -> FeatureSet:
    """The set of features of this name.

    Raises
    ------
    LibraryVersionError : no such set here: a newer dousa trained the library.
    """
    from dousa.retrieval.feature_sets import FEATURE_SETS

    if name not in FEATURE_SETS:
        raise LibraryVersionError(
            f"the forest was trained on features '{name}', this dousa knows {', '.join(FEATURE_SETS)}; "
            "run: pip install --upgrade dousa"
        )
    return FEATURE_SETS[name]


def describe_clip(motion: StoredMotion, feature_set: str) -> Description:
    """Features and poses of a motion whose positions are rounded."""
    from dousa.retrieval.feature_sets import FEATURE_SETS
    from dousa.retrieval.pose_sequences import compute_window_poses
    from dousa.retrieval.tracks import compute_track

    # The poses are read from the integrals of the extended features: these are computed once for both.
    track = compute_track(motion, FEATURE_SETS["extended"])
    poses = compute_window_poses(track, [0.0], [track.n_frames])[0]
    wanted = find_feature_set(feature_set)
    if wanted is track.feature_set:
        return Description(feature_set, track.describe([0.0], [track.n_frames])[0], poses)
    return Description(feature_set, wanted.compute(motion), poses)


def load_motions(connection: sa.Connection, ids: Sequence[int]) -> Iterator[StoredMotion]:
    """Stored motions, one after the other, in the order of these numbers.

    Raises
    ------
    LibraryDamagedError : numbers that are missing, too few or not finite.
    """
    clips, arrays = schema.clips.c, schema.clip_trajectories.c
    query = sa.select(clips.id, clips.path, clips.n_frames, clips.frame_rate, clips.height, arrays.positions)
    query = query.join(schema.clip_trajectories, arrays.clip_id == clips.id)
    for some in portions(ids):
        rows = {row.id: row for row in connection.execute(query.where(clips.id.in_(some)))}
        if len(rows) != len(set(some)):
            raise LibraryDamagedError(
                f"expected positions of {len(set(some))} clips, found {len(rows)}; add them again"
            )
        for clip_id in some:
            yield _unpack(rows[clip_id])


def _unpack(row: Any) -> StoredMotion:
    positions = unpack(row.positions, "<f4", (row.n_frames, len(CANONICAL_JOINTS), 3), row.path)
    numbers = row.height, 1 / row.height if row.height else np.inf, row.frame_rate, np.abs(positions).max()
    if not (max(numbers) < BEYOND_MEASURE and min(numbers) >= 0 and row.frame_rate >= SLOWEST_RATE):
        raise LibraryDamagedError(
            f"{row.path}: {row.height} m tall, at {row.frame_rate} Hz; the library is damaged, remove the clip and "
            "add its file again"
        )
    return StoredMotion(positions.astype(np.float64), row.frame_rate, row.height)
