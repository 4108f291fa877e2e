"""Whichever process of a run compiles numerical kernels, people are told so, once."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

from rich.console import Console

import deploy
from bus_schema.runtime.compiled import COMPILES, HAS_SAID
from deploy.cli.terminal.progress import CommandProgress
from deploy.cli.terminal.show_run import status_handler
from deploy.processes.status import StatusMessage

ROOT = Path(deploy.__file__).parent.parent
LAW = """
from bus_schema.runtime.compiled import compiled
from controller.control_law import Diagnostics

@compiled
def spring(error):
    return -50.0 * error

class Spring:
    def __init__(self, model):
        self.diagnostics = Diagnostics(model.joints)

    def reset(self):
        pass

    def torque(self, tracking):
        return spring(tracking.error)
"""


def test_a_run_says_what_only_one_of_its_processes_compiles(tmp_path):
    (tmp_path / "compiled_law.py").write_text(LAW)
    path = os.pathsep.join([str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    del environment[HAS_SAID]
    changes = [
        "controller.law=compiled_law:Spring", "clock=lockstep", "duration_s=0.02",
        "metrics.from_s=0", "link.reply_timeout_s=100",
    ]  # fmt: skip
    words = [word for change in changes for word in ("--set", change)]
    done = subprocess.run(
        [sys.executable, "-m", "deploy.cli", "run", "paper_arm", "--no-report",
         "--out", str(tmp_path / "run"), *words],
        env=environment, capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert (done.stdout + done.stderr).count(COMPILES) == 1


def test_what_several_processes_compile_is_said_once(monkeypatch):
    monkeypatch.delenv(HAS_SAID)
    console = Console(file=io.StringIO(), width=200)
    with CommandProgress(console, "arm", 8, "s") as progress:
        handle = status_handler(progress)
        for role in ("plant", "controller"):
            handle(StatusMessage(role, "compiles", {}))
    assert console.file.getvalue().splitlines() == [COMPILES]
