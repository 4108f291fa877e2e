"""Descriptions of ended child processes."""

from __future__ import annotations

import pytest

from bus_schema.runtime.child import how_it_ended, last_line


@pytest.mark.parametrize(
    ("output", "line"),
    [("first\n  last\n\n", "last"), (b"a\xff\nb\xc3\xa9", "bé"), ("", ""), (" \n", "")],
)
def test_last_line_is_the_last_one_with_text(output: str | bytes, line: str) -> None:
    assert last_line(output) == line


@pytest.mark.parametrize(
    ("code", "words"),
    [(3, "ended with exit code 3"), (-6, "killed by SIGABRT"), (-40, "killed by signal 40")],
)
def test_exit_codes_are_described(code: int, words: str) -> None:
    assert how_it_ended(code) == words
