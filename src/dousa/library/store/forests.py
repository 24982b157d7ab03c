"""The forest in the library, and the leaves and votes of clips."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import blake2b
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import DousaError, LibraryDamagedError, LibraryVersionError, NotTrainedError, TrainingError
from dousa.library.store import schema
from dousa.library.store.checksums import FOREST
from dousa.library.store.engine import choose_jobs
from dousa.library.store.features import ClipFeatures, StoredMotion, find_feature_set, load_motions
from dousa.library.store.rows import insert_rows, update_rows
from dousa.library.store.schema import pack
from dousa.workers.current import current_cluster
from dousa.workers.threads import map_pieces, map_together

if TYPE_CHECKING:
    from dousa.retrieval import MotionForest
    from dousa.retrieval.features.feature_sets import FeatureSet
    from dousa.retrieval.features.posed_motion import PosedMotion
    from dousa.retrieval.forest.calibration import Assessor, Copies, Watch
    from dousa.retrieval.forest.likeness import Likeness
    from dousa.retrieval.takes.windows import WindowGrid

_FOREST_ID = 1  # of the only row, by definition

# Clips that the rounds of a calibration use, enough for two curves: so many of each category, within these bounds.
_HELD_OF_EACH, _MOST_HELD_BACK = 20, (1500, 3000)

PARTS_OF_A_VOTE = 64
"""The unit of stored votes is this part of a tree: a power of two, so that whole votes are exact."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredForest:
    """A forest as the library keeps it.

    Parameters
    ----------
    forest : the trees.
    categories : names, in the order of the votes.
    feature_set : name of the features it uses.
    grid : windows that takes are cut into.
    assessor : separates known motions from unknown ones; None if there were too few categories.
    revision : of the library at the end of the training; identifies the trees.
    learned : of the library when the leaves last learned; the histograms of clips are valid until the next time.
    likeness : decides which clips are similar; None if there were too few.
    first_later : number of the first clip after the training.
    """

    forest: MotionForest
    categories: tuple[str, ...]
    feature_set: str
    grid: WindowGrid
    assessor: Assessor | None
    revision: int
    learned: int
    likeness: Likeness | None = None
    first_later: int = 1

    @property
    def hidden(self) -> tuple[str, ...]:
        """Joints it does not use."""
        return find_feature_set(self.feature_set).hidden

    def grown(self, forest: MotionForest, features: FloatArray, labels: NDArray[np.str_]) -> StoredForest:
        """Return it with its forest grown by clips (M, T, F) of categories (M,)."""
        assessor = self.assessor
        if assessor is not None:
            assessor = type(assessor)(forest, assessor.calibration.with_clips(features, labels))
        categories = tuple(str(name) for name in forest.classes_)
        return replace(self, forest=forest, categories=categories, assessor=assessor)


@dataclass(frozen=True, slots=True, eq=False)
class TreeAnswers:
    """Votes and leaves of N clips in a forest.

    Parameters
    ----------
    votes : (N, n_categories) int32, votes for each category in 64ths: the histogram H of section 3.4, times 64 trees.
        Whole numbers, so that equal histograms are equal to the last bit.
    leaves : (N, n_trees) int32, the leaf that each clip reaches in each tree.
    categories : names, in the order of the votes.
    directions : (N, K) of ``Likeness.place``; None if not known.
    """

    votes: NDArray[np.int32]
    leaves: NDArray[np.int32]
    categories: tuple[str, ...]
    directions: NDArray[np.float32] | None = None

    def __getitem__(self, rows: slice) -> TreeAnswers:
        directions = None if self.directions is None else self.directions[rows]
        return TreeAnswers(self.votes[rows], self.leaves[rows], self.categories, directions)

    def shares(self) -> FloatArray:
        """(N, n_categories) share of the votes of each category: the histograms."""
        shares: FloatArray = self.votes / (PARTS_OF_A_VOTE * self.leaves.shape[1])
        return shares

    def predicted(self) -> list[str]:
        """The most voted category of each clip; of equals the first in order."""
        return [self.categories[index] for index in self.votes.argmax(axis=1)]


def ask_trees(stored: StoredForest, features: FloatArray) -> TreeAnswers:
    """Run clips down all trees: features (N, frames, columns) of the forest's set."""
    answers = count_votes(stored, find_leaves(stored, features))
    if stored.likeness is None or not len(features):
        return answers
    parts = [features[some] for some in _cut(len(features))]
    placed = map_pieces(stored.likeness.place, parts, stored.forest.n_jobs, at_a_time=1)
    return replace(answers, directions=np.concatenate(placed))


