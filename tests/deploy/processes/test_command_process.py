"""Commands in processes forked from one that has the program loaded."""

from __future__ import annotations

import os
from pathlib import Path

from deploy.processes.command_process import start


def test_command_has_streams_session_folder_and_exit_code_of_its_own(tmp_path, monkeypatch):
    """It is refused (exit code 2) what this process would be refused, there and not here."""
    monkeypatch.chdir(tmp_path)
    Path("here.yaml").write_text("rate_hz: fast\n")
    command = start(["plant", "here.yaml"])
    assert os.getsid(command.process.pid) != os.getsid(0)  # a terminal's signals are not for it
    assert command.stdout.read() == ""
    said = command.stderr.read()
    assert said.startswith("error: ")
    assert "here.yaml: rate_hz = 'fast'" in said
    command.process.join()
    assert command.process.exitcode == 2


def test_command_is_told_by_its_command_line(tmp_path):
    """`ps`, and whoever looks for the controller of a run, sees what was started."""
    words = ["record", "paper_arm", "--log", str(tmp_path / "run.mcap")]
    command = start(words)
    assert command.stdout.readline()  # its first message: it has begun
    line = Path(f"/proc/{command.process.pid}/cmdline").read_bytes().decode()
    command.process.terminate()
    command.process.join()
    assert f"-m deploy.cli {' '.join(words)} --to-parent " in line
