"""A hundred random fault schedules in virtual time: what has to hold whatever happens."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import chaos
import numpy as np
import pytest

from bus_schema.arrays import Vector
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import JOINT_COMMANDS, PLANT_TRUTH, TOPICS, Role
from bus_schema.recording.mcap_log import read_log
from bus_schema.runtime.modes import TRANSITIONS, Mode, mode_in
from deploy.processes.message_counts import GapCounter
from deploy.runs.run_data import RunData
from deploy.runs.simulate import Simulation

SCHEDULES = 100
STEPS = {(before, after) for (before, _), after in TRANSITIONS.items()}


def data_of(attacked: chaos.AttackedRun) -> RunData:
    return Simulation(attacked.setup, attacked.bus.topics, attacked.bus.payloads, None).data()


def limit_nm(attacked: chaos.AttackedRun) -> Vector:
    return attacked.setup.scenario.limits.of_plant(attacked.setup.robot).torque_nm


def modes_of(run: RunData, role: Role) -> list[Mode]:
    told = (e for e in run.events if e.source == role and e.kind == EventKind.MODE)
    modes = [mode_in(event.detail) for event in told]
    assert None not in modes
    return modes


@pytest.mark.parametrize("seed", range(SCHEDULES))
def test_what_holds_whatever_happens(seed, tmp_path):
    attacked = chaos.run_under_attack(seed)
    run = data_of(attacked)
    assert_torque_is_within_limits(attacked, run)
    assert_every_command_is_accounted_for(attacked, run)
    assert_nothing_hostile_came_into_force(attacked, run)
    assert_modes_follow_the_table(run)
    assert_recording_is_whole_and_losses_are_known(attacked, tmp_path)
    if not attacked.outcome.completed:
        assert attacked.outcome.faults


def assert_torque_is_within_limits(attacked, run):
    limit = limit_nm(attacked)
    for name, field in ((PLANT_TRUTH, "torque"), (JOINT_COMMANDS, "effort")):
        torque = run.tables[name.name][field]
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= limit).all()


def assert_every_command_is_accounted_for(attacked, run):
    """Whatever arrived was refused, lost, used, found out of date, or is on its way at the end."""
    down = run.last_values(Role.PLANT, EventKind.COUNTS)["downlink"]
    after_the_gate = {"overtaken", "after_stop"}
    rejected = {why: n for why, n in down["rejected"].items() if why not in after_the_gate}
    assert down["sent"] + sum(rejected.values()) == attacked.link.arrivals
    unused = sum(down["rejected"].get(why, 0) for why in after_the_gate)
    truth = run.tables[PLANT_TRUTH.name]
    in_force = len(np.unique(truth["command_sequence"][truth["command_sequence"] > 0]))
    came_out = down["delivered"] - unused
    assert came_out >= in_force  # two may come into force between two ticks
    on_their_way = down["sent"] + down["duplicated"] - down["lost"] - down["delivered"]
    assert on_their_way >= 0


def assert_nothing_hostile_came_into_force(attacked, run):
    """The command in force is at any tick one that the controller sent."""
    rejected = run.last_values(Role.PLANT, EventKind.COUNTS)["downlink"]["rejected"]
    refused = sum(n for why, n in rejected.items() if why not in ("overtaken", "after_stop"))
    assert refused >= attacked.link.hostile
    assert attacked.largest_nm <= limit_nm(attacked).max()  # the hostile ones ask for far more
    sent = attacked.bus.topics.count(JOINT_COMMANDS)
    assert run.tables[PLANT_TRUTH.name]["command_sequence"].max() <= sent


def assert_modes_follow_the_table(run):
    for role, last in ((Role.PLANT, {Mode.IDLE, Mode.FAULT}), (Role.CONTROLLER, {Mode.IDLE})):
        modes = [Mode.IDLE, *modes_of(run, role)]
        assert set(pairwise(modes)) <= STEPS
        assert modes[-1] in last
    numbers = run.tables[PLANT_TRUTH.name]["mode"]
    seen = [Mode(int(mode)) for mode in numbers[np.flatnonzero(np.diff(numbers, prepend=255))]]
    assert set(pairwise(seen)) <= STEPS


def assert_recording_is_whole_and_losses_are_known(attacked, tmp_path):
    bus = attacked.bus
    simulation = Simulation(attacked.setup, bus.topics, bus.payloads, None)
    simulation.write_log(tmp_path / "run.mcap")
    log = read_log(tmp_path / "run.mcap")
    assert log.complete
    assert sum(len(log.payloads[topic.name]) for topic in TOPICS) == len(bus.payloads)
    assert_losses_are_known(bus, attacked.outcome)


def assert_losses_are_known(bus, outcome):
    """A recorder that misses a fifth of all messages, but hears the last of each topic."""
    random = np.random.default_rng(len(bus.payloads))
    sent = Counter(topic.name for topic in bus.topics)
    numbers: Counter[str] = Counter()
    gaps, heard = GapCounter(), Counter()
    for topic in bus.topics:
        numbers[topic.name] += 1
        number = numbers[topic.name]
        if number == sent[topic.name] or random.random() > 0.2:
            gaps.note(topic.name, b"sender", number)
            heard[topic.name] += 1
    assert heard + gaps.missed == sent
    assert heard[PLANT_TRUTH.name] + gaps.missed[PLANT_TRUTH.name] == outcome.ticks + 1


def test_the_schedules_are_trouble_indeed() -> None:
    """Across a few schedules, every kind of trouble is really met."""
    rejected: Counter[str] = Counter()
    modes: set[Mode] = set()
    limits: Counter[str] = Counter()
    for seed in range(12):
        run = data_of(chaos.run_under_attack(seed))
        counts = run.last_values(Role.PLANT, EventKind.COUNTS)
        rejected.update(counts["downlink"]["rejected"])
        limits.update(counts["limits"])
        modes.update(modes_of(run, Role.PLANT))
    assert set(rejected) >= {
        "other_commander", "replayed", "stale", "not_finite", "malformed", "from_the_future",
        "overtaken", "after_stop",
    }  # fmt: skip
    assert modes == set(Mode)
    assert limits["velocity"] > 0
    assert limits["torque"] + limits["torque_rate"] > 0
