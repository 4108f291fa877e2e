"""Compilation of the numerical kernels with numba.

numba's own cache checks only a function's own file, not the files of the functions it calls. An
edited helper would leave a stale caller, so kernels are cached in a folder named by a hash of all
sources with kernels. A test checks that kernels take constants only from such files.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import math
import os
import pickle
import time
from collections.abc import Callable, Sequence
from functools import partial
from operator import setitem
from typing import Any, ParamSpec, TypeVar, cast

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime import kernel_cache

logger = logging.getLogger(__name__)
HAS_SAID = "FUNNEL_HIL_HAS_SAID_THAT_IT_COMPILES"
"""Environment variable: the message about compiling was shown, also for child processes."""
COMPILES = (
    "compiling the numerical kernels for this kind of run, once per machine and version: 2 to 8 s"
    " of CPU, with delay compensation 5 to 16 s"
)
"""The message."""
P = ParamSpec("P")
R = TypeVar("R")


_CUT_OFF = (EOFError, pickle.UnpicklingError)
"""Errors of a file of the cache that another process is writing, or left unfinished."""
_BEING_WRITTEN_S = 0.2

_is_kept = kernel_cache.choose_folder()
# Intel's vector functions, if installed, differ in their last bits between CPUs.
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"

import numba  # noqa: E402  (reads both at import)
import numpy as np  # noqa: E402
from llvmlite import binding  # noqa: E402
from numba.core import cgutils as _cgutils  # noqa: E402
from numba.np import arrayobj as _arrayobj  # noqa: E402

cgutils: Any = _cgutils
arrayobj: Any = _arrayobj
_linking: Any = None
_Cache: Any = object
# Internal to numba; without it, compiling and loading take longer.
with contextlib.suppress(ImportError, AttributeError):
    from bus_schema.runtime import linked_kernels as _linking
with contextlib.suppress(ImportError, AttributeError):
    from numba.core.runtime.nrt import rtsys

    from bus_schema.runtime.located_cache import LocatedCache as _Cache


class _CompiledBefore(_Cache):  # type: ignore[misc]
    """Machine code of one function, loaded without the compiler.

    numba initializes its compiler whenever it reads its cache, which takes several times as long as
    loading the code. If code is missing, numba initializes the compiler and compiles as usual.
    """

    def load_overload(self, signature: Any, target: Any) -> Any:
        try:
            found = self._found(signature, target)
        except _CUT_OFF:
            time.sleep(_BEING_WRITTEN_S)
            try:
                found = self._found(signature, target)
            except _CUT_OFF:
                self.flush()
                found = None
        if found is None:
            say_that_it_compiles(logger.warning)
        return found

    def _found(self, signature: Any, target: Any) -> Any:
        try:
            rtsys.initialize(target)  # symbols that machine code may call
            return self._load_overload(signature, target)
        except (AttributeError, TypeError):  # from another version of numba
            return super().load_overload(signature, target)

    def save_overload(self, signature: Any, machine_code: Any) -> None:
        try:
            super().save_overload(signature, machine_code)
        except OSError as error:
            kernel_cache.report_refusal(f"a compiled kernel cannot be stored ({error})")


def say_that_it_compiles(say: Callable[[str], None]) -> None:
    """Explain the wait by `say`, once for this process and its children."""
    if HAS_SAID not in os.environ:
        os.environ[HAS_SAID] = "1"
        say(COMPILES)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` at its first call, with IEEE semantics, and cache the machine code."""
    config = cast("Any", numba.config)
    chosen, config.DISABLE_JIT = config.DISABLE_JIT, 0  # the user's, for kernels of their own
    # A second wrapper, for C, costs as much as a kernel; nothing here passes kernels as values.
    options = {"error_model": "numpy", "no_cfunc_wrapper": True}
    if _linking is None:
        dispatcher = cast("Any", numba.njit)(**options)(function)
    else:
        dispatcher = cast("Any", numba.njit)(**options, pipeline_class=_linking.EntryCompiler)(
            function
        )
        _linking.link_into_callers(dispatcher, function, error_model="numpy")
    config.DISABLE_JIT = chosen
    if _is_kept and _Cache is not object and hasattr(dispatcher, "_cache"):
        dispatcher._cache = cast("Any", _CompiledBefore)(function)
    elif _is_kept:
        dispatcher.enable_caching()
    return cast("Callable[P, R]", dispatcher)


