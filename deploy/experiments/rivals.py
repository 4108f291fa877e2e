"""Fair rivals: a search for the gains of a law, and how much the outcome hangs on them.

The search is a (1+1) random search from the law's present gains: all gains, per joint, are
multiplied by log-normal factors, and the result is kept if it lowers the geometric mean of the
joints' RMS errors. A candidate is admitted only if its torque never reaches the actuators' limits,
and a switching gain only if it outweighs all that the nominal model does not know, which is the
condition under which sliding exists; without it the least chattering, and so the best RMS, would
come from a sliding mode law that no longer slides.

Run as ``python -m deploy.experiments.rivals paper_arm smc --trials 100``.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from bus_schema.arrays import Vector
from controller.manipulator_model import ManipulatorModel
from deploy.experiments.metrics import summarise
from deploy.experiments.simulate import simulate
from deploy.scenario import Setup, load_setup
from deploy.scenario_text import plain
from plant_emulator.joint_torques import JointTorques

SWITCHING_RESERVE = 1.2
"""Least ratio of a switching gain to the acceleration it has to outweigh."""

_STEP = 0.35
_SAMPLES = 1000


def with_gains(setup: Setup, gains: Any) -> Setup:
    """The same scenario under the same law with other gains."""
    return replace(setup, gains=gains)


def varied(gains: Any, factor: Any) -> Any:
    """Gains with each per-joint entry multiplied by a factor; powers and widths stay.

    Args:
        gains: a NamedTuple of gains.
        factor: called with the number of joints, returns factors of shape (joints,).
    """
    values = {
        name: value * factor(value.size)
        for name, value in gains._asdict().items()
        if isinstance(value, np.ndarray)
    }
    return gains._replace(**values)


def required_switching(setup: Setup) -> Vector:
    """Largest acceleration along the reference that the nominal model misses, (joints,), rad/s².

    M̂⁻¹ times friction, disturbance and the difference between the arm's dynamics and the model's.
    """
    robot, plant = setup.robot, setup.scenario.plant
    model = setup.scenario.controller.nominal_model(robot)
    truth = ManipulatorModel(robot, payload_kg=plant.payload_kg)
    torques = JointTorques(plant, robot, setup.grid.substep_s, np.random.default_rng(0))
    position, velocity, acceleration = np.zeros((3, robot.joints))
    largest = np.zeros(robot.joints)
    for time_s in np.linspace(0.0, setup.scenario.duration_s, _SAMPLES):
        setup.reference.evaluate(float(time_s), position, velocity, acceleration)
        torques.act(np.zeros(robot.joints), velocity, float(time_s))
        missed = truth.inverse_dynamics(position, velocity, acceleration)
        missed -= model.inverse_dynamics(position, velocity, acceleration)
        missed += torques.friction + torques.disturbance
        missed = np.linalg.solve(model.mass_matrix(position), missed)
        largest = np.maximum(largest, np.abs(missed))
    return largest


def rms_rad(setup: Setup) -> Vector | None:
    """RMS error per joint, (joints,), rad; None where the run failed or reached torque limits."""
    simulation = simulate(setup)
    summary = summarise(simulation.data())
    if simulation.failure or not summary["completed"] or summary["torque"]["saturated_fraction"]:
        return None
    return np.array(summary["tracking"]["rms_rad"])


def search(setup: Setup, trials: int, seed: int) -> tuple[Any, Vector | None]:
    """Gains after so many trials, and their RMS errors; None if none was admitted."""
    random = np.random.default_rng(seed)
    required = SWITCHING_RESERVE * required_switching(setup)

    def admitted(gains: Any) -> Any:
        if not hasattr(gains, "switching"):
            return gains
        return gains._replace(switching=np.maximum(gains.switching, required))

    best = admitted(setup.gains)
    best_rms = rms_rad(with_gains(setup, best))
    for _ in range(trials):
        trial = admitted(varied(best, lambda joints: np.exp(_STEP * random.normal(size=joints))))
        rms = rms_rad(with_gains(setup, trial))
        if rms is not None and (best_rms is None or _score(rms) < _score(best_rms)):
            best, best_rms = trial, rms
    return best, best_rms


def _score(rms: Vector) -> float:
    score = float(np.log(rms).mean())
    return score if math.isfinite(score) else math.inf


def main() -> None:
    """Search, and print the gains as YAML."""
    parser = argparse.ArgumentParser(description="Search for the gains of a law.")
    parser.add_argument("scenario")
    parser.add_argument("law")
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--duration-s", type=float, default=8.0)
    options = parser.parse_args()
    overrides = [f"controller.law={options.law}", f"duration_s={options.duration_s}"]
    gains, rms = search(load_setup(options.scenario, overrides), options.trials, options.seed)
    print(f"# RMS error, mrad: {None if rms is None else np.round(1e3 * rms, 4).tolist()}")
    rounded = plain(varied(gains, lambda _joints: 1.0))
    print(yaml.safe_dump({options.law: rounded}, sort_keys=False))


if __name__ == "__main__":
    main()
