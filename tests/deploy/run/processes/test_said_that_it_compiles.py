"""Whichever process of a run compiles numerical kernels, people are told so, once."""

from __future__ import annotations

import io

from rich.console import Console

from bus_schema.runtime.compiled import COMPILES, HAS_SAID
from deploy.cli.terminal.progress import CommandProgress
from deploy.cli.terminal.show_run import status_handler
from deploy.run.processes.status import StatusMessage


def test_what_several_processes_compile_is_said_once(monkeypatch):
    monkeypatch.delenv(HAS_SAID)
    console = Console(file=io.StringIO(), width=200)
    with CommandProgress(console, "arm", 8, "s") as progress:
        handle = status_handler(progress)
        for role in ("plant", "controller"):
            handle(StatusMessage(role, "compiles", {}))
    assert console.file.getvalue().splitlines() == [COMPILES]
