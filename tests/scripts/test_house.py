"""Limits on the product's source that no linter checks."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("bus_schema", "controller", "plant_emulator", "deploy")
MOST_PARAMETERS, MOST_PRIVATE_NAMES = 8, 5
QUESTION_WORDS = {"How", "What", "When", "Where", "Which", "Who", "Whose", "Why"}


@cache
def sources() -> dict[str, ast.Module]:
    files = (file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py")))
    return {str(file.relative_to(ROOT)): ast.parse(file.read_text()) for file in files}


def parameters(function: ast.FunctionDef) -> int:
    """Number of parameters without `self`."""
    given = function.args
    return len([*given.posonlyargs, *given.args, *given.kwonlyargs]) - 1


def private_names(tree: ast.Module) -> Iterator[str]:
    """Names with an underscore in front that a module takes from others than our own."""
    modules: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [
                (each.asname or each.name, f"{node.module}.{each.name}") for each in node.names
            ]
        elif isinstance(node, ast.Import):
            names = [(each.asname or each.name.split(".")[0], each.name) for each in node.names]
        else:
            continue
        modules |= {name: path for name, path in names if path.split(".")[0] not in ROOMS}
    yield from (path for path in modules.values() if any(map(is_private, path.split("."))))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            root = ast.unparse(node).split(".")[0]
            if root in modules:
                yield f"{modules[root]}.{node.attr}"


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def test_no_constructor_takes_more_than_eight_parameters() -> None:
    """Data classes and pydantic models have none of their own, and may have more fields."""
    constructors = {
        f"{file}: {each.name}": parameters(method)
        for file, tree in sources().items()
        for each in ast.walk(tree)
        if isinstance(each, ast.ClassDef)
        for method in each.body
        if isinstance(method, ast.FunctionDef) and method.name == "__init__"
    }
    assert len(constructors) > 100
    assert {name: n for name, n in constructors.items() if n > MOST_PARAMETERS} == {}


def test_few_private_names_of_libraries_are_used() -> None:
    """Names that are found by their module; objects are not followed."""
    found = {name for tree in sources().values() for name in private_names(tree)}
    found -= {"os._exit", "__future__.annotations"}  # documented
    assert len(found) <= MOST_PRIVATE_NAMES, found


def test_docstrings_begin_with_a_noun_or_a_verb_and_not_with_a_question_word() -> None:
    """A docstring says what a thing is or does; the help of the program may ask its question."""
    found = {
        f"{file}: {getattr(node, 'name', 'module')}": text.partition("\n")[0]
        for file, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and (text := ast.get_docstring(node) or "").split(" ")[0] in QUESTION_WORDS
    }
    assert {name: text for name, text in found.items() if not text.endswith("?")} == {}


def test_modules_of_tests_have_names_of_their_own():
    """Pytest imports them by their last name: of two alike it leaves one out, with an error."""
    names = [file.name for file in (ROOT / "tests").rglob("test_*.py")]
    assert [name for name, count in Counter(names).items() if count > 1] == []


def test_a_drive_loop_has_one_name_in_texts() -> None:
    others = re.compile(r"drive feedback|(loops?|feedback) at the drives|drives' loop", re.I)
    files = [*(ROOT / "deploy").rglob("*.md"), *(ROOT / "deploy").rglob("*.yaml")]
    texts = {str(each): each.read_text() for each in files} | {
        file: ast.unparse(tree) for file, tree in sources().items()
    }
    assert {name: found for name, text in texts.items() if (found := others.findall(text))} == {}
