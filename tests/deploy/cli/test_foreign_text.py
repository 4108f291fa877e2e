"""Text of others reaches the terminal as text: no escape sequence acts, no markup is read."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from bus_schema.foreign_text import markdown_cell, printable
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import RUN_EVENTS, Role
from deploy.run.console import Console
from deploy.run.simulate import Simulation, simulate
from deploy.scenario.scenario import load_setup

TITLE, RED, CSI = "\x1b]0;stolen\x1b\\", "\x1b[31m", "\x9b2J"
HOSTILE = f"[bold]a[/nothing]{TITLE}b{RED}c{CSI}d\x01\x7f[link=http://x]e"
SHOWN = "[bold]a[/nothing]bcd��[link=http://x]e"
ACTS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@given(st.text())
def test_nothing_that_acts_on_a_terminal_is_left(text):
    assert not ACTS.search(printable(text))
    assert "\n" not in markdown_cell(text)
    assert re.search(r"(?<!\\)\|", markdown_cell(text)) is None


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (HOSTILE, SHOWN),
        ("\x1b]8;;http://x\x1b\\link\x1b]8;;\x1b\\", "link"),
        ("two\nlines\tand a tab, ü, 漢", "two\nlines\tand a tab, ü, 漢"),
        ("\x1b]0;title\x07text", "text"),
        ("\x1b]without an end", "without an end"),
        ("\x1b", ""),
        ("\x1b[", ""),
        ("\x1b(0x", "x"),
    ],
)
def test_escape_sequences_are_removed_whole(text, shown):
    assert printable(text) == shown


@pytest.mark.parametrize("is_terminal", [False, True])
def test_console_shows_foreign_text_in_lines_and_tables(is_terminal):
    out = io.StringIO()
    console = Console(file=out, width=100, force_terminal=is_terminal, highlight=False)
    table = Table("name")
    table.add_row(HOSTILE)
    console.print(HOSTILE)
    console.print(table)
    plain = re.sub(r"\x1b\[[\d;]*m", "", out.getvalue())  # the styles of the table
    assert plain.count(SHOWN) == 2
    assert not ACTS.search(plain)


def test_every_command_prints_by_this_console():
    """Rich would read markup in names; its tables are made in `deploy.reports.terminal` alone."""
    deploy = Path(__file__).parents[3] / "deploy"
    makes = [
        str(file.relative_to(deploy))
        for folder in ("cli", "run")
        for file in (deploy / folder).rglob("*.py")
        if re.search(r"rich\.console import Console|rich\.print|rich.* Table\b", file.read_text())
    ]
    assert makes == []


def test_commands_show_a_hostile_recording_and_its_tags_as_text(tmp_path, funnel_hil):
    run = simulate(load_setup("paper_arm", ["duration_s=0.05"]))
    event = RunEvent(10**7, Role.PLANT, EventKind.FAULT, HOSTILE).encode()
    folder = tmp_path / "run"
    folder.mkdir()
    Simulation(run.setup, [*run.topics, RUN_EVENTS], [*run.payloads, event], None).write_log(
        folder / "run.mcap"
    )
    output = funnel_hil("report", folder)[1]
    assert SHOWN in output
    assert not ACTS.search(output)
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | {"scenario": HOSTILE}))
    (folder / "tags.json").write_text(json.dumps({"tags": [HOSTILE]}))
    for words in (("runs", "list", tmp_path), ("runs", "tag", folder)):
        output = funnel_hil.output(*words)
        assert SHOWN in output
        assert not ACTS.search(output)
