"""What can be asked about: a file, or a motion in any of the forms that the package knows."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from dousa.library.ingest import ReadOptions, read_canonical

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion

__all__ = ["name_query", "read_query"]


def read_query(query: Any, options: ReadOptions) -> CanonicalMotion:
    """A file or a motion on canonical joints."""
    from dousa.motion import CanonicalMotion, Motion, canonicalise, compute_trajectories

    if isinstance(query, str | os.PathLike):
        return read_canonical(os.fspath(query), options)[0]
    if isinstance(query, CanonicalMotion):
        return query
    trajectories = compute_trajectories(query) if isinstance(query, Motion) else query
    return canonicalise(trajectories, options.joint_map)


def name_query(query: Any) -> str:
    """What the answer calls the query: its path, where it has one."""
    if isinstance(query, str | os.PathLike):
        return os.fspath(query)
    return getattr(getattr(query, "provenance", None), "path", "motion")
