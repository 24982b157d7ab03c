"""Parts of kernels, run by themselves."""

from functools import cache

from numba import njit


@cache
def run_part(part):
    """Return a function for Python that calls a part of `dousa.kernels`."""

    @njit(error_model="numpy")
    def call(*arguments):
        return part(*arguments)

    return call
