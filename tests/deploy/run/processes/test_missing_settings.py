"""One line names the settings that a machine refuses, with a command that grants them."""

from __future__ import annotations

import io
import os
import pwd
import subprocess

import pytest
from rich.console import Console

from bus_schema.link.configuration import DEFAULT_FOLDER, KeyFolder
from bus_schema.runtime import realtime
from deploy.cli.parts.progress import CommandProgress
from deploy.cli.show_run import status_handler
from deploy.run.processes.scheduling import missing_settings, remedy
from deploy.run.processes.status import StatusMessage


def refused(*names):
    return [vars(realtime.RealtimeSetting(name, False, f"why {name}")) for name in names]


def test_one_line_for_all_processes_of_a_run():
    out = io.StringIO()
    with CommandProgress(Console(file=out, width=300), "paper_arm", 1.0, "s") as progress:
        handle = status_handler(progress)
        for role, names in (
            ("plant", (realtime.SCHEDULER, realtime.MEMORY_LOCK, realtime.IDLE_STATES)),
            ("controller", (realtime.SCHEDULER, realtime.MEMORY_LOCK, realtime.IDLE_STATES)),
            ("recorder", (realtime.PRECEDENCE,)),
        ):
            handle(StatusMessage(role, "realtime", {"settings": refused(*names)}))
            handle(StatusMessage(role, "lacks", {"text": "works without"}))
        for time_s in (0.1, 0.2):
            handle(StatusMessage("plant", "progress", {"time_s": time_s}))
    (line,) = [line for line in out.getvalue().splitlines() if "works without" in line]
    assert "real-time scheduler, memory lock, CPU idle states, precedence:" in line
    assert "doctor --fix" in line


def test_no_warning_where_everything_is_granted():
    assert (
        missing_settings([vars(realtime.RealtimeSetting(realtime.SCHEDULER, True, "SCHED_FIFO"))])
        == ""
    )


def test_setting_that_no_permission_can_grant_is_reported_with_its_reason():
    text = missing_settings(refused(realtime.AFFINITY))
    assert "why CPU affinity" in text
    assert "--fix" not in text


def test_fix_is_a_script_for_every_right_that_is_asked_for(funnel_hil):
    output = funnel_hil.output("doctor", "--fix")
    assert output == remedy() + "\n"
    subprocess.run(["bash", "-n"], input=output, text=True, check=True)
    for part in ("rtprio 50", "memlock unlimited", "nice -10", "cpu_dma_latency", "limits.d"):
        assert part in output


def test_user_without_a_name_or_a_home_gets_the_script_and_a_sentence(monkeypatch):
    def missing(uid):
        raise KeyError(uid)

    monkeypatch.setattr(pwd, "getpwuid", missing)
    for name in ("HOME", "LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    assert f"realtime {os.getuid()}\n" in remedy()
    with pytest.raises(FileNotFoundError, match="use an absolute path"):
        KeyFolder.at(DEFAULT_FOLDER)
