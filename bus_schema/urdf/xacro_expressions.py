"""Expressions of xacro files: Python's grammar, of which only what computes a value has a meaning.

There are numbers, texts, lists and mappings, arithmetic, comparisons and the functions below; no
attribute, function or module of Python's own can be reached, and no value outgrows `MOST`.
"""

from __future__ import annotations

import ast
import builtins
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

MOST = 10_000
"""Characters and elements of a value, and three times as many bits of a whole number."""
_LONGEST = 2_000
_METHODS = {
    str: {
        "capitalize", "count", "endswith", "find", "isalpha", "isdigit", "isspace", "join", "lower",
        "lstrip", "replace", "rfind", "rstrip", "split", "startswith", "strip", "title", "upper",
    },
    list: {"count", "index"},
    dict: {"get", "items", "keys", "values"},
}  # fmt: skip
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod,
    ast.Pow: operator.pow, ast.Not: operator.not_, ast.UAdd: operator.pos, ast.USub: operator.neg,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda part, whole: part in whole, ast.NotIn: lambda part, whole: part not in whole,
}  # fmt: skip


def _round(value: float, digits: int = 0) -> float:
    """Python's, but for the powers of ten that it would compute first."""
    return round(value, max(-400, min(400, digits))) if digits else round(value)


def _range(*ends: int) -> list[int]:
    return list(range(*ends)[: MOST + 1])


_LAZY = {name: getattr(builtins, name) for name in ("enumerate", "map", "reversed", "zip")}
MATH = {
    name: value
    for name, value in vars(math).items()
    if not name.startswith("_") and name not in ("comb", "factorial", "perm", "prod")
}
PYTHON = {
    **{
        name: getattr(builtins, name)
        for name in (
            "abs", "all", "any", "bool", "dict", "divmod", "float", "int", "len", "list", "max",
            "min", "sorted", "str", "sum", "tuple",
        )
    },
    **{name: lambda *given, of=of: list(of(*given)) for name, of in _LAZY.items()},
    "range": _range, "round": _round, "True": True, "False": False,
}  # fmt: skip
FUNCTIONS: dict[str, Any] = {**MATH, **PYTHON, "math": MATH, "python": PYTHON}
"""What expressions may call or name, beside what a file defines."""


class ExpressionError(ValueError):
    """An expression is beyond what is evaluated."""


def evaluate(text: str, names: Mapping[str, Any]) -> Any:
    """The value of an expression.

    Args:
        text: the expression.
        names: all that it can name; functions among them can be called.

    Raises:
        Exception: it is beyond what is evaluated, or whatever Python says to its values.
    """
    if len(text) > _LONGEST:
        raise ExpressionError(f"an expression has at most {_LONGEST} characters")
    return _value(ast.parse(text.strip(), mode="eval").body, names)


def bounded(value: Any, most: int = MOST) -> Any:
    """The value.

    Raises:
        ExpressionError: it is too large, or none of xacro's.
    """
    if _size(value, most) > most:
        raise ExpressionError(f"a value has at most {most} characters or elements")
    return value


def _size(value: Any, most: int) -> int:
    """How large a value is; beyond `most` it is not counted any further."""
    match value:
        case str():
            return len(value)
        case int():
            return 1 + value.bit_length() // 3
        case dict():
            parts = [*value, *value.values()]
        case list() | tuple():
            parts = list(value)
        case float() | None:
            return 1
        case _:
            raise ExpressionError(f"{type(value).__name__} is no value of xacro's")
    total = 1
    for part in parts:
        total += _size(part, most)
        if total > most:
            break
    return total


def _value(node: ast.AST, names: Mapping[str, Any]) -> Any:
    def of(inner: ast.AST | None) -> Any:
        return None if inner is None else _value(inner, names)

    match node:
        case ast.Constant(value=value):
            return bounded(value)
        case ast.Name(id=name):
            try:
                return names[name]
            except KeyError:
                raise NameError(f"name {name!r} is not defined") from None
        case ast.List(elts=parts) | ast.Tuple(elts=parts):
            return bounded([of(part) for part in parts])
        case ast.Dict(keys=keys, values=values):
            return bounded({of(key): of(value) for key, value in zip(keys, values, strict=True)})
        case ast.UnaryOp(op=op, operand=inner) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](of(inner))
        case ast.BinOp(op=op, left=left, right=right) if type(op) in _OPERATORS:
            return _computed(_OPERATORS[type(op)], of(left), of(right))
        case ast.BoolOp(op=op, values=parts):
            value = of(parts[0])
            for part in parts[1:]:
                if bool(value) != isinstance(op, ast.And):
                    break
                value = of(part)
            return value
        case ast.Compare(left=left, ops=ops, comparators=others):
            terms = [of(each) for each in (left, *others)]
            pairs = zip(ops, terms, terms[1:], strict=False)
            return all(_OPERATORS[type(op)](first, then) for op, first, then in pairs)
        case ast.IfExp(test=test, body=then, orelse=other):
            return of(then if of(test) else other)
        case ast.Slice(lower=lower, upper=upper, step=step):
            return slice(of(lower), of(upper), of(step))
        case ast.Subscript(value=whole, slice=place):
            return of(whole)[of(place)]
        case ast.Attribute(value=whole, attr=name):
            return _attribute(of(whole), name)
        case ast.Call(func=function, args=given, keywords=named):
            return _called(of(function), [of(each) for each in given], {
                str(each.arg): of(each.value) for each in named
            })  # fmt: skip
    raise ExpressionError(f"{type(node).__name__} is not among what xacro files may use here")


def _computed(operate: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """The result of arithmetic, whose size is known before it is computed."""
    if operate is operator.mul:
        for many, times in ((left, right), (right, left)):
            if isinstance(many, str | list) and _size(many, MOST) * int(times) > MOST:
                raise ExpressionError(f"a value has at most {MOST} characters or elements")
    is_power = operate is operator.pow and isinstance(left, int) and isinstance(right, int)
    if is_power and left.bit_length() * right > MOST:
        raise ExpressionError(f"a power has at most {MOST} bits")
    if operate is operator.mod and isinstance(left, str) and re.search(r"\*|\d{4}", left):
        raise ExpressionError("a width has at most three digits")
    return bounded(operate(left, right))


def _attribute(whole: Any, name: str) -> Any:
    """A property of a namespace or mapping by its name, or one of the methods that are allowed."""
    if isinstance(whole, dict) and name in whole:
        return whole[name]
    if any(isinstance(whole, kind) and name in names for kind, names in _METHODS.items()):
        method = getattr(whole, name)
        if isinstance(whole, dict) and name != "get":  # whose views are no lists
            return lambda: [list(each) if name == "items" else each for each in method()]
        return method
    raise ExpressionError(f".{name} is not among what xacro files may use")


def _called(function: Any, given: list[Any], named: dict[str, Any]) -> Any:
    if not callable(function) or (named and function is not dict):
        raise ExpressionError("only functions of xacro's are called, and with values by place")
    return bounded(function(*given, **named))
