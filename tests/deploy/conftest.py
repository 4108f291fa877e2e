from __future__ import annotations

import sys

import pytest

from deploy import cli
from deploy.cli import processes as cli_processes
from deploy.cli import run as cli_run
from deploy.cli import simulate as cli_simulate


@pytest.fixture
def funnel_hil(monkeypatch, capsys):
    def run(*words):
        """Exit code and output of a command."""
        monkeypatch.setattr(sys, "argv", ["funnel-hil", *map(str, words)])
        monkeypatch.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return ended.value.code or 0, said.out + said.err

    return run


@pytest.fixture
def nothing_starts(monkeypatch):
    """Whatever would start a process or a simulation fails the test."""

    def start(*_):
        pytest.fail("something was started")

    monkeypatch.setattr(cli_run, "Launcher", start)
    monkeypatch.setattr(cli_simulate, "simulate_setup", start)
    for name in ("run_controller", "run_plant", "run_recorder"):
        monkeypatch.setattr(cli_processes, name, start)
