"""Compilation of kernels that other kernels call: intermediate code, linked into their callers.

By itself numba optimizes each called function, makes machine code and a wrapper for Python of it,
and does all of that again in each caller that it links it into. Only the outermost kernels run.
"""

from __future__ import annotations

import contextlib
import gc
import operator
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numba
from llvmlite import binding
from numba.core import codegen, compiler, compiler_machinery, cpu, targetconfig, typed_passes, types
from numba.core import ir as _ir
from numba.core.datamodel import models, registry

from bus_schema.runtime.kernel_cache import PACKAGES

ir: Any = _ir
AnalysisPass: Any = compiler_machinery.AnalysisPass
_register_pass: Any = compiler_machinery.register_pass
_JITCodeLibrary: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.Compiler
_njit: Any = numba.njit
_ConfigStack: Any = targetconfig.ConfigStack


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


def _link_each_once(module: Any, libraries: Any, linked: set[Any]) -> None:
    """Add the code of these libraries to a module, with that of those they call."""
    for library in libraries:
        if library not in linked:
            linked.add(library)
            if isinstance(library, _LinkedLibrary):
                module.link_in(library._final_module, preserve=True)
                _link_each_once(module, library._linking_libraries, linked)
            else:
                module.link_in(library._get_module_for_linking(), preserve=True)


class _Unoptimized(_JITCodeLibrary):  # type: ignore[misc]
    def _optimize_functions(self, module: Any) -> None:
        """Leave that to the outermost kernel, which optimizes all functions together."""
        module.data_layout = self._codegen._data_layout


class _LinkedLibrary(_Unoptimized):
    """Intermediate code of a function that kernels call, without that of those that it calls."""

    codegen = _NoMachineCode()
    _shared_module: Any

    def finalize(self) -> None:
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == binding.Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """For callers that are not ours."""
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            _link_each_once(self._shared_module, self._linking_libraries, {self})
        return self._shared_module

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        self._ensure_finalized()
        return 0


def _called_library(generator: Any, name: str) -> Any:
    """Return a library for a function that kernels call, which Python may call too if not ours."""
    flags = _ConfigStack.top_or_none()
    is_linked = flags.no_cpython_wrapper or flags.no_cfunc_wrapper
    return (_LinkedLibrary if is_linked else _JITCodeLibrary)(generator, name)


class _EntryLibrary(_Unoptimized):
    _linking_libraries: list[Any]

    def finalize(self) -> None:
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        _link_each_once(self._final_module, self._linking_libraries, set())
        self._linking_libraries = []
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Optimize at LLVM's first level: a tenth of the time less, for code as fast.

        More levels, vectors and unrolling are for long loops; those of kernels run over few joints.
        """
        tuning = binding.create_pipeline_tuning_options(speed_level=1)
        tuning.loop_vectorization = tuning.slp_vectorization = tuning.loop_unrolling = False
        builder = binding.create_pass_builder(self._codegen._tm, tuning)
        passes = builder.getModulePassManager()
        passes.add_refprune_pass()
        passes.run(self._final_module, builder)


UNCOUNTED: set[Any] = set()
"""Functions whose arrays live as long as their caller's call."""
_BORROWS = {
    "getitem", "static_getitem", "typed_getitem", "getattr", "build_tuple", "exhaust_iter",
    "iternext", "getiter", "pair_first", "pair_second", "cast", "phi",
}  # fmt: skip