def find_leaves(stored: StoredForest, features: FloatArray) -> NDArray[np.int32]:
    """Return the leaf that each clip reaches in each tree, (N, n_trees)."""
    leaves = np.empty((len(features), len(stored.forest.trees_.roots)), np.int32)

    def find(some: slice) -> None:
        leaves[some] = stored.forest.apply(features[some])

    map_pieces(find, _cut(len(features)), stored.forest.n_jobs, at_a_time=1)
    return leaves


def _cut(count: int, *, at_once: int = 1024) -> list[slice]:
    """Cut clips into portions for one pass through the trees, which needs some kilobytes for each clip."""
    return [slice(start, start + at_once) for start in range(0, count, at_once)]


def make_keys(hashes: Iterable[str]) -> NDArray[np.uint64]:
    """Return numbers for clips from the hashes of their contents, so that a forest does not depend on their order."""
    digests = (blake2b(content.encode(), digest_size=8).digest() for content in hashes)
    return np.array([int.from_bytes(digest) for digest in digests], np.uint64)


def check_leaves(stored: StoredForest, leaves: NDArray[np.int32]) -> None:
    """Raise LibraryDamagedError for a leaf that the forest does not have."""
    if leaves.size and not (leaves.min() >= 0 and leaves.max() < stored.forest.trees_.n_leaves):
        raise LibraryDamagedError("library_forest.no_such_leaf")


def count_votes(stored: StoredForest, leaves: NDArray[np.int32]) -> TreeAnswers:
    """Count the votes for clips with leaves (N, n_trees); LibraryDamagedError for an unknown leaf."""
    check_leaves(stored, leaves)
    shares = stored.forest.histograms_of(leaves.astype(np.int64))
    votes = np.rint(shares * (PARTS_OF_A_VOTE * leaves.shape[1])).astype(np.int32)
    return TreeAnswers(votes, leaves, stored.categories)


def load_forest(connection: sa.Connection, where: str, known: StoredForest | None = None) -> StoredForest | None:
    """Load the forest of the library, None before the training; ``known`` is returned if it is still current.

    LibraryDamagedError for bytes that are not a forest. LibraryVersionError for a forest with features that this dousa
    does not have.
    """
    table = schema.forests.c
    query = sa.select(table.revision, table.learned).where(table.id == _FOREST_ID)
    state = connection.execute(query).one_or_none()
    if state is None or (known is not None and (known.revision, known.learned) == tuple(state)):
        return None if state is None else known
    columns = (*FOREST.columns, table.data, table.calibration, table.likeness, table.first_later)
    row = connection.execute(sa.select(*columns).where(table.id == _FOREST_ID)).one()
    FOREST.check(connection, row)
    from dousa.retrieval import MotionForest
    from dousa.retrieval.forest.calibration import Assessor, Calibration
    from dousa.retrieval.forest.likeness import Likeness

    try:
        forest = MotionForest.from_bytes(row.data)
        categories = tuple(str(name) for name in row.categories)
        if tuple(str(name) for name in forest.classes_) != categories:
            raise LibraryDamagedError("library_forest.other_categories")
        if not isinstance(row.parameters, dict) or not isinstance(row.parameters.get("feature_set"), str):
            raise LibraryDamagedError("library_forest.no_features")
        likeness = None if row.likeness is None else Likeness.from_bytes(row.likeness)
        assessor = None if row.calibration is None else Assessor(forest, Calibration.from_bytes(row.calibration))
    except DousaError as error:
        raise LibraryDamagedError("library_forest.damaged", library=where, problem=error) from error
    feature_set = row.parameters["feature_set"]
    if forest.feature_names_ != find_feature_set(feature_set).column_names:
        raise LibraryVersionError("library_forest.other_features", library=where)
    grid, first_later = _read_grid(row.window_lengths), int(row.first_later)
    revisions = int(state.revision), int(state.learned)
    return StoredForest(forest, categories, feature_set, grid, assessor, *revisions, likeness, first_later)


