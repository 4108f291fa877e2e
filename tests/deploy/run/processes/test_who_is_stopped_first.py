"""Whom the launcher asks to stop when the user stops a run: who brings the other to its end."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from bus_schema.messages.topics import Role
from deploy.run.processes import roles
from deploy.run.processes.launcher import Launcher
from deploy.run.run_folder import RunFolder
from deploy.scenario.effective import write_scenario
from deploy.scenario.scenario import load_setup
from tests.deploy.run.processes.example_roles import records_late


class Process:
    """Ends when it is asked to, or when the plant was."""

    def __init__(self, role: Role, asked: list[Role]) -> None:
        self.role, self._asked = role, asked
        self.has_started = threading.Event()

    def ask_to_stop(self) -> None:
        self._asked.append(self.role)

    def is_running(self) -> bool:
        return not {self.role, Role.PLANT} & set(self._asked)

    def is_frozen(self) -> bool:
        return False

    def kill(self) -> None:
        pass

    def failure(self) -> None:
        return None


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [("paper_arm", [Role.PLANT]), ("paper_arm_can", [Role.CONTROLLER, Role.PLANT])],
)
def test_over_can_the_master_of_the_drives_is_stopped_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenario: str, expected: list[Role]
) -> None:
    """Else it would find its drives silent, and blame them."""
    asked: list[Role] = []
    launcher = Launcher(load_setup(scenario), RunFolder(tmp_path))
    monkeypatch.setattr(launcher, "_child", lambda role: Process(role, asked))
    launcher.request_stop()
    outcome = launcher.run(lambda _: None)
    assert list(dict.fromkeys(asked)) == expected
    assert outcome.interrupted
    assert outcome.failures == []


def test_a_recorder_that_starts_after_the_program_has_failed_still_writes_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A request to stop would kill it while it starts, and the run would have no recording."""
    monkeypatch.setitem(roles.ROLES, Role.RECORDER, records_late)
    setup = load_setup("paper_arm", ["controller.process=[sh, -c, exit 3]", "clock=lockstep"])
    folder = RunFolder(tmp_path)
    write_scenario(setup, folder.scenario)
    outcome = Launcher(setup, folder).run(lambda _: None)
    assert "exit code 3" in outcome.failures[0]
    assert folder.log.is_file()
