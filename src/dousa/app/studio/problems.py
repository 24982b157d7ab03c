"""What the studio answers when something cannot be done: a status and one sentence."""

from __future__ import annotations

import errno

from dousa.errors import (
    DousaError,
    LibraryError,
    LibraryLockedError,
    MissingExtraError,
    NotTrainedError,
    TrainingError,
)

__all__ = ["RefusedError", "describe_disk", "status_of"]

_NO_ROOM = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "your disk quota is used up",
    errno.EFBIG: "files may not grow that large here",
}


class RefusedError(DousaError):
    """A request that the studio does not carry out.

    Parameters
    ----------
    status : of HTTP, 400 to 499.
    problem : what was expected, what came and what to do.
    """

    def __init__(self, status: int, problem: str) -> None:
        self.status = status
        self.problem = problem
        super().__init__(problem)


def status_of(error: DousaError) -> int:
    """The status of HTTP that goes with an error a person can put right."""
    if isinstance(error, RefusedError):
        return error.status
    if any(reason in str(error) for reason in _NO_ROOM.values()):
        return 507
    if isinstance(error, NotTrainedError | TrainingError | LibraryLockedError):
        return 409
    if isinstance(error, LibraryError):
        return 404
    if isinstance(error, MissingExtraError):
        return 501
    return 422


def describe_disk(error: OSError) -> str | None:
    """One sentence where the disk takes no more; None where something else is wrong."""
    reason = _NO_ROOM.get(error.errno or 0)
    if reason is None:
        return None
    return f"{reason}, so this was not kept; free some space and try again"
