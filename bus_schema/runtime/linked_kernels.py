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
from numba.core import codegen, compiler

_JITCodeLibrary: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.Compiler
_njit: Any = numba.njit
config: Any = numba.config


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
    """Intermediate code of a kernel, with that of the kernels that it calls."""

    codegen = _NoMachineCode()

    def _optimize_functions(self, module: Any) -> None:
        """Leave that to the callers."""
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        self._ensure_finalized()
        return 0


class _LinkedCompiler(_Compiler):  # type: ignore[misc]
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        if self.state.library is None:
            self.state.library = _LinkedLibrary(self.state.targetctx.codegen(), "linked")


class EntryCompiler(_Compiler):  # type: ignore[misc]
    """Compiles kernels that Python calls, and their environments with those of what they call."""

    def compile_extra(self, function: Any) -> Any:
        with _garbage_kept(), _optimized_once():
            result = super().compile_extra(function)
        for environment in result._find_referenced_environments():
            result.library.codegen.set_env(environment.env_name, environment)
        return result


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


@contextlib.contextmanager
def _optimized_once() -> Iterator[None]:
    """Let LLVM optimize at its first level: a tenth of the time less, for code as fast.

    More levels and vectors are for long loops; those of kernels run over a few joints.
    """
    chosen = config.OPT, config.LOOP_VECTORIZE
    config.OPT, config.LOOP_VECTORIZE = type(config.OPT)(1), 0
    try:
        yield
    finally:
        config.OPT, config.LOOP_VECTORIZE = chosen
