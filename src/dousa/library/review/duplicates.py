"""Groups of clips that are nearly the same: one recording twice, at another rate, cut a little differently, or cleaned.

Clips are compared by their pose sequences, whose distance is how far the joints are apart, in body heights, and by how
long they are. Two repetitions by one person differ by more than the bound; what was copied differs by less.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.library import schema
from dousa.library.engine import Database
from dousa.library.features import lacks, load_poses
from dousa.library.selection import list_clips
from dousa.retrieval import DEFAULT_FEATURE_SET

NEAR = 0.01
"""Body heights that the joints of near duplicates are apart, root mean square over joints and time."""

_LONGER = 1.15  # times as long as the other
_BLOCK = 1024


@dataclass(frozen=True, slots=True)
class DuplicateGroup:
    """Clips that are nearly the same.

    Parameters
    ----------
    clip_ids, paths, categories : of them, in the order of their paths.
    distance : the largest of the distances that hold them together, body heights.
    """

    clip_ids: tuple[int, ...]
    paths: tuple[str, ...]
    categories: tuple[str | None, ...]
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        clips = zip(self.clip_ids, self.paths, self.categories, strict=True)
        listed = [{"clip_id": number, "path": path, "category": category} for number, path, category in clips]
        return {"distance": self.distance, "clips": listed}


def find_near_duplicates(database: Database, near: float) -> list[DuplicateGroup]:
    """Groups of clips that are nearly the same, the largest first; as ``Library.find_near_duplicates``."""
    with database.reading() as connection:
        parameters = connection.execute(sa.select(schema.forests.c.parameters)).scalar()
        feature_set = str((parameters or {}).get("feature_set", DEFAULT_FEATURE_SET))
        absent = {row.id: row.absent for row in connection.execute(sa.select(schema.clips.c.id, schema.clips.c.absent))}
        clips = [clip for clip in list_clips(connection) if clip.kind == schema.CLIP]
        clips = [clip for clip in clips if not lacks(feature_set, absent[clip.id])]
        poses = load_poses(connection, [clip.id for clip in clips], feature_set)
    pairs = find_pairs(poses, np.array([clip.duration for clip in clips]), near)
    groups: dict[int, list[int]] = {row: [row] for row in range(len(clips))}
    widest = np.zeros(len(clips))
    for first, second, distance in sorted(pairs, key=lambda pair: pair[2]):
        one, other = groups[first], groups[second]
        widest[[*one, *other]] = distance
        if one is not other:
            one += other
            groups.update(dict.fromkeys(other, one))
    found = []
    for rows in {id(rows): sorted(rows) for rows in groups.values() if len(rows) > 1}.values():
        some = [clips[row] for row in rows]
        labels = tuple(clip.category for clip in some)
        found.append(
            DuplicateGroup(
                tuple(clip.id for clip in some),
                tuple(clip.path for clip in some),
                labels,
                round(float(widest[rows[0]]), 5),
            )
        )
    return sorted(found, key=lambda group: (-len(group.clip_ids), group.distance, group.paths))


def find_pairs(poses: NDArray[np.float32], durations: FloatArray, near: float) -> list[tuple[int, int, float]]:
    """Pairs of clips (row, later row, distance) that are nearer than a bound.

    Parameters
    ----------
    poses : (N, cells, columns) pose sequences.
    durations : (N,) s.
    near : bound, body heights.
    """
    flat = poses.reshape(len(poses), -1) / np.float32(np.sqrt(poses.shape[1] if poses.ndim > 1 else 1))
    order = np.argsort(durations, kind="stable")
    flat, lengths = flat[order], durations[order]
    squares = (flat * flat).sum(axis=1)
    pairs = []
    for start in range(0, len(flat), _BLOCK):
        stop = min(start + _BLOCK, len(flat))
        last = int(np.searchsorted(lengths, _LONGER * lengths[stop - 1], side="right"))
        square = squares[start:stop, np.newaxis] + squares[start:last] - 2 * flat[start:stop] @ flat[start:last].T
        for one, other in np.argwhere(square < (2 * near) ** 2).tolist():
            first, second = start + one, start + other
            if second <= first or lengths[second] > _LONGER * lengths[first]:
                continue
            # Once more, as little is left of the difference of large numbers.
            distance = float(np.linalg.norm(flat[first] - flat[second]))
            if distance < near:
                rows = int(order[first]), int(order[second])
                pairs.append((min(rows), max(rows), distance))
    return pairs
