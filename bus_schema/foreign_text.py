"""Text of others, as it may go to terminals, XML and Markdown."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence

_ESCAPE = re.compile(
    r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"  # CSI: colours, cursor
    r"|(?:\x1b[\]PX^_]|[\x9d\x90\x98\x9e\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)"  # OSC, …
    r"|\x1b[ -/]*[0-~]?"
)
_INVISIBLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ufffe\uffff]"
)
_BYTES = re.compile(r"[\ud800-\udfff]")


def printable(text: str) -> str:
    """A text without escape sequences, and with � for each other control character.

    Line feeds and tabs stay. A byte of a file's name that is no text is shown as its number.
    """
    return _INVISIBLE.sub("\ufffd", _ESCAPE.sub("", _BYTES.sub(_number, text)))


def in_one_line(text: str) -> str:
    """A text with line feeds and other invisible characters as in Python's strings."""
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


def shortened(text: str, longest: int = 120) -> str:
    """A text in one line, without the rest of a long one."""
    line = in_one_line(text[: longest + 1])
    return line if len(line) <= longest else line[: longest - 3] + "..."


def quoted(text: str) -> str:
    """A text in one line and in quotes, without the rest of a long one."""
    return shortened(repr(text))


def _number(match: re.Match[str]) -> str:
    return f"\\u{ord(match[0]):04x}"


def say(text: str, *, err: bool = False) -> None:
    """Print a text of others, and leave out what would act on the terminal."""
    print(printable(text), file=sys.stderr if err else sys.stdout)


def markdown_cell(text: str) -> str:
    """A text for one cell of a Markdown table, which ends at no `|` and no line feed in it."""
    return " ".join(printable(text).split()).replace("|", "\\|")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, with a line feed at its end."""
    lines = [list(header), ["---"] * len(header), *(map(markdown_cell, row) for row in rows)]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
