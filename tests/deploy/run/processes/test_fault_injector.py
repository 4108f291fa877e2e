"""Process faults: each is done once, however often the plant comes to it."""

from __future__ import annotations

import signal

import pytest

from bus_schema.messages.topics import Role
from deploy.run.processes import fault_injector
from deploy.run.processes.fault_injector import ProcessFaultInjector
from plant_emulator.faults.fault import FaultScheduler
from plant_emulator.faults.kinds import parse_fault
from plant_emulator.faults.process_faults import process_actions

S = 1_000_000_000
FROZEN_TWICE = [
    {"kind": "process_frozen", "target": "controller", "at_s": at_s, "for_s": 0.5}
    for at_s in (1, 3)
]


class Process:
    """A process that is there until it is killed."""

    def __init__(self) -> None:
        self.signals: list[str] = []
        self.runs = True

    def is_running(self) -> bool:
        return self.runs

    def is_frozen(self) -> bool:
        return self.signals[-1] == "SIGSTOP"

    def kill(self) -> None:
        self.runs = False

    def send(self, number: signal.Signals) -> None:
        self.signals.append(number.name)


class Run:
    """Processes, and what a plant asks for to be done to them."""

    def __init__(self) -> None:
        self.processes = {role: Process() for role in Role}
        self.started: list[Role] = []
        self.injector = ProcessFaultInjector(self.processes, self.started.append)

    def play(self, faults: list[dict[str, object]], until_ns: int) -> None:
        """Let a plant go through its schedule from the beginning."""
        parsed = [parse_fault(fault) for fault in faults]
        schedule = FaultScheduler(process_actions(parsed, self.injector.request))
        for now_ns in range(0, until_ns + 1, S // 2):
            schedule.run_due(now_ns)


def test_fault_that_is_repeated_happens_every_time() -> None:
    run = Run()
    run.play(FROZEN_TWICE, until_ns=5 * S)
    assert run.processes[Role.CONTROLLER].signals == ["SIGSTOP", "SIGCONT"] * 2


def test_plant_that_was_restarted_does_not_repeat_what_was_done() -> None:
    run = Run()
    run.play(FROZEN_TWICE, until_ns=2 * S)
    run.play(FROZEN_TWICE, until_ns=2 * S)
    assert run.processes[Role.CONTROLLER].signals == ["SIGSTOP", "SIGCONT"]
    run.play(FROZEN_TWICE, until_ns=5 * S)
    assert run.processes[Role.CONTROLLER].signals == ["SIGSTOP", "SIGCONT"] * 2


def test_fault_of_the_plant_ends_by_the_clock_on_the_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_ns = [0]
    monkeypatch.setattr(fault_injector.time, "monotonic_ns", lambda: wall_ns[0])
    run = Run()
    run.play([{"kind": "process_frozen", "target": "plant", "at_s": 1, "for_s": 2}], until_ns=S)
    for wall_ns[0], signals in ((2 * S - 1, ["SIGSTOP"]), (2 * S, ["SIGSTOP", "SIGCONT"])):
        run.injector.run_due()
        assert run.processes[Role.PLANT].signals == signals
