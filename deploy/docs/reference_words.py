"""Words and tables of the generated reference."""

from __future__ import annotations

import inspect
import re
from functools import cache
from pathlib import Path

import yaml

from bus_schema.foreign_text import markdown_table
from bus_schema.units import split_unit


def unit_of(name: str) -> str:
    """Return the unit that a name or its last part but one ends with; empty for none."""
    parts = name.split(".")[-2:]
    return next(filter(None, (split_unit(part)[1] for part in reversed(parts))), "")


def table(header: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown; docstrings have code between two backticks."""
    return markdown_table(header, [[cell.replace("``", "`") for cell in row] for row in rows])


def attributes_of(section: type) -> dict[str, str]:
    """Return the meaning of each key, from the docstrings of a class and its bases."""
    found: dict[str, str] = {}
    for each in reversed(section.__mro__):
        text = inspect.cleandoc(each.__doc__ or "").partition("Attributes:")[2]
        found |= re.findall(r"^ {1,4}(\w+): (.*(?:\n {5,}.*)*)", text, re.MULTILINE)
    return found


@cache
def meanings() -> dict[str, dict[str, str]]:
    """Return the words that the code does not have: for keys of results and for exit codes."""
    found: dict[str, dict[str, str]] = yaml.safe_load(
        Path(__file__).with_name("meanings.yaml").read_text(encoding="utf-8")
    )
    return found
