"""`controller.process` in a scenario: what displaces what, what is refused, and whose it is."""

from __future__ import annotations

import pytest

from deploy.cli.parts.common import parse_laws
from deploy.run.execute import InProcess, execute
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

PROCESS = "controller.process=[./my_controller, --gain, 3]"


def load(*overrides: str) -> Setup:
    return load_setup("paper_arm", overrides)


def test_a_process_displaces_the_law_of_the_file() -> None:
    controller = load(PROCESS).scenario.controller
    assert controller.law == "process"
    assert controller.process == ("./my_controller", "--gain", "3")


def test_a_law_that_is_set_displaces_a_process() -> None:
    controller = load(PROCESS, "controller.law=pid").scenario.controller
    assert (controller.law, controller.process) == ("pid", None)
    assert load(PROCESS, "controller.law=process").scenario.controller.process is not None
    assert parse_laws("process,pid") == ["process", "pid"]


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("[./my_controller]", "my_controller"),
        ("[build/loop.bin, fast]", "loop"),
        ("[/usr/bin/python3.11, -u, control/arm.py, --fast]", "arm"),
        ("[python, -m, arm_control]", "arm_control"),
        ("[sh, -c, 'exec ./this']", "sh"),
    ],
)
def test_it_is_called_after_its_program(command: str, name: str) -> None:
    assert load(f"controller.process={command}").scenario.controller.name == f"process: {name}"


def test_a_simulation_has_no_process() -> None:
    run = execute(load(PROCESS, "duration_s=0.1"), InProcess())
    assert "controller.law = 'process'" in str(run.data.faults())
