"""URDFs written with xacro's macros, expanded without ROS.

The file may be a stranger's. The package xacro evaluates expressions by Python's `eval` and reads
any file; so the functions by which it does are replaced here: expressions are evaluated by our own
rules, files are read below the folders of `_Expansion` only, and what a file may expand to is
limited.
"""

from __future__ import annotations

import math
import os
import re
import time
import xml.dom.minidom
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import xacro
import yaml

from bus_schema.errors import RobotDescriptionError
from bus_schema.urdf.xacro_expressions import FUNCTIONS, bounded, evaluate
from bus_schema.user_files import UserFileError, read_text

INCLUDE = "FUNNEL_HIL_INCLUDE"
"""Environment variable with more folders that files may be included from."""

_MOST_BYTES = 1_000_000
_MOST_COMMENTS = 10_000
_MOST_YAML = 100_000
_MOST_EXPANDED = 5_000_000
_ELEMENT = 100
"""What an element costs of `_MOST_EXPANDED`, as a text of so many characters does."""
_LONGEST_S = 5.0
_REFUSED = (
    xacro.XacroException, ExpatError, OSError, ValueError, TypeError, LookupError, NameError,
    AttributeError, ArithmeticError, AssertionError, SyntaxError,
)  # fmt: skip
"""What the package says, or lets through, of files that are none of xacro's."""


class _Expansion:
    """A file that is expanded: where files may be included from, and what is left to it."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        more = os.environ.get(INCLUDE, "").split(os.pathsep)
        self.folders = [self.path.parent, *(Path(each).resolve() for each in more if each)]
        self.left = _MOST_EXPANDED
        self.until_s = time.monotonic() + _LONGEST_S

    def spend(self, characters: int) -> None:
        """Take from what is left.

        Raises:
            XacroException: it is not enough.
        """
        self.left -= characters
        if self.left < 0 or time.monotonic() > self.until_s:
            raise xacro.XacroException("expands to more than an arm can be")

    def package(self, name: str) -> str:
        """The folder of a ROS package in `INCLUDE`'s folders, or at, above or beside the file.

        A folder above the file is one where it has ``package.xml``.

        Raises:
            RobotDescriptionError: there is none.
        """
        for folder in (*self.folders[1:], *self.path.parents):
            for candidate in (folder, folder / name):
                is_package = folder in self.folders[1:] or (candidate / "package.xml").is_file()
                if candidate.name == name and candidate.is_dir() and is_package:
                    self.folders.append(candidate.resolve())
                    return str(candidate)
        raise RobotDescriptionError(
            f"{self.path}: no folder {name!r} with a package.xml at or above it for $(find {name});"
            f" {INCLUDE} may name more folders"
        )

    def allowed(self, name: str) -> Path:
        """The path of a file to read.

        Raises:
            XacroException: it is outside of the folders.
        """
        path = Path(name).resolve()
        if not any(path.is_relative_to(folder) for folder in self.folders):
            raise xacro.XacroException(
                f"{name}: must be below {self.folders[0]}, or a folder that {INCLUDE} names"
            )
        return path


_under_way: list[_Expansion] = []


class _Loader(yaml.SafeLoader):
    """The safe loader, with the units that xacro knows."""


def _with_unit(_loader: _Loader, node: yaml.ScalarNode) -> float:
    return _UNITS[node.tag] * float(evaluate(node.value, FUNCTIONS))


_UNITS = {
    "!radians": 1.0, "!degrees": math.pi / 180.0,
    "!meters": 1.0, "!millimeters": 0.001, "!foot": 0.3048, "!inches": 0.0254,
}  # fmt: skip
for _unit in _UNITS:
    _Loader.add_constructor(_unit, _with_unit)


def is_xacro(path: Path) -> bool:
    """Whether a file is named as one with macros is."""
    return path.suffix == ".xacro"


def expanded(path: Path) -> str:
    """The URDF that a xacro file stands for, with its arguments' own defaults.

    Packages in ``$(find …)`` are folders of that name at or above the file.

    Raises:
        RobotDescriptionError: xacro refuses it; the file is named.
    """
    _under_way.append(_Expansion(path))
    try:
        return str(xacro.process_file(str(path)).toxml())
    except RecursionError as error:
        what = "macros, includes or elements are nested too deep, or without an end"
        raise RobotDescriptionError(f"{path}: xacro: {what}") from error
    except _REFUSED as error:
        said = " ".join(str(error).split())[:500]
        raise RobotDescriptionError(f"{path}: xacro: {said}") from error
    finally:
        _under_way.pop()


def _parsed(_given: None, filename: str) -> xml.dom.minidom.Document:
    """In place of xacro's: a file as a tree."""
    try:
        text = read_text(_under_way[-1].allowed(filename), _MOST_BYTES)
    except OSError as error:
        xacro.filestack.pop()
        name = filename if isinstance(error, UserFileError) else None
        raise xacro.XacroException(name, exc=error) from error
    if text.count("<!--") > _MOST_COMMENTS:
        raise xacro.XacroException(f"{filename}: has more than {_MOST_COMMENTS} comments")
    return xml.dom.minidom.parseString(text)


