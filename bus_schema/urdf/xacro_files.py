"""Expansion of URDFs with xacro macros, without ROS.

The file is untrusted, and the package xacro evaluates expressions by Python's `eval` and reads any
file. So a process of limited time and memory expands it, with replaced functions: expressions may
use only `_NODES`, `_METHODS` and `_NAMES`, and files are read only below the folders of `_Folders`.
Arguments are texts, which expressions may use and nothing evaluates by itself.
"""

from __future__ import annotations

import ast
import json
import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from bus_schema.errors import RobotDescriptionError
from bus_schema.runtime.limited_process import (
    LimitedProcess,
    LimitedProcessError,
    limit_this_process,
)
from bus_schema.urdf.packages import INCLUDE, ROS_PATHS, find_package, folders_in

_MISSING = "/missing package"
"""Stands for the folder of a package that is not found. Many files name packages of controllers or
launch files, from which nothing of the arm is read."""
_MOST_EXPANDED, _MOST_FILES = 5_000_000, 100
_TOO_MUCH = "takes more time or memory than an arm may"
_ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
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
    list: {
        "append", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse", "sort",
    },
    dict: {"copy", "get", "items", "keys", "pop", "values"},
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


_Stamp = tuple[str, int, int]
"""A file, when it was changed (ns), and its size."""
_known: dict[tuple[str, ...], tuple[str, list[_Stamp]]] = {}
"""The last URDFs, and the files from which they were expanded: a study reads them in every run."""
_MOST_KNOWN = 8


def is_xacro(path: Path) -> bool:
    """Whether a file name is that of a xacro file."""
    return path.suffix == ".xacro"


def expanded(path: Path, arguments: Mapping[str, str], include: Sequence[Path]) -> str:
    """Return the URDF that a xacro file expands to.

    Args:
        path: the file.
        arguments: values of its arguments, by name; others have their defaults.
        include: folders that may be read, besides its own and ROS packages.

    Raises:
        RobotDescriptionError: xacro refuses it; the message names the file.
    """
    places = [os.environ.get(each, "") for each in (INCLUDE, *ROS_PATHS)]
    order = json.dumps([str(path), dict(arguments), [str(each.resolve()) for each in include]])
    text, stamps = _known.get(key := (str(Path.cwd()), *places, order), ("", []))
    if stamps and stamps == list(map(_stamp, [each[0] for each in stamps])):
        return text
    try:
        answer = LimitedProcess(__name__, order.encode()).answer()
    except LimitedProcessError as error:
        raise RobotDescriptionError(f"{path}: xacro: {_TOO_MUCH} ({error})") from error
    is_urdf, text, files = json.loads(answer)
    if not is_urdf:
        raise RobotDescriptionError(f"{path}: xacro: {text}")
    if len(_known) >= _MOST_KNOWN:
        _known.clear()
    _known[key] = str(text), list(map(_stamp, files))
    return str(text)


def _stamp(file: str) -> _Stamp:
    """Return what changes with the content of a file."""
    found = Path(file).stat() if Path(file).exists() else None
    return file, *((found.st_mtime_ns, found.st_size) if found else (0, 0))


def main() -> None:
    """Expand the file that standard input names; write whether it worked, and URDF or reason."""
    limit_this_process(cpu_s=3)
    path, arguments, include = json.load(sys.stdin.buffer)
    folders = _Folders(Path(path), list(map(Path, include)))
    json.dump([*_expanded_here(Path(path), arguments, folders), folders.files], sys.stdout)


def _expanded_here(path: Path, arguments: dict[str, str], folders: _Folders) -> tuple[bool, str]:
    try:
        text = _safe_xacro(folders).process_file(str(path), mappings=arguments).toxml()
    except RecursionError:
        return False, "macros, includes or elements are nested too deep, or without an end"
    except MemoryError:
        return False, _TOO_MUCH
    except Exception as error:  # noqa: BLE001 (xacro lets through what Python says to a file)
        return False, " ".join(f"{error}{folders.advice(error)}".split())[:700]
    is_small = len(text) <= _MOST_EXPANDED
    return is_small, text if is_small else _TOO_MUCH


