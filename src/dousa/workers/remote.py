"""Code that runs on a worker: portions of tasks, and checks of the worker.

Work and tasks come as bytes, so that each worker unpacks work shared by many portions only once.
"""

from __future__ import annotations

import os
import pickle
import platform
import zlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from importlib import metadata
from threading import Lock
from typing import Any

from dousa.errors import ClusterError
from dousa.workers.threads import limit_blas

_KEPT: OrderedDict[tuple[int, int], Callable[[Any], Any]] = OrderedDict()
_LOCK = Lock()


def list_versions() -> dict[str, str]:
    """Return the versions that the numbers depend on, by name."""
    import dousa

    names = ("numpy", "numba")
    return {
        "dousa": dousa.__version__,
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: metadata.version(name) for name in names},
    }


def check_versions(worker: str, found: dict[str, str], expected: dict[str, str]) -> None:
    """Raise ClusterError where a worker has other versions than the client."""
    for name, version in expected.items():
        if found.get(name) != version:
            raise ClusterError("cluster.versions", worker=worker, name=name, found=found.get(name), expected=version)


def find_hidden(sizes: dict[str, int]) -> str | None:
    """Return the first file that is missing or has another size (bytes)."""
    for path, size in sizes.items():
        try:
            if os.stat(path).st_size != size:
                return path
        except OSError:
            return path
    return None


def run_portion(work: bytes, tasks: bytes, expected: dict[str, str]) -> list[Any]:
    """Compute the answers to a portion of tasks, in their order, from a pickled function and a pickled list.

    ``expected`` : versions of the client; checked here because workers may join later.
    """
    check_versions(platform.node(), list_versions(), expected)
    function = _unpack(work)
    with limit_blas():
        return [function(task) for task in pickle.loads(tasks)]


def _unpack(work: bytes, most_kept: int = 2) -> Callable[[Any], Any]:
    """Unpickle work, or return it where it was unpacked before; the last ``most_kept`` are kept."""
    key = len(work), zlib.crc32(work)
    with _LOCK:
        if key not in _KEPT:
            _KEPT[key] = pickle.loads(work)
            while len(_KEPT) > most_kept:
                _KEPT.popitem(last=False)
        _KEPT.move_to_end(key)
        return _KEPT[key]


def cut(sizes: Sequence[int], most: int, most_bytes: int) -> list[slice]:
    """Cut tasks into portions of at most so many tasks and bytes, in order; one task at least in each."""
    cuts, start, total = [], 0, 0
    for number, size in enumerate(sizes):
        if number > start and (number - start >= most or total + size > most_bytes):
            cuts.append(slice(start, number))
            start, total = number, 0
        total += size
    return [*cuts, slice(start, len(sizes))] if len(sizes) else []
