"""Lowering of kernels in which arguments, and parts of tuples that are arguments, are not counted.

A caller keeps its arguments for as long as a call lasts. By itself numba counts references to each
array in a tuple at every access to the tuple, and stores tuples where a function branches. For the
nested tuples that kernels pass on, that is a third of all intermediate code.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from numba import types
from numba.core import compiler, ir, lowering, typed_passes
from numba.core.compiler_machinery import register_pass

_Lower: Any = lowering.Lower
_NativeLowering: Any = typed_passes.NativeLowering
_Passes: Any = compiler.DefaultPassBuilder
_register: Any = register_pass
_PARTS = "getattr", "static_getitem", "exhaust_iter"
"""Expressions that are a part of a tuple, or all of it, if applied to one."""


class _BorrowingLower(_Lower):  # type: ignore[misc]
    """Lowers a function, with borrowed variables as values that are neither stored nor counted."""

    context: Any

    def lower_normal_function(self, descriptor: Any) -> None:
        self._values: dict[str, Any] = {}
        self._borrowed = _borrowed(self.blocks, self.typeof)
        self._uncounted = self.context.subtarget(enable_nrt=False)
        super().lower_normal_function(descriptor)

    def lower_inst(self, instruction: Any) -> None:
        if isinstance(instruction, ir.Assign) and instruction.target.name in self._borrowed:
            name, counted = instruction.target.name, self.context
            self.context = self._uncounted
            try:
                self._values[name] = self.lower_assign(self.typeof(name), instruction)
            finally:
                self.context = counted
        else:
            super().lower_inst(instruction)

    def loadvar(self, name: str) -> Any:
        return self._values[name] if name in self._values else super().loadvar(name)

    def delvar(self, name: str) -> None:
        if name not in self._borrowed:
            super().delvar(name)


def _borrowed(blocks: Any, typeof: Any) -> set[str]:
    """Return the names of variables that are only ever an argument, or a part of one.

    Each is assigned in one place, before every use on every path, as numba's code is in SSA form.
    """
    assignments = [
        each for _, block in sorted(blocks.items()) for each in block.find_insts(ir.Assign)
    ]
    times = Counter(each.target.name for each in assignments)
    borrowed: set[str] = set()
    size = -1
    while size < len(borrowed):
        size = len(borrowed)
        borrowed |= {
            each.target.name
            for each in assignments
            if times[each.target.name] == 1 and _is_part(each, borrowed, typeof)
        }
    return borrowed


def _is_part(assignment: Any, borrowed: set[str], typeof: Any) -> bool:
    value, type_ = assignment.value, typeof(assignment.target.name)
    if isinstance(value, ir.Arg):
        return bool(typeof(f"arg.{value.name}") == type_)
    if isinstance(value, ir.Var):
        return value.name in borrowed and bool(typeof(value.name) == type_)
    return (
        isinstance(value, ir.Expr)
        and value.op in _PARTS
        and value.value.name in borrowed
        and isinstance(typeof(value.value.name), types.BaseTuple)
    )


@_register(mutates_CFG=True, analysis_only=False)
class _BorrowingLowering(_NativeLowering):  # type: ignore[misc]
    _name = "borrowing_lowering"

    @property
    def lowering_class(self) -> Any:
        return _BorrowingLower


def pipelines(state: Any) -> list[Any]:
    """Return numba's passes for a kernel, but for this lowering."""
    passes = _Passes.define_nopython_pipeline(state)
    passes.passes = [
        (_BorrowingLowering if each is _NativeLowering else each, name)
        for each, name in passes.passes
    ]
    passes.finalize()
    return [passes]
