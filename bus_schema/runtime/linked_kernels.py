"""Compilation of kernels that other kernels call: intermediate code, linked into their callers.

By itself numba optimizes each called function, makes machine code and a wrapper for Python of it,
and does all of that again in each caller that it links it into. Only the outermost kernels run.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator
from typing import Any

import numba
from llvmlite.binding import Linkage
from numba.core import codegen, compiler

from bus_schema.runtime.borrowed_arguments import pipelines

_JITCodeLibrary: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.Compiler
_njit: Any = numba.njit


def link_into_callers(dispatcher: Any, function: Callable[..., Any], **options: Any) -> None:
    """Let other kernels link the code of a function, of which Python calls `dispatcher`.

    Args:
        dispatcher: made by ``numba.njit``.
        function: what it compiles.
        options: of ``numba.njit``.
    """
    linked: Any = _njit(
        no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_LinkedCompiler, **options
    )(function)
    dispatcher.get_call_template = linked.get_call_template
    dispatcher.get_overload = linked.get_overload


class _NoMachineCode:
    """In place of numba's code generator where no machine code is made."""

    def set_env(self, name: str, environment: Any) -> None:
        """Does nothing: `EntryCompiler` does it for the callers."""


class _LinkedLibrary(_JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code of one kernel, or of a function of numba's that kernels call."""

    codegen = _NoMachineCode()
    _shared_module: Any

    def _optimize_functions(self, module: Any) -> None:
        """Leave that to the callers."""
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = Linkage.linkonce_odr
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return it with what it calls, for a caller of which numba itself makes the library."""
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for library in _called_by(self):
                self._shared_module.link_in(_module_of(library), preserve=True)
        return self._shared_module

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        self._ensure_finalized()
        return 0


class _EntryLibrary(_JITCodeLibrary):  # type: ignore[misc]
    """Machine code of a kernel that Python calls, with all that it calls."""

    _linking_libraries: list[Any]

    def _optimize_functions(self, module: Any) -> None:
        """Leave that to the passes over the whole, which include these."""
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        for library in _called_by(self):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(_module_of(library), preserve=True)
        self._linking_libraries = []
        super().finalize()


def _called_by(library: Any) -> list[Any]:
    """Return the libraries of all that the functions of one call, each once."""
    found: dict[Any, None] = {}
    waiting = list(library._linking_libraries)
    while waiting:
        each = waiting.pop()
        if each not in found:
            found[each] = None
            if isinstance(each, _LinkedLibrary):  # others contain what they call
                waiting += each._linking_libraries
    return list(found)


def _module_of(library: Any) -> Any:
    library._ensure_finalized()
    if isinstance(library, _LinkedLibrary):
        return library._final_module
    return library._get_module_for_linking()


class _LinkedCompiler(_Compiler):  # type: ignore[misc]
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        if self.state.library is None:
            self.state.library = _LinkedLibrary(self.state.targetctx.codegen(), "linked")

    def define_pipelines(self) -> Any:
        return pipelines(self.state)


class EntryCompiler(_Compiler):  # type: ignore[misc]
    """Compiles kernels that Python calls, and their environments with those of what they call."""

    def define_pipelines(self) -> Any:
        return pipelines(self.state)

    def compile_extra(self, function: Any) -> Any:
        codegen = self.state.targetctx.codegen()
        self.state.library = _EntryLibrary(codegen, function.__qualname__)
        self.state.library.enable_object_caching()
        with _garbage_kept(), _linked_libraries(codegen):
            result = super().compile_extra(function)
        for environment in result._find_referenced_environments():
            result.library.codegen.set_env(environment.env_name, environment)
        return result


@contextlib.contextmanager
def _linked_libraries(codegen: Any) -> Iterator[None]:
    """Have numba's own functions, that kernels call, become intermediate code as well."""
    codegen._library_class = _LinkedLibrary
    try:
        yield
    finally:
        del codegen._library_class


@contextlib.contextmanager
def _garbage_kept() -> Iterator[None]:
    """Pause garbage collection, which takes a fifth of the time of a compilation."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
