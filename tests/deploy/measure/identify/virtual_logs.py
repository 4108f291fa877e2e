"""Logs of virtual robots, whose parameters are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bus_schema.robot_description import RobotDescription, load_robot
from controller.manipulator_model import ManipulatorModel, body_from_log_cholesky, log_cholesky
from deploy.measure.identify.base_parameters import Interval, base_values, link_masses
from deploy.measure.identify.design import design
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.regression import COULOMB, ROTOR, VISCOUS
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.starter import drives_of

RATE_HZ = 125.0


@dataclass(frozen=True)
class Truth:
    """What a virtual robot is like; arrays of shape (joints,), bodies (10 × bodies,)."""

    bodies: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    rotors: np.ndarray
    smoothing: float
    lag_s: float


@cache
def excitation(name: str, duration_s: float):
    """Return times, motion and regressors of the designed trajectory of a shipped arm."""
    robot = load_robot(ROBOTS / f"{name}.urdf")
    model = ManipulatorModel(robot)
    found = design(robot, duration_s)
    times_s = np.arange(0.0, found.times_s[-1], 1.0 / RATE_HZ)
    motion = np.stack([
        np.column_stack([np.interp(times_s, found.times_s, c) for c in each.T])
        for each in found.motion
    ])  # fmt: skip
    return robot, model, times_s, motion, model.torque_regressors(*motion)


def truth_of(robot: RobotDescription, model: ManipulatorModel, random) -> Truth:
    """Draw a robot near its file."""
    drives, joints = drives_of(robot), robot.joints
    coordinates = log_cholesky(model.body_parameters())
    extent = np.exp(coordinates[:, 1:4]).max(axis=1, keepdims=True)
    spread = np.hstack([np.full((len(coordinates), 4), 0.3), np.repeat(0.3 * extent, 6, axis=1)])
    moved = coordinates + spread * random.normal(size=coordinates.shape)
    return Truth(
        np.concatenate([body_from_log_cholesky(each)[0] for each in moved]),
        0.03 * drives.rated * random.uniform(0.5, 2.0, joints),
        0.04 * drives.rated * random.uniform(0.5, 2.0, joints),
        drives.rotors * random.uniform(0.5, 1.5, joints),
        smoothing=0.02,
        lag_s=float(random.uniform(0.0, 0.006)),
    )


def coloured(random, shape: tuple[int, int], correlation_s: float) -> np.ndarray:
    """Return noise of variance 1 with autocorrelation exp(−|t| / correlation); white for 0."""
    white = random.normal(size=shape)
    if not correlation_s:
        return white
    decay = np.exp(-1.0 / (RATE_HZ * correlation_s))
    noise = np.empty(shape)
    noise[0] = white[0]
    for row in range(1, shape[0]):
        noise[row] = decay * noise[row - 1] + np.sqrt(1.0 - decay**2) * white[row]
    return noise


def write_log(
    file: Path, name: str, truth: Truth, random, duration_s: float = 25.0, noise=0.01,
    correlation_s: float = 0.0,
):  # fmt: skip
    """Write the log of a virtual robot on its designed trajectory; return its arm.

    The torques have noise of this share of their largest value, correlated over this time.
    """
    robot, _, times_s, (position, velocity, acceleration), regressors = excitation(name, duration_s)
    friction = truth.coulomb * np.tanh(velocity / truth.smoothing) + truth.viscous * velocity
    torque = regressors @ truth.bodies + truth.rotors * acceleration + friction
    ahead = np.column_stack([np.interp(times_s + truth.lag_s, times_s, c) for c in torque.T])
    size = noise * np.abs(torque).max(axis=0)
    torque = ahead + size * coloured(random, torque.shape, correlation_s)
    position = np.rint(position / 1e-5) * 1e-5
    velocity = velocity + 1e-3 * random.normal(size=velocity.shape)
    names = [f"{kind}.{joint}" for kind in ("position", "velocity", "effort")
             for joint in robot.joint_names]  # fmt: skip
    values = np.column_stack([times_s, position, velocity, torque])
    np.savetxt(file, values, "%.9g", ",", header=",".join(["time_s", *names]), comments="")
    return robot


def to_currents(file: Path, constants: np.ndarray) -> None:
    """Turn the torques of a log into currents."""
    head, *rows = file.read_text().splitlines()
    values = np.array([list(map(float, row.split(","))) for row in rows])
    joints = len(constants)
    values[:, -joints:] /= constants
    names = head.split(",")
    names[-joints:] = [f"current{n}_a" for n in range(1, joints + 1)]
    np.savetxt(file, values, "%.9g", ",", header=",".join(names), comments="")


def intervals(found: Identified, truth: Truth) -> Iterator[tuple[str, Interval, float]]:
    """Yield name, interval and true value of each parameter, also of those that are not seen."""
    true = found.group.matrix @ truth.bodies
    yield from zip(found.group.names, base_values(found.fit, found.group), true, strict=True)
    masses = zip(found.model.body_joints, link_masses(found.fit), truth.bodies[::10], strict=True)
    for name, mass, kg in masses:
        yield f"{name}: mass of the link", mass, kg
    for name, term in (("coulomb", COULOMB), ("viscous", VISCOUS), ("rotors", ROTOR)):
        for joint, each in enumerate(getattr(truth, name)):
            yield f"{found.robot.joint_names[joint]}: {name}", found.term(joint, term), each
    delay_s, sd_s = found.fit.delay_s
    yield "delay", Interval(delay_s, 1.96 * sd_s, 0.0, seen=True), truth.lag_s
