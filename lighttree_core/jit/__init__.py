"""The one way LightTree compiles a kernel, and the float32 constants that kernels use.

numba promotes `x * 0.5` to float64, so kernels take their constants from here. How kernels are
compiled is in `dispatcher.py`, how they are put together in `library.py`, where they are kept in
`cache.py`, and the tables that they read in `table.py`.
"""

from __future__ import annotations

import functools
import weakref

import numba
import numpy as np
from numba.extending import typeof_impl

from .cache import read_sources
from .dispatcher import Dispatcher
from .table import f32, f64, flag, i32, i64, table, u8

__all__ = ["f32", "f64", "flag", "i32", "i64", "table", "u8"]

ZERO = np.float32(0)
HALF = np.float32(0.5)
ONE = np.float32(1)
TWO = np.float32(2)
PI = np.float32(np.pi)
INV_PI = np.float32(1 / np.pi)
TWO_PI = np.float32(2 * np.pi)
FAR = np.float32(1e30)  # distance to a light at infinity; its square must not be used
# A float32 result of k roundings is off by at most k * 2^-24 / (1 - k * 2^-24), here for k = 8.
ROUNDING_BOUND = np.float32(8 * 2**-24 / (1 - 8 * 2**-24))


KERNELS: weakref.WeakSet[Kernel] = weakref.WeakSet()


class Kernel:
    """A function compiled for other kernels, and by itself once Python calls it."""

    def __init__(self, function, *, inlined: bool = True, allocates: bool = False):
        self.function, self._allocates, self._entries = function, allocates, {}
        self.for_kernels = Dispatcher(function, inlined=inlined, allocates=allocates)
        functools.update_wrapper(self, function)
        KERNELS.add(self)
        read_sources(function.__module__)

    @functools.cached_property
    def for_python(self) -> Dispatcher:
        """The kernel with a way in from Python."""
        if not self.for_kernels.inlined:
            return self.for_kernels
        return Dispatcher(self.function, inlined=False, allocates=self._allocates)

    def __call__(self, *args):
        # numba looks at every array of every table to find the types of the arguments: 0.1 ms.
        kinds = tuple(map(_kind, args))
        entry = self._entries.get(kinds)
        if entry is None:
            types = tuple(map(numba.typeof, args))
            entry = self._entries[kinds] = self.for_python.compile(types)
        return entry(*args)


def _kind(value):
    """What tells the type of an argument."""
    if type(value) is np.ndarray:
        return value.dtype, value.ndim, value.flags.c_contiguous, value.flags.writeable
    if isinstance(value, tuple) and not hasattr(value, "table_type"):
        return type(value), *map(_kind, value)
    return type(value)


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel, context):
    return typeof_impl(kernel.for_kernels, context)


def kernel(function):
    """Compile a function for use without the GIL, cached on disk, with IEEE division.

    A kernel allocates nothing, so it is compiled without reference counts, and kernels that call it
    get a copy of it: shading a path took 47 us with counts and calls, 10 us without counts, 3 us
    without either.
    """
    return function if numba.config.DISABLE_JIT else Kernel(function)


def called_kernel(function):
    """The same for what is large or rare: compiled once, and called where others get a copy."""
    return function if numba.config.DISABLE_JIT else Kernel(function, inlined=False)


def allocating_kernel(function):
    """The same for the few functions that allocate arrays."""
    return function if numba.config.DISABLE_JIT else Kernel(function, allocates=True)