class ForestCache:
    """The forest of a library in memory, ``last``; read again after a change by another program."""

    def __init__(self, where: str) -> None:
        self._where = where
        self.last: StoredForest | None = None

    def renew(self, connection: sa.Connection) -> StoredForest | None:
        """Return the current forest; None before the training."""
        self.last = load_forest(connection, self._where, self.last)
        return self.last

    def load(self, connection: sa.Connection) -> StoredForest:
        """Return the current forest; NotTrainedError if there is none."""
        stored = self.renew(connection)
        if stored is None:
            raise NotTrainedError("library_forest.not_trained", library=self._where)
        return stored


def _read_grid(lengths: Any) -> WindowGrid:
    from dousa.retrieval.takes.windows import WindowGrid

    try:
        return WindowGrid(tuple(lengths))
    except (DousaError, TypeError) as error:
        raise LibraryDamagedError("library_forest.windows_damaged", reason=error) from error


def fit_grid(connection: sa.Connection, *, tempos: tuple[float, float] = (0.5, 2.0)) -> WindowGrid:
    """Choose windows as long as the labelled clips at these tempos, between which places in takes are found."""
    from dousa.retrieval.takes.windows import choose_grid

    table = schema.clips.c
    query = sa.select(table.duration).where(table.kind == schema.CLIP, table.category.is_not(None))
    return choose_grid(list(connection.execute(query).scalars()) or [1.0], *tempos)


