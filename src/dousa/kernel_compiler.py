"""How Numba compiles the kernels and parts of ``dousa.kernels``, which loads this with the first kernel that runs.

Numba makes each function ready to run by itself: it optimises the function with everything that it calls, and makes
machine code and a wrapper for Python. A function that only other compiled functions call needs none of this: what
calls it is optimised with it in any case. Such a part is half as long to compile; and as no other kernel shares its
code, what the kernel does not use is dropped: arguments that no part reads, as most of an array's, are not passed.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from typing import Any

from llvmlite.binding import Linkage
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack
from numba.core.types import unliteral
from numba.core.types.functions import BaseFunction
from numba.np import linalg


def _load_arrays() -> None:
    """Load what Numba knows of arrays, but not SciPy, of which it wants to see that it is there.

    That is a third of loading Numba; code that multiplies matrices looks again when it is compiled.
    """
    check, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = check


def _remember_types() -> None:
    """Let Numba remember which types its own functions return for which: it asks ten times for each answer.

    Each time it would try some ten overloads, half of the work on types. Answers hold for one set of options, as an
    overload is compiled for those that asked last.
    """
    functions: Any = BaseFunction
    find = functions.get_call_type

    def get_call_type(self: Any, context: Any, args: Any, named: Any) -> Any:
        flags = ConfigStack.top_or_none()
        options = context, flags and (flags.nrt, flags.error_model, frozenset(flags.fastmath.flags))
        if vars(self).get("asked_with") != options:
            self.asked_with, self.answers = options, {}
        answers, asked = self.answers, (args, tuple(named.items()))
        if asked not in answers:
            answers[asked] = find(self, context, args, named)
        return answers[asked]

    functions.get_call_type = get_call_type


_load_arrays()
_remember_types()


def _options(allocates: bool, fastmath: Any) -> dict[str, Any]:
    kept = {"nopython": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    return {**kept, "_nrt": allocates, "fastmath": fastmath}


class _PartLibrary(JITCodeLibrary):
    """The code of a part: neither optimised nor made to run, and apart from what it calls until a kernel takes both."""

    def add_llvm_module(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout
        self._final_module.link_in(ll_module)

    def finalize(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def list_called(self) -> dict[Any, None]:
        """Return the libraries that the code needs, each once."""
        called: dict[Any, None] = {}
        for library in self._linking_libraries:
            called[library] = None
            if type(library) is _PartLibrary:
                called.update(library.list_called())
        return called

    def link_called(self, module: Any) -> None:
        """Add the code that is called."""
        for library in self.list_called():
            self._reload_init.update(library._reload_init)
            module.link_in(JITCodeLibrary._get_module_for_linking(library), preserve=True)

    def _get_module_for_linking(self) -> Any:
        raise TypeError("a part is compiled into kernels alone: make what calls it a kernel")


class _KernelLibrary(_PartLibrary):
    """The code of a kernel: its parts become its own, so that LLVM drops what of them and their arguments is not used.

    They get names of their own, by which no other code takes them for the functions that they were before. Numba's
    first round of optimising prepares the removal of counts of references.
    """

    counts = False

    def finalize(self) -> None:
        self.link_called(self._final_module)
        for function in self._final_module.functions:
            mangled = function.name.startswith("_ZN")  # the others count references, and Numba knows them by name
            if mangled and function.linkage == Linkage.linkonce_odr and not function.is_declaration:
                function.linkage, function.name = Linkage.internal, f"part {function.name}"
        if self.counts:
            self._optimize_final_module()
        else:
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)
        self._final_module.verify()
        self._finalize_final_module()

    def _get_module_for_linking(self) -> Any:
        return JITCodeLibrary._get_module_for_linking(self)


class _PartCompiler(Compiler):
    def define_pipelines(self) -> Any:
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), "part")
        self.state.flags.no_compile = True
        return super().define_pipelines()


class _KernelCompiler(Compiler):
    def define_pipelines(self) -> Any:
        self.state.library = _KernelLibrary(self.state.targetctx.codegen(), "kernel")
        self.state.library.counts = bool(self.state.flags.nrt)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class _Part(CPUDispatcher):
    """A function that has no machine code of its own."""

    def add_overload(self, cres: Any) -> None:
        known = cres._replace(entry_point=object())  # by which callers find it
        self.targetctx.insert_user_function(known.entry_point, known.fndesc, [known.library])
        self.overloads[tuple(known.signature.args)] = known

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """One code for all numbers: else Numba would compile it for each constant that is passed."""
        plain = [unliteral(one) for one in args]
        return super().get_call_template(plain, {name: unliteral(one) for name, one in kws.items()})

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__} is a part of kernels: call it from a kernel")


class _Kernel(CPUDispatcher):
    """A function that Python calls."""

    _cache: Any
    under_way: list[str]  # names of the kernels that are being compiled, of which ``dousa.kernels`` knows

    def is_kept(self) -> bool:
        """Tell whether it need not be compiled, as this or another process has done so."""
        file = getattr(self._cache, "_cache_file", None)  # none for a function within another
        return bool(self.overloads) or (file is not None and os.path.exists(file._index_path))

    def compile(self, sig: Any) -> Any:
        """Compile while nothing is collected: of a tenth of the time Python looks through what the compiler keeps."""
        collects, before = gc.isenabled(), len(self.under_way)
        gc.disable()
        if not self.is_kept():
            self.under_way.append(self.py_func.__name__)
        try:
            return super().compile(sig)
        finally:
            del self.under_way[before:]
            if collects:
                gc.enable()


def compile_kernel(function: Callable[..., Any], under_way: list[str], allocates: bool, fastmath: Any) -> Any:
    """Make the dispatcher of a kernel, whose name is in a list while it is compiled."""
    made = _Kernel(function, targetoptions=_options(allocates, fastmath), pipeline_class=_KernelCompiler)
    made.under_way = under_way
    made.enable_caching()
    return made


def compile_part(function: Callable[..., Any], under_way: list[str], allocates: bool, fastmath: Any) -> Any:
    """Make the dispatcher of a part."""
    options = {"no_cpython_wrapper": True, **_options(allocates, fastmath)}
    return _Part(function, targetoptions=options, pipeline_class=_PartCompiler)
