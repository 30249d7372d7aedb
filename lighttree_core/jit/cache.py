"""Compiled kernels on disk: one file for a kernel and the types of its arguments.

A file's name ends in a digest of all that the code in it depends on: the sources of its module and
of what that imports, the types, numba and its settings, the processor. So an edit compiles anew
what can see it and nothing else, and versions of LightTree and of Python share one folder. Files
are written whole or not at all, and what has been damaged since is compiled again. Where nothing
can be written, kernels are compiled in memory.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import logging
import os
import pickle
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

import llvmlite
import numba
import platformdirs
from llvmlite import binding as llvm
from numba.core.caching import _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from .library import Library, is_called, is_missing

log = logging.getLogger("lighttree")

MAX_BYTES = 100 << 20  # of all files; the longest unused are removed first
MAX_AGE_S = 30 * 24 * 3600.0  # since a file was last used
SUFFIX = ".kernel"
# Where Pythons, that of a Blender too, keep modules that are no part of a checkout.
_STANDARD_LIBRARY, _INSTALLED = sysconfig.get_path("stdlib"), {"site-packages", "dist-packages"}
DIGEST_BYTES = 32


@functools.cache
def cache_folder() -> Path | None:
    """The user's folder for compiled kernels, or None if nothing can be kept there."""
    try:
        folder = Path(platformdirs.user_cache_dir("lighttree", appauthor=False))
        if not folder.is_absolute():
            raise OSError("this user has no home folder")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(4096))
    except (OSError, RuntimeError) as error:  # the latter of a user whom the system does not know
        log.warning("Compiled kernels cannot be kept (%s): they are compiled at each start", error)
        return None
    return folder


def remove_old_kernels() -> None:
    """Remove the files of kernels that have not been used for long, or are too much in all."""
    folder = cache_folder()
    if folder is None:
        return
    files, total, oldest = [], 0, time.time() - MAX_AGE_S
    for path in folder.iterdir():
        try:
            status = path.stat()
        except OSError:
            continue  # removed by another process
        if path.is_file():
            files.append((status.st_mtime, status.st_size, path))
    for modified, size, path in sorted(files, key=lambda file: file[0], reverse=True):
        total += size
        if modified < oldest or total > MAX_BYTES:
            path.unlink(missing_ok=True)


@functools.cache
def _imports(name: str) -> frozenset[str]:
    """Modules that it imports, but for those of Python and of installed packages other than ours.

    Imports within functions do not count: kernels have none.
    """
    module = sys.modules[name]
    is_package = hasattr(module, "__path__")
    package = name if is_package else name.rpartition(".")[0]
    found = set()
    for node in ast.parse(_source(name)).body:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.rsplit(".", node.level - 1)[0] if node.level else ""
            base = ".".join(part for part in (above, node.module) if part)
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        else:
            continue
        found.update(filter(_is_own, names))
    return frozenset(found)


def _is_own(name: str) -> bool:
    """Whether there is such a module, and it is LightTree's or nowhere among what is installed."""
    if name not in sys.modules:
        return False
    if name.partition(".")[0] == __name__.partition(".")[0]:
        return True
    file = getattr(sys.modules[name], "__file__", None) or ""
    is_installed = file.startswith(_STANDARD_LIBRARY) or not _INSTALLED.isdisjoint(Path(file).parts)
    return file.endswith(".py") and not is_installed


def read_sources(name: str) -> None:
    """Read the sources of LightTree's modules, and of others beside one that is being imported.

    At once, lest they be edited before a digest is made of them, and not be what is compiled.
    """
    roots = __name__.partition(".")[0], name.partition(".")[0]
    for known in list(sys.modules):
        if known.partition(".")[0] in roots:
            _source(known)


@functools.cache
def _source(name: str) -> bytes:
    file = getattr(sys.modules[name], "__file__", None)
    return Path(file).read_bytes() if file else b""


@functools.cache
def sources_digest(name: str) -> str:
    """A digest of the sources of a module and of all that it imports, however far away."""
    names, todo = set(), [name]
    while todo:
        name = todo.pop()
        if name not in names:
            names.add(name)
            todo += _imports(name)
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(name.encode() + b"\0" + _source(name) + b"\0")
    return digest.hexdigest()


@functools.cache
def compiler_digest() -> str:
    """A digest of what compiles, of its settings, and of what it compiles for."""
    versions = sys.implementation.cache_tag, numba.__version__, llvmlite.__version__
    target = llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features()
    settings = numba.config.BOUNDSCHECK, numba.config.CPU_NAME, numba.config.CPU_FEATURES
    told = repr((versions, target[0], target[1], target[2].flatten(), settings))
    return hashlib.sha256(told.encode()).hexdigest()


