"""The emulated arm: rigid bodies, actuators, friction, disturbance, brakes and encoders."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import ConfigurationError, expand
from bus_schema.drive_feedback import DriveGains, no_drive_feedback
from bus_schema.limits import LimitsConfiguration
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from bus_schema.runtime.modes import COMMANDABLE, Mode, Trigger, follow
from bus_schema.runtime.randomness import generator
from plant_emulator.arm.delay_line import NEVER, DelayLine, DriveCommand
from plant_emulator.arm.drive_loop import add_drive_torques
from plant_emulator.arm.joint_hardware import Encoders
from plant_emulator.arm.joint_torques import JointTorques
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.faults.arm_faults import ArmFaults, PayloadFault
from plant_emulator.faults.fault import Fault
from plant_emulator.interfaces.interface import Reflex
from plant_emulator.physics.engine import ANY_PAYLOAD_KG, ArmSpecification
from plant_emulator.physics.engines import engine_in_force, physics_in_force
from plant_emulator.robot_controller import RobotController


class ArmPlant:
    """The arm with all its hardware, advanced one physics substep at a time.

    Args:
        configuration: section ``plant`` of the scenario.
        robot: description of the arm.
        start_position_rad: joint positions at the start, shape (joints,).
        grid: ticks and physics steps of the run.
        seed: seed of everything random in the arm.
        limits: section ``limits`` of the scenario.
        faults: the scheduled faults.
        drive: gains of its drives' own loops; None if they follow torques alone.

    Attributes:
        mode: the arm's mode; it changes by `bus_schema.runtime.modes.TRANSITIONS`.
        stops_at: limits that require a safe stop.
        joint_names: names of the joints.
        physics: engine, version and integrator.
        torques: torques of the last substep.
        position: true joint positions, rad, shape (joints,).
        velocity: true joint velocities, rad/s, shape (joints,).
        motion: both as rows, shape (2, joints).
        measured: the encoders' latest readings of it.
    """

    def __init__(
        self,
        configuration: PlantConfiguration,
        robot: RobotDescription,
        start_position_rad: Vector,
        grid: TickGrid,
        seed: int,
        limits: LimitsConfiguration = LimitsConfiguration(),  # noqa: B008 (frozen)
        faults: Sequence[Fault] = (),
        drive: DriveGains | None = None,
    ) -> None:
        self._safe_stop = configuration.safe_stop
        self.stops_at, self.joint_names = limits.stops_at, robot.joint_names
        randoms = [generator(child) for child in np.random.SeedSequence(seed).spawn(3)]
        self._stop_damping = _stop_damping(configuration, robot)
        gains = drive or no_drive_feedback(robot.joints)
        self.torques = JointTorques(
            configuration, robot, grid.substep_s, randoms[0], limits, gains,
            adds_drive=not faults,
        )  # fmt: skip
        self._commanded: Vector = np.zeros(robot.joints)
        self._line = DelayLine(configuration.actuator.delay_steps(grid.substep_s))
        self._robot: RobotController | None = None
        self._grid = grid
        engine = engine_in_force(configuration)
        self.physics = physics_in_force(configuration)
        self._bodies = engine.arm_type(
            ArmSpecification(
                robot, grid, self.torques, configuration.physics.integrator,
                configuration.payload_kg,
                configuration.actuator.rigid_rotor_inertia(robot.joints),
                payload_changes=any(isinstance(fault, PayloadFault) for fault in faults),
                gui=configuration.gui,
            )
        )  # fmt: skip
        self._faults = (
            ArmFaults(faults, robot.joint_names, randoms[2], self._bodies) if faults else None
        )
        self._bodies.place(start_position_rad)
        self.position: Vector = self._bodies.position
        self.velocity: Vector = self._bodies.velocity
        self.motion: Matrix = self._bodies.motion
        trains = self.torques.tables.trains
        sees_motors = trains.is_elastic and configuration.actuator.encoder_side == "motor"
        seen = trains.rotors if sees_motors else self.motion
        self._encoders = Encoders(configuration.encoder, seen, randoms[1])
        self.measured: Matrix = self._encoders.shown
        self._set_brakes(engaged=True)
        self.mode = Mode.IDLE

    def be_controlled_by(self, robot: RobotController) -> None:
        """Let commands go to the robot's own controller, which tells the drives what to do."""
        self._robot = robot

    @staticmethod
    def check(
        configuration: PlantConfiguration,
        robot: RobotDescription,
        grid: TickGrid,
        limits: LimitsConfiguration,
    ) -> None:
        """Check that the arm can be built.

        Raises:
            ConfigurationError: a value does not fit the arm.
            RobotDescriptionError: the physics engine cannot load the arm.
        """
        if configuration.gui and not os.environ.get("DISPLAY"):
            raise ConfigurationError("plant.gui", True, "needs a display, but DISPLAY is not set")
        random = np.random.default_rng()
        _stop_damping(configuration, robot)
        gains = no_drive_feedback(robot.joints)
        JointTorques(configuration, robot, grid.substep_s, random, limits, gains)
        Encoders(configuration.encoder, np.zeros((2, robot.joints)), random)
        # One payload stands for all: arms that differ only in payload need not be loaded again.
        engine_in_force(configuration).arm_type.check(
            robot, bool(configuration.payload_kg) * ANY_PAYLOAD_KG, gui=configuration.gui
        )

    @property
    def reflex(self) -> Reflex | None:
        """The stop that the robot's own controller has decided; None without one."""
        return None if self._robot is None else self._robot.reflex

    def read_encoders(self, now_ns: int = 0) -> None:
        """Update `measured`; faults that begin and end depend on `now_ns`."""
        self._encoders.read()
        if self._faults is not None:
            self._faults.spoil_readings(self.measured, now_ns)

    def begin(self) -> None:
        """Join a run: the brakes hold until the first torque."""
        self.mode = follow(self.mode, Trigger.BEGIN)

    def command(self, torque_nm: Vector, target: Matrix | None = None, stamp_ns: int = 0) -> None:
        """Apply a torque after the actuators' dead time; ignored once stopping.

        The first torque that acts releases the brakes.

        Args:
            torque_nm: shape (joints,).
            target: for drives that close their own loop, see `DriveLoop`; None without one.
            stamp_ns: stamp of the state that the command answers.
        """
        if self.mode not in COMMANDABLE:
            return
        if self.mode is Mode.READY:
            self.mode = follow(self.mode, Trigger.COMMAND)
        if self._robot is not None:
            self._robot.receive(torque_nm, target)
            return
        self._send(DriveCommand(torque_nm, target, stamp_ns))

    def _send(self, command: DriveCommand) -> None:
        """Give the drives a command; it acts after their dead time."""
        if not self._line.substeps:
            self._follow(command)
            return
        target = None if command.target is None else command.target.copy()
        self._line.put(command._replace(torque_nm=command.torque_nm.copy(), target=target))

    def _follow(self, command: DriveCommand) -> None:
        """Let a command act: release the brakes, and give the drives its torque and target."""
        if self._is_braked:
            self._set_brakes(engaged=False)
        self._commanded[...] = command.torque_nm
        drive, target = self.torques.drive, command.target
        if drive.gains.is_active:
            drive.stamp_s[0] = command.stamp_ns * 1e-9 if target is not None else math.nan
            if target is not None:
                drive.target[:] = target

    def hold(self, joints: NDArray[np.bool_]) -> None:
        """Keep the brakes of some joints engaged while the others move, shape (joints,)."""
        held = self.torques.held
        if joints.tobytes() != held.tobytes():  # a tenth of np.array_equal's time
            held[:] = joints
            if not self._is_braked:
                self._bodies.hold(held.tolist())

    def stop(self) -> None:
        """Begin the configured safe stop, which cannot be revoked."""
        self.mode = follow(self.mode, Trigger.FAIL)
        self._clear_command()
        if self._safe_stop == "brake":
            self._set_brakes(engaged=True)

    def end(self) -> None:
        """End the run: engage the brakes for good."""
        self.mode = follow(
            self.mode, Trigger.STOPPED if self.mode is Mode.STOPPING else Trigger.END
        )
        self._clear_command()
        self._set_brakes(engaged=True)

    def advance(self, first: int, end: int) -> None:
        """Advance by substeps under the current command.

        Args:
            first: number of the first substep in the run.
            end: number of the first substep to leave out.
        """
        while first < end and (self._line.substeps or self._robot is not None):
            until = min(end, self._pass_commands_on(first))
            self._advance(first, until)
            self._line.pass_by(until)
            first = until
        if first < end:
            self._advance(first, end)

    def _pass_commands_on(self, number: int) -> int:
        """Let commands act that are due at a substep; return the substep of the next ones."""
        due, line = NEVER, self._line
        if (robot := self._robot) is not None and self.mode is Mode.TRACKING:
            if robot.next_due == NEVER:
                robot.start(self.measured[0], number)
            if robot.next_due <= number:
                self._send(robot.cycle(self.measured))
            due = robot.next_due
        for command in line.take_due(number):
            self._follow(command)
        return min(line.next_due, due)

    def _advance(self, first: int, end: int) -> None:
        """Advance by substeps between which no command begins to act."""
        if self._faults is None and self.mode in COMMANDABLE:
            self.torques.asked[:] = self._commanded
            self._go(first, end)
            return
        is_damped = self.mode is Mode.STOPPING and self._safe_stop == "damping"
        for number in range(first, end):
            if is_damped:
                np.multiply(self._stop_damping, self.velocity, out=self._commanded)
                np.negative(self._commanded, out=self._commanded)
            if self._faults is None:
                self.torques.asked[:] = self._commanded
            else:
                self._apply_faults(self._faults, self._grid.substep_ns(number))
            self._go(number, number + 1)

    def close(self) -> None:
        """Free the physics engine."""
        self._bodies.close()

    def _clear_command(self) -> None:
        """Clear torque and target, so that drives stop following it."""
        self._line.clear()
        self._commanded[:] = 0.0
        self.torques.drive.stamp_s[0] = np.nan

    def _apply_faults(self, faults: ArmFaults, now_ns: int) -> None:
        """Apply faults to the torques requested of the actuators."""
        faults.begin_due(now_ns)
        wanted, drive = self._commanded.copy(), self.torques.drive
        if drive.gains.is_active:
            add_drive_torques(self.motion, now_ns * 1e-9, drive, wanted)
        self.torques.asked[:] = faults.faulty_torques(wanted, now_ns)

    def _go(self, first: int, end: int) -> None:
        if self._is_braked:
            self.torques.rest()
            self._bodies.advance_braked(end - first)
        else:
            self._bodies.advance(first, end)

    def _set_brakes(self, *, engaged: bool) -> None:
        self._bodies.set_brakes(engaged=engaged)
        if not engaged and self.torques.held.any():
            self._bodies.hold(self.torques.held.tolist())
        self._is_braked = engaged


def _stop_damping(configuration: PlantConfiguration, robot: RobotDescription) -> Vector:
    """Return the damping of a safe stop, N m s, shape (joints,)."""
    return expand(configuration.stop_damping_nm_s, robot.joints, "plant.stop_damping_nm_s")