def bind(function: Callable[..., R], *fixed: Any, free: Sequence[str] = ()) -> Callable[..., R]:
    """Bind the first arguments of a `compiled` function, which halves the cost of a call.

    The types of bound arguments are not determined again at every call. Bind the arrays that a loop
    uses in every cycle; their owner must never replace them.

    Args:
        function: made by `compiled`.
        fixed: its first arguments, the same for every call.
        free: numba's names of the types of the others: scalars only, as they are not checked.
    """
    dispatcher, typeof = cast("Any", function), cast("Any", numba.typeof)
    types = (*map(typeof, fixed), *(getattr(numba.types, name) for name in free))
    dispatcher.compile(types)
    try:
        entry = dispatcher.overloads[types].entry_point
    except AttributeError:  # internal to numba: the public way takes twice as long
        entry = dispatcher
    return partial(entry, *fixed)


def copying(source: Matrix, target: Matrix) -> Callable[[], None]:
    """Return a function that copies one small array over another, 3 times as fast as NumPy or more.

    Args:
        source: any shape.
        target: of the same shape.
    """
    # For contiguous arrays, Python's own copy of bytes takes half of that again.
    if source.flags.c_contiguous and target.flags.c_contiguous:
        return partial(setitem, target.data.cast("B"), slice(None), source.data.cast("B"))
    return bind(assign, target, source)


def _scratch(_typing: Any, shape: Any) -> Any:
    """Return an array of floats for this call only, not initialized; a kernel cannot return it.

    Args:
        _typing: what numba passes besides.
        shape: a size, or sizes.
    """
    types, size = numba.types, np.dtype(float).itemsize
    array = types.Array(types.float64, getattr(shape, "count", 1), "C")

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        shape, made = arguments[0], arrayobj.make_array(array)(context, builder)
        sizes = cgutils.unpack_tuple(builder, shape) if array.ndim > 1 else [shape]
        strides = [context.get_constant(types.intp, size)]
        for each in reversed(sizes):
            strides.insert(0, builder.mul(strides[0], each))
        memory = builder.alloca(cgutils.int8_t, strides[0])
        memory.align = 2 * size
        data = builder.bitcast(memory, made.data.type)
        arrayobj.populate_array(made, data, sizes, strides[1:], strides[-1], None)
        return made._getvalue()

    return array(shape), generate


scratch: Callable[..., Any] = cast("Any", numba).extending.intrinsic(_scratch)
if _linking is not None:
    _linking.UNCOUNTED.add(scratch)


@compiled
def assign(target: Vector | Matrix, source: Vector | Matrix) -> None:
    """Copy an array over another of the same shape, which is not checked.

    In a kernel, ``target[:] = source`` would compile numba's message about shapes for a second.
    """
    for index in np.ndindex(target.shape):
        target[index] = source[index]


@compiled
def all_finite(values: Vector | Matrix) -> bool:
    """Whether no entry of an array is infinite or NaN."""
    for value in values.flat:  # noqa: SIM110 (compiled: a loop is the fast form)
        if not math.isfinite(value):
            return False
    return True


def c_function(library: ctypes.CDLL, name: str, result: str, *arguments: str) -> Any:
    """Return a C function that `compiled` functions can call; other code cannot.

    Args:
        library: the library that contains it.
        name: its name in the library.
        result: type of what it returns, as numba names it; ``uintp`` for pointers.
        arguments: types of its arguments.

    Raises:
        AttributeError: the library has no such function.
    """
    binding.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
    types = [getattr(numba.types, argument) for argument in arguments]
    return numba.types.ExternalFunction(name, getattr(numba.types, result)(*types))
