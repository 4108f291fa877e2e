"""All torques that act on the joints in one physics substep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.compiled import compiled
from bus_schema.limits import LimitsConfiguration, limit_torques
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
        self._limits = limits.of_plant(robot).table(substep_s)
        self._saturation = actuators.saturation_nm
        self._lag_factor = actuators.lag_factor
        self._friction_table = friction_table(configuration.friction, robot.joints)
        self._disturbance_table = disturbance_table(
            configuration.disturbance, robot.joint_names, random
        )
        self._torques: Matrix = np.zeros((5, robot.joints))
        self.actuator: Vector = self._torques[0]
        self.friction: Vector = self._torques[1]
        self.disturbance: Vector = self._torques[2]
        self.total: Vector = self._torques[3]
        self.acting: Matrix = self._torques[:3]
        self.saturated = False
        self.hits = 0

    def act(self, commanded_nm: Vector, motion: Matrix, time_s: float) -> Vector:
        """Total torque of a substep that starts at `time_s`, shape (joints,), N m.

        Args:
            commanded_nm: torques in force, shape (joints,).
            motion: positions and velocities as rows, shape (2, joints).
            time_s: start of the substep.
        """
        self.saturated, hits = _act(
            commanded_nm,
            motion,
            time_s,
            self._limits,
            self._saturation,
            self._lag_factor,
            self._friction_table,
            self._disturbance_table,
            self._torques,
        )
        self.hits |= hits
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
    commanded: Vector, motion: Matrix, time_s: float, limits: Matrix,
    saturation: Vector, lag_factor: float, friction_parameters: Matrix, disturbances: Matrix,
    torques: Matrix,
) -> tuple[bool, int]:  # fmt: skip
    actuator, friction, disturbance, total = torques[0], torques[1], torques[2], torques[3]
    allowed = torques[4]
    hits = limit_torques(commanded, motion, limits, 1.0, allowed)
    add_disturbance(time_s, disturbances, disturbance)
    saturated = False
    for i in range(commanded.size):
        target = min(max(allowed[i], -saturation[i]), saturation[i])
        saturated = saturated or abs(commanded[i]) >= saturation[i]
        actuator[i] = target + lag_factor * (actuator[i] - target)
        friction[i] = friction_torque(motion[1, i], friction_parameters, i)
        total[i] = actuator[i] - friction[i] - disturbance[i]
    return saturated, hits
