"""The cluster in use, if any."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dousa.workers.cluster import Cluster

_CURRENT: ContextVar[Cluster | None] = ContextVar("dousa_cluster", default=None)


def current_cluster() -> Cluster | None:
    """Return the cluster of the enclosing ``use_cluster``."""
    return _CURRENT.get()


@contextmanager
def use_cluster(address: str | None) -> Iterator[Cluster | None]:
    """Let a cluster read and describe files, and grow trees, within the block.

    Results do not depend on it. All writing is done by this process.

    Parameters
    ----------
    address : of the scheduler of Dask, such as ``tcp://scheduler:8786``; None for no cluster.

    Raises
    ------
    ClusterError : there is no scheduler, it has no workers, or these have other versions.
    MissingExtraError : the extra ``dousa[cluster]`` is not installed.
    """
    if address is None:
        yield None
        return
    from dousa.workers.cluster import connect

    with connect(address) as cluster:
        token = _CURRENT.set(cluster)
        try:
            yield cluster
        finally:
            _CURRENT.reset(token)
