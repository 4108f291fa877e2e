"""A scenario with all that it refers to, from which the parts of a run are created."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.drive_feedback import DriveGains, critically_damped, no_drive_feedback
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus
from bus_schema.messages import topics
from bus_schema.messages.layout import MessageLayout
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from controller.compensation.command_timeline import HorizonSettings
from controller.control_loop import ControlTask
from controller.funnel import Funnel
from controller.manipulator_model import ManipulatorModel
from controller.reference import Reference
from deploy.scenario.checking.explanation import Origin
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.link_kinds.kind import LINK_KINDS, Arm, LinkKind, LinkRun
from deploy.scenario.plant_count import FunnelCounter
from deploy.scenario.playout import horizon_settings, resolved_link
from deploy.scenario.robot_interface import (
    interface_in_force,
    law_for_robot,
    longest_step_s,
    takes_torque,
)
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.faults.fault import ScheduledAction
from plant_emulator.faults.process_faults import plant_faults
from plant_emulator.interfaces.interface import RobotInterface
from plant_emulator.plant_task import PlantTask
from plant_emulator.robot_controller import RobotController

_GIVEN_BY = {
    "plant.actuator.rotor_inertia_kg_m2=": "rotor inertia",
    "plant.friction.coulomb_": "dry friction",
    "plant.friction.viscous_": "viscous friction",
}
"""Keys of the drives, and their names in the source of their numbers."""


@dataclass(frozen=True)
class Setup:
    """A scenario with everything its values refer to, checked for consistency.

    Attributes:
        source: the scenario file.
        nominal: the arm with the masses of the controller's nominal model.
        funnel: the bounds that laws and judge share.
        gains: gains in use, expanded to the robot's joints.
        start_position_rad: joint positions at the start, shape (joints,).
        governing_inertia_kg_m2: nominal inertia by which gains are sized, shape (joints,).
        overrides: values set in addition to the file, as ``dotted.key=value``.
        given_by: the option that set them.
    """

    scenario: ScenarioConfiguration
    source: Path
    robot: RobotDescription
    nominal: RobotDescription
    reference: Reference
    funnel: Funnel
    gains: Any
    start_position_rad: Vector
    governing_inertia_kg_m2: Vector
    grid: TickGrid
    overrides: tuple[str, ...] = ()
    given_by: str = "--set"

    @property
    def origin(self) -> Origin:
        """Origin of the scenario's values, for messages."""
        return Origin(self.source, self.overrides, self.given_by)

    @property
    def drive_data(self) -> str:
        """Source of the numbers of the arm and its drives, where a scenario or the arm names it.

        What an override gives is estimated no longer.
        """
        named, estimated = self.scenario.robot.drive_data or "", self.robot.estimated
        for key, what in _GIVEN_BY.items():
            if any(each.startswith(key) for each in self.overrides):
                named = re.sub(rf"{what}[^,;]*", f"{what} as given", named)
        return named if estimated in named else ", ".join(filter(None, [estimated, named]))

    @property
    def ticks(self) -> int:
        return max(1, round(self.scenario.duration_s * 1e9 / self.grid.period_ns))

    @property
    def answer_every(self) -> int:
        """Ticks from one state that the controller answers to the next."""
        controller = self.scenario.controller
        return 1 if controller.process is None else controller.every

    @property
    def largest_torques_nm(self) -> Vector:
        """Largest torques that act on the arm, shape (joints,); inf where there is no limit."""
        limits = self.scenario.limits.of_plant(self.robot).torque_nm
        saturation_nm = self.scenario.plant.actuator.saturation_nm
        return limits if saturation_nm is None else np.minimum(limits, saturation_nm)

    def control_task(self) -> ControlTask:
        """Return a new task for a controller."""
        controller = self.scenario.controller
        joints = self.robot.joints
        rotors = self.scenario.plant.actuator.rotor_inertia(joints)
        own_rates = controller.torque_rate_limits(joints)
        limits = self.scenario.limits.of_controller(self.robot, own_rates)
        return ControlTask(
            robot=self.robot,
            reference=self.reference.copied(),  # a law can write into its arrays
            funnel=self.funnel.copied(),
            law=law_for_robot(self, controller.build_law(self.gains, self.nominal, rotors)),
            law_name=controller.law,
            limits=limits,
            compensation=controller.build_compensation(
                self.nominal,
                self.governing_inertia_kg_m2,
                self.drive if controller.drive_feedback.enabled else no_drive_feedback(joints),
                self.horizon,
                rotors,
            ),
            sends_targets=controller.drive_feedback.enabled or not takes_torque(self),
            longest_step_s=longest_step_s(self),
        )

    @property
    def drive(self) -> DriveGains:
        """Gains of the drives' own loops."""
        interface = self.scenario.plant.interface
        if not takes_torque(self):
            inertia = self.governing_inertia_kg_m2
            gains = critically_damped(inertia, interface.bandwidth_rad_s)
            return self.scenario.plant.drive_feedback.gains(gains)
        wanted, plant = self.scenario.controller.drive_feedback, self.scenario.plant.drive_feedback
        if not (wanted.enabled or plant.enabled):
            return no_drive_feedback(self.robot.joints)
        return self.tuned_drive

    @property
    def tuned_drive(self) -> DriveGains:
        """Gains to which drives with their own loops are tuned, even if they take no targets."""
        wanted, plant = self.scenario.controller.drive_feedback, self.scenario.plant.drive_feedback
        return plant.gains(critically_damped(self.governing_inertia_kg_m2, wanted.bandwidth_rad_s))

    def plant_task(
        self, *, lockstep: bool, process_actions: tuple[ScheduledAction, ...] = ()
    ) -> PlantTask:
        """Return the task of a plant.

        Args:
            lockstep: wait for the reply to every state that is delivered.
            process_actions: actions on processes that the plant requests, on its clock.
        """
        return PlantTask(
            robot=self.robot,
            plant=self.scenario.plant,
            link=self.link,
            grid=self.grid,
            ticks=self.ticks,
            lockstep=lockstep,
            seed=self.scenario.seed,
            takes_targets=self.drive.is_active,
            answer_every=self.answer_every,
            expected_ns=self.horizon.first_ns if self.link.plays_automatically else 0,
            faults=plant_faults(self.scenario.faults),
            process_actions=process_actions,
            watch=partial(FunnelCounter, self.reference, self.funnel),
        )

    @cached_property
    def link(self) -> LinkConfiguration:
        """Section ``link`` of the scenario, with the play-out time that applies."""
        return resolved_link(self)

    @cached_property
    def horizon(self) -> HorizonSettings:
        """Settings by which a controller with delay compensation chooses when its commands act."""
        return horizon_settings(self)

    def layouts(self) -> dict[str, MessageLayout]:
        """Wire layouts of the topics of fixed size, by their names."""
        return {
            topic.name: topics.layout(
                topic, self.robot.joint_names,
                has_targets=self.drive.is_active, has_acting_time=self.link.plays_automatically,
            )
            for topic in topics.TOPICS
            if topic is not topics.RUN_EVENTS
        }  # fmt: skip

    @property
    def link_kind(self) -> LinkKind[Any]:
        """The scenario's kind of link."""
        return LINK_KINDS[self.scenario.link.kind]()

    def link_run(
        self, *, lockstep: bool, bus: InProcessBus | None = None, can_log: Path | None = None
    ) -> LinkRun:
        """Return the link's inputs for the run; the arguments are those of `LinkRun`."""
        return LinkRun(
            robot=self.robot,
            plant=self.scenario.plant,
            link=self.link,
            grid=self.grid,
            ticks=self.ticks,
            lockstep=lockstep,
            seed=self.scenario.seed,
            takes_targets=self.drive.is_active,
            bus=bus,
            can_log=can_log,
            drive=self.drive if self.drive.is_active else None,
            tuned_drive=self.tuned_drive,
        )

    def arm(self) -> ArmPlant:
        """Return a new arm at its start, of the type that the link needs."""
        arm: ArmPlant = self.arm_of_type(self.link_kind.arm_type)
        return arm

    def arm_of_type(self, arm_type: type[Arm]) -> Arm:
        """Return a new arm at its start."""
        arm = arm_type(
            self.scenario.plant,
            self.robot,
            self.start_position_rad,
            self.grid,
            self.scenario.seed,
            self.scenario.limits,
            plant_faults(self.scenario.faults),
            self.drive,
        )
        if self.scenario.plant.interface.has_controller:
            arm.be_controlled_by(self.robot_controller())
        return arm

    def robot_controller(self, interface: RobotInterface | None = None) -> RobotController:
        """Return the robot's own controller, moved by this interface or by the scenario's."""
        along = self._true_model().inverse_dynamics
        return RobotController(interface_in_force(self), along, self.grid, interface)

    def _true_model(self) -> ManipulatorModel:
        """Return the arm as the robot's own controller knows it: exactly, without friction."""
        plant, joints = self.scenario.plant, self.robot.joints
        return ManipulatorModel(
            self.robot, payload_kg=plant.payload_kg,
            rotor_inertia_kg_m2=plant.actuator.rotor_inertia(joints),
        )  # fmt: skip
