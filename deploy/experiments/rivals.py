"""Fair rivals: a search for the gains of a law, and how much the outcome hangs on them.

The search is a (1+1) random search from the law's present gains: all gains, per joint, are
multiplied by log-normal factors, and the result is kept if it lowers the geometric mean of the
joints' RMS errors. Rules keep the comparison one of laws, not of bandwidths:

- the torque never reaches the actuators' limits;
- a switching gain outweighs all that the nominal model does not know, which is the condition under
  which sliding exists: else the best RMS would be that of a sliding mode law that does not slide;
- at zero error no surface is steeper than the proposed law's: with neither noise nor delay in the
  scenario, any law gains precision from a steeper surface, and a real arm limits all alike;
- a PID is damped: kd ≥ 2 ζ √(kp m) for the inertia m that the joint sees.

Run as ``python -m deploy.experiments.rivals paper_arm smc --trials 100``.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import yaml

from bus_schema.arrays import Vector
from controller.laws.fixed_time_neural import FixedTimeNeuralGains
from controller.laws.ftsmc import FtsmcGains
from controller.laws.pid import PidGains
from controller.laws.smc import SmcGains
from controller.laws.tsmc import TsmcGains
from controller.manipulator_model import ManipulatorModel
from controller.sliding_surface import surface_pull_slope
from deploy.experiments.metrics import summarise
from deploy.experiments.simulate import simulate
from deploy.scenario import Setup, load_setup
from deploy.scenario_text import plain
from plant_emulator.joint_torques import JointTorques

SWITCHING_RESERVE = 1.2
"""Least ratio of a switching gain to the acceleration it has to outweigh."""

DAMPING_RATIO = 0.7
"""Least damping ratio of a PID: a lower one buys RMS with ringing."""

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
    largest: Vector = np.zeros(robot.joints)
    for time_s in np.linspace(0.0, setup.scenario.duration_s, _SAMPLES):
        setup.reference.evaluate(float(time_s), position, velocity, acceleration)
        torques.act(np.zeros(robot.joints), velocity, float(time_s))
        missed = truth.inverse_dynamics(position, velocity, acceleration)
        missed -= model.inverse_dynamics(position, velocity, acceleration)
        missed += torques.friction + torques.disturbance
        needed = np.linalg.solve(model.mass_matrix(position), missed)
        largest = np.maximum(largest, np.abs(needed))
    return largest


def surface_slope(gains: Any) -> Vector | None:
    """How fast a surface pulls at zero error, (joints,), 1/s; None for a law without a surface."""
    if isinstance(gains, SmcGains):
        return gains.slope
    if isinstance(gains, TsmcGains):
        steepness = surface_pull_slope(0.0, 0.0, 1.0, 1.0, gains.power, gains.eta)
        return np.asarray(steepness * gains.beta)
    if isinstance(gains, FtsmcGains):
        steepness = surface_pull_slope(0.0, 0.0, 1.0, 1.0, gains.psi, gains.eta)
        linear = gains.alpha if gains.phi == 1.0 else 0.0
        return np.asarray(steepness * gains.beta + linear)
    return None


def proposed_slope(gains: FixedTimeNeuralGains) -> float:
    """ψ′(0) of the proposed law, 1/s: the slope of its surface in the error too, as v = 0 there."""
    g = gains
    return surface_pull_slope(0.0, g.alpha_1, g.alpha_2, g.phi_1, g.phi_2, g.eta)


def rms_rad(setup: Setup) -> Vector | None:
    """RMS error per joint, (joints,), rad; None where the run failed or reached torque limits."""
    simulation = simulate(setup)
    summary = summarise(simulation.data())
    if simulation.failure or not summary["completed"] or summary["torque"]["saturated_fraction"]:
        return None
    return np.array(summary["tracking"]["rms_rad"])


@dataclass(frozen=True)
class _Rules:
    """What gains must obey; vectors of shape (joints,).

    Attributes:
        switching: least switching gain, rad/s².
        steepest_per_s: largest slope of a surface at zero error.
        inertia_kg_m2: inertia by which a PID's damping is judged.
    """

    switching: Vector
    steepest_per_s: float
    inertia_kg_m2: Vector

    @classmethod
    def of(cls, setup: Setup, steepest_per_s: float) -> _Rules:
        model = setup.scenario.controller.nominal_model(setup.robot)
        inertia = model.governing_inertia(setup.start_position_rad[None])
        return cls(SWITCHING_RESERVE * required_switching(setup), steepest_per_s, inertia)

    def admit(self, gains: Any) -> Any:
        """The nearest gains that obey."""
        if isinstance(gains, PidGains):
            least = 2.0 * DAMPING_RATIO * np.sqrt(gains.proportional * self.inertia_kg_m2)
            return gains._replace(derivative=np.maximum(gains.derivative, least))
        slope = surface_slope(gains)
        if slope is None:
            return gains
        too_steep = np.maximum(slope / self.steepest_per_s, 1.0)
        surface = {
            name: getattr(gains, name) / too_steep
            for name in ("slope", "alpha", "beta")
            if hasattr(gains, name)
        }
        switching = np.maximum(gains.switching, self.switching)
        return gains._replace(switching=switching, **surface)


def search(
    setup: Setup, trials: int, seed: int, steepest_per_s: float
) -> tuple[Any, Vector | None]:
    """Gains after so many trials, and their RMS errors; None if none was admitted.

    Args:
        setup: the scenario under the law to be tuned, with gains to start from.
        trials: number of candidates.
        seed: of the candidates.
        steepest_per_s: largest slope of the surface at zero error.
    """
    random = np.random.default_rng(seed)
    rules = _Rules.of(setup, steepest_per_s)
    best = rules.admit(setup.gains)
    best_rms = rms_rad(with_gains(setup, best))
    for _ in range(trials):
        trial = rules.admit(varied(best, lambda joints: np.exp(_STEP * random.normal(size=joints))))
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
    setup = load_setup(options.scenario, overrides)
    proposed = load_setup(options.scenario, ["controller.law=fixed_time_neural"]).gains
    gains, rms = search(setup, options.trials, options.seed, proposed_slope(proposed))
    print(f"# RMS error, mrad: {None if rms is None else np.round(1e3 * rms, 4).tolist()}")
    rounded = plain(varied(gains, lambda _joints: 1.0))
    print(yaml.safe_dump({options.law: rounded}, sort_keys=False))


if __name__ == "__main__":
    main()
