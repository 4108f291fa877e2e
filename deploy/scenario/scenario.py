"""Scenarios: the one description that controller, plant, recorder and judge all read.

A scenario is a YAML file. Everything that can be wrong with it is found here, before any process
starts, and told with file, key, value and what is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    PerJoint,
    StrictModel,
    expand,
)
from bus_schema.drive_feedback import DriveGains, critically_damped, no_drive_feedback
from bus_schema.errors import RobotDescriptionError
from bus_schema.limits import LimitsConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.link.in_process import InProcessBus
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.runtime.clock import TickGrid
from controller.configuration import ControllerConfiguration
from controller.control_loop import ControlTask
from controller.funnel import Funnel
from controller.funnel_configuration import FunnelConfiguration
from controller.reference import Reference, sample_positions
from controller.reference_configuration import ReferenceConfiguration
from deploy.link_kinds.kind import LinkKind, LinkRun
from deploy.link_kinds.table import LINK_KINDS
from deploy.scenario.referenced_files import find_delay_files, find_urdf
from deploy.scenario.uncertainty import Uncertainty, check_uncertainty
from deploy.scenario.yaml_files import (
    ScenarioError,
    find_yaml,
    naming,
    parse_override,
    plain,
    read_yaml,
    set_value,
    to_yaml,
    validated,
)
from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.drives.protocol import PROTOCOLS
from plant_emulator.faults.fault import FaultContext
from plant_emulator.faults.kinds import ScheduledFault, check_faults
from plant_emulator.faults.process_faults import plant_faults
from plant_emulator.faults.scheduler import ScheduledAction
from plant_emulator.plant_task import PlantTask

SHIPPED = Path(str(resources.files("deploy").joinpath("scenarios")))
_CHECKED_PER_SECOND = 100
_MOST_CHECKED = 20_000
_SIZED_BY = 100


class RobotConfiguration(StrictModel):
    """The arm.

    Attributes:
        urdf: a path (relative to the scenario file), the name of a shipped robot, or
            ``pybullet_data:`` with a path inside that package.
        initial_offset_rad: joint positions at the start, relative to the reference.
    """

    urdf: str
    initial_offset_rad: PerJoint = Field(default_factory=lambda: np.zeros(1))


class MetricsConfiguration(StrictModel):
    """The judge.

    Attributes:
        from_s: start of the time over which tracking errors are summed up.
    """

    from_s: NonNegative = 2.0


class Scenario(StrictModel):
    """A whole experiment.

    What is uncertain about it changes nothing in a run: studies draw plants from it.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    duration_s: Annotated[float, Field(gt=0, le=86_400)]
    rate_hz: Annotated[float, Field(ge=10, le=10_000)] = 1000.0
    clock: Literal["realtime", "lockstep"] = "realtime"
    seed: Annotated[int, Field(ge=0)] = 0
    robot: RobotConfiguration
    reference: ReferenceConfiguration
    funnel: FunnelConfiguration = FunnelConfiguration()
    controller: ControllerConfiguration = ControllerConfiguration()
    link: LinkConfiguration = LinkConfiguration()
    plant: PlantConfiguration = PlantConfiguration()
    limits: LimitsConfiguration = LimitsConfiguration()
    metrics: MetricsConfiguration = MetricsConfiguration()
    faults: tuple[ScheduledFault, ...] = ()
    uncertainty: Uncertainty = Field(default_factory=dict)