@_register_pass(mutates_CFG=False, analysis_only=True)
class _ReferenceCounts(AnalysisPass):  # type: ignore[misc]
    """Leaves out counts of references, half of the code, where no arrays are made or returned."""

    _name = "reference_counts"

    def __init__(self) -> None:
        """The base class requires one."""

    def run_pass(self, state: Any) -> bool:
        def counts(kind: Any) -> bool:
            return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())

        def makes_arrays(line: Any) -> bool:
            if isinstance(line, ir.Assign):
                makes = isinstance(line.value, ir.Expr) and line.value.op not in _BORROWS
                if makes and line.value.op == "call":
                    called = state.typemap[line.value.func.name]
                    makes = getattr(called, "typing_key", None) not in UNCOUNTED
                    makes &= not isinstance(called, types.NamedTupleClass)
                return makes and counts(state.typemap[line.target.name])
            if isinstance(line, (ir.SetItem, ir.StaticSetItem, ir.SetAttr)):
                return counts(state.typemap[line.value.name])
            return not isinstance(line, (ir.Jump, ir.Branch, ir.Return, ir.Del, ir.StaticRaise))

        lines = (line for block in state.func_ir.blocks.values() for line in block.body)
        returns = state.func_ir.is_generator or counts(state.return_type)
        if not returns and not any(map(makes_arrays, lines)):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return False


def _load_known(context: Any) -> None:
    """Load what was registered since; numba would import everything again for each function."""
    for each in tuple(context._registries):
        context.install_registry(each)


_DataModel: Any = models.DataModel
_AnyFunction: Any = types.BaseFunction
_find_call_type: Any = _AnyFunction.get_call_type
_call_types: dict[Any, Any] = {}
_OPERATORS = {getattr(operator, name) for name in operator.__all__} | {bool, range}
_PLAIN = (types.Number, types.Boolean, types.Array, types.BaseTuple, types.SliceType)


def _known_call_type(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Look up the types of an operator: numba would search all of its meanings at each use."""
    is_operator = function.typing_key in _OPERATORS
    if named or not is_operator or not all(isinstance(each, _PLAIN) for each in arguments):
        return _find_call_type(function, context, arguments, named)
    key = id(function), tuple(arguments)
    if key not in _call_types:
        _call_types[key] = _find_call_type(function, context, arguments, named), function
    return _call_types[key][0]


class _LinkedCompiler(_Compiler):  # type: ignore[misc]
    def define_pipelines(self) -> Any:
        (pipeline,) = super().define_pipelines()
        pipeline.add_pass_after(_ReferenceCounts, typed_passes.NopythonTypeInference)
        pipeline.finalize()
        return [pipeline]


class EntryCompiler(_LinkedCompiler):
    """Compiles kernels that Python calls, and their environments with those of what they call."""

    def compile_extra(self, function: Any) -> Any:
        generator = self.state.targetctx.codegen()
        self.state.library = _EntryLibrary(generator, function.__qualname__)
        self.state.library.enable_object_caching()
        with (
            _garbage_kept(),
            _replaced(generator, create_library=partial(_called_library, generator)),
            _replaced(cpu.CPUContext, refresh=_load_known),
            _replaced(_AnyFunction, get_call_type=_known_call_type),
        ):
            result = super().compile_extra(function)
        for environment in result._find_referenced_environments():
            result.library.codegen.set_env(environment.env_name, environment)
        return result


class _WholeArgument(_DataModel):  # type: ignore[misc]
    """Passes our tuples whole; numba would pass each of their hundreds of numbers by itself."""

    def _is_ours(self) -> bool:
        return self._fe_type.instance_class.__module__.partition(".")[0] in PACKAGES

    def get_argument_type(self) -> Any:
        return self.get_value_type() if self._is_ours() else super().get_argument_type()

    def as_argument(self, builder: Any, value: Any) -> Any:
        return value if self._is_ours() else super().as_argument(builder, value)

    def from_argument(self, builder: Any, value: Any) -> Any:
        return value if self._is_ours() else super().from_argument(builder, value)


for _kind, _model in (
    (types.NamedTuple, models.TupleModel),
    (types.NamedUniTuple, models.UniTupleModel),
):
    registry.register_default(_kind)(type("_Whole", (_WholeArgument, _model), {}))


@contextlib.contextmanager
def _garbage_kept() -> Iterator[None]:
    """Collect no garbage of a compilation, which takes a fifth of its time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.freeze()
            gc.enable()


@contextlib.contextmanager
def _replaced(thing: Any, **values: Any) -> Iterator[None]:
    before = {name: getattr(thing, name) for name in values}
    for name, value in values.items():
        setattr(thing, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(thing, name, value)
