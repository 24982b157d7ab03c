"""The tables of a library, in portable SQLAlchemy Core.

``clips`` is small; the arrays of a clip are in separate tables, so that listing reads no arrays, training only
features, and searching only leaves. Histograms are not stored: they follow from the leaves and the forest, which learns
from added clips. A large library keeps positions and features in fragments (`dousa.library.store.fragments`); the row
then has their place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import ArrayLike, NDArray

from dousa.errors import LibraryDamagedError

APPLICATION_ID = 0x444F5553
"""``DOUS``: marks an SQLite file as a dousa library (https://sqlite.org/fileformat.html, 1.3.15)."""

FRAME_BYTES = 4 * 3 * 20
"""Bytes of one frame of stored positions, by definition of ``clip_trajectories``: float32 of 20 joints."""

CLIP, TAKE = "clip", "take"
"""The kinds of motion in a library: a cut clip, and an uncut recording."""

metadata = sa.MetaData()


def _checksum(name: str = "checksum") -> sa.Column[int]:
    """Return the checksum column, see ``dousa.library.store.checksums``."""
    return sa.Column(name, sa.BigInteger, nullable=False)


migrations = sa.Table(
    "dousa_migrations",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("name", sa.Text, nullable=False),
    sa.Column("applied_at", sa.Text, nullable=False),
    sa.Column("dousa_version", sa.Text, nullable=False),
)

library_state = sa.Table(
    "library_state",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # Counts writes: other programs see that their copy of the histograms is out of date.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # We choose the numbers of clips: known before the insert, and never used twice.
    sa.Column("next_clip_id", sa.Integer, nullable=False),
    # The last write that changed clips or their categories, from which a forest learns; not takes.
    sa.Column("clips_revision", sa.BigInteger, nullable=False, server_default="0"),
    _checksum(),
)

clips = sa.Table(
    "clips",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("path", sa.Text, nullable=False, unique=True),
    sa.Column("content_hash", sa.String(64), nullable=False, unique=True),
    # Sizes and times of the files of the clip: equal ones need not be read again.
    sa.Column("fingerprint", sa.Text, nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    # The unit, up axis, joint map and skeleton given by hand, empty if none.
    sa.Column("read_options", sa.Text, nullable=False),
    sa.Column("category", sa.Text, index=True),
    sa.Column("performer", sa.Text, index=True),
    sa.Column("format", sa.Text, nullable=False),
    sa.Column("n_frames", sa.Integer, nullable=False),
    sa.Column("frame_rate", sa.Double, nullable=False),
    sa.Column("duration", sa.Double, nullable=False),
    sa.Column("height", sa.Double, nullable=False),
    sa.Column("joint_table", sa.Text, nullable=False),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("added_at", sa.Text, nullable=False),
    sa.Column("kind", sa.Text, nullable=False, server_default=CLIP),
    # Canonical joints that the body lacks, separated by spaces.
    sa.Column("absent", sa.Text, nullable=False, server_default=""),
    # Of the columns that a search reads, and of the rest.
    _checksum("label_checksum"),
    _checksum(),
    # Files of the same size as a new one may have the same content.
    sa.Index("ix_clips_size", "size"),
    # Sums of checksums show changes without reading the rows.
    sa.Index("ix_clips_label_checksum", "id", "label_checksum"),
)


def _key(name: str, owner: str) -> sa.Column[int]:
    """Return a key that is also the key of another table, whose rows take these with them."""
    return sa.Column(name, sa.Integer, sa.ForeignKey(owner, ondelete="CASCADE"), primary_key=True, autoincrement=False)


def _clip_id() -> sa.Column[int]:
    return _key("clip_id", "clips.id")


def _place() -> tuple[sa.Column[Any], ...]:
    """Return the columns of a place outside the row: name of the fragment, first byte in it, number of bytes."""
    return (
        sa.Column("fragment", sa.String(64)),
        sa.Column("first_byte", sa.BigInteger),
        sa.Column("n_bytes", sa.BigInteger),
    )


clip_trajectories = sa.Table(
    "clip_trajectories",
    metadata,
    _clip_id(),
    # float32, little endian, (n_frames, 20, 3) m; 0 for joints that are absent; empty if in a fragment
    sa.Column("positions", sa.LargeBinary, nullable=False),
    # uint32, little endian, one for every ``BLOCK_FRAMES`` frames: a segment is checked without its whole take
    sa.Column("block_checksums", sa.LargeBinary, nullable=False),
    *_place(),
)

clip_features = sa.Table(
    "clip_features",
    metadata,
    _clip_id(),
    # Name in ``FEATURE_SETS``; features of another set than wanted are computed again.
    sa.Column("feature_set", sa.Text, nullable=False),
    # float32, little endian, (frames, columns) of the set; empty if in a fragment
    sa.Column("pose_features", sa.LargeBinary, nullable=False),
    # Of the number, the set and the features, in row or fragment.
    _checksum(),
    *_place(),
)

clip_poses = sa.Table(
    "clip_poses",
    metadata,
    _clip_id(),
    # float32, little endian, ``compute_pose_sequence``: poses to align clips by in rankings
    sa.Column("poses", sa.LargeBinary, nullable=False),
    _checksum(),
)

clip_leaves = sa.Table(
    "clip_leaves",
    metadata,
    _clip_id(),
    sa.Column("predicted_category", sa.Text, nullable=False),
    # int32, little endian, (n_trees,): the leaf that the clip reaches in each tree
    sa.Column("leaves", sa.LargeBinary, nullable=False),
    # float32, little endian: ``Likeness.place``; None if no likeness was learned
    sa.Column("direction", sa.LargeBinary),
    _checksum(),
    sa.Index("ix_clip_leaves_checksum", "clip_id", "checksum"),
)

clip_relations = sa.Table(
    "clip_relations",
    metadata,
    _clip_id(),
    # Of ``dousa.retrieval.words.relations``: those of other questions are computed again.
    sa.Column("version", sa.Integer, nullable=False),
    # [[name, part, share, start, end], ...] of the actions in the motion, for text search
    sa.Column("relations", sa.JSON, nullable=False),
    _checksum(),
    # Counts clips with words without reading them.
    sa.Index("ix_clip_relations_version", "version"),
)

take_windows = sa.Table(
    "take_windows",
    metadata,
    _clip_id(),
    # ``forests.learned`` of their forest; for another one they are computed again
    sa.Column("learned", sa.BigInteger, nullable=False),
    # ``TakeWindows.to_bytes``: leaves and poses of every window of a take
    sa.Column("data", sa.LargeBinary, nullable=False),
)

segments = sa.Table(
    "segments",
    metadata,
    # A segment is a clip that refers to a part of the take's positions.
    _clip_id(),
    sa.Column("take_id", sa.Integer, sa.ForeignKey("clips.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("first_frame", sa.Integer, nullable=False),
    # s, as given: frames would be rounded
    sa.Column("start_s", sa.Double, nullable=False),
    sa.Column("end_s", sa.Double, nullable=False),
    # Whether it was named by hand rather than by a table of labels.
    sa.Column("by_hand", sa.Boolean, nullable=False, server_default=sa.false()),
    _checksum(),
)

take_annotations = sa.Table(
    "take_annotations",
    metadata,
    # Takes labelled from beginning to end: the rest shows nothing that has a name.
    _key("take_id", "clips.id"),
    # Its table of labels, the tier, and a hash of the content.
    sa.Column("source", sa.Text, nullable=False),
    sa.Column("tier", sa.Text, nullable=False),
    sa.Column("labels_hash", sa.String(64), nullable=False),
    # [[start, end], ...] s of undecided parts
    sa.Column("unclear", sa.JSON, nullable=False),
    _checksum(),
)

forests = sa.Table(
    "forests",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # Of the library at the end of the training: identifies the forest, and shows later changes of clips.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # Of the library when the leaves last learned, in the training or from clips added later.
    sa.Column("learned", sa.BigInteger, nullable=False, server_default="0"),
    sa.Column("trained_at", sa.Text, nullable=False),
    sa.Column("categories", sa.JSON, nullable=False),
    sa.Column("parameters", sa.JSON, nullable=False),
    sa.Column("n_clips", sa.Integer, nullable=False),
    # Frames of the windows that takes are cut into.
    sa.Column("window_lengths", sa.JSON, nullable=False),
    # Number of the first clip after the training.
    sa.Column("first_later", sa.Integer, nullable=False),
    # Clips that the leaves learned after the training.
    sa.Column("n_learned", sa.Integer, nullable=False, server_default="0"),
    sa.Column("data", sa.LargeBinary, nullable=False),
    # ``Calibration.to_bytes``, for unknown motions; None if there were too few categories.
    sa.Column("calibration", sa.LargeBinary),
    # ``Likeness.to_bytes``, for similar clips; None if there were too few clips.
    sa.Column("likeness", sa.LargeBinary),
    # ``TakeLabeller.to_bytes``: learned when a take is first labelled
    sa.Column("labeller", sa.LargeBinary),
    _checksum(),
)

leaf_examples = sa.Table(
    "leaf_examples",
    metadata,
    # One row, if the trees of the forest grew from samples; made again if missing.
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # ``forests.revision`` of the training.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # int32, little endian, (leaves, 8): numbers of a few clips of each leaf, padded with -1
    sa.Column("clips", sa.LargeBinary, nullable=False),
    _checksum(),
)

unlearned = sa.Table(
    "unlearned",
    metadata,
    # Clips with leaves and a category that the forest has still to learn, in the next add.
    _clip_id(),
)

part_forests = sa.Table(
    "part_forests",
    metadata,
    # Name of its features, such as ``extended without left_hand right_hand``.
    sa.Column("feature_set", sa.Text, primary_key=True),
    # Hash of its clips, categories and parameters: it is learned again if they change.
    sa.Column("learned_from", sa.String(64), nullable=False),
    sa.Column("forest", sa.LargeBinary, nullable=False),
    sa.Column("calibration", sa.LargeBinary),
    # Of the clips that have its joints: int32 numbers (N,), int32 leaves (N, n_trees), float32 poses.
    sa.Column("clip_ids", sa.LargeBinary, nullable=False),
    sa.Column("leaves", sa.LargeBinary, nullable=False),
    sa.Column("poses", sa.LargeBinary, nullable=False),
    # The labeller of takes of such bodies, once one was labelled.
    sa.Column("labeller", sa.LargeBinary),
    _checksum(),
)

clip_tags = sa.Table(
    "clip_tags",
    metadata,
    # Of clips and takes that have tags.
    _clip_id(),
    # Sorted names.
    sa.Column("tags", sa.JSON, nullable=False),
    _checksum(),
)

saved_searches = sa.Table(
    "saved_searches",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("name", sa.Text, nullable=False, unique=True),
    # Values by name of the filter; or ``{"clips": [...]}`` of a selection.
    sa.Column("asked", sa.JSON, nullable=False),
    _checksum(),
)

journal = sa.Table(
    "journal",
    metadata,
    # The revision of the library made by the change: never used twice.
    sa.Column("number", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("made_at", sa.Text, nullable=False),
    sa.Column("kind", sa.Text, nullable=False),
    sa.Column("n_clips", sa.Integer, nullable=False),
    # Values of its message.
    sa.Column("told", sa.JSON, nullable=False),
    # The states before and after, see ``dousa.library.history.recording``.
    sa.Column("changes", sa.JSON, nullable=False),
    # The revision of its undo; None while it is in force.
    sa.Column("undone", sa.BigInteger),
    _checksum(),
)

removed_clips = sa.Table(
    "removed_clips",
    metadata,
    # Number of a clip or take to restore by undo or redo: ``kept`` has its rows of other tables.
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("change", sa.BigInteger, sa.ForeignKey("journal.number", ondelete="CASCADE"), nullable=False, index=True),
    # Bytes of its positions.
    sa.Column("size", sa.BigInteger, nullable=False),
    sa.Column("kept", sa.JSON, nullable=False),
    _checksum(),
)

removed_positions = sa.Table(
    "removed_positions",
    metadata,
    _key("number", "removed_clips.number"),
    sa.Column("positions", sa.LargeBinary, nullable=False),
    sa.Column("block_checksums", sa.LargeBinary, nullable=False),
    *_place(),
)

array_store = sa.Table(
    "array_store",
    metadata,
    # One row, if new positions and features go to fragments; none if they stay in their rows.
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # Folder or URL of the fragments; empty for those beside a library file.
    sa.Column("place", sa.Text, nullable=False),
    _checksum(),
)

JOURNAL_TABLES = (journal, removed_clips, removed_positions)
"""Tables for undo; a library is complete without them."""


PLACE = ("fragment", "first_byte", "n_bytes")
"""Columns with the place of bytes outside the row."""


def key_of(table: sa.Table) -> sa.Column[Any]:
    """Return the column of the primary key."""
    return next(iter(table.primary_key))


def is_id(number: int) -> bool:
    """Return whether a clip or take can have this number; beyond them databases raise errors of their own."""
    return number in range(1, 2**31)


def pack(values: ArrayLike, dtype: str) -> bytes:
    """Return the bytes of an array, C order, of a NumPy type with its byte order such as ``"<f4"``."""
    return np.ascontiguousarray(values, dtype=dtype).tobytes()


def unpack(data: bytes, dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """Read an array of ``pack``; LibraryDamagedError as in ``stack``."""
    array: NDArray[Any] = stack([data], dtype, shape, what)[0]
    return array


def stack(blobs: Sequence[bytes], dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """Read arrays of one shape from ``pack`` into (N, *shape) with one copy.

    LibraryDamagedError for a wrong number of bytes, or numbers that are not finite.
    """
    expected = int(np.prod(shape)) * np.dtype(dtype).itemsize
    for blob in blobs:
        if len(blob) != expected:
            raise LibraryDamagedError("library_file.wrong_size", what=what, expected=expected, found=len(blob))
    # A bytearray, so that the array is writable like a computed one: numba would compile again for a read-only one.
    array = np.frombuffer(bytearray().join(blobs), dtype=dtype).reshape(len(blobs), *shape)
    # A sum is finite unless a part is not (or the parts are absurd): cheaper than checking every number.
    with np.errstate(over="ignore", invalid="ignore"):
        whole = array.dtype.kind != "f" or bool(np.isfinite(array.sum(dtype=np.float64)))
    if not whole:
        raise LibraryDamagedError("library_file.not_finite", what=what)
    return array
