"""All torques that act on the joints in one physics substep."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.limits import LimitsConfiguration, limit_torques
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import compiled
from plant_emulator.arm.disturbance import add_disturbance, disturbance_table
from plant_emulator.arm.friction import friction_table, friction_torque
from plant_emulator.arm.joint_hardware import ActuatorLimits
from plant_emulator.configuration import PlantConfiguration


class Tables(NamedTuple):
    """What the torques of a substep depend on, and where they go, as compiled code takes it.

    Attributes:
        limits: of the torques, `bus_schema.limits.JointLimits.table`.
        saturation: largest torques of the actuators, N m, shape (joints,).
        lag_factor: share of the difference to the commanded torque that is left after a substep.
        friction: `friction_table`.
        disturbance: `disturbance_table`.
        asked: what the actuators are asked for, N m.
        held: joints that their brakes hold, shape (joints,).
        torques: actuator, friction, disturbance, total, limited and asked torques as rows, N m,
            shape (6, joints).
    """

    limits: Matrix
    saturation: Vector
    lag_factor: float
    friction: Matrix
    disturbance: Matrix
    held: NDArray[np.bool_]
    torques: Matrix


class JointTorques:
    """Actuators, friction and disturbance between a command and the rigid bodies.

    Attributes:
        actuator: torque that the actuators deliver, N m.
        friction: friction, opposing, N m.
        disturbance: disturbance, opposing, N m.
        asked: what the actuators are asked for, N m.
        held: joints that their brakes hold: nothing else is felt there. All of shape (joints,).
        tables: what compiled code needs to work the torques out.
        acting: actuator, friction and disturbance as rows, shape (3, joints).
        saturated: whether the last command asked for all that an actuator has, or more.
        hits: limits that commands or motion ran into since this was last set to 0: a sum of
            `bus_schema.limits.Hit`.
    """

    def __init__(
        self,
        configuration: PlantConfiguration,
        robot: RobotDescription,
        substep_s: float,
        random: np.random.Generator,
        limits: LimitsConfiguration,
    ) -> None:
        actuators = ActuatorLimits(configuration.actuator, robot, substep_s)
        self._torques: Matrix = np.zeros((6, robot.joints))
        self.tables = Tables(
            limits.of_plant(robot).table(substep_s),
            actuators.saturation_nm,
            actuators.lag_factor,
            friction_table(configuration.friction, robot.joints),
            disturbance_table(configuration.disturbance, robot.joint_names, random),
            np.zeros(robot.joints, dtype=np.bool_),
            self._torques,
        )
        self.held = self.tables.held
        self.actuator: Vector = self._torques[0]
        self.friction: Vector = self._torques[1]
        self.disturbance: Vector = self._torques[2]
        self.acting: Matrix = self._torques[:3]
        self.asked: Vector = self._torques[5]
        self.saturated = False
        self.hits = 0

    def rest(self) -> None:
        """The brakes hold the joints: nothing else is felt."""
        self._torques[:5] = 0.0
        self.saturated = False


@compiled
def act(motion: Matrix, time_s: float, tables: Tables) -> tuple[bool, int]:
    """Write the torques of a substep; whether actuators saturate, and the limits that were hit.

    Args:
        motion: positions and velocities as rows, shape (2, joints).
        time_s: start of the substep.
        tables: what the torques depend on, and where they go.
    """
    torques, saturation = tables.torques, tables.saturation
    actuator, friction, disturbance, total = torques[0], torques[1], torques[2], torques[3]
    allowed, asked = torques[4], torques[5]
    hits = limit_torques(asked, motion, tables.limits, allowed, 1.0)
    add_disturbance(time_s, tables.disturbance, disturbance)
    saturated = False
    for i in range(asked.size):
        target = min(max(allowed[i], -saturation[i]), saturation[i])
        saturated = saturated or abs(asked[i]) >= saturation[i]
        actuator[i] = target + tables.lag_factor * (actuator[i] - target)
        friction[i] = friction_torque(motion[1, i], tables.friction, i)
        total[i] = actuator[i] - friction[i] - disturbance[i]
        if tables.held[i]:  # its brake holds it: nothing else is felt there
            torques[:5, i] = 0.0
    return saturated, hits
