"""Commands in processes forked from one that has the program loaded."""

from __future__ import annotations

import os
import subprocess
import sys
import time
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


PREPARED = """
import os
from multiprocessing import forkserver
from deploy.processes.command_process import prepare, start

prepare()
pid = forkserver._forkserver._forkserver_pid
command = start(["plant", "--help"])
print(command.stdout.read().split()[0])
assert forkserver._forkserver._forkserver_pid == pid
print(pid)
"""


FROZEN = """
import os, signal, threading
from multiprocessing import forkserver
from deploy.processes.command_process import prepare, start, thaw

signal.signal(signal.SIGTERM, lambda *_: thaw())
prepare()
os.kill(forkserver._forkserver._forkserver_pid, signal.SIGSTOP)
threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGTERM)).start()
print(start(["plant", "--help"]).stdout.read().split()[0])
"""


def test_request_to_stop_ends_the_wait_for_a_frozen_fork_server():
    done = subprocess.run(
        [sys.executable, "-c", FROZEN], capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "Usage:\n", done.stderr


KILLED = """
import os, signal, sys
from deploy.processes.command_process import start

command = start(["record", "paper_arm", "--log", sys.argv[1]])
command.stdout.readline()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_killed_command_leaves_no_socket_folder(tmp_path):
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    words = [sys.executable, "-c", KILLED, str(tmp_path / "run.mcap")]
    subprocess.run(words, env={**os.environ, "TMPDIR": str(temporary)}, timeout=60)
    give_up_s = time.monotonic() + 60.0
    while left := list(temporary.glob("pymp-*")):
        assert time.monotonic() < give_up_s, left
        time.sleep(0.05)


def test_what_processes_are_forked_from_can_load_before_it_is_needed():
    done = subprocess.run(
        [sys.executable, "-c", PREPARED], capture_output=True, text=True, check=True
    )
    usage, pid = done.stdout.splitlines()
    assert usage == "Usage:"
    assert ends(int(pid))


@pytest.mark.parametrize("words", [["--set", "rate_hz=fast"], ["nowhere"]])
def test_refused_run_leaves_nothing_behind_that_would_be_forked_from(tmp_path, words):
    """Not even what loaded the program for it meanwhile: a word in its environment tells it."""
    word = f"REFUSED_IN={tmp_path}"
    environment = os.environ | dict([word.split("=")])
    done = subprocess.run(
        [sys.executable, "-m", "deploy.cli", "run", *words, "--out", str(tmp_path / "run")],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    left = [
        int(folder.name)
        for folder in Path("/proc").iterdir()
        if folder.name.isdecimal() and word.encode() in _environment(folder)
    ]
    assert all(ends(pid) for pid in left)


def _environment(process: Path) -> bytes:
    try:
        return (process / "environ").read_bytes()
    except OSError:  # it has ended, or is another user's
        return b""


def ends(pid: int) -> bool:
    """Whether a process ends by itself."""
    give_up_s = time.monotonic() + 60.0
    while not _has_ended(pid) and time.monotonic() < give_up_s:
        time.sleep(0.02)
    return _has_ended(pid)


def _has_ended(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"  # in a container there may be nobody to take note of it


KILLED_WHILE_ASKED = """
import os, signal, threading
from multiprocessing import forkserver
from deploy.processes.command_process import start

command = start(["plant", "--help"])
print(command.stdout.read().split()[0])
pid = forkserver._forkserver._forkserver_pid
os.kill(pid, signal.SIGSTOP)  # so that it cannot answer before it is killed
threading.Timer(3, os.kill, (pid, signal.SIGKILL)).start()
try:
    start(["plant", "--help"])
except OSError as error:  # which ends commands with one message
    print(error)
os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
print(start(["plant", "--help"]).stdout.read().split()[0])
"""


def test_a_fork_server_that_is_killed_is_named_and_replaced():
    done = subprocess.run(
        [sys.executable, "-c", KILLED_WHILE_ASKED], capture_output=True, text=True, check=True,
        timeout=120,
    )  # fmt: skip
    usage, error, again = done.stdout.splitlines()
    assert usage == again == "Usage:"
    assert error == "what this run's processes are forked from was killed"