@dataclass(frozen=True)
class Setup:
    """A scenario with everything its values refer to, checked against each other.

    Attributes:
        source: the scenario file.
        funnel: the bounds that laws and judge share.
        gains: gains in use, expanded to the robot's joints.
        start_position_rad: joint positions at the start, shape (joints,).
        governing_inertia_kg_m2: nominal inertia by which gains are sized, shape (joints,).
    """

    scenario: Scenario
    source: Path
    robot: RobotDescription
    reference: Reference
    funnel: Funnel
    gains: Any
    start_position_rad: Vector
    governing_inertia_kg_m2: Vector
    grid: TickGrid

    @property
    def ticks(self) -> int:
        return max(1, round(self.scenario.duration_s * 1e9 / self.grid.period_ns))

    def control_task(self) -> ControlTask:
        """A fresh task for a controller."""
        controller = self.scenario.controller
        joints = self.robot.joints
        own_rates = controller.torque_rate_limits(joints)
        limits = self.scenario.limits.of_controller(self.robot, own_rates)
        return ControlTask(
            robot=self.robot,
            reference=self.reference,
            funnel=self.funnel,
            law=controller.build_law(self.gains, self.robot),
            law_name=controller.law,
            limits=limits,
            compensation=controller.build_compensation(
                self.robot,
                self.governing_inertia_kg_m2,
                self.drive if controller.drive_feedback.enabled else no_drive_feedback(joints),
                self.scenario.link,
            ),
            sends_targets=controller.drive_feedback.enabled,
        )

    @property
    def drive(self) -> DriveGains:
        """What the drives add to torques of their own."""
        wanted, plant = self.scenario.controller.drive_feedback, self.scenario.plant.drive_feedback
        joints = self.robot.joints
        if not (wanted.enabled or plant.enabled):
            return no_drive_feedback(joints)
        derived = critically_damped(self.governing_inertia_kg_m2, wanted.bandwidth_rad_s)
        key = "plant.drive_feedback"
        given = plant.stiffness_nm_rad, plant.damping_nm_s
        stiffness, damping = given
        return DriveGains(
            True,
            derived.stiffness_nm_rad
            if stiffness is None
            else expand(stiffness, joints, f"{key}.stiffness_nm_rad"),
            derived.damping_nm_s
            if damping is None
            else expand(damping, joints, f"{key}.damping_nm_s"),
        )

    def plant_task(
        self, *, lockstep: bool, process_actions: tuple[ScheduledAction, ...] = ()
    ) -> PlantTask:
        """The task of a plant.

        Args:
            lockstep: wait for the reply to every state that is delivered.
            process_actions: what the plant asks for to be done to processes, on its clock.
        """
        return PlantTask(
            robot=self.robot,
            plant=self.scenario.plant,
            link=self.scenario.link,
            grid=self.grid,
            ticks=self.ticks,
            lockstep=lockstep,
            seed=self.scenario.seed,
            takes_targets=self.drive.is_active,
            faults=plant_faults(self.scenario.faults),
            process_actions=process_actions,
        )

    @property
    def link_kind(self) -> LinkKind[Any]:
        """What there is to know of the scenario's kind of link."""
        return LINK_KINDS.build(self.scenario.link.kind)

    def link_run(
        self, *, lockstep: bool, bus: InProcessBus | None = None, can_log: Path | None = None
    ) -> LinkRun:
        """What the link has to know of the run; the arguments are those of `LinkRun`."""
        task = self.plant_task(lockstep=lockstep)
        return LinkRun(**vars(task), bus=bus, can_log=can_log)

    def arm(self) -> ArmPlant:
        """A fresh arm at its start, of the type that the link needs."""
        arm: ArmPlant = self.link_kind.arm_type(
            self.scenario.plant,
            self.robot,
            self.start_position_rad,
            self.grid,
            self.scenario.seed,
            self.scenario.limits,
            plant_faults(self.scenario.faults),
            self.drive,
        )
        return arm


def load_setup(name_or_path: str, overrides: Sequence[str] = ()) -> Setup:
    """Load, override and check a scenario.

    Args:
        name_or_path: a scenario file, or the name of a shipped scenario.
        overrides: ``dotted.key=value``; values are YAML.

    Raises:
        ScenarioError: anything about it is wrong.
    """
    path = find_yaml(name_or_path, SHIPPED)
    values = _read_scenario(path)
    for text in overrides:
        set_value(values, *parse_override(text))
    return check(validated(values, Scenario, path), path)


def effective_scenario(setup: Setup) -> str:
    """The scenario in force as YAML: every default and override written out, paths absolute.

    But for endpoints that nobody chose: who runs it again may choose others.
    """
    values = plain(setup.scenario)
    values["robot"]["urdf"] = str(setup.robot.path)
    for key in {"plant_endpoint", "controller_endpoint"} - setup.scenario.link.model_fields_set:
        del values["link"][key]
    return to_yaml(values)


