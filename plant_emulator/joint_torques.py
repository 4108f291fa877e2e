"""All torques that act on the joints in one physics substep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.compiled import compiled
from bus_schema.robot_description import RobotDescription
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.disturbance import add_disturbance, disturbance_table
from plant_emulator.friction import friction_table, friction_torque
from plant_emulator.joint_hardware import ActuatorLimits


class JointTorques:
    """Actuators, friction and disturbance between a command and the rigid bodies.

    Attributes:
        actuator: torque that the actuators deliver, N m.
        friction: friction, opposing, N m.
        disturbance: disturbance, opposing, N m.
        total: actuator − friction − disturbance, N m. All of shape (joints,).
        acting: actuator, friction and disturbance as rows, shape (3, joints).
        saturated: whether the last command asked for all that an actuator has, or more.
    """

    def __init__(
        self,
        configuration: PlantConfiguration,
        robot: RobotDescription,
        substep_s: float,
        random: np.random.Generator,
    ) -> None:
        limits = ActuatorLimits(configuration.actuator, robot, substep_s)
        self._saturation = limits.saturation_nm
        self._lag_factor = limits.lag_factor
        self._friction_table = friction_table(configuration.friction, robot.joints)
        self._disturbance_table = disturbance_table(
            configuration.disturbance, robot.joint_names, random
        )
        self._torques: Matrix = np.zeros((4, robot.joints))
        self.actuator: Vector = self._torques[0]
        self.friction: Vector = self._torques[1]
        self.disturbance: Vector = self._torques[2]
        self.total: Vector = self._torques[3]
        self.acting: Matrix = self._torques[:3]
        self.saturated = False

    def act(self, commanded_nm: Vector, velocity: Vector, time_s: float) -> Vector:
        """Total torque of a substep that starts at `time_s`, shape (joints,), N m."""
        self.saturated = _act(
            commanded_nm,
            velocity,
            time_s,
            self._saturation,
            self._lag_factor,
            self._friction_table,
            self._disturbance_table,
            self._torques,
        )
        return self.total

    def rest(self) -> None:
        """The brakes hold the joints: nothing else is felt."""
        self._torques[:] = 0.0
        self.saturated = False

    def rest_at(self, joints: NDArray[np.bool_]) -> None:
        """The brakes of some joints, shape (joints,), hold: nothing else is felt there."""
        self._torques[:, joints] = 0.0


@compiled
def _act(
    commanded: Vector, velocity: Vector, time_s: float,
    saturation: Vector, lag_factor: float, friction_parameters: Matrix, disturbances: Matrix,
    torques: Matrix,
) -> bool:  # fmt: skip
    actuator, friction, disturbance, total = torques[0], torques[1], torques[2], torques[3]
    add_disturbance(time_s, disturbances, disturbance)
    saturated = False
    for i in range(velocity.size):
        target = min(max(commanded[i], -saturation[i]), saturation[i])
        saturated = saturated or abs(commanded[i]) >= saturation[i]
        actuator[i] = target + lag_factor * (actuator[i] - target)
        friction[i] = friction_torque(velocity[i], friction_parameters, i)
        total[i] = actuator[i] - friction[i] - disturbance[i]
    return saturated
