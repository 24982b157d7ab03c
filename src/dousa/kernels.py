"""Compiled loops: ``kernel`` for what Python calls, ``part`` for what kernels call.

Both follow NumPy where something is divided by 0, release the interpreter's lock, and count no references: arrays come
as arguments, as compiling ``np.empty`` takes longer than most kernels. ``kernel(allocates=True)`` may make arrays.

Numba is loaded with the first kernel that runs, which takes half a second: a command without kernels does not wait for
it. ``is_worth_compiling`` tells what has a second way of doing the same work.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any, TypeVar, overload

__all__ = ["is_worth_compiling", "kernel", "part"]

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Compiled:
    """A function that becomes a dispatcher of Numba, which it stands for, when it is first called or compiled."""

    def __init__(self, function: Callable[..., Any], made_by: str, *options: Any) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._made_by, self._options = made_by, options

    @functools.cached_property
    def _dispatcher(self) -> Any:
        from dousa import kernel_compiler

        return getattr(kernel_compiler, self._made_by)(self.py_func, *self._options)

    def __call__(self, *args: Any, **named: Any) -> Any:
        return self._dispatcher(*args, **named)

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
def kernel(function: _Function) -> _Function: ...
@overload
def kernel(*, allocates: bool = False, fastmath: Any = False) -> Callable[[_Function], _Function]: ...
def kernel(function: Any = None, *, allocates: bool = False, fastmath: Any = False) -> Any:
    """Compile a function that Python calls; what was compiled is kept for the next process.

    Parameters
    ----------
    allocates : the function, or one that it calls, makes arrays.
    fastmath : as for ``numba.njit``.
    """
    return _make("compile_kernel", function, allocates, fastmath)


@overload
def part(function: _Function) -> _Function: ...
@overload
def part(*, allocates: bool = False, fastmath: Any = False) -> Callable[[_Function], _Function]: ...
def part(function: Any = None, *, allocates: bool = False, fastmath: Any = False) -> Any:
    """Compile a function that kernels and other parts call, as a piece of them; options as for `kernel`."""
    return _make("compile_part", function, allocates, fastmath)


def _make(made_by: str, function: Any, *options: Any) -> Any:
    return _Compiled(function, made_by, *options) if function else lambda made: _Compiled(made, made_by, *options)


_interpreted = [0]


def is_worth_compiling(numbers: int, most: int = 2_500_000) -> bool:
    """Tell whether to call a kernel for work on so many numbers, or to do the same without Numba, more slowly.

    Numba is worth loading as soon as this process has spent as long without it as loading takes: on ``most`` numbers of
    0.2 us each (``python -m lab.benchmarks.first_run``).
    """
    if "numba" in sys.modules or _interpreted[0] + numbers > most:
        return True
    _interpreted[0] += numbers
    return False
