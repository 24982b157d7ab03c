"""The tables of a library, in SQLAlchemy Core and nothing that only one database knows.

``clips`` is small and holds what people ask for; the arrays of a clip stand in tables of their own, so that
listing reads no array, training reads features only, and searching reads histograms only.
"""

from __future__ import annotations

import sqlalchemy as sa

__all__ = [
    "APPLICATION_ID",
    "clip_features",
    "clip_histograms",
    "clip_trajectories",
    "clips",
    "forests",
    "library_state",
    "metadata",
    "migrations",
]

APPLICATION_ID = 0x444F5553
"""``DOUS``: marks an SQLite file as a library of ours."""

metadata = sa.MetaData()

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
)


def _clip_id() -> sa.Column[int]:
    owner = sa.ForeignKey("clips.id", ondelete="CASCADE")
    return sa.Column("clip_id", sa.Integer, owner, primary_key=True, autoincrement=False)


clip_trajectories = sa.Table(
    "clip_trajectories",
    metadata,
    _clip_id(),
    # float32, little endian, (n_frames, 20, 3) m
    sa.Column("positions", sa.LargeBinary, nullable=False),
)

clip_features = sa.Table(
    "clip_features",
    metadata,
    _clip_id(),
    # float64, little endian, (10, 56): not float32, so that a query file meets its own clip at distance 0
    sa.Column("pose_features", sa.LargeBinary, nullable=False),
)

clip_histograms = sa.Table(
    "clip_histograms",
    metadata,
    _clip_id(),
    sa.Column("predicted_category", sa.Text, nullable=False),
    # int32, little endian, (n_categories,) in the order of the forest's categories: trees that name each
    sa.Column("votes", sa.LargeBinary, nullable=False),
    # int32, little endian, (n_trees,): the leaf that the clip reaches in each tree
    sa.Column("leaves", sa.LargeBinary, nullable=False),
)

forests = sa.Table(
    "forests",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
    # Of the library at the end of the training: tells forests apart, and whether clips changed since.
    sa.Column("revision", sa.BigInteger, nullable=False),
    sa.Column("trained_at", sa.Text, nullable=False),
    sa.Column("categories", sa.JSON, nullable=False),
    sa.Column("parameters", sa.JSON, nullable=False),
    sa.Column("n_clips", sa.Integer, nullable=False),
    sa.Column("data", sa.LargeBinary, nullable=False),
)