def _read_scenario(path: Path) -> dict[str, Any]:
    """The values of a scenario; one that ``extends`` another says only what is different."""
    values = read_yaml(path)
    base = values.pop("extends", None)
    if base is None:
        return values
    if not isinstance(base, str):
        raise ScenarioError(f"{path}: extends = {base!r}: must be the name or path of a scenario")
    base_values = read_yaml(find_yaml(base, SHIPPED, path.parent))
    if "extends" in base_values:
        raise ScenarioError(f"{path}: extends = {base!r}: must be a scenario that extends no other")
    return _merged(base_values, values)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merged(base[key], value) if both else value
    return merged


def check(scenario: Scenario, source: Path) -> Setup:
    """Check a scenario against the files and the robot it refers to.

    Raises:
        ScenarioError: something does not fit.
    """
    with naming(source):
        try:
            return _check(scenario, source)
        except RobotDescriptionError as error:
            raise ScenarioError(f"robot.urdf = {scenario.robot.urdf!r}: {error}") from error


def _check(scenario: Scenario, source: Path) -> Setup:
    link_kind = LINK_KINDS.build(scenario.link.kind)
    PROTOCOLS.check(scenario.link.can.protocol)
    robot = load_robot(find_urdf(scenario.robot.urdf, source.parent))
    reference = scenario.reference.build(robot)
    grid = TickGrid(scenario.rate_hz, scenario.plant.substeps)
    if scenario.duration_s * 1e9 < grid.period_ns:
        allowed = f"at least a tick, {grid.period_ns * 1e-9} s"
        raise ConfigurationError("duration_s", scenario.duration_s, allowed)
    key = "robot.initial_offset_rad"
    offset = expand(scenario.robot.initial_offset_rad, robot.joints, key)
    motion = _reachable_motion(reference, robot, scenario)
    start = sample_positions(reference, np.zeros(1), robot.joints)[0] + offset
    if np.any(start < robot.lower_rad) or np.any(start > robot.upper_rad):
        allowed = f"the start {np.round(start, 4).tolist()} must lie within the joint limits"
        raise ConfigurationError(key, offset.tolist(), f"{allowed} {_ranges(robot)}")
    context = FaultContext(
        robot.joint_names, scenario.duration_s, scenario.plant.payload_kg, link_kind.no_link_faults
    )
    check_faults(scenario.faults, context)
    sized_by = motion[:: -(-len(motion) // _SIZED_BY)]
    inertia = scenario.controller.nominal_model(robot).governing_inertia(sized_by)
    link = find_delay_files(scenario.link, source.parent)
    setup = Setup(
        scenario=scenario.model_copy(update={"link": link}),
        source=source,
        robot=robot,
        reference=reference,
        funnel=scenario.funnel.build(offset),
        gains=scenario.controller.build_gains(robot, inertia),
        start_position_rad=start,
        governing_inertia_kg_m2=inertia,
        grid=grid,
    )
    setup.control_task()
    link_kind.check(setup.link_run(lockstep=True))
    ArmPlant.check(scenario.plant, robot, grid, scenario.limits)
    if scenario.uncertainty:
        check_uncertainty(scenario.uncertainty, plain(scenario), robot.joints)
    return setup


def _reachable_motion(reference: Reference, robot: RobotDescription, scenario: Scenario) -> Matrix:
    """Reference positions over the run, shape (samples, joints), all within the arm's reach."""
    samples = min(round(scenario.duration_s * _CHECKED_PER_SECOND), _MOST_CHECKED) + 1
    times = np.linspace(0.0, scenario.duration_s, samples)
    positions = sample_positions(reference, times, robot.joints)
    outside = ~((positions >= robot.lower_rad) & (positions <= robot.upper_rad)).all(axis=1)
    if outside.any():
        first = int(np.argmax(outside))
        what = np.round(positions[first], 4).tolist()
        raise ConfigurationError(
            "reference",
            f"{what} at {times[first]:g} s",
            f"must stay within the arm's reach and joint limits {_ranges(robot)}",
        )
    return positions


def _ranges(robot: RobotDescription) -> str:
    ends = zip(robot.lower_rad, robot.upper_rad, strict=True)
    return ", ".join(f"[{lower:.4g}, {upper:.4g}]" for lower, upper in ends)
