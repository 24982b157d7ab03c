"""Checksums of everything a library keeps, so that a flipped bit is an error rather than a wrong result.

Each row has a CRC-32 of its values, its number included, which is compared on every read. Positions have one for every
block of frames, so that a segment is checked without its whole take. npz data (forests, windows of takes) has checksums
of its own.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.errors import LibraryDamagedError
from dousa.library.store import schema
from dousa.messages import Message

BLOCK_FRAMES = 256
"""Frames of positions that share a checksum, by definition of the stored form."""

LIBRARY_NAME = "dousa_library"
"""Execution option of a connection: the name of its library in messages."""


# C functions where possible: a search compares one or two checksums of every clip.
_ENCODERS: tuple[tuple[type[Any], Callable[[Any], bytes]], ...] = (
    (sa.LargeBinary, bytes),
    (sa.Double, struct.Struct("<d").pack),
    (sa.Integer, b"%d".__mod__),
    (sa.Boolean, b"%d".__mod__),
    (sa.JSON, lambda value: json.dumps(value).encode()),
    (sa.Text, str.encode),
    (sa.String, str.encode),
)


@dataclass(frozen=True, slots=True)
class Seal:
    """A checksum over some columns of a table.

    Parameters
    ----------
    checksum : its column.
    covered : the covered columns; the first is the key of the table.
    encoders : of their values, to bytes that do not depend on the database.
    what : names them in messages.
    """

    checksum: sa.Column[Any]
    covered: tuple[sa.Column[Any], ...]
    encoders: tuple[Callable[[Any], bytes], ...]
    what: Message

    @property
    def columns(self) -> tuple[sa.Column[Any], ...]:
        """The covered columns, then the checksum."""
        return (*self.covered, self.checksum)

    def compute(self, values: Iterable[Any]) -> int:
        """Compute the checksum of values, in the order of the covered columns."""
        parts = []
        for encode, value in zip(self.encoders, values, strict=True):
            if value is None:
                parts.append(b"~")
            else:
                data = encode(value)
                parts += (b"%d:" % len(data), data)
        return zlib.crc32(b"".join(parts))

    def compute_all(self, columns: Sequence[Sequence[Any]]) -> list[int]:
        """Compute the checksums of many rows, given by their covered columns; four times as fast as single rows."""
        parts: list[Iterable[bytes]] = []
        for encode, values in zip(self.encoders, columns, strict=True):
            if None in values:
                encoded = [b"" if value is None else encode(value) for value in values]
                heads = [b"~" if v is None else b"%d:" % len(e) for v, e in zip(values, encoded, strict=True)]
                parts += [heads, encoded]
            else:
                encoded = list(map(encode, values))
                parts += [map(b"%d:".__mod__, map(len, encoded)), encoded]
        return list(map(zlib.crc32, map(b"".join, zip(*parts, strict=True))))

    def check_all(self, connection: sa.Connection, columns: Sequence[Sequence[Any]]) -> None:
        """Check many rows, given by ``columns``; as ``check``."""
        try:
            found = self.compute_all(columns[:-1])
        except (TypeError, ValueError, struct.error):  # of another type
            found = [0 if self.is_whole(row) else -1 for row in zip(*columns, strict=True)]
        for place, (own, kept) in enumerate(zip(found, columns[-1], strict=True)):
            if own != kept and (own < 0 or not self.is_whole([c[place] for c in columns])):
                raise damaged(connection, self.what, columns[0][place] if self.is_of_clip else None)

    def is_whole(self, values: Sequence[Any]) -> bool:
        """Return whether the values of ``columns`` agree."""
        try:
            return bool(self.compute(values[:-1]) == values[-1])
        except (TypeError, ValueError, struct.error):  # of another type
            return False

    def check(self, connection: sa.Connection, row: Any) -> None:
        """Raise LibraryDamagedError for a damaged row with columns of these names, or labelled by ``labelled``."""
        values = [row._mapping[column] for column in self.columns]
        if not self.is_whole(values):
            raise damaged(connection, self.what, values[0] if self.is_of_clip else None)

    def check_rows(self, connection: sa.Connection, rows: Sequence[Any]) -> None:
        """Check many rows of one query; as ``check``."""
        values = [row._mapping for row in rows]
        if values:
            self.check_all(connection, [[value[column] for value in values] for column in self.columns])

    @property
    def is_of_clip(self) -> bool:
        """Whether the key is the number of a clip."""
        return self.covered[0].name in ("id", "clip_id", "take_id") and self.covered[0].table.name not in _OWN_KEYS


_OWN_KEYS = ("library_state", "forests", "part_forests", "array_store", "leaf_examples")


def _seal(table: sa.Table, what: Message, names: Sequence[str] | None = None, checksum: str = "checksum") -> Seal:
    chosen = [column.name for column in table.c if "checksum" not in column.name] if names is None else names
    covered = tuple(table.c[name] for name in chosen)
    encoders = (next(own for kind, own in _ENCODERS if isinstance(column.type, kind)) for column in covered)
    return Seal(table.c[checksum], covered, tuple(encoders), what)


_LABELS = ("id", "path", "category", "performer", "kind", "absent")
_NUMBERS = ("id", *(c.name for c in schema.clips.c if c.name not in _LABELS and "checksum" not in c.name))
_FOREST = (
    "id", "revision", "learned", "trained_at", "categories", "parameters", "n_clips", "window_lengths", "n_learned",
)  # fmt: skip

LABELS = _seal(schema.clips, Message("library_damage.labels"), _LABELS, "label_checksum")
"""Seal of the columns of a clip that a search returns."""
NUMBERS = _seal(schema.clips, Message("library_damage.numbers"), _NUMBERS)
"""Seal of the rest of its row: file, length, height."""
FEATURES = _seal(schema.clip_features, Message("library_damage.features"), ("clip_id", "feature_set", "pose_features"))
"""Seal of the features, in or outside the row: see ``dousa.library.store.fragments``."""
POSES = _seal(schema.clip_poses, Message("library_damage.poses"))
LEAVES = _seal(schema.clip_leaves, Message("library_damage.leaves"))
RELATIONS = _seal(schema.clip_relations, Message("library_damage.relations"))
SEGMENTS = _seal(schema.segments, Message("library_damage.segment"))
ANNOTATIONS = _seal(schema.take_annotations, Message("library_damage.annotation"))
FOREST = _seal(schema.forests, Message("library_damage.forest"), _FOREST)
PART_FORESTS = _seal(
    schema.part_forests,
    Message("library_damage.part_forest"),
    ("feature_set", "learned_from", "clip_ids", "leaves", "poses"),
)
EXAMPLES = _seal(schema.leaf_examples, Message("library_damage.examples"))
STATE = _seal(schema.library_state, Message("library_damage.state"))
TAGS = _seal(schema.clip_tags, Message("library_damage.tags"))
SEARCHES = _seal(schema.saved_searches, Message("library_damage.search"))
JOURNAL = _seal(schema.journal, Message("library_damage.journal"))
REMOVED = _seal(schema.removed_clips, Message("library_damage.removed"))
STORE = _seal(schema.array_store, Message("library_damage.store"))

SEALS = (
    LABELS, NUMBERS, FEATURES, POSES, LEAVES, RELATIONS, SEGMENTS, ANNOTATIONS, FOREST, PART_FORESTS, EXAMPLES,
    STATE, TAGS, SEARCHES, JOURNAL, REMOVED, STORE,
)  # fmt: skip
POSITIONS = Message("library_damage.positions")


def seal_positions(number: int, data: bytes, first_block: int = 0) -> bytes:
    """Compute the checksums of the blocks of a clip's positions, ``block_checksums``, from a given block on."""
    size = BLOCK_FRAMES * schema.FRAME_BYTES
    sums = [
        zlib.crc32(data[start : start + size], zlib.crc32(b"%d:%d:" % (number, first_block + block)))
        for block, start in enumerate(range(0, len(data), size))
    ]
    return np.array(sums, "<u4").tobytes()


def damaged(connection: sa.Connection, what: Message, number: int | None = None) -> LibraryDamagedError:
    """Return the error for something damaged, of a clip if there is a number."""
    library = connection.get_execution_options().get(LIBRARY_NAME, "")
    if number is None:
        return LibraryDamagedError("library_damage.part", library=library, what=what)
    path = connection.execute(sa.select(schema.clips.c.path).where(schema.clips.c.id == number)).scalar_one_or_none()
    return LibraryDamagedError("library_damage.of_clip", library=library, what=what, number=number, path=path or "?")