class _Folders:
    """Folders that may be read: the xacro file's own, ROS packages and those that the user names.

    Args:
        file: the xacro file.
        include: folders that the user names, besides those of `INCLUDE`.

    Attributes:
        arguments: values of the arguments that are known so far, by name.
    """

    def __init__(self, file: Path, include: list[Path]) -> None:
        self.file = file.resolve()
        self._named = [*include, *folders_in(INCLUDE)]
        self._folders = [self.file.parent, *self._named]
        self._read: list[Path] = []
        self.arguments: Mapping[str, str] = {}

    def package(self, name: str) -> str:
        """Return a ROS package's folder, or a name for one that is not found."""
        if (found := find_package(name, self.file, self._named)) is None:
            return f"{_MISSING}/{name}"
        self._folders.append(found.resolve())
        return str(found)

    def advice(self, error: Exception) -> str:
        """Return the values of arguments that the files know, where one is missing or unknown."""
        if missing := re.search(r"Undefined substitution argument (\w+)", str(error)):
            values = _listed(self._in_paths(missing[1])) or _listed(
                self._compared(missing[1])
            ).replace("know", "compare it with")
            return values + self._declared(missing[1])
        for name, value in self.arguments.items() if "No such file" in str(error) else ():
            known = self._in_paths(name)
            if known and value not in known:
                return f"; the argument {name} is {value!r}{_listed(known)}"
        return ""

    def _declared(self, missing: str) -> str:
        """Return the arguments that the files declare, with defaults and the values they know."""
        words = []
        for name, default in self._defaults().items():
            if "$" in default:  # worked out of others
                words.append(name)
                continue
            known = set[str]() if name == missing else self._in_paths(name)
            words.append(f"{name}:={default}" + (f" ({_listed(known)[2:]})" if known else ""))
        return f"; arguments and their defaults: {', '.join(words)}" if words else ""

    def _defaults(self) -> dict[str, str]:
        """Return the defaults of the arguments that the files read so far declare."""
        found: dict[str, str] = {}
        for file in dict.fromkeys((self.file, *self._read)):
            text = re.sub(r"<!--.*?-->", "", file.read_text("utf-8", "replace"), flags=re.DOTALL)
            for tag in re.findall(r"<xacro:arg\s[^>]*>", text):
                given = {name: one or other for name, one, other in _ATTRIBUTE.findall(tag)}
                if "name" in given:
                    found.setdefault(given["name"], given.get("default", ""))
        return found

    @property
    def files(self) -> list[str]:
        """The files that were read."""
        return list(dict.fromkeys(map(str, (self.file, *self._read))))

    def _texts(self) -> list[str]:
        files = (*self._read, *islice(self.file.parent.rglob("*.xacro"), _MOST_FILES))
        return [file.read_text("utf-8", "replace") for file in dict.fromkeys(files)]

    def _compared(self, argument: str) -> set[str]:
        """Return the values that expressions compare an argument with."""
        pattern = rf"""\b{argument}\b\)?\}}?['"]?\s*==\s*['"]?(\w+)"""
        return {value for text in self._texts() for value in re.findall(pattern, text)}

    def _in_paths(self, argument: str) -> set[str]:
        """Return the values of an argument that, in paths of the files, give existing files."""
        ours, found = (f"$(arg {argument})", f"${{{argument}}}"), set()
        places = {
            each for text in self._texts() for each in re.findall(r'"(\$\(find [^"]*)"', text)
        }
        for place in places:
            whole = re.sub(r"\$\(find (\S+)\)", lambda name: self.package(name[1]), place)
            parts = re.split(r"(\$\(arg \w+\)|\$\{\w+\})", whole)
            folder = Path(parts[0].rpartition("/")[0])
            if len(parts) < 2 or not set(ours) & set(parts) or not self._is_below(folder):
                continue
            known = [("([^/]*)" if part in ours else "[^/]*") if index % 2 else re.escape(part)
                     for index, part in enumerate(parts)]  # fmt: skip
            shape = "*".join(parts[::2])[len(f"{folder}/") :]
            files = islice(folder.glob(shape), _MOST_FILES)
            found |= {match[1] for file in files if (match := re.match("".join(known), str(file)))}
        return found

    def _is_below(self, path: Path) -> bool:
        return any(path.resolve().is_relative_to(folder) for folder in self._folders)

    def allowed(self, name: str) -> str:
        """Return the path of a file, or a pattern of files, that may be read.

        Raises:
            ValueError: it is outside of the folders, or no regular file.
        """
        if name.startswith(_MISSING):
            package = name.removeprefix(_MISSING).split("/")[1]
            raise ValueError(
                f"no folder {package!r} with a package.xml above or beside the file, or in its"
                f" repository, for $(find {package}); --include, robot.include, {INCLUDE},"
                " AMENT_PREFIX_PATH and ROS_PACKAGE_PATH may name more folders"
            )
        path = Path(name).resolve()
        if not self._is_below(path):
            raise ValueError(
                f"{name}: must be below {self._folders[0]}, or a folder that {INCLUDE} names"
            )
        if path.exists() and not path.is_file():
            raise ValueError(f"{name}: is not a regular file")
        if path.exists():
            self._read.append(path)
        return str(path)


