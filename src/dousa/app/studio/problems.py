"""What the studio answers when something cannot be done: a status and one sentence."""

from __future__ import annotations

from dousa.errors import (
    DousaError,
    LibraryError,
    LibraryLockedError,
    MissingExtraError,
    NotTrainedError,
    TrainingError,
)

__all__ = ["RefusedError", "status_of"]


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
    if isinstance(error, NotTrainedError | TrainingError | LibraryLockedError):
        return 409
    if isinstance(error, LibraryError):
        return 404
    if isinstance(error, MissingExtraError):
        return 501
    return 422
