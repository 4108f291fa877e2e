"""Commands in processes forked from one that has the program loaded."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.processes.command_process import start


@pytest.mark.parametrize("name", ["here.yaml", os.fsdecode(b"h\xe9re.yaml")])
def test_command_has_streams_folder_and_exit_code_of_its_own(tmp_path, monkeypatch, name):
    """It is refused (exit code 2) what this process would be refused, there and not here.

    A file's name need not be text: Python shows what is none as an escape.
    """
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("rate_hz: fast\n")
    command = start(["plant", name])
    assert command.stdout.read() == ""
    said = command.stderr.read()
    assert said.startswith("error: ")
    assert f"{name}: rate_hz = 'fast'".encode(errors="backslashreplace").decode() in said
    command.process.join()
    assert command.process.exitcode == 2


def test_command_is_told_by_its_command_line(tmp_path):
    """`ps`, and whoever looks for the controller of a run, sees what was started."""
    words = ["record", "paper_arm", "--log", str(tmp_path / "run.mcap")]
    command = start(words)
    assert command.stdout.readline()  # its first message: it has begun
    line = Path(f"/proc/{command.process.pid}/cmdline").read_bytes().decode()
    session = os.getsid(command.process.pid)
    command.process.terminate()
    command.process.join()
    assert f"-m deploy.cli {' '.join(words)} --to-parent " in line
    assert session == command.process.pid  # a terminal's signals are not for it


KILLED_WHILE_ASKED = """
import os, signal, threading
from multiprocessing import forkserver
from deploy.processes.command_process import start

command = start(["--version"])
print(command.stdout.read().strip())
pid = forkserver._forkserver._forkserver_pid
os.kill(pid, signal.SIGSTOP)  # so that it cannot answer before it is killed
threading.Timer(3, os.kill, (pid, signal.SIGKILL)).start()
try:
    start(["--version"])
except OSError as error:  # which ends commands with one message
    print(error)
os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
print(start(["--version"]).stdout.read().strip())
"""


def test_a_fork_server_that_is_killed_is_named_and_replaced():
    done = subprocess.run(
        [sys.executable, "-c", KILLED_WHILE_ASKED], capture_output=True, text=True, check=True,
        timeout=120,
    )  # fmt: skip
    version, error, again = done.stdout.splitlines()
    assert version == again
    assert error == "what this run's processes are forked from was killed"
