"""What a tick costs: bare physics, simulation, and the loop over Zenoh in lockstep."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bus_schema.events import EventKind
from deploy.benchmarks.measure import Measurement, interleave
from deploy.benchmarks.ping_pong import PingPong
from deploy.experiments.simulate import simulate
from deploy.launcher import Launcher, with_free_endpoints
from deploy.run_folder import RunFolder, load_run
from deploy.scenario import Setup, load_setup
from plant_emulator.pybullet_arm import PybulletArm

BARE_PHYSICS = "bare pybullet calls per tick"
SIMULATE = "simulate per tick"
PING_PONG = "bare Zenoh ping-pong"
LOCKSTEP = "lockstep over Zenoh per tick"
_EXCHANGES = 1000
_REPETITIONS = 5


@dataclass(frozen=True)
class LoopCosts:
    """Costs of a tick, and the two ratios that matter."""

    measurements: dict[str, Measurement]

    @property
    def simulate_to_physics(self) -> float:
        """Simulation over the pybullet calls that it cannot do without."""
        return self._us(SIMULATE) / self._us(BARE_PHYSICS)

    @property
    def lockstep_to_parts(self) -> float:
        """Lockstep over Zenoh against ping-pong plus simulation."""
        return self._us(LOCKSTEP) / (self._us(PING_PONG) + self._us(SIMULATE))

    def as_dict(self) -> dict[str, Any]:
        return {
            "measurements_us": {name: vars(value) for name, value in self.measurements.items()},
            "simulate_to_physics": self.simulate_to_physics,
            "lockstep_to_parts": self.lockstep_to_parts,
        }

    def _us(self, name: str) -> float:
        return self.measurements[name].median_us


def measure_loop_costs(scenario: str, seconds: float = 2.0) -> LoopCosts:
    """Measure a scenario.

    Args:
        scenario: name or path.
        seconds: length of each simulated run on the run's clock.
    """
    overrides = [f"duration_s={seconds}", "clock=lockstep", "plant.gui=false"]
    setup = load_setup(scenario, with_free_endpoints(overrides))
    link = load_setup(scenario, with_free_endpoints(overrides)).scenario.link
    with PingPong(link, setup.robot.joint_names) as ping_pong:
        return LoopCosts(
            interleave(
                {
                    BARE_PHYSICS: lambda: bare_physics_us(setup),
                    SIMULATE: lambda: simulate_us(setup),
                    PING_PONG: lambda: ping_pong.round_trip_us(_EXCHANGES),
                    LOCKSTEP: lambda: lockstep_us(setup),
                },
                _REPETITIONS,
            )
        )


def bare_physics_us(setup: Setup) -> float:
    """Cost of the pybullet calls of one tick: set torques, step and read, for each substep."""
    arm = PybulletArm(setup.robot, setup.grid.substep_s)
    arm.place(setup.start_position_rad)
    torque = [0.0] * setup.robot.joints
    substeps = setup.ticks * setup.grid.substeps
    started_ns = time.perf_counter_ns()
    for _ in range(substeps):
        arm.step_bare(torque)
    cost_us = (time.perf_counter_ns() - started_ns) / setup.ticks * 1e-3
    arm.close()
    return cost_us


def simulate_us(setup: Setup) -> float:
    """Cost of one tick of a simulation, all messages kept."""
    return _wall_us(simulate(setup).data().plant_event(EventKind.ENDED), setup)


def lockstep_us(setup: Setup) -> float:
    """Cost of one tick of a run with three processes in lockstep, everything recorded."""
    with TemporaryDirectory() as path:
        folder = RunFolder.create(setup.scenario.name, Path(path))
        folder.write_scenario(setup)
        failures = Launcher(setup, folder).run(lambda _: None).failures
        if failures:
            raise RuntimeError("; ".join(failures))
        return _wall_us(load_run(folder.path)[0].plant_event(EventKind.ENDED), setup)


def _wall_us(ended: Any, setup: Setup) -> float:
    return float(ended.values()["wall_s"]) / setup.ticks * 1e6
