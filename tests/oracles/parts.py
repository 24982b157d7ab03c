"""Parts of kernels, run by themselves."""

from functools import cache

from numba.core.caching import NullCache

from dousa.kernel_compiler import compile_kernel


@cache
def run_part(part):
    """Return a function for Python that calls a part of `dousa.kernels`."""

    def call(*arguments):
        return part(*arguments)

    run = compile_kernel(call, [], True, False)
    run._cache = NullCache()  # a part that was changed would not be noticed
    return run
