"""Expansion of URDFs with xacro macros, without ROS.

The file is untrusted, and the package xacro evaluates expressions by Python's `eval` and reads any
file. So a process of limited time and memory expands it, with replaced functions: expressions may
use only `_NODES`, `_METHODS` and `_NAMES`, and files are read only below the folders of `_Folders`.
"""

from __future__ import annotations

import ast
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

from bus_schema.errors import RobotDescriptionError
from bus_schema.runtime.limited_process import (
    LimitedProcess,
    LimitedProcessError,
    limit_this_process,
)

INCLUDE = "FUNNEL_HIL_INCLUDE"
"""Environment variable: additional folders that files may be included from."""

_MOST_EXPANDED = 5_000_000
_TOO_MUCH = "takes more time or memory than an arm may"
_NODES = (
    ast.Constant, ast.Name, ast.expr_context, ast.List, ast.Tuple, ast.Dict, ast.IfExp,
    ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.unaryop, ast.operator, ast.boolop,
    ast.cmpop, ast.Subscript, ast.Slice, ast.Attribute, ast.Call, ast.keyword,
)  # fmt: skip
_METHODS = {
    str: {
        "capitalize", "count", "endswith", "find", "isalpha", "isdigit", "isspace", "join", "lower",
        "lstrip", "replace", "rfind", "rstrip", "split", "startswith", "strip", "title", "upper",
    },
    list: {"count", "index"},
    dict: {"get", "items", "keys", "values"},
}  # fmt: skip
_PYTHON = {
    "True", "False", "abs", "all", "any", "bool", "dict", "divmod", "enumerate", "float", "int",
    "len", "list", "map", "max", "min", "range", "reversed", "round", "sorted", "str", "sum",
    "tuple", "zip",
}  # fmt: skip
_XACRO = {
    "abs_filename", "arg", "dotify", "error", "fatal", "load_yaml", "message", "print_location",
    "tokenize", "warning",
}  # fmt: skip
_NAMES = {"math", "python", "xacro", *_PYTHON, *_XACRO, *vars(math)}
"""Names that expressions may use, besides those that a file defines."""


def is_xacro(path: Path) -> bool:
    """Whether a file name is that of a xacro file."""
    return path.suffix == ".xacro"


def expanded(path: Path) -> str:
    """Return the URDF that a xacro file expands to with its default arguments.

    Packages in ``$(find …)`` are folders of that name at or above the file.

    Raises:
        RobotDescriptionError: xacro refuses it; the message names the file.
    """
    try:
        answer = LimitedProcess(__name__, bytes(path)).answer()
    except LimitedProcessError as error:
        raise RobotDescriptionError(f"{path}: xacro: {_TOO_MUCH} ({error})") from error
    is_urdf, text = json.loads(answer)
    if not is_urdf:
        raise RobotDescriptionError(f"{path}: xacro: {text}")
    return str(text)


def main() -> None:
    """Expand the file that standard input names; write whether it worked, and URDF or reason."""
    limit_this_process(cpu_s=3)
    path = Path(os.fsdecode(sys.stdin.buffer.read()))
    json.dump(_expanded_here(path), sys.stdout)


def _expanded_here(path: Path) -> tuple[bool, str]:
    try:
        text = _safe_xacro(path).process_file(str(path)).toxml()
    except RecursionError:
        return False, "macros, includes or elements are nested too deep, or without an end"
    except MemoryError:
        return False, _TOO_MUCH
    except Exception as error:  # noqa: BLE001 (xacro lets through what Python says to a file)
        return False, " ".join(str(error).split())[:500]
    is_small = len(text) <= _MOST_EXPANDED
    return is_small, text if is_small else _TOO_MUCH


class _Folders:
    """Folders that may be read: the xacro file's own, ROS packages and those that `INCLUDE` names.

    Args:
        file: the xacro file.
    """

    def __init__(self, file: Path) -> None:
        self.file = file.resolve()
        more = os.environ.get(INCLUDE, "").split(os.pathsep)
        self._named = [Path(each).resolve() for each in more if each]
        self._folders = [self.file.parent, *self._named]

    def package(self, name: str) -> str:
        """Return a ROS package's folder: in `INCLUDE`'s folders, or at, above or beside the file.

        A folder above the file counts only if it has ``package.xml``.

        Raises:
            OSError: there is none.
        """
        is_name = name not in ("", ".", "..") and "/" not in name
        for folder in (*self._named, *self.file.parents) if is_name else ():
            for candidate in (folder, folder / name):
                is_package = folder in self._named or (candidate / "package.xml").is_file()
                if candidate.name == name and candidate.is_dir() and is_package:
                    self._folders.append(candidate.resolve())
                    return str(candidate)
        raise OSError(
            f"no folder {name!r} with a package.xml at or above the file for $(find {name});"
            f" {INCLUDE} may name more folders"
        )

    def allowed(self, name: str) -> str:
        """Return the path of a file, or a pattern of files, that may be read.

        Raises:
            ValueError: it is outside of the folders, or no regular file.
        """
        path = Path(name).resolve()
        if not any(path.is_relative_to(folder) for folder in self._folders):
            raise ValueError(
                f"{name}: must be below {self._folders[0]}, or a folder that {INCLUDE} names"
            )
        if path.exists() and not path.is_file():
            raise ValueError(f"{name}: is not a regular file")
        return str(path)


