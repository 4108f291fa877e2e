"""A few runs in a row leave nothing behind but their folders; what is left is found."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

from scripts.benchmarks import leftovers


def test_runs_leave_nothing_behind_but_their_folders(tmp_path: Path) -> None:
    shared = tmp_path / "shared"  # in the true one there is what other tests leave meanwhile
    with mock.patch.object(leftovers, "_SHARED", shared):
        assert leftovers.run_and_look(2, tmp_path) == []
    assert (tmp_path / "runs" / "1" / "summary.json").is_file()


def test_what_is_left_behind_is_found(tmp_path: Path) -> None:
    """In place of a run, a program that leaves a file, a process and a port in use."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        started: list[subprocess.Popen[bytes]] = []

        def untidy(*_: Any, env: dict[str, str], **__: Any) -> subprocess.CompletedProcess[str]:
            (Path(env["TMPDIR"]) / "pymp-left").mkdir()
            command = [sys.executable, "-c", "input()"]
            started.append(subprocess.Popen(command, env=env, stdin=subprocess.PIPE))
            folder = tmp_path / "runs" / "0"
            folder.mkdir(parents=True)
            (tmp_path / "runs" / "0.lock").touch()
            return subprocess.CompletedProcess([], 3, "", "said")

        with (
            mock.patch.object(leftovers.subprocess, "run", untidy),
            mock.patch.object(leftovers, "free_ports", return_value=[port, port]),
        ):
            found = leftovers.run_and_look(1, tmp_path)
    (process,) = started
    process.communicate()
    assert found[:2] == ["run 0 ended with 3: said", "file pymp-left"]
    assert found[-3:] == [f"port {port}", f"port {port}", "beside run folders 0.lock"]
    assert any(line.startswith(f"process {process.pid} ") for line in found)