def _load_yaml(name: str) -> Any:
    path = _under_way[-1].allowed(xacro.abs_filename_spec(name))
    return bounded(yaml.load(read_text(path, _MOST_YAML), _Loader), _MOST_YAML)


def _argument(name: str) -> Any:
    return xacro.substitution_args_context["arg"][name]


def _refuse(*words: Any) -> None:
    raise xacro.XacroException(" ".join(map(str, words)))


def _say_nothing(*_words: Any) -> str:
    return ""


_XACRO = {
    "load_yaml": _load_yaml, "arg": _argument, "abs_filename": lambda name: _abs_filename(name),
    "dotify": dict, "tokenize": xacro.tokenize, "fatal": _refuse,
    **dict.fromkeys(("message", "warning", "error", "print_location"), _say_nothing),
}  # fmt: skip


def _extension(text: str) -> str:
    """In place of xacro's: the value of ``$(find …)``, ``$(arg …)`` and the like."""
    command, _, rest = text[2:-1].strip().partition(" ")
    rest = rest.strip()
    match command:
        case "find":
            return _under_way[-1].package(rest)
        case "arg":
            if rest not in xacro.substitution_args_context["arg"]:
                raise xacro.XacroException(f"Undefined substitution argument {rest}")
            return str(_argument(rest))
        case "cwd":
            return str(Path.cwd())
        case "dirname":
            return str(_under_way[-1].path.parent)
        case "optenv":
            return rest.partition(" ")[2]
        case "eval":
            given = {
                name: xacro.Table._eval_literal(value)
                for name, value in xacro.substitution_args_context["arg"].items()
            }
            functions = {"true": True, "false": False, "find": _under_way[-1].package}
            return str(evaluate(rest, {**FUNCTIONS, **functions, "arg": given.get, **given}))
    raise xacro.XacroException(f"$({command} {rest}) is not expanded: environment variables and"
                               " other commands are no part of an arm")  # fmt: skip


def _text(text: str, symbols: Any) -> Any:
    """In place of xacro's: a text with its expressions evaluated, of a limited length."""
    if len(text) > _MOST_YAML:
        raise xacro.XacroException(f"a text has at most {_MOST_YAML} characters")
    value = _eval_text(text, symbols)
    _under_way[-1].spend(len(value) if isinstance(value, str) else 1)
    return value


def _macro_call(node: Any, macros: Any, symbols: Any) -> bool:
    """In place of xacro's: each element passes here."""
    _under_way[-1].spend(_ELEMENT)
    return bool(_handle_macro_call(node, macros, symbols))


def _abs_filename(name: str) -> str:
    """In place of xacro's: a name to include; patterns look nowhere else either."""
    return str(_under_way[-1].allowed(_abs_filename_spec(name)))


_eval_text, _handle_macro_call = xacro.eval_text, xacro.handle_macro_call
_abs_filename_spec = xacro.abs_filename_spec
for _name, _ours in {
    "_global_symbols": {**FUNCTIONS, **_XACRO, "xacro": _XACRO},
    "safe_eval": lambda text, names, _locals=None: evaluate(text, names),
    "eval_text": _text, "handle_macro_call": _macro_call, "parse": _parsed,
    "eval_extension": _extension, "abs_filename_spec": _abs_filename,
    # Possessive: xacro's own goes through all ways to cut a word into words.
    "re_macro_arg": re.compile(xacro.re_macro_arg.pattern.replace("]+)+", "]++)++")),
}.items():  # fmt: skip
    getattr(xacro, _name)  # a version without it would have another way to evaluate
    setattr(xacro, _name, _ours)
