"""All torques that act on the joints in one physics substep."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Records, Vector, records
from bus_schema.drive_feedback import DriveGains
from bus_schema.limits import LimitsConfiguration, limit_torques
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import assign, compiled
from plant_emulator.arm.disturbance import add_disturbance, disturbance_table
from plant_emulator.arm.drive_loop import DriveLoop, add_drive_torques, drive_loop, idle
from plant_emulator.arm.drive_train import (
    DriveTrains,
    cogging_torque,
    drive_trains,
    friction_table,
    friction_torque,
    largest_torque,
    turn_rotor,
)
from plant_emulator.configuration import PlantConfiguration

ACTUATOR, FRICTION, DISTURBANCE, TOTAL, LIMITED, WANTED, ASKED = range(7)
"""Rows of `TorqueTables.torques_nm`."""


class TorqueTables(NamedTuple):
    """Inputs and outputs of `joint_torques`, for compiled code.

    Attributes:
        joints: of each joint, by name, shape (joints,): `bus_schema.limits.JointLimits.packed`,
            `friction_table`, and held (whether its brake holds it). Each additional array would
            cost every call of compiled code as much again.
        trains: motors and gears.
        disturbance: `disturbance_table`.
        drive: the loop that the drives close themselves.
        torques_nm: rows `ACTUATOR` to `ASKED`, shape (7, joints): `ASKED` is requested of the
            actuators, `WANTED` includes the drives' own loop, `LIMITED` is `WANTED` within the
            limits.
    """

    joints: Records
    trains: DriveTrains
    disturbance: Records
    drive: DriveLoop
    torques_nm: Matrix


class JointTorques:
    """Actuators, friction and disturbance between a command and the rigid bodies.

    Attributes:
        actuator: torque that the actuators deliver, N m.
        friction: friction, opposing, N m.
        disturbance: disturbance, opposing, N m.
        asked: torque requested of the actuators, N m.
        held: joints that their brakes hold, where no other torque acts. All of shape (joints,).
        tables: inputs and outputs of the compiled code.
        drive: the loop that the drives close themselves.
        acting: actuator, friction and disturbance as rows, shape (3, joints).
        saturated: whether the last command requested an actuator's largest torque, or more.
        limit_hits: limits that commands or motion exceeded since `take_limit_hits`: a sum of
            `bus_schema.limits.Hit`.
    """

    def __init__(
        self,
        configuration: PlantConfiguration,
        robot: RobotDescription,
        substep_s: float,
        random: np.random.Generator,
        limits: LimitsConfiguration,
        drive: DriveGains,
        *,
        adds_drive: bool = True,
    ) -> None:
        integrator = configuration.physics.integrator
        trains = drive_trains(configuration.actuator, robot, substep_s, integrator)
        self._torques: Matrix = np.zeros((7, robot.joints))
        disturbance = disturbance_table(configuration.disturbance, robot.joint_names, random)
        self.drive = drive_loop(drive, configuration.drive_feedback.encoder, random)
        of_plant = limits.of_plant(robot).packed(substep_s)
        friction = friction_table(configuration.friction, trains.joints["saturation_nm"])
        columns = {
            name: table[name] for table in (of_plant, friction) for name in table.dtype.names or ()
        }
        columns["held"] = np.zeros(robot.joints, np.bool_)
        self.tables = TorqueTables(
            records(robot.joints, columns),
            trains,
            disturbance,
            self.drive if adds_drive else idle(self.drive),
            self._torques,
        )
        self.held: NDArray[np.bool_] = self.tables.joints["held"]
        self.actuator: Vector = self._torques[ACTUATOR]
        self.friction: Vector = self._torques[FRICTION]
        self.disturbance: Vector = self._torques[DISTURBANCE]
        self.acting: Matrix = self._torques[ACTUATOR : DISTURBANCE + 1]
        self.asked: Vector = self._torques[ASKED]
        self.saturated = False
        self.limit_hits = 0

    def note(self, *, saturated: bool, hits: int) -> None:
        """Store the values returned by `joint_torques`."""
        self.saturated = saturated
        self.limit_hits |= hits

    def take_limit_hits(self) -> int:
        """Return and clear the limits hit since the last call: a sum of `bus_schema.limits.Hit`."""
        hits, self.limit_hits = self.limit_hits, 0
        return hits

    def rest(self) -> None:
        """Clear all torques: the brakes hold the joints."""
        self._torques[:ASKED] = 0.0
        self.tables.trains.rotors[1] = 0.0
        self.saturated = False


@compiled
def joint_torques(motion: Matrix, time_s: float, tables: TorqueTables) -> tuple[bool, int]:
    """Write the torques of a substep; return whether actuators saturate, and the limits hit.

    Args:
        motion: positions and velocities as rows, shape (2, joints).
        time_s: start of the substep.
        tables: inputs and outputs.
    """
    torques, joints, trains = tables.torques_nm, tables.joints, tables.trains
    motors = trains.rotors if trains.is_elastic else motion
    actuator, friction, disturbance = torques[ACTUATOR], torques[FRICTION], torques[DISTURBANCE]
    total, limited, wanted = torques[TOTAL], torques[LIMITED], torques[WANTED]
    assign(wanted, torques[ASKED])
    if tables.drive.gains.is_active:
        add_drive_torques(motors, time_s, tables.drive, wanted)
    hits = limit_torques(wanted, motion, joints, limited, 1.0)
    add_disturbance(time_s, tables.disturbance, disturbance)
    saturated = False
    for i in range(wanted.size):
        largest = largest_torque(trains, i, limited[i], motors[1, i])
        target = min(max(limited[i], -largest), largest)
        saturated = saturated or abs(wanted[i]) >= largest
        actuator[i] = target + trains.lag_factor * (actuator[i] - target)
        friction[i] = friction_torque(motors[1, i], joints, i, actuator[i])
        total[i] = actuator[i] - friction[i]
        if trains.cogging_per_rad > 0.0:
            total[i] -= cogging_torque(trains, motors, i)
        if trains.is_elastic and not joints[i].held:
            total[i] = turn_rotor(trains, motion, i, total[i])
        total[i] -= disturbance[i]
        if joints[i].held:  # the brake holds the joint: no other torque acts there
            torques[:ASKED, i] = 0.0
    return saturated, hits
