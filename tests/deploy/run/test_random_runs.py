"""Invariants of runs with random bad links, limits and laws in virtual time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import JOINT_COMMANDS, PLANT_TRUTH, TOPICS, Role
from bus_schema.recording.mcap_log import read_log
from bus_schema.runtime.modes import TRANSITIONS, Mode, mode_in
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

RUNS = 40
STEPS = {(before, after) for (before, _), after in TRANSITIONS.items()}


def random_setup(random: np.random.Generator) -> Setup:
    """A short run over a random bad link, with random limits."""
    return load_setup(
        "paper_arm",
        [
            "duration_s=0.3",
            f"seed={random.integers(1, 10_000)}",
            f"controller.law={random.choice(['fixed_time_neural', 'pid', 'smc'])}",
            *(f"link.{way}={direction(random)}" for way in ("uplink", "downlink")),
            f"plant.command_timeout_ms={random.integers(5, 60)}",
            f"plant.safe_stop={random.choice(['brake', 'damping', 'zero_torque'])}",
            "plant.stop_duration_s=0.05",
            f"limits.torque_nm={random.uniform(20.0, 400.0):.3f}",
            f"limits.torque_rate_nm_s={random.choice([1e3, 1e5, 1e9])}",
            f"limits.velocity_rad_s={random.uniform(0.3, 6.0):.3f}",
            f"limits.on_velocity={random.choice(['count', 'cut', 'stop'])}",
        ],
    )


def direction(random: np.random.Generator) -> str:
    """A direction of the link, in YAML."""
    keys = {
        "delay_ms": random.uniform(0.0, 6.0),
        "jitter_ms": random.uniform(0.0, 4.0),
        "duplicate": random.choice([0.0, 0.2]),
        "loss": random.choice([0.0, 0.05, 0.3]),
        "reorder": str(bool(random.integers(2))).lower(),
    }
    if random.integers(2):
        at_s, for_s = random.uniform(0.05, 0.2), random.uniform(0.005, 0.1)
        keys["schedule"] = f"[{{kind: outage, at_s: {at_s:.4f}, for_s: {for_s:.4f}}}]"
    return "{" + ", ".join(f"{name}: {value}" for name, value in keys.items()) + "}"


@pytest.mark.parametrize("seed", range(RUNS))
def test_invariants_hold_in_random_runs(seed, tmp_path):
    simulation = simulate(random_setup(np.random.default_rng(seed)))
    run = simulation.data()
    assert_torque_is_within_limits(run)
    assert_commands_in_force_were_delivered(run)
    assert_modes_follow_the_table(run)
    simulation.write_log(tmp_path / "run.mcap")
    log = read_log(tmp_path / "run.mcap")
    assert log.complete
    assert sum(len(log.payloads[topic.name]) for topic in TOPICS) == len(simulation.payloads)


def assert_torque_is_within_limits(run: RunData) -> None:
    limit_nm = run.setup.scenario.limits.of_plant(run.setup.robot).torque_nm
    for name, field in ((PLANT_TRUTH, "torque"), (JOINT_COMMANDS, "effort")):
        torque = run.tables[name.name][field]
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= limit_nm).all()


def assert_commands_in_force_were_delivered(run: RunData) -> None:
    """Commands that arrived were refused, lost, used, out of date, or are on their way."""
    down = run.last_values(Role.PLANT, EventKind.COUNTS)["downlink"]
    unused = sum(down["rejected"].get(why, 0) for why in ("overtaken", "after_stop"))
    sequence = run.tables[PLANT_TRUTH.name]["command_sequence"]
    assert down["delivered"] - unused >= len(np.unique(sequence[sequence > 0]))
    assert down["sent"] + down["duplicated"] - down["lost"] - down["delivered"] >= 0
    assert sequence.max() <= len(run.tables[JOINT_COMMANDS.name])


def assert_modes_follow_the_table(run: RunData) -> None:
    for role, last in ((Role.PLANT, {Mode.IDLE, Mode.FAULT}), (Role.CONTROLLER, {Mode.IDLE})):
        events = (e for e in run.events if e.source == role and e.kind == EventKind.MODE)
        modes = [Mode.IDLE, *(mode_in(event.detail) for event in events)]
        assert set(pairwise(modes)) <= STEPS
        assert modes[-1] in last
    numbers = run.tables[PLANT_TRUTH.name]["mode"]
    seen = [Mode(int(mode)) for mode in numbers[np.flatnonzero(np.diff(numbers, prepend=255))]]
    assert set(pairwise(seen)) <= STEPS
