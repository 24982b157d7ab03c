"""Clips whose label is likely wrong, and groups of near duplicates.

A forest that has learned a wrong label repeats it, so each clip is judged by trees trained without it: the clips are
split into random halves a dozen times, and trees of each half judge the other (complementary pairs: Shah, Samworth,
"Variable Selection with Error Control", JRSS B 75, 2013). A clip is in doubt if another category has more votes than
its own: the normalised margin of confident learning (Northcutt, Jiang, Chuang, "Confident Learning: Estimating
Uncertainty in Dataset Labels", JAIR 70, 2021). Categories of the same meaning count as one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import TrainingError
from dousa.library.annotations.tags import CHECKED
from dousa.library.results import Answer
from dousa.library.search.text_store import find_meanings
from dousa.library.store import schema
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import (
    ClipFeatures,
    find_feature_set,
    lacks,
    load_features,
    load_poses,
    name_feature_set,
)
from dousa.library.store.selection import list_clips
from dousa.messages import Message, Progress
from dousa.retrieval import FeatureSet, MotionForest


@dataclass(frozen=True, slots=True)
class DuplicateGroup:
    """Clips that are nearly the same, in the order of their paths.

    ``distance`` is the largest of the distances that link them, body heights.
    """

    clip_ids: tuple[int, ...]
    paths: tuple[str, ...]
    categories: tuple[str | None, ...]
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        clips = zip(self.clip_ids, self.paths, self.categories, strict=True)
        listed = [{"clip_id": number, "path": path, "category": category} for number, path, category in clips]
        return {"distance": self.distance, "clips": listed}


def find_near_duplicates(database: Database, near: float) -> list[DuplicateGroup]:
    """Find groups of nearly equal clips, the largest first; as ``Library.find_near_duplicates``."""
    with database.reading() as connection:
        feature_set = name_feature_set(connection)
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


def find_pairs(
    poses: NDArray[np.float32], durations: FloatArray, near: float, *, longer: float = 1.15, at_once: int = 1024
) -> list[tuple[int, int, float]]:
    """Pairs of clips (row, later row, distance) that are nearer than a bound.

    Parameters
    ----------
    poses : (N, cells, columns) pose sequences.
    durations : (N,) s.
    near : bound of the root mean square over joints and time, body heights.
    longer : largest ratio of the durations of a pair; larger finds parts of clips.
    at_once : clips compared with the others at a time.
    """
    flat = poses.reshape(len(poses), -1) / np.float32(np.sqrt(poses.shape[1] if poses.ndim > 1 else 1))
    order = np.argsort(durations, kind="stable")
    flat, lengths = flat[order], durations[order]
    squares = (flat * flat).sum(axis=1)
    pairs = []
    for start in range(0, len(flat), at_once):
        stop = min(start + at_once, len(flat))
        last = int(np.searchsorted(lengths, longer * lengths[stop - 1], side="right"))
        square = squares[start:stop, np.newaxis] + squares[start:last] - 2 * flat[start:stop] @ flat[start:last].T
        for one, other in np.argwhere(square < (2 * near) ** 2).tolist():
            first, second = start + one, start + other
            if second <= first or lengths[second] > longer * lengths[first]:
                continue
            # Computed again directly: the difference of large numbers is imprecise.
            distance = float(np.linalg.norm(flat[first] - flat[second]))
            if distance < near:
                rows = int(order[first]), int(order[second])
                pairs.append((min(rows), max(rows), distance))
    return pairs


_SPLITS = 12  # into halves: python -m lab.trials.label_review
_TREES = 10  # of each half: python -m lab.trials.label_review


@dataclass(frozen=True, slots=True)
class LabelDoubt(Answer):
    """A clip whose label is likely wrong.

    Parameters
    ----------
    clip_id, path, category : as in ``ClipInfo``.
    suggested : the category of its neighbours.
    votes, own_votes : share of the trees, none trained on the clip, that vote for the suggestion and for the label,
        0 to 1.
    alike, same : numbers of the clips of the suggested and of its own category that share the most leaves with it, the
        nearest first.
    """

    clip_id: int
    path: str
    category: str
    suggested: str
    votes: float
    own_votes: float
    alike: tuple[int, ...]
    same: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class LabelReview:
    """The result of reviewing the labels of a library.

    Parameters
    ----------
    doubts : clips whose label is likely wrong, the likeliest first.
    n_judged : clips that were judged.
    n_few : clips not judged because fewer than three have their category.
    n_checked : clips with the tag ``checked``, reviewed before.
    """

    doubts: tuple[LabelDoubt, ...]
    n_judged: int
    n_few: int
    n_checked: int

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        counts = {"n_judged": self.n_judged, "n_few": self.n_few, "n_checked": self.n_checked}
        return counts | {"doubts": [one.to_json() for one in self.doubts]}


def review_labels(database: Database, n_jobs: int | None, progress: Progress | None, *, least: int = 3) -> LabelReview:
    """Find the labels of a library that are likely wrong; as ``Library.review_labels``.

    Categories of fewer than ``least`` clips are not judged, as there are too few others to compare.
    """
    tell = progress or (lambda done, total, what: None)
    tell(0, 2 * _SPLITS + 1, Message("library_training.describing_clips"))
    with database.reading() as connection:
        feature_set = name_feature_set(connection)
        clips = load_features(connection, feature_set, n_jobs=n_jobs)
        paths = {clip.id: (clip.path, CHECKED in clip.tags) for clip in list_clips(connection)}
    counts = Counter(category for category in clips.categories if category is not None)
    rows = [row for row, label in enumerate(clips.categories) if label is not None and counts[label] >= least]
    labels = np.array([clips.categories[row] for row in rows], dtype=np.str_)
    if len(set(labels.tolist())) < 2:
        raise TrainingError("library_review.too_few", library=database.where, least=least)

    def tell_part(part: int) -> None:
        tell(1 + part, 2 * _SPLITS + 1, Message("library_review.comparing"))

    found = _judge(clips, np.array(rows, np.intp), labels, feature_set, n_jobs, tell_part)
    doubts = tuple(LabelDoubt(one, paths[one][0], *more) for one, *more in found if not paths[one][1])
    n_few = sum(counts.values()) - len(rows)
    n_checked = sum(paths[clips.ids[row]][1] for row in rows)
    return LabelReview(doubts, len(rows), n_few, n_checked)


def _judge(
    clips: ClipFeatures,
    rows: IndexArray,
    labels: NDArray[np.str_],
    feature_set: str,
    n_jobs: int | None,
    tell: Callable[[int], None],
) -> list[tuple[Any, ...]]:
    """Return number, label, suggestion, votes and neighbours of each clip in doubt, the likeliest first."""
    kind, named = find_feature_set(feature_set), find_meanings(set(labels.tolist()))
    means = np.array([named[label] for label in labels.tolist()], dtype=np.str_)
    ids = np.array([clips.ids[row] for row in rows])
    halves = split_halves(labels, _SPLITS)
    learned = np.concatenate([halves, ~halves])
    classes, shares, leaves = vote_without(
        clips.features[rows], labels, kind, learned, n_trees=_TREES, n_jobs=n_jobs, tell=tell
    )
    meant = np.array([named[name] for name in classes], dtype=np.str_)
    found: list[tuple[float, tuple[Any, ...]]] = []
    for row, meaning in enumerate(means):
        other, votes, own = _compare(shares[row], meant, str(meaning))
        if votes <= own:
            continue
        suggested = max((name for name in classes if named[name] == other), key=lambda n: shares[row][classes.index(n)])
        judges = np.flatnonzero(~learned[:, row])
        shared = sum(learned[judge] * (leaves[judge] == leaves[judge, row]).sum(axis=1) for judge in judges)
        near = (_nearest(shared, means == name, ids, row) for name in (other, meaning))
        one = int(ids[row]), str(labels[row]), suggested, round(votes, 4), round(own, 4), *near
        found.append((votes - own, one))
    return [one for _, one in sorted(found, key=lambda item: (-item[0], item[1][0]))]


def vote_without(
    features: FloatArray,
    labels: NDArray[np.str_],
    feature_set: FeatureSet,
    learned: NDArray[np.bool_],
    *,
    n_trees: int,
    n_jobs: int | None = None,
    tell: Callable[[int], None] = lambda _: None,
) -> tuple[list[str], FloatArray, NDArray[np.int32]]:
    """Let forests vote for the clips that they have not learned.

    Parameters
    ----------
    features : (N, frames, columns) of clips; ``labels``, their categories.
    learned : (J, N) the clips that each forest learns; each clip is left out by at least one.
    n_trees : of each forest.

    Returns
    -------
    The categories, sorted; (N, C) the shares of the votes of the forests that have not learned the clip; and (J, N,
    n_trees) the leaves that the clips reach.
    """
    classes = sorted(set(labels.tolist()))
    shares = np.zeros((len(labels), len(classes)))
    leaves = np.empty((*learned.shape, n_trees), np.int32)
    for number, some in enumerate(learned):
        tell(number)
        forest = MotionForest(
            n_trees=n_trees,
            thresholds=feature_set.thresholds,
            random_state=number,
            n_jobs=choose_jobs(n_jobs),
        )
        forest.fit(features[some], labels[some], feature_set=feature_set)
        leaves[number] = forest.apply(features)
        places = np.searchsorted(classes, forest.classes_)
        shares[np.ix_(~some, places)] += forest.histograms_of(leaves[number, ~some])
    tell(len(learned))
    return classes, shares / (~learned).sum(axis=0)[:, np.newaxis], leaves


def split_halves(labels: NDArray[np.str_], n_splits: int) -> NDArray[np.bool_]:
    """Split clips into halves with a fixed seed, (n_splits, N); each half has half of every category."""
    chance = np.random.default_rng(0)
    halves = np.empty((n_splits, len(labels)), np.bool_)
    for half in halves:
        half[np.lexsort((chance.permutation(len(labels)), labels))] = np.arange(len(labels)) % 2
    return halves


def _compare(shares: FloatArray, meant: NDArray[np.str_], own: str) -> tuple[str, float, float]:
    """Return the other meaning with the most votes, its votes, and those of the clip's own."""
    votes: dict[str, float] = {}
    for meaning, share in zip(meant.tolist(), shares.tolist(), strict=True):
        votes[meaning] = votes.get(meaning, 0.0) + share
    mine = votes.pop(own, 0.0)
    other = max(votes, key=lambda meaning: votes[meaning], default=own)
    return other, votes.get(other, 0.0), mine


def _nearest(
    shared: IndexArray, chosen: NDArray[np.bool_], ids: NDArray[Any], row: int, *, count: int = 3
) -> tuple[int, ...]:
    places = np.flatnonzero(chosen)
    places = places[places != row]
    order = np.argsort(-shared[places], kind="stable")[:count]
    return tuple(int(number) for number in ids[places[order]])
