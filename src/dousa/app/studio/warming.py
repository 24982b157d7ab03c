"""What the first question would wait for, done before it is asked."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from dousa.errors import DousaError

if TYPE_CHECKING:
    from dousa.app.studio.studio import Studio

__all__ = ["warm"]


def warm(studio: Studio) -> None:
    """Load kernels, the forest and the index by one search and one pair; a library without a forest has none."""
    from dousa.app.player import encode_pair

    with suppress(DousaError):
        clips = [clip for clip in studio.library.clips() if clip.kind == "clip"]
        if clips:
            motion = studio.library.trajectories(clips[0].id)
            encode_pair(motion, motion)
            studio.library.search(motion, 1)
