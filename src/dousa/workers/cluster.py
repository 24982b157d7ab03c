"""A cluster of workers behind a scheduler of Dask.

A portion of work is a task of Dask, repeated elsewhere when its worker dies. Few portions wait at a time, to limit
memory; answers come in the order of the tasks, so that results do not depend on the number of workers.
"""

from __future__ import annotations

import logging
import os
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from dousa.errors import ClusterError, OptionError
from dousa.extras import require
from dousa.workers.remote import check_versions, cut, find_hidden, list_versions, run_portion

_Task = TypeVar("_Task")
_Answer = TypeVar("_Answer")


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Workers that are ready: ``address`` of the scheduler, ``client`` of Dask."""

    address: str
    client: Any

    @property
    def n_threads(self) -> int:
        """Number of portions worked on at a time."""
        return sum(int(worker["nthreads"]) for worker in self._workers().values())

    def _workers(self) -> dict[str, Any]:
        workers: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
        return workers

    def check_paths(self, paths: Sequence[str | os.PathLike[str]], n_checked: int = 100) -> None:
        """Raise ClusterError where a worker cannot see the files to read; about so many of them are checked."""
        step = max(1, len(paths) // n_checked)
        sizes = {os.fspath(path): os.path.getsize(path) for path in paths[::step] if os.path.isfile(path)}
        for worker, hidden in self.client.run(find_hidden, sizes).items():
            if hidden is not None:
                raise ClusterError("cluster.hidden", worker=worker, path=hidden)

    def map(
        self,
        work: Callable[[_Task], _Answer],
        tasks: Sequence[_Task],
        *,
        most: int = 64,
        sizes: Sequence[int] | None = None,
        most_bytes: int = 1 << 23,
    ) -> Generator[_Answer, None, None]:
        """Yield answers in the order of the tasks.

        Parameters
        ----------
        work : function of one task, without side effects, as it may run twice.
        tasks : any number.
        most : tasks in a portion.
        sizes : bytes that each task reads or carries; None for few.
        most_bytes : of these in a portion; more leave workers idle at the end, fewer take more messages.

        Raises
        ------
        ClusterError : the scheduler is gone, all workers are, or they die of the same tasks.
        """
        import cloudpickle

        shared = _Shared(self, cloudpickle.dumps(work))
        portions = cut([0] * len(tasks) if sizes is None else sizes, most, most_bytes)
        ahead = 2 * max(self.n_threads, 1) + 2
        waiting: deque[_Portion] = deque()
        coming = iter(portions)
        try:
            while True:
                while len(waiting) < ahead and (portion := next(coming, None)) is not None:
                    waiting.append(_Portion(self, shared, cloudpickle.dumps(list(tasks[portion]))))
                if not waiting:
                    return
                yield from waiting.popleft().finish()
        finally:
            for left in waiting:
                left.cancel()

    def wait(self, future: Any, patience: float = 60.0, turn: float = 2.0) -> Any:
        """Return the result of a future; ClusterError if no worker is left.

        Parameters
        ----------
        future : of Dask.
        patience : s to wait for workers to come back when all are gone.
        turn : s between two looks at whether there are workers.
        """
        alone_since = None
        while True:
            try:
                return future.result(timeout=turn)
            except TimeoutError:
                if future.status == "error":
                    raise  # the work's own
            if self.client.status != "running":
                raise ClusterError("cluster.lost", address=self.address)
            now = time.monotonic()
            alone_since = None if self._workers() else alone_since or now
            if alone_since is not None and now - alone_since > patience:
                raise ClusterError("cluster.no_workers", address=self.address)


class _Shared:
    """Work shared by all portions, stored on the workers."""

    def __init__(self, cluster: Cluster, work: bytes) -> None:
        self._cluster, self._work = cluster, work
        self._held: Any = None

    def hold(self, again: bool = False) -> Any:
        """Return the work, or a reference to it on the workers."""
        if self._held is None or again:
            self._held = _send(self._cluster.client, self._work, broadcast=True)
        return self._held


def _send(client: Any, data: bytes, *, broadcast: bool = False, inline: int = 1 << 18) -> Any:
    """Return data of up to ``inline`` bytes; scatter larger ones to the workers, and return the reference to them."""
    return data if len(data) <= inline else client.scatter(data, broadcast=broadcast, hash=False)


class _Portion:
    """Some tasks sent to a worker."""

    def __init__(self, cluster: Cluster, shared: _Shared, tasks: bytes) -> None:
        self._cluster, self._shared, self._tasks = cluster, shared, tasks
        self._future = self._submit()

    def _submit(self, again: bool = False) -> Any:
        client = self._cluster.client
        given = _send(client, self._tasks)
        return client.submit(run_portion, self._shared.hold(again), given, list_versions(), pure=False)

    def finish(self, attempts: int = 5) -> list[Any]:
        """Wait for the answers; so many attempts are made where data are lost with their workers."""
        from concurrent.futures import CancelledError

        from distributed.scheduler import KilledWorker

        for attempt in range(attempts):
            try:
                answers: list[Any] = self._cluster.wait(self._future)
                return answers
            except KilledWorker as error:
                raise ClusterError("cluster.killed", address=self._cluster.address) from error
            except CancelledError:  # data that were handed out were lost with a worker
                if self._cluster.client.status != "running":
                    break
                self._future = self._submit(again=attempt > 0)
        raise ClusterError("cluster.lost", address=self._cluster.address)

    def cancel(self) -> None:
        self._future.cancel()


@contextmanager
def connect(address: str, *, timeout: float = 10.0) -> Iterator[Cluster]:
    """Connect to the cluster of a scheduler, within so many s, and check its workers; see ``use_cluster``."""
    distributed = require("distributed", "cluster")
    if "://" not in address:
        raise OptionError("cluster.address", address=address)
    for name in ("distributed", "tornado"):  # its warnings are raised as errors, or do not matter
        logging.getLogger(name).setLevel(logging.CRITICAL)
    client = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of other versions: they are compared below
        try:
            client = distributed.Client(address, timeout=timeout, set_as_default=False)
        except (OSError, ValueError, RuntimeError) as error:
            raise ClusterError("cluster.unreachable", address=address, reason=_shorten(error)) from error
    try:
        cluster = Cluster(address, client)
        _check_workers(cluster)
        yield cluster
    finally:
        client.close(timeout=timeout)


def _shorten(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _check_workers(cluster: Cluster) -> None:
    """Raise ClusterError if there are no workers, or some with other versions."""
    try:
        found = cluster.client.run(list_versions, on_error="return")
    except (OSError, ValueError) as error:
        raise ClusterError("cluster.unreachable", address=cluster.address, reason=_shorten(error)) from error
    if not found:
        raise ClusterError("cluster.no_workers", address=cluster.address)
    expected = list_versions()
    for worker, versions in found.items():
        if not isinstance(versions, dict):
            raise ClusterError("cluster.not_ours", worker=worker, reason=_shorten(versions))
        check_versions(worker, versions, expected)
