"""Runs over CAN in one process: master and drives, with python-can's virtual bus between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages.topics import PLANT_TRUTH
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.arm_plant import Mode

VIRTUAL = ("link.can.interface=virtual", "link.can.answer_timeout_s=60")
FEEDBACK = "controller.drive_feedback.enabled=true"
MOTEUS = "link.can.protocol=moteus"
CANSIMPLE = ("link.can.protocol=cansimple", "link.can.cansimple.input_torque_scale=40")


@dataclass(frozen=True)
class CanRun:
    """A finished run and the log of its frames."""

    data: RunData
    can_log: Path | None

    @cached_property
    def summary(self) -> dict[str, Any]:
        return summarise(self.data)

    @cached_property
    def faults(self) -> str:
        return "; ".join(self.data.faults())

    @cached_property
    def speed(self) -> Vector:
        """Largest joint speed at every tick, rad/s."""
        return np.abs(self.data.tables[PLANT_TRUTH.name]["velocity"]).max(axis=1)

    def at_rest_from_s(self) -> float:
        """When the arm came to rest for good."""
        times_s = self.data.times_s(PLANT_TRUTH)
        return float(times_s[np.flatnonzero(self.speed > 0.02)[-1]])

    def assert_stopped(self) -> None:
        """The run did not come to its end, and its drives hold an arm at rest without torque."""
        assert not self.summary["completed"]
        truth = self.data.tables[PLANT_TRUTH.name]
        assert truth["mode"][-1] == Mode.STOPPING
        assert not truth["torque"][-1].any()
        assert self.speed[-1] < 0.02

    @cached_property
    def logged(self) -> list[str]:
        """Each logged frame, as candump writes it."""
        assert self.can_log is not None
        return [line.split()[2] for line in self.can_log.read_text().splitlines()]

    def frames(self) -> list[tuple[int, str]]:
        """Identifier and content of each logged frame."""
        fields = [frame.replace("##1", "#").split("#") for frame in self.logged]
        return [(int(identifier, 16), content) for identifier, content in fields]

    def contents(self, identifier: int) -> list[bytes]:
        """Content of each logged frame with an identifier."""
        return [bytes.fromhex(content) for each, content in self.frames() if each == identifier]


def run_over_can(scenario: str, *overrides: str, folder: Path | None = None) -> CanRun:
    """Simulate a scenario over the virtual bus; with a folder its frames are logged there."""
    log = None if folder is None else folder / "can.log"
    setup = load_setup(scenario, [*VIRTUAL, *overrides])
    return CanRun(simulate(setup, can_log=log).data(), log)


def holds_in_one_piece(values: Sequence[float] | Vector, wanted: Vector) -> bool:
    """Whether `wanted` stands somewhere in `values`; there is more before and after a run."""
    starts = range(len(values) - len(wanted) + 1)
    return any(np.array_equal(values[start : start + len(wanted)], wanted) for start in starts)
