"""Takes whose windows can be looked at, and how those are described that no library keeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dousa.formats.motion_files import ReadOptions, Skipped
from dousa.library.features import StoredMotion
from dousa.library.forests import StoredForest
from dousa.library.takes.kept_windows import describe_windows
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.retrieval.takes.windows import TakeWindows, WindowGrid


@dataclass(frozen=True, slots=True, eq=False)
class ReadTake:
    """A take whose windows can be looked at.

    Parameters
    ----------
    path : its file.
    clip_id : its number in the library, None for a file that is not there.
    read : gives its windows; of many takes not all are in memory at a time.
    stored : that forest: the present one, or one for the joints that take and query have in common.
    motion : of a take that is not in the library.
    notes : what came up when its file was read, if that was done just now.
    """

    path: str
    clip_id: int | None
    read: Callable[[], TakeWindows]
    stored: StoredForest
    motion: StoredMotion | None = None
    notes: tuple[Message, ...] = ()


@dataclass(frozen=True, slots=True)
class Describing:
    """How takes are described that are not kept.

    Parameters
    ----------
    stored : the forest of the library.
    choose : gives the forest for a body that lacks some joints, and the grid of its windows; or None, and why.
    options : what is said about files.
    n_jobs : parts described at a time.
    """

    stored: StoredForest
    choose: Callable[[Sequence[str]], tuple[tuple[StoredForest, WindowGrid] | None, Message | None]]
    options: ReadOptions
    n_jobs: int | None

    def describe(
        self, path: str, clip_id: int | None, motion: StoredMotion, notes: tuple[Message, ...] = ()
    ) -> ReadTake | Skipped:
        """A recording with its windows, or why it has none."""
        chosen, why = self.choose(motion.absent)
        if chosen is None:
            assert why is not None
            return Skipped(path, why)
        stored, grid = chosen
        kept = motion if clip_id is None else None
        windows = describe_windows(stored, motion, self.n_jobs, grid)
        return ReadTake(path, clip_id, lambda: windows, stored, kept, notes)
