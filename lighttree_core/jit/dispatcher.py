"""Compiling one kernel for the types it meets: numba's steps, into our own libraries and cache."""

from __future__ import annotations

import itertools
import os

from numba import types
from numba.core.bytecode import FunctionIdentity
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

from .cache import KernelCache
from .library import Library

OPTIONS = {
    "nopython": True,
    "boundscheck": None,  # by NUMBA_BOUNDSCHECK
    "nogil": True,
    "error_model": "numpy",
    # A product and a sum in one rounding. More would let NaN and infinity pass `isfinite`.
    "fastmath": {"contract"},
}


class Dispatcher(CPUDispatcher):
    """One kernel: compiles it for the types it meets. Literal and 32-bit integers count as int64.

    inlined: whether kernels that call it get a copy of it. Then Python cannot call it.
    """

    def __init__(self, function, *, inlined: bool, allocates: bool):
        self.inlined = inlined
        options = dict(OPTIONS, forceinline=inlined, no_cfunc_wrapper=True)
        if not allocates:
            options["_nrt"] = False  # no reference counts
        if inlined:
            options["no_cpython_wrapper"] = True
        super().__init__(function, targetoptions=options, pipeline_class=_compiler_of(self))
        self._cache = KernelCache(self)

    def get_call_template(self, args, kws):
        return super().get_call_template([_widen(arg) for arg in args], kws)


def _widen(arg: types.Type) -> types.Type:
    """int64 for literal and 32-bit integers, so that a kernel is not compiled for each of them."""
    arg = types.unliteral(arg)
    return types.int64 if arg == types.int32 else arg


# numba tells functions apart by numbers, which in another process stand for others: what is cached
# must not take one of numba's own for another.
FunctionIdentity._unique_ids = itertools.count(int.from_bytes(os.urandom(7), "big"))


def _compiler_of(dispatcher: Dispatcher) -> type[Compiler]:
    """numba's steps, into a Library, under a name that is the same in every process."""

    class KernelCompiler(Compiler):
        def compile_extra(self, function):
            codegen, name = self.state.targetctx.codegen(), function.__qualname__
            source = function.__module__, name, tuple(self.state.args)
            self.state.library = Library(codegen, name, dispatcher.inlined, source)
            return super().compile_extra(function)

        def _compile_bytecode(self):
            identity = self.state.func_id
            identity.unique_id = dispatcher._cache.kernel_digest[:16]
            identity.unique_name = f"{identity.func_qualname}${identity.unique_id}"
            return super()._compile_bytecode()

    return KernelCompiler
