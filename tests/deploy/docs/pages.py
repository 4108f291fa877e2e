"""The pages of the documentation and their code blocks, as tests read them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.warm_process import ROOT

DOCS = ROOT / "deploy" / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
_BLOCK = re.compile(r"((?:<!-- test [^>]*-->\n)*)```([^\n]*)\n(.*?)```", re.DOTALL)
_NOTE = re.compile(r"<!-- test (runs in the background|adds|exits|skips)(?:, adds)?: (.*?) -->")


class Block(NamedTuple):
    """A code block: its language or directive, its text, and what comments before it say.

    ``test adds: OPTIONS`` gives each command of funnel-hil more options, ``test runs in the
    background, adds: OPTIONS`` does not wait for its end, ``test exits: CODE`` expects another exit
    code than 0, and ``test skips: REASON`` leaves the block out.
    """

    language: str
    text: str
    notes: dict[str, str]


def blocks(page: Path) -> Iterator[Block]:
    """All code blocks of a page, in their order."""
    for notes, language, text in _BLOCK.findall(page.read_text()):
        yield Block(language.strip(), text, dict(_NOTE.findall(notes)))


def block(page: str, language: str, containing: str) -> str:
    """The only block of a page in a language that has a text in it, without a caption."""
    found = [b.text for b in blocks(DOCS / page) if language in b.language and containing in b.text]
    (only,) = found
    return re.sub(r"\A:caption: .*\n\n", "", only)


def commands(text: str) -> Iterator[list[str]]:
    """The words of each command of a shell block."""
    for line in text.replace("\\\n", " ").splitlines():
        if words := shlex.split(line, comments=True):
            yield words
