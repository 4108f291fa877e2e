"""Compilation of the numerical kernels with numba.

numba's own cache looks only at the file a function stands in, not at the functions it calls in
other files. So that an edited helper can never leave a stale caller behind, kernels are cached
under a folder named by a hash of all sources that have kernels. So kernels take constants only from
files that have kernels, which a test keeps.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
from collections.abc import Callable, Sequence
from functools import partial
from operator import setitem
from typing import Any, ParamSpec, TypeVar, cast

from bus_schema.arrays import Matrix
from bus_schema.runtime import kernel_cache

logger = logging.getLogger(__name__)
HAS_SAID = "FUNNEL_HIL_HAS_SAID_THAT_IT_COMPILES"
"""Environment variable by which the processes that one starts know that it has said so."""
COMPILES = (
    "compiling the numerical kernels of this kind of run, which takes up to half a minute: each"
    " kind needs it once on a machine, and again after a change of version"
)
"""What it says."""
P = ParamSpec("P")
R = TypeVar("R")


_is_kept = kernel_cache.choose_folder()
# Intel's vector functions, where they are installed, have other last bits on other CPUs.
os.environ["NUMBA_DISABLE_INTEL_SVML"] = "1"

import numba  # noqa: E402  (reads both at import)
from llvmlite import binding  # noqa: E402

_Cache: Any = object
with contextlib.suppress(ImportError):
    # What numba keeps to itself; without it, loading takes longer, and all else is the same.
    from numba.core.caching import FunctionCache
    from numba.core.runtime.nrt import rtsys

    _Cache = FunctionCache


class _CompiledBefore(_Cache):  # type: ignore[misc]
    """Machine code of one function, found without loading the compiler.

    numba prepares for compiling whenever it looks into its cache, which takes several times as long
    as all that is found there. What is missing it compiles as ever, and prepares for that itself.
    """

    def load_overload(self, signature: Any, target: Any) -> Any:
        try:
            rtsys.initialize(target)  # what machine code may call
            found = self._load_overload(signature, target)
        except (AttributeError, TypeError):  # of another version of numba
            found = super().load_overload(signature, target)
        if found is None:
            say_that_it_compiles(logger.warning)
        return found

    def save_overload(self, signature: Any, machine_code: Any) -> None:
        try:
            super().save_overload(signature, machine_code)
        except OSError as error:
            kernel_cache.report_refusal(f"a compiled kernel cannot be kept ({error})")


def say_that_it_compiles(say: Callable[[str], None]) -> None:
    """Tell by `say` why nothing seems to happen; once, whatever other processes this one starts."""
    if HAS_SAID not in os.environ:
        os.environ[HAS_SAID] = "1"
        say(COMPILES)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` at its first call, with IEEE semantics, and cache the machine code."""
    dispatcher = cast("Any", numba.njit(error_model="numpy")(function))
    if _is_kept and _Cache is not object and hasattr(dispatcher, "_cache"):
        dispatcher._cache = cast("Any", _CompiledBefore)(function)
    elif _is_kept:
        dispatcher.enable_caching()
    return cast("Callable[P, R]", dispatcher)


def bind(function: Callable[..., R], *fixed: Any, free: Sequence[str] = ()) -> Callable[..., R]:
    """A `compiled` function with its first arguments fixed, at half the cost of a call.

    What kind of argument each one is need not be found out again at every call. So the arrays that
    a loop works on in every cycle are best fixed, by those who own them and never replace them.

    Args:
        function: made by `compiled`.
        fixed: its first arguments, as they are to be at every call.
        free: types of the others, as numba names them: scalars alone, as nobody checks them.
    """
    dispatcher, typeof = cast("Any", function), cast("Any", numba.typeof)
    types = (*map(typeof, fixed), *(getattr(numba.types, name) for name in free))
    dispatcher.compile(types)
    try:
        entry = dispatcher.overloads[types].entry_point
    except AttributeError:  # numba keeps it to itself: the usual way in takes twice as long
        entry = dispatcher
    return partial(entry, *fixed)


def copying(source: Matrix, target: Matrix) -> Callable[[], None]:
    """A function that copies one small array over another, in a third of NumPy's time at most.

    Args:
        source: any shape.
        target: of the same shape.
    """
    # Where no numbers are between numbers, Python's own copy of bytes takes half of that again.
    if source.flags.c_contiguous and target.flags.c_contiguous:
        return partial(setitem, target.data.cast("B"), slice(None), source.data.cast("B"))
    return bind(_copy, source, target)


@compiled
def _copy(source: Matrix, target: Matrix) -> None:
    target[:] = source


def c_function(library: ctypes.CDLL, name: str, result: str, *arguments: str) -> Any:
    """A C function for `compiled` functions to call; nothing else can.

    Args:
        library: where it is.
        name: its name there.
        result: type of what it returns, as numba names it; ``uintp`` for pointers.
        arguments: types of its arguments.

    Raises:
        AttributeError: the library has no such function.
    """
    binding.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
    types = [getattr(numba.types, argument) for argument in arguments]
    return numba.types.ExternalFunction(name, getattr(numba.types, result)(*types))
