"""Features and poses of the clips: stored once, and computed again for another feature set."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import LibraryDamagedError, LibraryVersionError, OptionError
from dousa.library.store import checksums, schema
from dousa.library.store.checksums import BLOCK_FRAMES, seal_positions
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.fragments import Place, in_portions, place_of, put_aside, read_feature_rows, read_places
from dousa.library.store.rows import delete_rows, fetch_in, fetch_rows, portions, seal_rows
from dousa.library.store.schema import pack, stack, unpack
from dousa.messages import Count
from dousa.motion import CANONICAL_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX, CanonicalPoses, find_absent
from dousa.retrieval.features.posed_motion import SLOWEST_RATE, hide_joints, order_joints
from dousa.workers.current import current_cluster
from dousa.workers.threads import map_together

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion, Trajectories
    from dousa.retrieval.features.feature_sets import FeatureSet


@dataclass(frozen=True, slots=True, eq=False)
class StoredMotion(CanonicalPoses):
    """A motion as the library stores it: canonical joints, without their source.

    Parameters
    ----------
    positions : (T, 20, 3) m, of float32 precision; NaN in all frames for joints that are absent.
    frame_rate : Hz.
    height : m, body height.
    """

    height: float

    @property
    def absent(self) -> tuple[str, ...]:
        """Canonical joints that the body lacks."""
        return find_absent(self.positions)

    def mirror(self) -> StoredMotion:
        """Return its mirror image."""
        from dousa.motion.canonical.canonicalise import mirror_positions

        return StoredMotion(mirror_positions(self.positions), self.frame_rate, self.height)


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """Data computed of a clip for the forest.

    Parameters
    ----------
    feature_set : name of the features.
    features : (frames, columns) of this set, of float32 precision: a query equals its own clip to the last bit.
    poses : its pose sequence, see ``dousa.retrieval.ranking.ranking``.
    """

    feature_set: str
    features: FloatArray
    poses: NDArray[np.float32]


def is_measurable(values: FloatArray, height: float, *, most: float = 1e9) -> bool:
    """Return whether values and a height can be of a motion: m, body heights or Hz below ``most``.

    A body has at least 1 / ``most`` m. Larger numbers come from a wrong unit or a damaged file; NaN is not measurable.
    """
    return bool((np.abs(values) < most).all()) and height * most > 1


def round_positions(motion: CanonicalMotion | StoredMotion) -> StoredMotion:
    """Return the motion as it would be stored; positions beyond float32 become infinite."""
    with np.errstate(over="ignore"):
        positions = motion.positions.astype(np.float32).astype(np.float64)
    return StoredMotion(positions, motion.frame_rate, motion.height)


def find_feature_set(name: str) -> FeatureSet:
    """Return the feature set of this name; LibraryVersionError if only a newer dousa knows it."""
    from dousa.retrieval.features.feature_sets import FEATURE_SETS, get_feature_set

    try:
        return get_feature_set(name)
    except OptionError as error:
        known = tuple(FEATURE_SETS)
        raise LibraryVersionError("library_forest.unknown_features", name=name, known=known) from error


def name_feature_set(connection: sa.Connection) -> str:
    """Return the name of the features of the forest, the default ones before the training."""
    from dousa.retrieval import DEFAULT_FEATURE_SET

    parameters = connection.execute(sa.select(schema.forests.c.parameters)).scalar()
    return str((parameters or {}).get("feature_set", DEFAULT_FEATURE_SET))


def describe_clip(motion: StoredMotion, feature_set: str) -> Description:
    """Compute features and poses of a motion with rounded positions; joints that the features leave out are hidden."""
    return _describe_clips([motion], feature_set)[0]


def _describe_clips(motions: Sequence[StoredMotion], feature_set: str) -> list[Description]:
    from dousa.retrieval.features.feature_sets import FEATURE_SETS
    from dousa.retrieval.features.sensor_noise import reduce_noise_of_all
    from dousa.retrieval.ranking.ranking import compute_with_poses

    wanted = find_feature_set(feature_set)
    seen = [hide_joints(motion, wanted.hidden) for motion in motions]
    posed = FEATURE_SETS["extended"].without(wanted.hidden)
    features, poses = compute_with_poses(reduce_noise_of_all(seen), posed)
    if wanted is not posed:
        features = np.array([wanted.compute(motion) for motion in seen])
    with np.errstate(over="ignore"):  # values beyond float32 become infinite
        features = features.astype(np.float32).astype(np.float64)
    return [Description(feature_set, *own) for own in zip(features, poses, strict=True)]


def lacks(feature_set: str, absent: str) -> bool:
    """Return whether features of this name use any of the absent joints (a row's ``absent``)."""
    if not absent:
        return False
    kind = find_feature_set(feature_set)
    return kind.without(absent.split()) is not kind


def _select_motion() -> sa.Select[Any]:
    """Select rows of motions; of a segment the blocks of its take's positions."""
    clips, segments, stored = schema.clips.c, schema.segments.c, schema.clip_trajectories.c
    first = segments.first_frame // BLOCK_FRAMES
    n_blocks = (segments.first_frame + clips.n_frames - 1) // BLOCK_FRAMES - first + 1

    def cut(column: sa.Column[Any], size: int) -> sa.ColumnElement[Any]:
        part = sa.func.substr(column, 1 + size * first, size * n_blocks, type_=sa.LargeBinary)
        return sa.case((segments.clip_id.is_(None), column), else_=part).label(column.name)

    own = (*checksums.LABELS.columns, *checksums.NUMBERS.columns, *checksums.SEGMENTS.columns)
    arrays = cut(stored.positions, BLOCK_FRAMES * schema.FRAME_BYTES), cut(stored.block_checksums, 4)
    own += tuple(stored[name] for name in schema.PLACE)
    query = sa.select(*dict.fromkeys(own), *arrays).join(schema.segments, segments.clip_id == clips.id, isouter=True)
    return query.join(schema.clip_trajectories, stored.clip_id == sa.func.coalesce(segments.take_id, clips.id))


_SELECT_MOTION = _select_motion()


def load_motions(connection: sa.Connection, ids: Sequence[int]) -> Iterator[StoredMotion]:
    """Yield stored motions in the order of these numbers.

    LibraryDamagedError for numbers that are missing, too few or not finite.
    """
    for some in portions(ids):
        rows = {row.id: row for row in connection.execute(_SELECT_MOTION.where(schema.clips.c.id.in_(some)))}
        if len(rows) != len(set(some)):
            raise LibraryDamagedError("library_clips.positions_missing", expected=len(set(some)), found=len(rows))
        for row, data in _read_positions(connection, [rows[clip_id] for clip_id in some]):
            yield _unpack(connection, row, data)


def _read_positions(connection: sa.Connection, rows: Iterable[Any]) -> Iterator[tuple[Any, bytes]]:
    """Read rows with their positions; of a segment with its blocks."""
    for some in in_portions(rows):
        _check_rows(connection, some)
        blocks = read_places(connection, [(row.positions, _find_blocks(row)) for row in some])
        yield from zip(some, blocks, strict=True)


def _find_blocks(row: Any) -> Place | None:
    """Return the place of positions in a fragment; of a segment its blocks, as the query cuts them out of a row."""
    place = place_of(row)
    if place is None or row.take_id is None:
        return place
    size = BLOCK_FRAMES * schema.FRAME_BYTES
    first = row.first_frame // BLOCK_FRAMES * size
    end = ((row.first_frame + row.n_frames - 1) // BLOCK_FRAMES + 1) * size
    return Place(place.fragment, place.first_byte + first, max(min(end, place.n_bytes) - first, 0))


def load_trajectories(connection: sa.Connection, ids: Sequence[int]) -> Iterator[tuple[int, Trajectories]]:
    """Yield numbers and stored joints of existing clips, in any order.

    LibraryDamagedError for numbers that are missing, too few or not finite.
    """
    from dousa.motion import CANONICAL_PARENTS, Trajectories

    parents = np.array(CANONICAL_PARENTS)
    rows = fetch_in(connection, _SELECT_MOTION, schema.clips.c.id, ids)
    lacking = set(ids)
    for row, data in _read_positions(connection, rows):
        positions = _unpack_positions(connection, row, data)
        lacking.discard(row.id)
        yield row.id, Trajectories(CANONICAL_JOINTS, positions, row.frame_rate, parents)
    for number in fetch_in(connection, sa.select(schema.clips.c.id), schema.clips.c.id, sorted(lacking)):
        raise checksums.damaged(connection, checksums.POSITIONS, number[0])


def _check_rows(connection: sa.Connection, rows: Sequence[Any]) -> None:
    checksums.LABELS.check_rows(connection, rows)
    checksums.NUMBERS.check_rows(connection, rows)
    checksums.SEGMENTS.check_rows(connection, [row for row in rows if row.take_id is not None])


def _unpack_positions(connection: sa.Connection, row: Any, data: bytes) -> FloatArray:
    owner, start = row.id, 0
    if row.take_id is not None:
        owner, start = row.take_id, row.first_frame
    block, skipped = divmod(start, BLOCK_FRAMES)
    if seal_positions(owner, data, block) != row.block_checksums:
        raise checksums.damaged(connection, checksums.POSITIONS, owner)
    if row.take_id is not None:
        data = data[skipped * schema.FRAME_BYTES : (skipped + row.n_frames) * schema.FRAME_BYTES]
    stored = unpack(data, "<f4", (row.n_frames, len(CANONICAL_JOINTS), 3), row.path)
    positions: FloatArray = stored.astype(np.float64)
    if row.absent:
        try:
            absent = order_joints(row.absent.split())
        except OptionError as error:
            raise LibraryDamagedError("library_clips.joints", path=row.path, problem=error) from error
        positions[:, [JOINT_INDEX[joint] for joint in absent]] = np.nan
    return positions


def pack_positions(motion: StoredMotion) -> bytes:
    """Return positions as stored bytes."""
    return pack(np.nan_to_num(motion.positions) if motion.absent else motion.positions, "<f4")


def _unpack(connection: sa.Connection, row: Any, data: bytes) -> StoredMotion:
    positions = _unpack_positions(connection, row, data)
    numbers = np.array([row.height, row.frame_rate, np.nanmax(np.abs(positions))])
    if not (is_measurable(numbers, row.height) and row.frame_rate >= SLOWEST_RATE):
        raise LibraryDamagedError(
            "library_clips.impossible", path=row.path, height=row.height, frame_rate=row.frame_rate
        )
    return StoredMotion(positions, row.frame_rate, row.height)


_FEATURES, _POSES = "<f4", "<f4"


@dataclass(frozen=True, slots=True, eq=False)
class ClipFeatures:
    """Features of N clips.

    Parameters
    ----------
    ids : numbers.
    features : (N, frames, columns) of one set, float32.
    categories, performers : labels, or None.
    heights : m, of the performers.
    computed : by number, those that were not stored, or of another set.
    room : (N + M, frames, columns), the features followed by spare room; None if there is none.
    """

    ids: list[int]
    features: FloatArray
    categories: list[str | None]
    performers: list[str | None]
    heights: list[float]
    computed: dict[int, Description]
    room: FloatArray | None = None


def load_features(
    connection: sa.Connection,
    feature_set: str,
    ids: Sequence[int] | None = None,
    n_jobs: int | None = 1,
    progress: Count | None = None,
    spare: int = 0,
) -> ClipFeatures:
    """Load features of clips, without takes; missing ones are computed from the stored positions.

    LibraryDamagedError for arrays that are missing, of another length, or not finite.

    Parameters
    ----------
    ids : of these clips, in this order; by default of all that have the joints, ordered by content, so that the order
        of adding does not matter.
    n_jobs : clips described at a time.
    progress : called with (clips described, clips to describe).
    spare : number of clips to leave room for; the features are then in the order of ``order_for_trees``.
    """
    kind = find_feature_set(feature_set)
    rows = _read_rows(connection, ids, feature_set)
    if spare:  # for a training: trees read the cells of a column in sequence
        room = _allocate((len(rows) + spare, kind.n_columns, kind.n_frames)).transpose(0, 2, 1)
    else:
        room = _allocate((len(rows), kind.n_frames, kind.n_columns))
    features = room[: len(rows)]
    # By number, as they were written, so that the disk is read in sequence.
    places = {row.id: place for place, row in enumerate(rows)}
    stored = sorted(row.id for row in rows if row.feature_set == feature_set)
    for some in portions(stored):
        read = read_feature_rows(connection, some)
        if read:
            checksums.FEATURES.check_all(connection, list(zip(*read, strict=True)))
            features[[places[row[0]] for row in read]] = _stack_features([row[2] for row in read], features.shape[1:])
    lacking = [row.id for row in rows if row.feature_set != feature_set]
    computed = describe_stored(connection, lacking, feature_set, n_jobs, progress)
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
        room=room if spare else None,
    )


def _stack_features(blobs: Sequence[bytes], shape: tuple[int, ...], *, most: float = 1e37) -> NDArray[np.float32]:
    """Read features; LibraryDamagedError for values over ``most``, near the largest that float32 has."""
    values: NDArray[np.float32] = stack(blobs, _FEATURES, shape, "features")
    if not np.abs(values).max() < most:
        raise LibraryDamagedError("library_clips.features_beyond_measure")
    return values


def _allocate(shape: tuple[int, int, int], *, in_memory: int = 2**32) -> NDArray[Any]:
    """Allocate room for features; over ``in_memory`` bytes in a temporary file that is deleted with its last view."""
    if 4 * int(np.prod(shape)) <= in_memory:
        return np.zeros(shape, np.float32)
    import tempfile

    with tempfile.TemporaryFile() as file:
        room: NDArray[Any] = np.asarray(np.memmap(file, np.float32, "w+", shape=shape))
    return room


def _read_rows(connection: sa.Connection, ids: Sequence[int] | None, feature_set: str) -> list[Any]:
    """Read rows of clips without features, but with the name of their set."""
    clips, table = schema.clips.c, schema.clip_features.c
    query = sa.select(*checksums.LABELS.columns, clips.height, table.feature_set)
    query = query.join(schema.clip_features, table.clip_id == clips.id, isouter=True)
    query = query.where(clips.kind == schema.CLIP)
    if ids is None:
        rows = connection.execute(query.order_by(clips.content_hash)).all()
        checksums.LABELS.check_rows(connection, rows)
        return [row for row in rows if not lacks(feature_set, row.absent)]
    found = {row.id: row for row in fetch_in(connection, query, clips.id, ids)}
    checksums.LABELS.check_rows(connection, list(found.values()))
    if len(found) != len(set(ids)):
        raise LibraryDamagedError("library_clips.clips_missing", expected=len(set(ids)), found=len(found))
    return [found[clip_id] for clip_id in ids]


def describe_stored(
    connection: sa.Connection,
    ids: Sequence[int],
    feature_set: str,
    n_jobs: int | None = 1,
    progress: Count | None = None,
) -> dict[int, Description]:
    """Describe stored motions, by number."""
    described: dict[int, Description] = {}
    for some in portions(ids):
        # Read here rather than in the workers: a connection is for one thread at a time.
        motions = list(load_motions(connection, some))
        described.update(zip(some, describe_motions(motions, feature_set, n_jobs), strict=True))
        if progress is not None:
            progress(len(described), len(ids))
    return described


def describe_motions(motions: Sequence[StoredMotion], feature_set: str, n_jobs: int | None = 1) -> list[Description]:
    """Describe motions with rounded positions, several at a time."""
    cluster = current_cluster()
    sizes = [motion.positions.nbytes for motion in motions]
    if cluster is not None:
        return list(cluster.map(partial(describe_clip, feature_set=feature_set), motions, sizes=sizes))
    return map_together(partial(_describe_clips, feature_set=feature_set), motions, sizes, choose_jobs(n_jobs))


def keep_features(
    database: Database,
    feature_set: str,
    n_jobs: int | None = 1,
    progress: Count | None = None,
    look: Callable[[Mapping[int, StoredMotion]], None] | None = None,
) -> None:
    """Compute and write missing features and poses of a set for all clips, one transaction per portion.

    An interrupted run keeps what it wrote, and memory holds one portion. Nothing is written if the library has a forest
    that hides other joints, whose poses are needed until it is replaced.

    Parameters
    ----------
    n_jobs : clips described at a time.
    progress : called with (clips described, clips to describe).
    look : called with the motions of each portion, by number, when it is written.
    """
    table = schema.forests.c
    with database.reading() as connection:
        known = connection.execute(sa.select(table.parameters)).scalar_one_or_none()
        own = known.get("feature_set") if isinstance(known, dict) else None
        same = isinstance(own, str) and find_feature_set(own).hidden == find_feature_set(feature_set).hidden
        if known is not None and not same:
            return
        rows = _read_rows(connection, None, feature_set)
        lacking = sorted(row.id for row in rows if row.feature_set != feature_set)
    done, describe = 0, partial(describe_motions, feature_set=feature_set, n_jobs=n_jobs)
    for motions, descriptions in _describe_ahead(database, lacking, describe):
        with database.writing() as connection:
            left = _list_existing(connection, list(motions))
            still = {number: own for number, own in zip(motions, descriptions, strict=True) if number in left}
            save_descriptions(connection, list(still), list(still.values()))
        if look is not None:
            look(motions)
        done += len(motions)
        if progress is not None:
            progress(done, len(lacking))


def _describe_ahead(
    database: Database, ids: Sequence[int], describe: Callable[[list[StoredMotion]], list[Description]]
) -> Iterator[tuple[dict[int, StoredMotion], list[Description]]]:
    """Yield the motions of portions, by number, and their descriptions; the next ones are computed meanwhile."""
    waiting: deque[tuple[dict[int, StoredMotion], Future[list[Description]]]] = deque()
    with ThreadPoolExecutor(1) as beside:
        for some in portions(ids):
            with database.reading() as connection:
                there = sorted(_list_existing(connection, some))
                motions = dict(zip(there, load_motions(connection, there), strict=True))
            waiting.append((motions, beside.submit(copy_context().run, describe, list(motions.values()))))
            if len(waiting) > 1:
                motions, described = waiting.popleft()
                yield motions, described.result()
        for motions, described in waiting:
            yield motions, described.result()


def _list_existing(connection: sa.Connection, ids: Sequence[int]) -> set[int]:
    return {row.id for row in fetch_in(connection, sa.select(schema.clips.c.id), schema.clips.c.id, ids)}


def load_poses(connection: sa.Connection, ids: Sequence[int], feature_set: str) -> NDArray[np.float32]:
    """Return (N, cells, columns) pose sequences of clips, in this order, stored with the forest's feature set.

    LibraryDamagedError for arrays that are of another length, or not finite.
    """
    from dousa.retrieval.ranking.ranking import POSE_CELLS, POSE_COLUMNS

    found = {row.clip_id: row.poses for row in fetch_rows(connection, checksums.POSES, ids)}
    lacking = [clip_id for clip_id in ids if clip_id not in found]  # before the training
    computed = describe_stored(connection, lacking, feature_set)
    poses = np.empty((len(ids), POSE_CELLS, POSE_COLUMNS), np.float32)
    stored = [place for place, clip_id in enumerate(ids) if clip_id in found]
    poses[stored] = stack([found[ids[place]] for place in stored], _POSES, poses.shape[1:], "poses")
    for place, clip_id in enumerate(ids):
        if clip_id in computed:
            poses[place] = computed[clip_id].poses
    return poses


def save_descriptions(connection: sa.Connection, ids: Sequence[int], descriptions: Sequence[Description]) -> None:
    """Write the features and poses of clips, replacing old ones."""
    for some in portions(list(zip(ids, descriptions, strict=True))):
        rows = [
            {
                "clip_id": clip_id,
                "feature_set": own.feature_set,
                "pose_features": pack(own.features, _FEATURES),
                "poses": pack(own.poses, _POSES),
            }
            for clip_id, own in some
        ]
        for table in (schema.clip_features, schema.clip_poses):
            delete_rows(connection, table, [row["clip_id"] for row in rows])
            names = [column.name for column in table.c if column.name not in ("checksum", *schema.PLACE)]
            own = seal_rows(table, [{name: row[name] for name in names} for row in rows])
            if table is schema.clip_features:
                own = put_aside(connection, own, "pose_features")
            connection.execute(sa.insert(table), own)
