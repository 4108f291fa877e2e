from __future__ import annotations

import sys

import pytest

from deploy import cli


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
