from __future__ import annotations

import io
import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from unittest import mock

import pytest

from deploy import cli
from deploy.cli import one_run
from deploy.run.processes import roles


@pytest.fixture(scope="session")
def funnel_hil():
    def run(*words):
        """Exit code and output of a command."""
        out, err = io.StringIO(), io.StringIO()
        with (
            mock.patch.object(sys, "argv", ["funnel-hil", *map(str, words)]),
            mock.patch.dict(os.environ, COLUMNS="200"),
            redirect_stdout(out),
            redirect_stderr(err),
            pytest.raises(SystemExit) as ended,
        ):
            cli.main()
        return ended.value.code or 0, out.getvalue() + err.getvalue()

    return run


@pytest.fixture
def import_folder(tmp_path, monkeypatch):
    """The current folder, in which Python also finds modules of the user's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.fixture
def nothing_starts(monkeypatch):
    """Whatever would start a process or a simulation fails the test."""

    def start(*_):
        pytest.fail("something was started")

    monkeypatch.setattr(one_run, "execute", start)
    for name in ("ControlLoop", "PlantLoop", "run_recorder"):
        monkeypatch.setattr(roles, name, start)
