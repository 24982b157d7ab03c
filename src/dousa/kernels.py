"""Compiled loops: ``kernel`` for what Python calls, ``part`` for what kernels call.

Both follow NumPy where something is divided by 0, release the interpreter's lock, and count no references: arrays come
as arguments, as compiling ``np.empty`` takes longer than most kernels. ``kernel(allocates=True)`` may make arrays.

Numba is loaded with the first kernel that runs, which takes half a second, and compiles it, which takes about as long:
a small command does not wait for either. Small work of kernels that are ``linear`` is interpreted, with the same result
bit for bit, and ``is_worth_compiling`` tells the same to what has a second way of doing its work.
"""

from __future__ import annotations

import functools
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, overload

import numpy as np

under_way: list[str] = []
"""Names of the kernels that are being compiled now, which none has been before: for those who wait."""


class _Effort:
    """What this process does without compiled code, in numbers of 0.2 us each (``python -m lab.benchmarks.first_run``).

    ``most`` of all before Numba is loaded, and of each kernel that no process has compiled: as long as that takes.
    """

    most = 2_000_000
    spent = 0


class _Depth(threading.local):
    """Whether a kernel of a thread is being interpreted."""

    interpreting = False


_depth = _Depth()
_one_at_a_time = threading.Lock()


def is_worth_compiling(numbers: int) -> bool:
    """Tell whether to call a kernel for work on so many numbers, or to do the same without Numba, more slowly."""
    if "numba" in sys.modules or _Effort.spent + numbers > _Effort.most:
        return True
    _Effort.spent += numbers
    return False


def load_compiler() -> None:
    """Load Numba for work that needs it in any case: what was compiled before is then not interpreted."""
    import numba  # noqa: F401


def compile_always() -> None:
    """Interpret nothing from now on: for tests of what is compiled."""
    _Effort.most = _Effort.spent = 0


class _Compiled:
    """A function that becomes a dispatcher of Numba, which it stands for, when it is first called or compiled."""

    def __init__(self, function: Callable[..., Any], made_by: str, linear: bool, *options: Any) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._made_by, self._options = made_by, options
        self._left = _Effort.most if linear else 0

    @functools.cached_property
    def _dispatcher(self) -> Any:
        from dousa import kernel_compiler

        with _one_at_a_time:  # else two threads would compile it
            if "_dispatcher" not in vars(self):
                self._dispatcher = getattr(kernel_compiler, self._made_by)(self.py_func, under_way, *self._options)
        return vars(self)["_dispatcher"]

    def __call__(self, *args: Any, **named: Any) -> Any:
        if _depth.interpreting:  # as the kernel that calls it
            return self.py_func(*args, **named)
        if not self._left or not self.is_interpreted(args):
            return self._dispatcher(*args, **named)
        _depth.interpreting = True
        started = time.thread_time()
        try:
            with np.errstate(all="ignore"):  # as in compiled code
                return self.py_func(*args, **named)
        finally:
            _depth.interpreting = False
            numbers = round((time.thread_time() - started) / 2e-7)
            _Effort.spent += numbers
            self._left = max(self._left - numbers, 0)

    def is_interpreted(self, args: tuple[Any, ...]) -> bool:
        """Tell whether a call of a kernel is better interpreted."""
        numbers = sum(getattr(one, "size", 1) for one in args)
        if "numba" not in sys.modules:
            return _Effort.spent + numbers <= _Effort.most
        if self._left < numbers or self._dispatcher.is_kept():
            self._left = 0
        return self._left > 0

    def __reduce__(self) -> str:
        return self.py_func.__qualname__

    @property
    def _numba_type_(self) -> Any:  # by which Numba knows it in the code of other kernels
        return self._dispatcher._numba_type_

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._dispatcher, name)


@overload
def kernel(function: Callable[..., Any]) -> Any: ...
@overload
def kernel(
    *, linear: bool = False, allocates: bool = False, fastmath: Any = False
) -> Callable[[Callable[..., Any]], Any]: ...
def kernel(function: Any = None, *, linear: bool = False, allocates: bool = False, fastmath: Any = False) -> Any:
    """Compile a function that Python calls; what was compiled is kept for the next process.

    Parameters
    ----------
    linear : it visits each number of its arrays a few times, so that small work may be interpreted; float32 numbers it
        turns into float64 before it computes with them, as Numba does and NumPy does not.
    allocates : the function, or one that it calls, makes arrays.
    fastmath : as for ``numba.njit``.
    """
    return _make("compile_kernel", function, linear, allocates, fastmath)


@overload
def part(function: Callable[..., Any]) -> Any: ...
@overload
def part(*, allocates: bool = False, fastmath: Any = False) -> Callable[[Callable[..., Any]], Any]: ...
def part(function: Any = None, *, allocates: bool = False, fastmath: Any = False) -> Any:
    """Compile a function that kernels and other parts call, as a piece of them; options as for `kernel`."""
    return _make("compile_part", function, False, allocates, fastmath)


def _make(made_by: str, function: Any, *options: Any) -> Any:
    return _Compiled(function, made_by, *options) if function else lambda made: _Compiled(made, made_by, *options)
