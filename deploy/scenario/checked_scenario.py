"""The values of a scenario, checked, with the arm and the files that they refer to."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.drive_feedback import DriveGains, critically_damped, no_drive_feedback
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import TickGrid
from controller.funnel import Funnel
from controller.reference import Reference
from deploy.scenario.checking.explanation import Origin
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.link_kinds.kind import LINK_KINDS, LinkKind
from plant_emulator.interfaces.settings import TORQUE

_GIVEN_BY = {
    "plant.actuator.rotor_inertia_kg_m2=": "rotor inertia",
    "plant.friction.coulomb_": "dry friction",
    "plant.friction.viscous_": "viscous friction",
}
"""Keys of the drives, and their names in the source of their numbers."""


@dataclass(frozen=True)
class CheckedScenario:
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

    @property
    def takes_torque(self) -> bool:
        """Whether the robot's drives follow torques."""
        return self.scenario.plant.interface.takes == TORQUE

    @property
    def drive(self) -> DriveGains:
        """Gains of the drives' own loops."""
        interface = self.scenario.plant.interface
        if not self.takes_torque:
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

    @property
    def link_kind(self) -> LinkKind[Any]:
        """The scenario's kind of link."""
        return LINK_KINDS[self.scenario.link.kind]()