def _listed(known: set[str]) -> str:
    return f"; its files know {', '.join(sorted(known)[:30])}" if known else ""


def _safe_xacro(folders: _Folders) -> Any:
    """Return the package xacro with its functions for evaluation and file access replaced."""
    import xacro

    parse, abs_filename = xacro.parse, xacro.abs_filename_spec

    def extension(text: str) -> str:
        """Return the value of ``$(find …)``, ``$(arg …)`` and the like."""
        command, _, rest = text[2:-1].strip().partition(" ")
        return _extension(xacro, folders, command, rest.strip())

    def value(text: str, names: Any, _locals: Any = None) -> Any:
        """Return the value of an expression; the root of its names are those of all files."""
        _keep_allowed(getattr(names, "root", names))
        return _evaluate(text, names)

    ours = {
        "safe_eval": value,
        "parse": lambda given, filename=None: parse(given, folders.allowed(filename)),
        "abs_filename_spec": lambda name: folders.allowed(abs_filename(name)),
        "eval_extension": extension,
    }
    for name, function in ours.items():
        getattr(xacro, name)  # a version without it would evaluate in another way
        setattr(xacro, name, function)
    return xacro


def _keep_allowed(symbols: Any) -> Any:
    """Return xacro's global symbols without those that may not be used."""
    for namespace, names in ((symbols, _NAMES), (symbols["python"], _PYTHON),
                             (symbols["xacro"], _XACRO)):  # fmt: skip
        for name in set(namespace) - names:
            dict.pop(namespace, name)
    return symbols


def _extension(xacro: Any, folders: _Folders, command: str, rest: str) -> str:
    arguments = folders.arguments = xacro.substitution_args_context["arg"]
    match command:
        case "find":
            return folders.package(rest)
        case "arg":
            if rest not in arguments:
                raise ValueError(f"Undefined substitution argument {rest}: {rest}:=… gives it")
            return str(arguments[rest])
        case "cwd":
            return str(Path.cwd())
        case "dirname":
            return str(folders.file.parent)
        case "optenv":
            return rest.partition(" ")[2]
        case "eval":
            table = xacro.Table()  # turns numbers and truth values into such
            for name, text in arguments.items():
                table[name] = text
            given = dict(dict.items(table))  # as they are: the table would evaluate expressions
            functions = {"true": True, "false": False, "find": folders.package, "arg": given.get}
            symbols = _keep_allowed(xacro.create_global_symbols())
            return str(_evaluate(rest, {**symbols, **functions, **given}))
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
