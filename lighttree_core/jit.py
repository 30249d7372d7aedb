"""The one way LightTree compiles a kernel, and the float32 constants that kernels use.

numba promotes `x * 0.5` to float64, so kernels take their constants from here. Compiled kernels
are cached per user, in a folder keyed by the package's sources: numba itself does not notice an
edit to a function that a cached kernel calls.
"""

import functools
import hashlib
import os
import sys
import tempfile
import threading
from pathlib import Path

import numba
import numpy as np
from numba.extending import typeof_impl

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


def _user_cache_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData/Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library/Caches"
    folder = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return folder if folder.is_absolute() else Path.home() / ".cache"  # as its specification says


def _sources_hash() -> str:
    package = Path(__file__).parent
    # numba would run cached kernels without bounds checks where these are asked for.
    digest = hashlib.sha256(str(numba.config.BOUNDSCHECK).encode())
    for source in sorted(package.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """The user's folder for these sources, or a private one that lasts as long as this machine."""
    folder = _user_cache_folder() / "lighttree" / _sources_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass  # a home that cannot be written to
    return Path(tempfile.mkdtemp(prefix="lighttree-")) / folder.name


CACHE_FOLDER = _cache_folder()
_cache_dir_lock = threading.Lock()
# numba keeps the kernels of each Python, and of each of its own versions, apart.
_ALL_COMPILED = CACHE_FOLDER / f"compiled-{sys.implementation.cache_tag}-{numba.__version__}"


def are_kernels_compiled() -> bool:
    """Whether a render has gone through since the sources changed, so all kernels are cached."""
    return _ALL_COMPILED.exists()


def note_kernels_compiled() -> None:
    """Remember that a render has gone through."""
    if not numba.config.DISABLE_JIT:
        CACHE_FOLDER.mkdir(parents=True, exist_ok=True)
        _ALL_COMPILED.touch()


def _compile(function, folder=CACHE_FOLDER, **options):
    # Other users of numba in this process keep their own cache folder. Threads that take turns at
    # this would leave each other's folder behind, or none: kernels would be cached wherever one is.
    with _cache_dir_lock:
        previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
        try:
            return numba.njit(
                nogil=True,
                cache=True,
                error_model="numpy",
                fastmath={"contract"},
                **options,
            )(function)
        finally:
            numba.config.CACHE_DIR = previous


class Kernel:
    """A compiled function, with a way in from Python only if Python calls it.

    That way unpacks all tables that come as arguments, and took most of the time to compile a
    function that other kernels alone call.
    """

    def __init__(self, function):
        self.function = function
        self.for_kernels = _compile(
            function,
            CACHE_FOLDER / "for_kernels",
            _nrt=False,
            forceinline=True,
            no_cpython_wrapper=True,
            no_cfunc_wrapper=True,
        )
        functools.update_wrapper(self, function)

    @functools.cached_property
    def for_python(self):
        return _compile(self.function, _nrt=False)

    def __call__(self, *args):
        return self.for_python(*args)


@typeof_impl.register(Kernel)
def _type_of_kernel(kernel, context):
    return typeof_impl(kernel.for_kernels, context)


def kernel(function):
    """Compile a function for use without the GIL, cached on disk, with IEEE division.

    A kernel allocates nothing, so it is compiled without reference counts, and whole tables pass
    from function to function, so all are inlined: shading a path took 47 us with counts and calls,
    10 us without counts, 3 us without either. Of fastmath only `contract`, which adds a product in
    one rounding; more would let NaN and infinity pass `isfinite`.
    """
    return function if numba.config.DISABLE_JIT else Kernel(function)


def allocating_kernel(function):
    """The same for the few functions that allocate arrays."""
    return _compile(function)
