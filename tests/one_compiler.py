"""What one worker of the tests compiles, the others read: no kernel is compiled by two of them at the same time."""

import functools
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # elsewhere each compiles for itself
    fcntl = None


def compile_in_turns(folder: Path) -> None:
    """From now on a kernel that is kept in a cache is compiled by whoever comes first; others wait, and find it there.

    The workers begin together and want the same kernels at the same time: the cache alone helps only those who come
    later. ``folder`` is one for all workers, for the files that they lock.
    """
    if fcntl is None:
        return
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    folder.mkdir(exist_ok=True)
    compile_alone = Dispatcher.compile
    held: set[Path] = set()  # by this process: a kernel may call itself

    @functools.wraps(compile_alone)
    def wait_and_compile(kernel: Any, signature: Any) -> Any:
        path = folder / f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}.lock"
        # The lock of the compiler comes first, so that no thread waits for another one with a file in its hands.
        with global_compiler_lock:
            if not kernel._cache.cache_path or path in held:
                return compile_alone(kernel, signature)
            with open(path, "ab") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                held.add(path)
                try:
                    return compile_alone(kernel, signature)
                finally:
                    held.discard(path)

    Dispatcher.compile = wait_and_compile