def choose_held_back(clips: ClipFeatures, labelled: Sequence[int]) -> list[int]:
    """Return the places of the clips that rounds hold back or train on: every n-th of every category."""
    n_categories = len({clips.categories[row] for row in labelled})
    step = -(-len(labelled) // int(np.clip(_HELD_OF_EACH * n_categories, *_MOST_HELD_BACK)))
    return sorted(labelled, key=lambda row: str(clips.categories[row]))[::step]


@dataclass(frozen=True, slots=True, eq=False)
class HeldBack:
    """The clips of ``choose_held_back``: features (M, frames, columns), categories (M,) and performers."""

    features: FloatArray
    categories: NDArray[np.str_]
    performers: list[str]


def hold_back(clips: ClipFeatures, labelled: Sequence[int]) -> HeldBack:
    """Return the clips that rounds hold back or train on; ``labelled`` are the places of those with a category."""
    from dousa.retrieval.forest.calibration import guess_performers

    rows = choose_held_back(clips, labelled)
    guesses = guess_performers([clips.heights[row] for row in rows])
    people = [clips.performers[row] or guess for row, guess in zip(rows, guesses, strict=True)]
    categories = np.array([clips.categories[row] for row in rows], dtype=np.str_)
    return HeldBack(np.ascontiguousarray(clips.features[rows]), categories, people)


MOST_COPIES = 1000  # disturbed clips that a forest learns, see docs/noise.md


def describe_copies(
    connection: sa.Connection,
    clips: ClipFeatures,
    labelled: Sequence[int],
    kind: FeatureSet,
    n_jobs: int | None = 1,
    *,
    most: int = MOST_COPIES,
) -> Copies:
    """Describe disturbed copies of some clips of ``choose_held_back``, to learn the effect of noise.

    There are at most ``most`` copies: more take longer, and of a tenth of the clips a forest learns most effects.
    Empty for features without banks: the paper has no copies.
    """
    from dousa.retrieval.features.posed_motion import hide_joints
    from dousa.retrieval.features.sensor_noise import reduce_noise_of_all
    from dousa.retrieval.forest.calibration import Copies
    from dousa.retrieval.takes.made_takes import disturb_motion

    rows = choose_held_back(clips, labelled)
    some = bool(rows) and kind.has_banks
    places = np.arange(0, len(rows), -(-len(rows) // most)) if some else np.zeros(0, np.intp)

    def disturb(place: int, motion: StoredMotion) -> PosedMotion:
        whole = kind.complete(hide_joints(motion, kind.hidden))
        return disturb_motion(whole, np.random.default_rng(place))

    def describe(tasks: Sequence[tuple[int, StoredMotion]]) -> FloatArray:
        return kind.compute_quiet_all(reduce_noise_of_all([disturb(*task) for task in tasks]))

    motions = list(load_motions(connection, [clips.ids[rows[place]] for place in places]))
    tasks, sizes = list(zip(places.tolist(), motions, strict=True)), [motion.positions.nbytes for motion in motions]
    cluster = current_cluster()
    if cluster is not None:
        features = list(cluster.map(lambda task: describe([task])[0], tasks, sizes=sizes))
    else:
        features = map_together(describe, tasks, sizes, choose_jobs(n_jobs))
    shape = (0, kind.n_frames, kind.n_columns)
    return Copies(places, np.stack(features) if features else np.zeros(shape))


def fit_forest(
    forest: MotionForest, clips: ClipFeatures, labelled: Sequence[int], kind: FeatureSet, copies: Copies
) -> None:
    """Grow the trees from labelled clips and their copies of ``describe_copies``."""
    held = choose_held_back(clips, labelled)
    rows = np.full(len(clips.ids), -1, np.intp)
    rows[held] = np.arange(len(held))
    chosen = np.asarray(labelled, np.intp)
    categories = np.array([clips.categories[row] for row in labelled], dtype=np.str_)
    if clips.room is not None and len(chosen) == len(clips.ids):
        features, copied = copies.append(clips.room, rows)  # spare room avoids a copy of all features
    else:
        features, copied = copies.join(clips.features, chosen, rows[chosen])
    forest.fit(features, categories, feature_set=kind, copied=copied)


def learn_unknown(
    forest: MotionForest, held: HeldBack, kind: FeatureSet, copies: Copies | None = None, watch: Watch | None = None
) -> Assessor | None:
    """Learn to separate known motions from unknown ones; None if there are too few clips or categories.

    ``copies`` are of ``describe_copies``; ``watch`` as in ``learn_calibration``, with rows of ``choose_held_back``.
    """
    from dousa.retrieval.forest.calibration import Assessor, learn_calibration

    try:
        calibration = learn_calibration(
            forest, held.features, held.categories, held.performers, feature_set=kind, copies=copies, watch=watch
        )
    except TrainingError:
        return None
    return Assessor(forest, calibration)


def replace_forest(
    connection: sa.Connection, stored: StoredForest, n_clips: int, labeller: bytes | None = None
) -> None:
    """Replace the forest and its labeller by newly trained ones."""
    parameters = {name: value for name, value in stored.forest.get_params().items() if name != "n_jobs"}
    connection.execute(sa.delete(schema.forests))
    row = {
        "id": _FOREST_ID,
        "revision": stored.revision,
        "trained_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "parameters": {**parameters, "feature_set": stored.feature_set},
        "n_clips": n_clips,
        "window_lengths": list(stored.grid.lengths),
        "first_later": stored.first_later,
        "n_learned": 0,
        "labeller": labeller,
        **_to_columns(stored),
    }
    insert_rows(connection, schema.forests, [row])


def _to_columns(stored: StoredForest) -> dict[str, Any]:
    return {
        "learned": stored.learned,
        "categories": list(stored.categories),
        "data": stored.forest.to_bytes(),
        "calibration": None if stored.assessor is None else stored.assessor.calibration.to_bytes(),
        "likeness": None if stored.likeness is None else stored.likeness.to_bytes(),
    }


def update_forest(connection: sa.Connection, stored: StoredForest, n_clips: int) -> None:
    """Write a forest that learned more clips since its training."""
    before = connection.execute(sa.select(schema.forests.c.n_learned)).scalar_one()
    values = {
        "n_learned": before + n_clips,
        "labeller": None,  # it has not learned the new clips
        **_to_columns(stored),
    }
    update_rows(connection, FOREST, {_FOREST_ID: values})


def keep_unlearned(connection: sa.Connection, ids: Sequence[int]) -> None:
    """Set the clips that the forest has still to learn."""
    connection.execute(sa.delete(schema.unlearned))
    note_unlearned(connection, ids)


def note_unlearned(connection: sa.Connection, ids: Sequence[int]) -> None:
    """Add clips that the forest has still to learn."""
    insert_rows(connection, schema.unlearned, [{"clip_id": number} for number in ids])


def save_answers(connection: sa.Connection, ids: Sequence[int], answers: TreeAnswers) -> None:
    """Write the leaves and votes of clips that have none yet."""
    for portion in _cut(len(ids)):
        some = answers[portion]
        directions = [None] * len(some.leaves) if some.directions is None else [pack(d, "<f4") for d in some.directions]
        answered = zip(ids[portion], some.predicted(), some.leaves, directions, strict=True)
        rows = [
            {"clip_id": clip_id, "predicted_category": category, "leaves": pack(leaves, "<i4"), "direction": direction}
            for clip_id, category, leaves, direction in answered
        ]
        insert_rows(connection, schema.clip_leaves, rows)
