"""Small pieces of work side by side, in threads: a few of them at a time, as handing one over costs time too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

_One = TypeVar("_One")
_Answer = TypeVar("_Answer")

_AT_A_TIME = 16
"""Pieces that a thread does before it asks for more: handing over takes as long as half of a segment of a take."""


def map_pieces(
    work: Callable[[_One], _Answer], pieces: Sequence[_One], n_jobs: int | None = None, at_a_time: int = _AT_A_TIME
) -> list[_Answer]:
    """The answers to all pieces, in their order.

    Parameters
    ----------
    work : called with one piece; compiled loops, transforms and linear algebra run side by side, Python does not.
    pieces : what to do.
    n_jobs : threads as for joblib: with None one, unless ``joblib.parallel_config`` says otherwise.
    at_a_time : pieces that a thread does before it asks for more.

    Raises
    ------
    Whatever the work raises first.
    """
    from joblib import Parallel, delayed, effective_n_jobs

    if len(pieces) <= at_a_time or effective_n_jobs(n_jobs) == 1:
        return [work(piece) for piece in pieces]

    def do_some(some: Sequence[_One]) -> list[_Answer]:
        return [work(piece) for piece in some]

    parts = (pieces[first : first + at_a_time] for first in range(0, len(pieces), at_a_time))
    done = Parallel(n_jobs=n_jobs, prefer="threads")(delayed(do_some)(part) for part in parts)
    return [answer for some in done for answer in some]