class KernelCache(_Cache):
    """The files of one kernel, for `numba`'s dispatchers."""

    def __init__(self, dispatcher):
        self._dispatcher, self._enabled = dispatcher, True

    @property
    def cache_path(self) -> str:
        return str(cache_folder())

    def enable(self) -> None:
        self._enabled = True

    def disable(self) -> None:
        self._enabled = False

    def flush(self) -> None:
        """Nothing: no file is ever out of date."""

    def load_overload(self, sig, target_context):
        """The compiled kernel for the types of its arguments, or None."""
        path = self._path(sig)
        if path is None:
            return None
        target_context.refresh()
        try:
            data = path.read_bytes()
        except OSError:
            return None
        try:
            digest, body = data[:DIGEST_BYTES], data[DIGEST_BYTES:]
            if hashlib.sha256(body).digest() != digest:
                raise ValueError("it does not have the digest it was written with")
            result = _rebuild(target_context, self._dispatcher.inlined, pickle.loads(body))
            os.utime(path)
        except Exception as error:
            log.warning("%s is damaged and will be compiled again: %s", path, error)
            return None
        return result

    def save_overload(self, sig, data) -> None:
        """Keep a compiled kernel."""
        path = self._path(sig)
        if path is None or data.library.has_dynamic_globals:
            return
        try:
            body = dumps(_reduce(data))
            _write(path, hashlib.sha256(body).digest() + body)
        except LookupError:
            return  # it calls a kernel that is local to a function
        except OSError as error:
            _warn_unwritable(str(error))

    @functools.cached_property
    def kernel_digest(self) -> str:
        """A digest of all that the kernel's code depends on but the types of its arguments."""
        function = self._dispatcher.py_func
        code = function.__code__
        cells = [cell.cell_contents for cell in function.__closure__ or ()]
        try:
            kept = cells and dumps(cells)
        except Exception:  # it holds what cannot be pickled, so it will not be found again
            kept = os.urandom(8)
        depends_on = (
            sources_digest(function.__module__),
            compiler_digest(),
            self._dispatcher.targetoptions,
            code.co_firstlineno,
            code.co_code,
            kept,
        )
        return hashlib.sha256(repr(depends_on).encode()).hexdigest()

    def _path(self, types) -> Path | None:
        """The file for the types of the arguments; None if there is none."""
        folder, function = cache_folder(), self._dispatcher.py_func
        if folder is None or not self._enabled or function.__module__ == "__main__":
            return None
        digest = hashlib.sha256(f"{self.kernel_digest} {types}".encode()).hexdigest()[:24]
        name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
        return folder / f"{name[-100:]}-{digest}{SUFFIX}"


@functools.cache
def _warn_unwritable(error: str) -> None:
    log.warning("A compiled kernel could not be kept: %s", error)


def _write(path: Path, data: bytes) -> None:
    """Write a file whole, or leave none."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix="writing-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _reduce(result: CompileResult) -> tuple:
    """A compiled kernel as what can be pickled; raises LookupError for what cannot be kept."""
    library, description = result.library, result.fndesc
    module = library._final_module
    if library.inlined:
        code, callees = module.as_bitcode(), library.callees
    else:
        symbols = [*module.functions, *module.global_variables]
        defined = [symbol.name for symbol in symbols if not symbol.is_declaration]
        needed = [symbol.name for symbol in module.functions if is_missing(symbol)]
        code = library._get_compiled_object(), defined, needed
        callees = list(filter(is_called, library.find_callees()))
    description.typemap = description.calltypes = None  # large, and of no use any more
    return (
        code,
        [_reference(callee) for callee in callees],
        description,
        result.environment,
        result.signature,
        result.reload_init,
        library.source,
    )


def _reference(library) -> tuple:
    """By what the library of a callee is found again: its kernel and types, or its code."""
    if isinstance(library, Library):
        module, name, _ = library.source
        if "<locals>" in name or module == "__main__":
            raise LookupError(f"{name} cannot be found again")
        return library.source
    return library.name, library._get_module_for_linking().as_bitcode()


def _rebuild(context, inlined: bool, kept: tuple) -> CompileResult:
    """The compiled kernel that `_reduce` was given."""
    code, references, description, environment, signature, reload_init, source = kept
    for function in reload_init:
        function()
    callees = [_resolve(context, reference) for reference in references]
    library = Library(context.codegen(), description.qualname, inlined, source)
    library.restore(code, callees)
    return CompileResult(
        typing_context=context.typing_context,
        target_context=context,
        entry_point=context.get_executable(library, description, environment),
        typing_error=None,
        type_annotation=None,
        signature=signature,
        objectmode=False,
        lifted=(),
        fndesc=description,
        library=library,
        call_helper=None,
        environment=environment,
        metadata=None,
        reload_init=reload_init,
        referenced_envs=(),
    )


def _resolve(context, reference: tuple):
    """The library of a callee."""
    if len(reference) == 2:
        name, bitcode = reference
        library = JITCodeLibrary(context.codegen(), name)
        library._final_module, library._finalized = llvm.parse_bitcode(bitcode), True
        return library
    module, name, args = reference
    found = sys.modules[module]
    for part in name.split("."):
        found = getattr(found, part)
    dispatcher = found.for_kernels
    dispatcher.compile(args)
    return dispatcher.overloads[args].library
