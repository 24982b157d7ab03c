"""A map of all clips: points in a plane, near each other if their poses are similar.

Clips are compared by their pose sequences, as near duplicates are, in body heights. These are reduced to principal
components and laid out by t-SNE (van der Maaten, Hinton, "Visualizing Data using t-SNE", JMLR 9, 2008; approximation of
van der Maaten, JMLR 15, 2014), both of scikit-learn. Labels are not used, so that a mislabelled clip lies among similar
ones. Only nearness has a meaning: distances between groups and sizes of groups have none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import IndexArray
from dousa.extras import require
from dousa.library.store import schema
from dousa.library.store.engine import Database
from dousa.library.store.features import lacks, load_poses, name_feature_set
from dousa.library.store.rows import portions
from dousa.messages import Message, Progress

# Principal components to begin with, perplexity and early exaggeration, as scikit-learn advises or chooses:
# https://scikit-learn.org/stable/modules/generated/sklearn.manifold.TSNE.html
_COMPONENTS, _PERPLEXITY, _EXAGGERATION = 50, 30.0, 12.0


@dataclass(frozen=True, slots=True, eq=False)
class ClipMap:
    """The places of clips on a map.

    Parameters
    ----------
    clip_ids : (N,) numbers of the clips, in the order of their contents.
    points : (N, 2) x to the right, y up, from -1 to 1.
    n_laid_out : number of clips laid out together; the others were placed beside similar ones.
    left_out : numbers of clips without a place because their bodies lack joints that the others have.
    """

    clip_ids: NDArray[np.int64]
    points: NDArray[np.float32]
    n_laid_out: int
    left_out: tuple[int, ...]


def map_clips(
    database: Database, progress: Progress | None, *, most: int = 5_000, fewest: int = 4, n_rounds: int = 3
) -> ClipMap:
    """Compute the map of a library; as ``Library.map``.

    Parameters
    ----------
    most : clips laid out together; the others of a larger library are placed beside similar ones.
    fewest : clips that have meaningful neighbours; fewer are placed in a row.
    n_rounds : of the layout, of 250 steps each; progress is reported between them.
    """
    for name in ("sklearn", "sklearn.manifold"):  # loaded before the limit, which only affects loaded libraries
        require(name, "map")
    from threadpoolctl import threadpool_limits

    steps = n_rounds + 2
    tell = progress or (lambda done, total, what: None)
    tell(0, steps, Message("library_map.reading"))
    # One thread: the order of sums over several varies, and the map would vary with it.
    with threadpool_limits(1):
        with database.reading() as connection:
            ids, left_out, feature_set = _list(connection)
            if len(ids) < fewest:
                return ClipMap(np.array(ids, np.int64), _in_a_row(len(ids)), len(ids), tuple(left_out))
            chosen = np.sort(np.random.default_rng(0).permutation(len(ids))[:most])
            reduced = _reduce(connection, ids, chosen, feature_set)
        points = np.empty((len(ids), 2), np.float32)
        laying_out = Message("library_map.laying_out")
        points[chosen] = _lay_out(reduced[chosen], n_rounds, lambda done: tell(1 + done, steps, laying_out))
        tell(steps - 1, steps, Message("library_map.placing"))
        others = np.setdiff1d(np.arange(len(ids)), chosen)
        if len(others):
            points[others] = _place(reduced[others], reduced[chosen], points[chosen])
    tell(steps, steps, Message("library_map.placing"))
    return ClipMap(np.array(ids, np.int64), _fit(points), len(chosen), tuple(left_out))


def _reduce(connection: sa.Connection, ids: Sequence[int], chosen: IndexArray, feature_set: str) -> NDArray[np.float32]:
    """Return (N, C) principal components of the clips' poses, fitted to the chosen clips."""
    decomposition = require("sklearn.decomposition", "map")
    poses = _read_poses(connection, [ids[row] for row in chosen], feature_set)
    n_components = min(_COMPONENTS, *poses.shape)
    found = decomposition.PCA(n_components, svd_solver="randomized", random_state=0)
    with np.errstate(invalid="ignore", divide="ignore"):  # all clips are the same: no variance
        found.fit(poses)
    reduced = [found.transform(_read_poses(connection, some, feature_set)) for some in portions(ids)]
    return np.concatenate(reduced).astype(np.float32)


def _list(connection: sa.Connection) -> tuple[list[int], list[int], str]:
    """Return the clips that can be compared, those that cannot, and the feature set of the stored poses."""
    feature_set = name_feature_set(connection)
    clips = schema.clips.c
    query = sa.select(clips.id, clips.absent).where(clips.kind == schema.CLIP).order_by(clips.content_hash)
    ids: list[int] = []
    left_out: list[int] = []
    for row in connection.execute(query):
        (left_out if lacks(feature_set, row.absent) else ids).append(row.id)
    return ids, left_out, feature_set


def _read_poses(connection: sa.Connection, ids: Sequence[int], feature_set: str) -> NDArray[np.float32]:
    return load_poses(connection, ids, feature_set).reshape(len(ids), -1)


def _in_a_row(count: int) -> NDArray[np.float32]:
    """Place clips in a row if there are too few to compare."""
    across = np.linspace(-1, 1, count) if count > 1 else np.zeros(count)
    return np.stack([across, np.zeros(count)], axis=1).astype(np.float32)


def _lay_out(known: NDArray[np.float32], n_rounds: int, tell: Callable[[int], None]) -> NDArray[np.float32]:
    """Compute (N, 2) points by t-SNE, started from the first two of the principal components (N, C)."""
    manifold = require("sklearn.manifold", "map")
    points = np.zeros((len(known), 2), np.float32)
    points[:, : known.shape[1]] = known[:, :2]
    spread = float(points[:, 0].std())
    if spread <= 0 or not np.isfinite(spread):  # all clips are the same
        return points
    points *= np.float32(1e-4 / spread)
    rate = max(len(known) / _EXAGGERATION / 4, 50.0)  # scikit-learn's choice for a single run
    for number in range(n_rounds):
        tell(number)
        exaggeration = 1.0 if number else _EXAGGERATION
        layout = manifold.TSNE(
            perplexity=min(_PERPLEXITY, (len(known) - 1) / 3),
            early_exaggeration=exaggeration,
            learning_rate=rate,
            max_iter=250,
            init=points,
            random_state=0,
            n_jobs=1,
        )
        points = layout.fit_transform(known)
    return points


def _place(
    others: NDArray[np.float32], known: NDArray[np.float32], points: NDArray[np.float32], *, n_nearest: int = 3
) -> NDArray[np.float32]:
    """Compute (M, 2) points as means of the ``n_nearest`` clips, weighted by nearness; more draw to the middle."""
    neighbours = require("sklearn.neighbors", "map")
    nearest = neighbours.NearestNeighbors(n_neighbors=min(n_nearest, len(known)), n_jobs=1).fit(known)
    distances, rows = nearest.kneighbors(others)
    shares = 1 / np.maximum(distances, 1e-6) ** 2
    shares /= shares.sum(axis=1, keepdims=True)
    placed: NDArray[np.float32] = np.einsum("mk,mkd->md", shares, points[rows]).astype(np.float32)
    return placed


def _fit(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Centre the points on their extent and scale the longer side to -1 to 1."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = float((high - low).max()) / 2
    fitted: NDArray[np.float32] = (points - (low + high) / 2) / np.float32(half or 1.0)
    return fitted
