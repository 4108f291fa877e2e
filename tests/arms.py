"""Arms that tests are done with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schema.drive_feedback import no_drive_feedback
from bus_schema.limits import LimitsConfiguration
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.runtime.clock import TickGrid
from bus_schema.urdf.resolved import pybullet_data
from deploy.scenario.referenced_files import find_urdf
from plant_emulator.arm.joint_torques import JointTorques
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics.engine import ArmSpecification
from plant_emulator.physics.engines import ENGINES

ARMS = ("paper_arm", "iiwa", "panda")
PYBULLET_DATA = next(iter(pybullet_data()), Path("pybullet_data"))
"""Folder of more arms, where that package is installed."""
needs_pybullet_data = pytest.mark.skipif(
    not pybullet_data(), reason="pybullet_data is not installed: pip install 'funnel-hil[bullet]'"
)
INSTALLED = [name for name, engine in ENGINES.usable().items() if engine.is_installed]
"""Names of the physics engines that this Python has."""
needs_bullet = pytest.mark.skipif(
    "bullet" not in INSTALLED, reason="needs Bullet: pip install 'funnel-hil[bullet]'"
)


def shipped_arm(name: str) -> RobotDescription:
    """The description of a shipped arm."""
    return load_robot(find_urdf(name, Path()))


PAPER_ARM = shipped_arm("paper_arm")


def forward_dynamics(model, position, velocity, torque):
    """Acceleration of an arm under a torque, shape (joints,)."""
    load = model.inverse_dynamics(position, velocity, np.zeros(model.joints))
    return np.linalg.solve(model.mass_matrix(position), torque - load)


def runge_kutta(rate, state, step_s, steps):
    """States before each of so many steps of classical Runge-Kutta along rate(time, state)."""
    for index in range(steps):
        yield state
        time_s = index * step_s
        k_1 = rate(time_s, state)
        k_2 = rate(time_s + 0.5 * step_s, state + 0.5 * step_s * k_1)
        k_3 = rate(time_s + 0.5 * step_s, state + 0.5 * step_s * k_2)
        k_4 = rate(time_s + step_s, state + step_s * k_3)
        state = state + step_s / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)


def torques_of(plant, robot=PAPER_ARM, *, step_s=0.00025, seed=0, gains=None):
    """All that acts on the joints of an arm, of which nothing has acted yet."""
    return JointTorques(
        plant, robot, step_s, np.random.default_rng(seed), LimitsConfiguration(),
        gains or no_drive_feedback(robot.joints),
    )  # fmt: skip


class FreeArm:
    """An arm on a physics engine; by default nothing acts on it but the torques of a test.

    Args:
        robot: its description.
        engine: name of the engine.
        step_s: length of a substep.
        plant: what else acts on its joints.
        specification: further values of `ArmSpecification`.
    """

    def __init__(self, robot, engine="mujoco", step_s=1e-3, plant=None, **specification):
        grid, plant = TickGrid(1.0 / step_s, 1), plant or PlantConfiguration()
        self.torques = torques_of(plant, robot, step_s=step_s)
        kind = ENGINES[engine].arm_type
        self.arm = kind(ArmSpecification(robot, grid, self.torques, **specification))
        self.position, self.velocity = self.arm.position, self.arm.velocity
        self.place, self.close = self.arm.place, self.arm.close
        self._step_s, self._substeps = step_s, 0

    def push(self, torque_nm, substeps=1):
        """Apply joint torques for some substeps."""
        self.torques.asked[:] = torque_nm
        self.arm.advance(self._substeps, self._substeps + substeps)
        self._substeps += substeps

    def acceleration(self, position, torque_nm):
        """Acceleration from rest, rad/s², shape (joints,)."""
        self.place(position)
        self.push(torque_nm)
        return self.velocity / self._step_s

    def mass_matrix(self, position):
        """M(q), shape (joints, joints), from what each torque adds to the acceleration."""
        joints = position.size
        falling = self.acceleration(position, np.zeros(joints))
        return np.linalg.inv(
            np.array([self.acceleration(position, row) - falling for row in np.eye(joints)])
        )


def listed_from_the_tip(urdf: Path, folder: Path) -> Path:
    """A file in a folder with the same arm, its joints in the opposite order."""
    blocks = urdf.read_text().split("<joint ")
    head, links = blocks[0], [block.partition("</joint>") for block in blocks[1:]]
    joints = [f"<joint {inner}</joint>" for inner, _, _ in links][::-1]
    rest = "".join(tail for _, _, tail in links).replace("</robot>", "")
    path = folder / "reversed.urdf"
    path.write_text(f"{head}{rest}{''.join(joints)}</robot>")
    return path