def _safe_xacro(path: Path) -> Any:
    """Return the package xacro with its functions for evaluation and file access replaced."""
    import xacro

    folders = _Folders(path)
    parse, abs_filename = xacro.parse, xacro.abs_filename_spec

    def extension(text: str) -> str:
        """Return the value of ``$(find …)``, ``$(arg …)`` and the like."""
        command, _, rest = text[2:-1].strip().partition(" ")
        return _extension(xacro, folders, command, rest.strip())

    ours = {
        "safe_eval": lambda text, names, _locals=None: _evaluate(text, names),
        "parse": lambda given, filename=None: parse(given, folders.allowed(filename)),
        "abs_filename_spec": lambda name: folders.allowed(abs_filename(name)),
        "eval_extension": extension,
    }
    for name, function in ours.items():
        getattr(xacro, name)  # a version without it would evaluate in another way
        setattr(xacro, name, function)
    symbols = xacro.create_global_symbols()
    for namespace, names in ((symbols, _NAMES), (symbols["python"], _PYTHON),
                             (symbols["xacro"], _XACRO)):  # fmt: skip
        _keep(namespace, names)
    xacro._global_symbols = symbols
    return xacro


def _keep(namespace: dict[str, Any], names: set[str]) -> None:
    for name in set(namespace) - names:
        dict.pop(namespace, name)


def _extension(xacro: Any, folders: _Folders, command: str, rest: str) -> str:
    arguments = xacro.substitution_args_context["arg"]
    match command:
        case "find":
            return folders.package(rest)
        case "arg":
            if rest not in arguments:
                raise ValueError(f"Undefined substitution argument {rest}")
            return str(arguments[rest])
        case "cwd":
            return str(Path.cwd())
        case "dirname":
            return str(folders.file.parent)
        case "optenv":
            return rest.partition(" ")[2]
        case "eval":
            given = {name: xacro.Table._eval_literal(text) for name, text in arguments.items()}
            functions = {"true": True, "false": False, "find": folders.package, "arg": given.get}
            return str(_evaluate(rest, {**xacro._global_symbols, **functions, **given}))
    raise ValueError(
        f"$({command} {rest}) is not expanded: environment variables and other commands are no part"
        " of an arm"
    )


def _evaluate(text: str, names: Any) -> Any:
    """Return the value of an expression that may use only `names`."""
    tree = ast.fix_missing_locations(_Checked().visit(ast.parse(text.strip(), mode="eval")))
    code = compile(tree, "<expression>", "eval")
    try:
        return eval(code, {"__builtins__": {}, "_attribute": _attribute}, names)
    except MemoryError:
        raise ValueError(_TOO_MUCH) from None


class _Checked(ast.NodeTransformer):
    """Rejects syntax outside `_NODES`, and redirects attribute access to `_attribute`."""

    def visit_Expression(self, node: ast.Expression) -> ast.Expression:
        return ast.Expression(self.visit(node.body))

    def generic_visit(self, node: ast.AST) -> ast.AST:
        if not isinstance(node, _NODES):
            kind = type(node).__name__
            raise TypeError(f"{kind} is not among what xacro files may use here")
        return super().generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.Call:
        places = [self.visit(node.value), ast.Constant(node.attr)]
        return ast.Call(ast.Name("_attribute", ast.Load()), places, [])


def _attribute(whole: Any, name: str) -> Any:
    """Return a property of a namespace or mapping by its name, or one of the allowed methods."""
    if isinstance(whole, dict) and name in whole:
        return whole[name]
    if any(isinstance(whole, kind) and name in names for kind, names in _METHODS.items()):
        return getattr(whole, name)
    raise ValueError(f".{name} is not among what xacro files may use")


if __name__ == "__main__":
    main()
