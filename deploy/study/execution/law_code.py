"""The code of a custom law: its modules, the files that they name, and what is not seen of it.

A law can be known if all of it is Python source that imports only libraries which compute. Such a
law opens files in Python, where `files_read` sees them. Any other law may read the environment, the
clock, folders, devices, or files that a library or another process opens: that is not seen.
"""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from pathlib import Path
from string import Formatter

from bus_schema.user_files import read_bytes
from controller.laws.read_files import is_of_the_user

INSTALLED, MISSING = "installed", "missing"
COMPUTING = frozenset({
    "__future__", "abc", "bisect", "cmath", "collections", "contextlib", "copy", "csv",
    "dataclasses", "decimal", "enum", "fractions", "functools", "heapq", "itertools", "json",
    "logging", "math", "numbers", "numba", "numpy", "operator", "pathlib", "random", "re", "scipy",
    "statistics", "string", "struct", "textwrap", "tomllib", "typing", "typing_extensions",
    "warnings", "yaml", "bus_schema", "controller", "funnel_hil",
})  # fmt: skip
"""Packages that read nothing but files that Python opens, except by the names below."""
_READING_MORE = frozenset({
    "__builtins__", "__import__", "breakpoint", "compile", "ctypeslib", "cwd", "environ",
    "environb", "eval", "exec", "exists", "expanduser", "f2py", "getenv", "glob", "group", "home",
    "input", "is_block_device", "is_char_device", "is_dir", "is_fifo", "is_file", "is_junction",
    "is_mount", "is_socket", "is_symlink", "iterdir", "lstat", "objmode", "owner", "readlink",
    "resolve", "rglob", "samefile", "stat", "walk",
    "_os", "_sys", "builtins", "ctypes", "importlib", "os", "posix", "socket", "subprocess", "sys",
    "CLoader", "Loader", "UnsafeLoader", "allow_pickle", "dictConfig", "fileConfig", "unsafe_load",
    "unsafe_load_all",
    "__dict__", "__getattr__", "__getattribute__", "__globals__", "attrgetter", "f_builtins",
    "f_globals", "f_locals", "get_field", "globals", "locals", "methodcaller", "vars", "vformat",
})  # fmt: skip
"""Names with which code reads more than the contents of files, or runs other code.

In this order: reading, modules that other modules have imported, data that runs code, and names
that are made of text.
"""
_FORMATTING = {"format", "format_map"}
"""Methods that read the attributes named in a text, as in ``"{0.environ}"``."""
_ADDRESS, _WORD = re.compile(r"\w+://"), re.compile(r"\w+")


@dataclass
class LawCode:
    """The modules of a law.

    Attributes:
        places: file of each module by its name, or `INSTALLED` or `MISSING`.
        packages: installed packages that it imports.
        files: its modules' files, each with the texts in it, which may name other files.
        unseen: what it uses that may read something unseen.
    """

    places: dict[str, str] = field(default_factory=dict)
    packages: set[str] = field(default_factory=set)
    files: dict[Path, list[str]] = field(default_factory=dict)
    unseen: set[str] = field(default_factory=set)


def code_of(module: str) -> LawCode:
    """Return the code of a module and of all modules of the user that it imports, also later."""
    code, left = LawCode(), [module]
    while left:
        name = left.pop()
        if name in code.places:
            continue
        left += [name.rpartition(".")[0]] if "." in name else []
        place = code.places[name] = _place_of(name)
        if place == INSTALLED:
            package = name.partition(".")[0]
            code.packages.add(package)
            code.unseen |= {package} - COMPUTING
        elif place != MISSING:
            left += _add(code, name, Path(place))
    if code.places[module] == MISSING:
        code.unseen.add(module)
    return code


def _place_of(name: str) -> str:
    """Return the file of a module, or the one that an import would find; else why there is none."""
    if (module := sys.modules.get(name)) is not None:
        folder = next(iter(getattr(module, "__path__", ())), None)
        file = getattr(module, "__file__", None) or folder
    else:
        file = _found(name)
    if file is None:
        return INSTALLED if name.partition(".")[0] in sys.stdlib_module_names else MISSING
    return str(Path(file).absolute()) if is_of_the_user(file) else INSTALLED


def _found(name: str) -> str | None:
    """Return the file or folder from which a module would be imported; no package is imported."""
    folders, found = None, None
    for end in (*(place for place, each in enumerate(name) if each == "."), len(name)):
        found = PathFinder.find_spec(name[:end], folders)
        if found is None:
            return None
        folders = list(found.submodule_search_locations or ())
    return None if found is None else found.origin or next(iter(folders or ()), None)


def _add(code: LawCode, name: str, file: Path) -> list[str]:
    """Add a module's file; return the names that it imports."""
    if file.is_dir():  # a package without a file of its own
        return []
    texts = code.files[file] = [
        str(each) for each in vars(sys.modules.get(name, sys)).values() if isinstance(each, Path)
    ]
    try:
        tree = ast.parse(read_bytes(file))
    except (OSError, SyntaxError, ValueError):
        code.unseen.add(f"{file.name}, which is not Python source")
        return []
    package, imported = name if file.stem == "__init__" else name.rpartition(".")[0], list[str]()
    known = set[ast.AST]()  # walked before their own turn
    for node in ast.walk(tree):
        match node:
            case _ if node in known:
                pass
            case ast.Constant(value=str(text)):
                texts.append(text)
                is_elsewhere = text[:1] == "/" and not is_of_the_user(text)
                code.unseen |= {text} if is_elsewhere or _ADDRESS.match(text) else set()
                code.unseen |= _words_of_fields(text) & _READING_MORE
            case ast.Call(
                func=ast.Name(id="getattr") as function,
                args=[_, ast.Constant(value=named), *_],
            ) if named not in _READING_MORE | _FORMATTING:
                known.add(function)
            case ast.Attribute(value=ast.Constant(), attr=used) if used in _FORMATTING:
                pass  # its text is a constant
            case ast.Name(id=used) | ast.Attribute(attr=used) | ast.keyword(arg=str(used)):
                code.unseen |= {used} & (_READING_MORE | _FORMATTING | {"getattr"})
            case ast.MatchClass(kwd_attrs=used_ones):
                code.unseen |= {*used_ones} & _READING_MORE
            case ast.Import(names=names):
                imported += [alias.name for alias in names]
            case ast.ImportFrom(names=names):
                code.unseen |= {alias.name for alias in names} & _READING_MORE
                imported += _imported_from(node, package)
    return imported


def _words_of_fields(text: str) -> set[str]:
    """Return the words in the fields of a text to format, such as attributes that it reads."""
    try:
        fields = [f"{field} {more}" for _, field, more, _ in Formatter().parse(text)]
    except ValueError:
        return set()
    return set(_WORD.findall(" ".join(fields)))


def _imported_from(node: ast.ImportFrom, package: str) -> list[str]:
    """Return the module of ``from … import …``, and its parts, which may be modules as well."""
    try:
        name = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
    except ImportError:
        return []
    return [name, *(f"{name}.{alias.name}" for alias in node.names if alias.name != "*")]
