"""The parts of a run, created from a checked scenario."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from bus_schema.drive_feedback import no_drive_feedback
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus
from bus_schema.messages import topics
from bus_schema.messages.layout import MessageLayout
from controller.compensation.command_timeline import HorizonSettings
from controller.control_loop import ControlTask
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.checked_scenario import CheckedScenario
from deploy.scenario.link_kinds.kind import Arm, LinkRun
from deploy.scenario.plant_count import FunnelCounter
from deploy.scenario.playout import horizon_settings, levels, playout_range_ns, resolved_link
from deploy.scenario.robot_interface import interface_in_force, law_for_robot, longest_step_s
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.faults.fault import ScheduledAction
from plant_emulator.faults.process_faults import plant_faults
from plant_emulator.interfaces.interface import RobotInterface
from plant_emulator.plant_task import PlantTask
from plant_emulator.robot_controller import RobotController


@dataclass(frozen=True)
class Setup(CheckedScenario):
    """A checked scenario from which the parts of a run are created."""

    @cached_property
    def link(self) -> LinkConfiguration:
        """Section ``link`` of the scenario, with the play-out time that applies."""
        return resolved_link(self)

    @cached_property
    def horizon(self) -> HorizonSettings:
        """Settings by which a controller with delay compensation chooses when its commands act."""
        return horizon_settings(self, self.link)

    @property
    def playout_range_ns(self) -> tuple[int, int]:
        """Time from a state until its torque acts, at the start of a run and later, ns."""
        return playout_range_ns(self.link, self.horizon, self.grid)

    @property
    def is_levelled(self) -> bool:
        """Whether every message of a run arrives before the play-out lets it act, at any time."""
        return levels(self.link, self.horizon, self.grid)

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
            law=law_for_robot(
                self, self.link, controller.build_law(self.gains, self.nominal, rotors)
            ),
            law_name=controller.law,
            limits=limits,
            compensation=controller.build_compensation(
                self.nominal,
                self.governing_inertia_kg_m2,
                self.drive if controller.drive_feedback.enabled else no_drive_feedback(joints),
                self.horizon,
                rotors,
            ),
            sends_targets=controller.drive_feedback.enabled or not self.takes_torque,
            longest_step_s=longest_step_s(self),
        )

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
