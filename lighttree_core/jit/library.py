"""How kernels are put together: compiled from Python to LLVM one by one, optimized only as a whole.

Left to itself numba optimizes and assembles every function together with all it calls, so each is
worked over once for every function above it. Here an inlined kernel stays as it leaves the type
inference; one that is called by its address takes copies of the inlined ones below it, is optimized
once and assembled.
"""

from __future__ import annotations

from collections.abc import Iterator

from llvmlite import binding as llvm
from numba.core.codegen import JITCodeLibrary

from .table import describe_tables


class Library(JITCodeLibrary):
    """The code of one kernel, and the libraries of what it calls.

    source: the kernel's module, its name there and the types of its arguments, by which the cache
    finds it again.
    """

    def __init__(self, codegen, name: str, inlined: bool, source: tuple):
        super().__init__(codegen, name)
        self.inlined, self.source = inlined, source
        self.enable_object_caching()

    @property
    def codegen(self):
        return _NoEnvironment(self._codegen) if self.inlined else self._codegen

    @property
    def callees(self) -> list:
        """Libraries of what the kernel calls."""
        return self._linking_libraries

    def finalize(self) -> None:
        """Make the code ready: to be copied, or to be run."""
        self._raise_if_finalized()
        if self.inlined:
            self._finalize_dynamic_globals()
            self._finalized = True
            return
        for library in self.find_callees():
            if not is_called(library):
                self._reload_init.update(library._reload_init)
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._optimize_final_module()
        self._final_module.verify()
        self._finalize_final_module()

    def add_ir_module(self, ir_module) -> None:
        for function in ir_module.functions:
            describe_tables(function)
        super().add_ir_module(ir_module)

    def find_callees(self) -> Iterator[JITCodeLibrary]:
        """Each library that is copied into this one, and those whose machine code it jumps to."""
        seen, todo = set(), list(self.callees)
        while todo:
            library = todo.pop()
            if library in seen:
                continue
            seen.add(library)
            if isinstance(library, Library) and library.inlined:
                todo += library.callees
            yield library

    def restore(self, code, callees: list) -> None:
        """Make a library of code that was kept.

        code: bitcode, or (machine code, names that it defines, names of kernels that it calls).
        """
        self._linking_libraries += callees
        if self.inlined:
            self._final_module, self._finalized = llvm.parse_bitcode(code), True
            return
        machine_code, defined, needed = code
        engine = self._codegen._engine
        if missing := [name for name in needed if not engine.is_symbol_defined(name)]:
            raise LookupError(f"it calls {missing[0]}, which there is not")
        self._set_compiled_object(machine_code)
        self._finalize_final_module()
        engine._defined_symbols.update(defined)

    def get_pointer_to_function(self, name: str) -> int:
        return 0 if self.inlined else super().get_pointer_to_function(name)


def is_called(library) -> bool:
    """Whether a library is a kernel's that is called, and not copied into others."""
    return isinstance(library, Library) and not library.inlined


def is_missing(function) -> bool:
    """Whether a function of a module is a kernel's that is defined elsewhere."""
    return function.is_declaration and function.name.startswith("_ZN")


class _NoEnvironment:
    """A code generator for what has no machine code, so no place for its environment."""

    def __init__(self, codegen):
        self._codegen = codegen

    def __getattr__(self, name):
        return getattr(self._codegen, name)

    def set_env(self, name, environment):
        """Nothing: only code that uses Python objects looks for an environment."""
