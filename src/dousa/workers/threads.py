"""Small pieces of work side by side, in threads: a few of them at a time, as handing one over costs time too.

Threads are those of the standard library: ``joblib.Parallel`` looks every 10 ms whether they are done, which is as long
as some of what is done here. How many there are is asked of joblib.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
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
    from joblib import effective_n_jobs

    n_threads = 1 if len(pieces) <= at_a_time else effective_n_jobs(n_jobs)
    if n_threads == 1:
        return [work(piece) for piece in pieces]

    def do_some(some: Sequence[_One]) -> list[_Answer]:
        return [work(piece) for piece in some]

    parts = [pieces[first : first + at_a_time] for first in range(0, len(pieces), at_a_time)]
    with ThreadPoolExecutor(min(n_threads, len(parts))) as threads:
        return [answer for some in threads.map(do_some, parts) for answer in some]


def map_together(
    work: Callable[[list[_One]], Iterable[_Answer]],
    pieces: Sequence[_One],
    sizes: Sequence[float],
    n_jobs: int | None = None,
    at_a_time: int = _AT_A_TIME,
) -> list[_Answer]:
    """The answers to all pieces, in their order, of work that is cheaper for several of one size together.

    Parameters
    ----------
    work : called with some pieces, of sizes as near to each other as can be; gives an answer to each.
    sizes : of the pieces.
    n_jobs, at_a_time : as for `map_pieces`.
    """
    order = sorted(range(len(pieces)), key=lambda place: sizes[place])
    parts = [order[first : first + at_a_time] for first in range(0, len(order), at_a_time)]
    done = map_pieces(lambda part: list(work([pieces[place] for place in part])), parts, n_jobs, 1)
    answers = dict(zip(order, (answer for some in done for answer in some), strict=True))
    return [answers[place] for place in range(len(pieces))]
