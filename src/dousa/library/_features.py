"""Features and poses of the clips: stored once, computed anew where another set of features is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import LibraryDamagedError
from dousa.library import schema
from dousa.library._arrays import pack, stack
from dousa.library._describing import Description, describe_clip, find_feature_set, load_motions
from dousa.library._jobs import choose_jobs
from dousa.library.selection import portions
from dousa.motion._types import FloatArray

__all__ = ["ClipFeatures", "load_features", "load_poses", "save_descriptions"]

_FEATURES, _POSES = "<f8", "<f4"
_LARGEST = 1e60  # squares of it are finite

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class ClipFeatures:
    """Features of clips.

    Parameters
    ----------
    ids : numbers of N clips.
    features : (N, frames, columns) of one set.
    categories : labels, None where there are none.
    performers : labels, likewise.
    heights : m, of the performers.
    computed : by number, those that were not stored, or of another set.
    """

    ids: list[int]
    features: FloatArray
    categories: list[str | None]
    performers: list[str | None]
    heights: list[float]
    computed: dict[int, Description]


def load_features(
    connection: sa.Connection,
    feature_set: str,
    ids: Sequence[int] | None = None,
    n_jobs: int | None = 1,
    progress: Progress | None = None,
) -> ClipFeatures:
    """Features of clips, takes left out; those that are not stored are computed from the stored positions.

    Parameters
    ----------
    connection : in a transaction.
    feature_set : name of the set.
    ids : of these clips, in this order; by default of all, in the order of their numbers.
    n_jobs : clips described at a time.
    progress : called with (clips described, clips to describe).

    Raises
    ------
    LibraryDamagedError : arrays that are missing, of another length, or not finite.
    """
    kind = find_feature_set(feature_set)
    shape = (kind.n_frames, kind.n_columns)
    rows = _read_rows(connection, ids)
    features = np.zeros((len(rows), *shape))
    stored = [place for place, row in enumerate(rows) if row.feature_set == feature_set]
    read = stack([rows[place].pose_features for place in stored], _FEATURES, shape, "features")
    if read.size and not np.abs(read).max() < _LARGEST:
        raise LibraryDamagedError("features: numbers beyond measure; the library is damaged, make it again")
    features[stored] = read
    lacking = [row.id for row in rows if row.feature_set != feature_set]
    computed = _describe(connection, lacking, feature_set, n_jobs, progress)
    for place, row in enumerate(rows):
        if row.id in computed:
            features[place] = computed[row.id].features
    return ClipFeatures(
        ids=[row.id for row in rows],
        features=features,
        categories=[row.category for row in rows],
        performers=[row.performer for row in rows],
        heights=[row.height for row in rows],
        computed=computed,
    )


def _read_rows(connection: sa.Connection, ids: Sequence[int] | None) -> list[Any]:
    clips, table = schema.clips.c, schema.clip_features.c
    query = sa.select(
        clips.id, clips.category, clips.performer, clips.height, table.feature_set, table.pose_features
    )
    query = query.join(schema.clip_features, table.clip_id == clips.id, isouter=True)
    query = query.where(clips.kind == schema.CLIP)
    if ids is None:
        return list(connection.execute(query.order_by(clips.id)))
    found = {
        row.id: row for some in portions(ids) for row in connection.execute(query.where(clips.id.in_(some)))
    }
    if len(found) != len(set(ids)):
        raise LibraryDamagedError(f"expected {len(set(ids))} clips, found {len(found)}; add them again")
    return [found[clip_id] for clip_id in ids]


def _describe(
    connection: sa.Connection,
    ids: Sequence[int],
    feature_set: str,
    n_jobs: int | None = 1,
    progress: Progress | None = None,
) -> dict[int, Description]:
    """Describe stored motions, by number."""
    if not ids:
        return {}
    import joblib

    parallel = joblib.Parallel(n_jobs=choose_jobs(n_jobs), prefer="threads")
    described: dict[int, Description] = {}
    for some in portions(ids):
        # Read here, and not where they are described: a connection is for one thread at a time.
        motions = list(load_motions(connection, some))
        answers = parallel(joblib.delayed(describe_clip)(motion, feature_set) for motion in motions)
        described.update(zip(some, answers, strict=True))
        if progress is not None:
            progress(len(described), len(ids))
    return described


def load_poses(connection: sa.Connection, ids: Sequence[int]) -> NDArray[np.float32]:
    """(N, cells, columns) pose sequences of clips, in the order of these numbers.

    Raises
    ------
    LibraryDamagedError : arrays that are of another length, or not finite.
    """
    from dousa.retrieval.feature_sets import DEFAULT_FEATURE_SET
    from dousa.retrieval.pose_sequences import POSE_CELLS, POSE_COLUMNS

    table = schema.clip_poses.c
    query = sa.select(table.clip_id, table.poses)
    found = {
        row[0]: row[1]
        for some in portions(ids)
        for row in connection.execute(query.where(table.clip_id.in_(some))).all()
    }
    lacking = [clip_id for clip_id in ids if clip_id not in found]  # an older dousa trained the library
    computed = _describe(connection, lacking, DEFAULT_FEATURE_SET)
    poses = np.empty((len(ids), POSE_CELLS, POSE_COLUMNS), np.float32)
    stored = [place for place, clip_id in enumerate(ids) if clip_id in found]
    poses[stored] = stack([found[ids[place]] for place in stored], _POSES, poses.shape[1:], "poses")
    for place, clip_id in enumerate(ids):
        if clip_id in computed:
            poses[place] = computed[clip_id].poses
    return poses


def save_descriptions(
    connection: sa.Connection, ids: Sequence[int], descriptions: Sequence[Description]
) -> None:
    """Write the features and poses of clips, in the place of those that may be there."""
    for some in portions(list(zip(ids, descriptions, strict=True))):
        for table in (schema.clip_features, schema.clip_poses):
            chosen = [clip_id for clip_id, _ in some]
            connection.execute(sa.delete(table).where(table.c.clip_id.in_(chosen)))
        features = [
            {
                "clip_id": clip_id,
                "feature_set": own.feature_set,
                "pose_features": pack(own.features, _FEATURES),
            }
            for clip_id, own in some
        ]
        connection.execute(sa.insert(schema.clip_features), features)
        poses = [{"clip_id": clip_id, "poses": pack(own.poses, _POSES)} for clip_id, own in some]
        connection.execute(sa.insert(schema.clip_poses), poses)
