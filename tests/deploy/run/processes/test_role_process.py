"""Roles in processes forked from one that has the program loaded."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deploy.run.processes.role_process import start_role
from deploy.run.processes.roles import RoleOptions, plant
from tests.deploy.run.processes.example_roles import loses_a_request, prints, waits
from tests.warm_process import cold_python


@pytest.mark.parametrize("name", ["here.yaml", os.fsdecode(b"h\xe9re.yaml")])
def test_role_ends_as_its_command_does(tmp_path, monkeypatch, name):
    """It is refused (exit code 2) what this process would be refused, there and not here.

    A file's name need not be text: Python shows what is none as an escape.
    """
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("rate_hz: fast\n")
    output = tmp_path / "output.log"
    process, _ = start_role("plant", plant, RoleOptions(name), tmp_path, output)
    process.join()
    text = output.read_text(errors="replace")
    assert text.startswith("error: ")
    assert f"{name}: rate_hz = 'fast'".encode(errors="backslashreplace").decode() in text
    assert process.exitcode == 2


def test_a_request_to_stop_that_could_not_be_raised_is_not_lost(tmp_path):
    process, _ = start_role("plant", loses_a_request, None, tmp_path, tmp_path / "output.log")
    process.join()
    assert process.exitcode == 130


def test_what_a_role_prints_is_no_message_and_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    output = tmp_path / "output.log"
    process, channel = start_role("plant", prints, 7, tmp_path, output)
    assert channel.recv() == ("note", {"text": str(tmp_path)})
    process.join()
    with pytest.raises(EOFError):
        channel.recv()
    assert process.exitcode == 7
    assert output.read_text() == '{"kind": "realtime"}\n'


def test_role_is_visible_in_its_command_line_and_its_output_survives_a_kill(tmp_path):
    """`ps` shows which role was started."""
    output = tmp_path / "output.log"
    process, channel = start_role("recorder", waits, None, tmp_path, output)
    channel.recv()
    line = Path(f"/proc/{process.pid}/cmdline").read_bytes().decode()
    session = os.getsid(process.pid)
    process.kill()
    process.join()
    assert line.rstrip("\0") == f"{sys.executable} -m deploy.cli recorder {tmp_path}"
    assert session == process.pid  # a terminal's signals are not for it
    assert output.read_text() == "waits\n"


SCRIPT = """
import os, signal, sys
from pathlib import Path
from deploy.run.processes import role_process
from deploy.run.processes.role_process import prepare, start_role
from tests.deploy.run.processes.example_roles import prints, waits


def server():
    return role_process._server[0].pid

def start(role=prints, options=0):
    folder = Path(sys.argv[1])
    process, channel = start_role("plant", role, options, folder, folder / "output.log")
    print(channel.recv()[0], flush=True)
"""


def script(lines: str, tmp_path: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return cold_python("-c", SCRIPT + lines, tmp_path, **environment)


@pytest.mark.parametrize("killed", ["prepare()", "start(waits)"], ids=["before", "after"])
def test_killed_command_leaves_neither_socket_nor_process(tmp_path, killed):
    """Before its processes are up, and after."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    lines = f"{killed}\nprint(server(), flush=True)\nos.kill(os.getpid(), signal.SIGKILL)"
    done = script(lines, tmp_path, TMPDIR=str(temporary))
    assert done.returncode == -signal.SIGKILL
    assert ends(int(done.stdout.split()[-1]))
    assert list(temporary.iterdir()) == []


def test_fork_servers_that_end_leave_no_descriptors(tmp_path):
    """As each is reached by one; the first to be opened is not yet to be closed."""
    lines = """
for _ in range(3):
    prepare()
    os.kill(server(), signal.SIGKILL)
    os.waitid(os.P_PID, server(), os.WEXITED | os.WNOWAIT)
    print(len(os.listdir("/proc/self/fd")))
"""
    assert len(set(script(lines, tmp_path).stdout.split())) == 1


def test_signals_of_a_terminal_do_not_reach_the_fork_server(tmp_path):
    """It is in the command's process group, and is needed until all processes have ended."""
    lines = """
prepare()
os.kill(server(), signal.SIGINT)
start()
"""
    assert script(lines, tmp_path).stdout == "note\n"


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
    return state == "Z"  # in a container no process may collect it


def test_what_starts_the_fork_server_loads_no_numerical_library() -> None:
    """The server loads them while the command goes on: a run of 1 s is a twentieth shorter."""
    loaded = "print({'numpy', 'numba'} & {*sys.modules})"
    look = f"import sys, deploy.run.processes.role_process; {loaded}"
    assert cold_python("-c", look).stdout == "set()\n"
