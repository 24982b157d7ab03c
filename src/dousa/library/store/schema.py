"""The tables of a library, in SQLAlchemy Core and nothing that only one database knows.

``clips`` is small and holds what people ask for; the arrays of a clip stand in tables of their own, so that
listing reads no array, training reads features only, and searching reads leaves only. Histograms are not stored:
they follow from the leaves and the forest, whose leaves learn from clips that are added. Positions and features of a
large library lie beside its tables, in fragments (`dousa.library.store.fragments`): the row then says where.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import ArrayLike, NDArray

from dousa.errors import LibraryDamagedError
from dousa.messages import Message

APPLICATION_ID = 0x444F5553
"""``DOUS``: marks an SQLite file as a library of ours."""

FRAME_BYTES = 4 * 3 * 20
"""Of positions as they are stored."""

CLIP, TAKE = "clip", "take"
"""The kinds of motion in a library: one thing that is done, cut out; and an uncut recording."""

_IDS = range(1, 2**31)  # beyond them a database stops with an error of its own

metadata = sa.MetaData()


def _checksum(name: str = "checksum") -> sa.Column[int]:
    """Of a row, see ``dousa.library.store.checksums``; None where an older dousa wrote it."""
    return sa.Column(name, sa.BigInteger)


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
    # Counts writes: a library that is open elsewhere sees that its copy of the histograms is out of date.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # Numbers of clips are given out by us: known before the insert, and never used twice.
    sa.Column("next_clip_id", sa.Integer, nullable=False),
    # The write that last changed what a forest learns from: clips and their categories, not takes.
    sa.Column("clips_revision", sa.BigInteger, nullable=False, server_default="0"),
    _checksum(),
)

clips = sa.Table(
    "clips",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("path", sa.Text, nullable=False, unique=True),
    sa.Column("content_hash", sa.String(64), nullable=False, unique=True),
    # Bytes and times of the files behind the clip: equal ones need not be read again.
    sa.Column("fingerprint", sa.Text, nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    # The unit, up axis, joint map and skeleton that were given by hand, empty if none.
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
    # Canonical joints that the body lacks, with spaces between them; empty of a whole one.
    sa.Column("absent", sa.Text, nullable=False, server_default=""),
    # Of what a search reads, and of the rest.
    _checksum("label_checksum"),
    _checksum(),
    # Files of the size of a new one may hold the same.
    sa.Index("ix_clips_size", "size"),
    # What has changed is found by the sums of checksums, without a look at the rows.
    sa.Index("ix_clips_label_checksum", "id", "label_checksum"),
)


def _clip_id() -> sa.Column[int]:
    owner = sa.ForeignKey("clips.id", ondelete="CASCADE")
    return sa.Column("clip_id", sa.Integer, owner, primary_key=True, autoincrement=False)


def _place() -> tuple[sa.Column[Any], ...]:
    """Where the bytes of a row lie, if not in the row: name of the fragment, first byte in it, number of bytes."""
    return (
        sa.Column("fragment", sa.String(64)),
        sa.Column("first_byte", sa.BigInteger),
        sa.Column("n_bytes", sa.BigInteger),
    )


clip_trajectories = sa.Table(
    "clip_trajectories",
    metadata,
    _clip_id(),
    # float32, little endian, (n_frames, 20, 3) m; 0 for joints that are absent; empty where a fragment has them
    sa.Column("positions", sa.LargeBinary, nullable=False),
    # uint32, little endian, one for every ``BLOCK_FRAMES`` frames: a segment is checked without its whole take
    sa.Column("block_checksums", sa.LargeBinary),
    *_place(),
)

clip_features = sa.Table(
    "clip_features",
    metadata,
    _clip_id(),
    # Name in ``FEATURE_SETS``; empty where an older dousa computed them: they are computed anew when needed.
    sa.Column("feature_set", sa.Text, nullable=False, server_default=""),
    # float32, little endian, (frames, columns) of the set; float64 of the same values where an older dousa wrote them;
    # empty where a fragment has them
    sa.Column("pose_features", sa.LargeBinary, nullable=False),
    # Of the number, the set and the features, wherever these lie.
    _checksum(),
    *_place(),
)

clip_poses = sa.Table(
    "clip_poses",
    metadata,
    _clip_id(),
    # float32, little endian, ``compute_pose_sequence``: what clips are aligned by when they are ranked
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
    # float32, little endian: ``Likeness.place``; None where no likeness was learned
    sa.Column("direction", sa.LargeBinary),
    _checksum(),
    sa.Index("ix_clip_leaves_checksum", "clip_id", "checksum"),
)

clip_relations = sa.Table(
    "clip_relations",
    metadata,
    _clip_id(),
    # Of ``dousa.retrieval.words.relations``: those of other questions are computed anew.
    sa.Column("version", sa.Integer, nullable=False),
    # [[name, part, share, start, end], ...] of what the motion does, to be found by words
    sa.Column("relations", sa.JSON, nullable=False),
    _checksum(),
    # Whether all clips have some is counted without a look at them.
    sa.Index("ix_clip_relations_version", "version"),
)

take_windows = sa.Table(
    "take_windows",
    metadata,
    _clip_id(),
    # ``forests.learned`` of the forest that described them: of another one they are described anew
    sa.Column("learned", sa.BigInteger, nullable=False),
    # ``TakeWindows.to_bytes``: leaves and poses of every window of a take
    sa.Column("data", sa.LargeBinary, nullable=False),
)

segments = sa.Table(
    "segments",
    metadata,
    # A segment of a take is a clip without positions of its own: it is a place in those of the take.
    _clip_id(),
    sa.Column("take_id", sa.Integer, sa.ForeignKey("clips.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("first_frame", sa.Integer, nullable=False),
    # s, as they were given: frames are rounded
    sa.Column("start_s", sa.Double, nullable=False),
    sa.Column("end_s", sa.Double, nullable=False),
    # Whether somebody named it in the take, rather than a table of labels.
    sa.Column("by_hand", sa.Boolean, nullable=False, server_default=sa.false()),
    _checksum(),
)

take_annotations = sa.Table(
    "take_annotations",
    metadata,
    # Of a take that was labelled from beginning to end: where no segment is, nothing that has a name happens.
    sa.Column(
        "take_id", sa.Integer, sa.ForeignKey("clips.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    ),
    # The table of labels that it came from, its tier, and what stands for its content.
    sa.Column("source", sa.Text, nullable=False),
    sa.Column("tier", sa.Text, nullable=False),
    sa.Column("labels_hash", sa.String(64), nullable=False),
    # [[start, end], ...] s: nobody can say what happens there
    sa.Column("unclear", sa.JSON, nullable=False),
    _checksum(),
)

forests = sa.Table(
    "forests",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # Of the library at the end of the training: tells forests apart, and whether clips changed since.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # Of the library when the leaves last learned: by the training, or from clips that were added later.
    sa.Column("learned", sa.BigInteger, nullable=False, server_default="0"),
    sa.Column("trained_at", sa.Text, nullable=False),
    sa.Column("categories", sa.JSON, nullable=False),
    sa.Column("parameters", sa.JSON, nullable=False),
    sa.Column("n_clips", sa.Integer, nullable=False),
    # Frames of the windows that takes are cut into; None in a library that an older dousa trained.
    sa.Column("window_lengths", sa.JSON(none_as_null=True)),
    # Number from which on clips came after the training; None if an older dousa trained, and nobody knows.
    sa.Column("first_later", sa.Integer),
    # Clips that the leaves learned after the training.
    sa.Column("n_learned", sa.Integer, nullable=False, server_default="0"),
    sa.Column("data", sa.LargeBinary, nullable=False),
    # ``Calibration.to_bytes``: when is a motion unknown? None where there were too few categories to learn that.
    sa.Column("calibration", sa.LargeBinary),
    # ``Likeness.to_bytes``: which clips are alike? None where there were too few clips to learn that.
    sa.Column("likeness", sa.LargeBinary),
    # ``TakeLabeller.to_bytes``: learned when a take is first labelled
    sa.Column("labeller", sa.LargeBinary),
    _checksum(),
)

leaf_examples = sa.Table(
    "leaf_examples",
    metadata,
    # One row, where the trees of the forest grew from samples; made anew where there is none.
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # ``forests.revision`` of the training.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # int32, little endian, (leaves, 8): numbers of a few clips of each leaf, -1 where there are fewer
    sa.Column("clips", sa.LargeBinary, nullable=False),
    _checksum(),
)

unlearned = sa.Table(
    "unlearned",
    metadata,
    # Clips that have leaves and a category, from which the forest has not learned yet: who adds clips sees to it.
    _clip_id(),
)

part_forests = sa.Table(
    "part_forests",
    metadata,
    # Name of the features that it asks for, such as ``extended without left_hand right_hand``.
    sa.Column("feature_set", sa.Text, primary_key=True),
    # Of what it has learned: it is learned anew from other clips, categories or parameters.
    sa.Column("learned_from", sa.String(64), nullable=False),
    sa.Column("forest", sa.LargeBinary, nullable=False),
    sa.Column("calibration", sa.LargeBinary),
    # What it says of the clips that have its joints: int32 numbers (N,), int32 leaves (N, n_trees), float32 poses.
    sa.Column("clip_ids", sa.LargeBinary, nullable=False),
    sa.Column("leaves", sa.LargeBinary, nullable=False),
    sa.Column("poses", sa.LargeBinary, nullable=False),
    # What takes of such bodies are labelled with, when one has been labelled.
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
    # What is asked for, by name of the filter; or ``{"clips": [...]}`` of clips that were chosen one by one.
    sa.Column("asked", sa.JSON, nullable=False),
    _checksum(),
)

journal = sa.Table(
    "journal",
    metadata,
    # The revision of the library that the change made: never used twice.
    sa.Column("number", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("made_at", sa.Text, nullable=False),
    sa.Column("kind", sa.Text, nullable=False),
    sa.Column("n_clips", sa.Integer, nullable=False),
    # Values of the message that tells it.
    sa.Column("told", sa.JSON, nullable=False),
    # What was before and what is after, see ``dousa.library.history.recording``.
    sa.Column("changes", sa.JSON, nullable=False),
    # The revision in which it was undone; None while it is in force.
    sa.Column("undone", sa.BigInteger),
    _checksum(),
)

removed_clips = sa.Table(
    "removed_clips",
    metadata,
    # Number of a clip or take that an undo, or a redo, brings back: ``kept`` has the rows of other tables about it.
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
    sa.Column(
        "number", sa.Integer, sa.ForeignKey("removed_clips.number", ondelete="CASCADE"), primary_key=True,
        autoincrement=False,
    ),
    sa.Column("positions", sa.LargeBinary, nullable=False),
    sa.Column("block_checksums", sa.LargeBinary),
    *_place(),
)  # fmt: skip

array_store = sa.Table(
    "array_store",
    metadata,
    # One row, where new positions and features go to fragments; none while they stand in their rows.
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # Folder or URL of the fragments; empty for those beside a library file.
    sa.Column("place", sa.Text, nullable=False),
    _checksum(),
)

JOURNAL_TABLES = (journal, removed_clips, removed_positions)
"""What an undo needs; a library is whole without it."""


PLACE = ("fragment", "first_byte", "n_bytes")
"""Columns that say where the bytes of a row lie."""


def is_id(number: int) -> bool:
    """Whether a clip or take can have this number."""
    return number in _IDS


def as_message(stored: Any) -> Message:
    """A message as ``to_json()`` wrote it, or a sentence as an older dousa did."""
    if isinstance(stored, Message):
        return stored
    return Message.from_json(stored) if isinstance(stored, dict) else Message("text.verbatim", text=stored)


def pack(values: ArrayLike, dtype: str) -> bytes:
    """The bytes of an array, C order, of a NumPy type with its byte order such as ``"<f4"``."""
    return np.ascontiguousarray(values, dtype=dtype).tobytes()


def unpack(data: bytes, dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """The array that ``pack`` wrote; LibraryDamagedError as of ``stack``."""
    array: NDArray[Any] = stack([data], dtype, shape, what)[0]
    return array


def stack(blobs: Sequence[bytes], dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """Arrays of one shape that ``pack`` wrote, stacked to (N, *shape) with one copy.

    Raises
    ------
    LibraryDamagedError : one has another number of bytes, or numbers that are not finite.
    """
    expected = int(np.prod(shape)) * np.dtype(dtype).itemsize
    for blob in blobs:
        if len(blob) != expected:
            raise LibraryDamagedError("library_file.wrong_size", what=what, expected=expected, found=len(blob))
    # A bytearray, so that the array is writable as one that was computed is: numba would compile again for another.
    array = np.frombuffer(bytearray().join(blobs), dtype=dtype).reshape(len(blobs), *shape)
    # A sum is finite unless a part is not (or the parts are absurd): cheaper than looking at every number.
    with np.errstate(over="ignore", invalid="ignore"):
        whole = array.dtype.kind != "f" or bool(np.isfinite(array.sum(dtype=np.float64)))
    if not whole:
        raise LibraryDamagedError("library_file.not_finite", what=what)
    return array
