"""Small pieces of work in threads, a few pieces at a time, as handing one over costs time too.

Threads are those of the standard library: ``joblib.Parallel`` polls every 10 ms, as long as some of the work takes.
Their number comes from joblib. While they work, BLAS has one thread (`limit_blas`): its threads and ours would
wait for the same cores, and a thread of BLAS waits by computing.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any, TypeVar

_One = TypeVar("_One")
_Answer = TypeVar("_Answer")

_LIMITS: list[Any] = []  # set since no block was open
_OPEN: list[None] = []  # one for each open block
_LOCK = Lock()


@cache
def _find_blas(with_scipy: bool) -> Any:
    """Find the BLAS of NumPy, and that of SciPy once it is loaded.

    Once each, as looking through the loaded libraries takes half a millisecond.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


@contextmanager
def limit_blas() -> Iterator[None]:
    """Give BLAS one thread within the block, in the whole process; blocks in several threads may overlap.

    Sums of BLAS differ in their last bits with the number of its threads, so with the number of cores.
    """
    with _LOCK:
        _OPEN.append(None)
        _LIMITS.append(_find_blas("scipy.linalg" in sys.modules).limit(limits=1))
    try:
        yield
    finally:
        with _LOCK:
            _OPEN.pop()
            while _LIMITS and not _OPEN:
                _LIMITS.pop().restore_original_limits()


def count_threads(n_jobs: int | None) -> int:
    """Return the number of threads that joblib would use."""
    from joblib import effective_n_jobs

    return int(effective_n_jobs(n_jobs))


def map_pieces(
    work: Callable[[_One], _Answer], pieces: Sequence[_One], n_jobs: int | None = None, at_a_time: int = 16
) -> list[_Answer]:
    """Compute the answers to all pieces, in their order.

    Parameters
    ----------
    work : called with one piece; compiled loops, transforms and linear algebra run in parallel, Python does not.
    pieces : arguments of ``work``.
    n_jobs : threads as for joblib: one for None, unless set by ``joblib.parallel_config``.
    at_a_time : pieces that a thread takes at once: handing over takes as long as half of a segment of a take.

    Raises
    ------
    The first error of ``work``.
    """
    n_threads = 1 if len(pieces) <= at_a_time else count_threads(n_jobs)
    parts = [pieces[first : first + at_a_time] for first in range(0, len(pieces), at_a_time)]

    def do_some(some: Sequence[_One]) -> list[_Answer]:
        return [work(piece) for piece in some]

    with limit_blas():
        if n_threads == 1:
            return do_some(pieces)
        with ThreadPoolExecutor(min(n_threads, len(parts))) as threads:
            return [answer for some in threads.map(do_some, parts) for answer in some]


def yield_answers(
    work: Callable[[_One], _Answer], tasks: Iterable[_One], n_jobs: int | None, **options: Any
) -> Generator[_Answer, None, None]:
    """Compute the answers to tasks by joblib, some ahead of the one that is asked for, and yield them in order.

    Threads are only a preference, so that Dask or Ray can take over; ``options`` are of ``joblib.Parallel``.
    """
    import joblib

    options = {"prefer": "threads", "return_as": "generator", **options}
    with limit_blas():
        answers = joblib.Parallel(n_jobs=n_jobs, **options)(joblib.delayed(work)(task) for task in tasks)
        try:
            for answer in answers:  # noqa: UP028  (yield from would close them before the block below)
                yield answer
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # interrupted: joblib warns about work in vain
                answers.close()


def map_together(
    work: Callable[[list[_One]], Iterable[_Answer]],
    pieces: Sequence[_One],
    sizes: Sequence[float],
    n_jobs: int | None = None,
    at_a_time: int = 16,
) -> list[_Answer]:
    """Compute the answers to all pieces, in their order, for work that is cheaper on several of one size together.

    Parameters
    ----------
    work : called with some pieces of similar sizes; returns an answer to each.
    sizes : of the pieces.
    n_jobs, at_a_time : as for `map_pieces`.
    """
    order = sorted(range(len(pieces)), key=lambda place: sizes[place])
    parts = [order[first : first + at_a_time] for first in range(0, len(order), at_a_time)]
    done = map_pieces(lambda part: list(work([pieces[place] for place in part])), parts, n_jobs, 1)
    answers = dict(zip(order, (answer for some in done for answer in some), strict=True))
    return [answers[place] for place in range(len(pieces))]
