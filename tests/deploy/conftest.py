from __future__ import annotations

import sys

import pytest

from deploy.cli import run_and_simulate
from deploy.run.processes import roles
from tests.warm_process import here

STUDIES = {"compare", "margin", "sweep"}


class Commands:
    """Runs commands in this process; a study has one worker unless the words name another number.

    Every worker costs 2 s of CPU time to start.
    """

    def __call__(self, *words):
        """Return the exit code and the output of a command."""
        if words and words[0] in STUDIES and not {"--workers", "--scheduler"} & set(words):
            words = (*words, "--workers", "1")
        return here(*words, COLUMNS="200")

    def output(self, *words, code=0):
        """Return the output of a command that has to end with this exit code."""
        found, output = self(*words)
        assert found == code, output
        return output


@pytest.fixture(scope="session")
def funnel_hil():
    return Commands()


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

    monkeypatch.setattr(run_and_simulate, "execute", start)
    for name in ("ControlLoop", "PlantLoop", "run_recorder"):
        monkeypatch.setattr(roles, name, start)
