"""A controller for a robot that has a controller of its own."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from bus_schema.configuration import ConfigurationError
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.robot_description import RobotDescription
from controller.control_law import ABSENCE_STATES, ControlLaw
from controller.laws import LAWS
from controller.laws.custom import (
    EXTERNAL,
    SHIPPED,
    LeftOut,
    TargetsAlone,
    is_custom,
    tell_lag,
)
from controller.outer_laws.admittance import Admittance
from controller.outer_laws.outer_law import OuterLaw
from controller.policies.configuration import is_address
from deploy.scenario.checked_scenario import CheckedScenario
from deploy.scenario.definition import ScenarioConfiguration
from plant_emulator.channel.delay_range import configured_delays_ns, round_trip_ns
from plant_emulator.interfaces.configuration import InterfaceConfiguration
from plant_emulator.interfaces.settings import TORQUE

_SECTION = "plant.interface"
_KEY = f"{_SECTION}.kind"
_LAW, _PREVIEW = "controller.law", "controller.preview_ms"
_UNLESS = (
    "unless controller.drive_feedback.enabled is true, or a robot takes positions or velocities"
    " (as with --set plant.interface.kind=servoj)"
)
_OF_ITS_CONTROLLER = ("rate_hz", "clock_ppm", "phase_ms", "bandwidth_rad_s")
"""Keys of the section that only robots with a controller of their own have."""


def law_for_robot(setup: CheckedScenario, link: LinkConfiguration, law: ControlLaw) -> ControlLaw:
    """Return a law whose commands are what the robot takes.

    A law of positions or velocities reads the reference ahead; the torque of another one moves the
    nominal model, at every state even if the law is slower. A custom law with a method
    ``make_up_for`` receives the lag of the robot's own controller, s.
    """
    scenario = setup.scenario
    controller, takes = scenario.controller, scenario.plant.interface.takes
    if isinstance(law, TargetsAlone) and takes == TORQUE and not controller.drive_feedback.enabled:
        allowed = f"must have a method torque beside target, {_UNLESS}"
        raise ConfigurationError(_LAW, controller.law, allowed, [_KEY])
    if isinstance(law, OuterLaw):
        law.follow(setup.reference.copied(), preview_s(setup, link))
    else:
        _check_no_preview(setup)
    tell_lag(controller.law, law, own_lag_s(setup))
    moves_nominal = takes != TORQUE and not (hasattr(law, "target") or isinstance(law, LeftOut))
    period_s, fastest_rad_s = 1e-9 * setup.grid.period_ns, setup.robot.velocity_limits_rad_s
    takes = TORQUE if moves_nominal else takes
    paced = controller.paced(law, period_s, scenario.seed, takes, fastest_rad_s)
    if not moves_nominal:
        return paced
    rotors = scenario.plant.actuator.rotor_inertia(setup.robot.joints)
    model = controller.nominal_model(setup.nominal, rotors)
    return Admittance(paced, model, setup.largest_torques_nm)


def longest_step_s(setup: CheckedScenario) -> float:
    """Return the time between states above which some were absent, for laws that send targets."""
    return math.inf if setup.takes_torque else 1e-9 * (ABSENCE_STATES * setup.grid.period_ns)


def interface_in_force(setup: CheckedScenario) -> InterfaceConfiguration:
    """Return the robot's interface with its clock against that of the control loop's ticks."""
    interface, controller = setup.scenario.plant.interface, setup.scenario.controller
    ppm = interface.clock_ppm - controller.clock_ppm
    return interface.model_copy(update={"clock_ppm": ppm})


def preview_s(setup: CheckedScenario, link: LinkConfiguration) -> float:
    """Return how far ahead of a state the reference is read.

    ``auto`` is the median round trip at the start, or the play-out time if that is longer, the lag
    of the robot's own controller, and the age of a slow law's answers. It is 0 for drives, which go
    on along their targets from the stamp of the state.

    Raises:
        ConfigurationError: it is ``auto``, but the robot's lag is unknown.
    """
    controller, interface = setup.scenario.controller, setup.scenario.plant.interface
    if controller.preview_ms != "auto":
        return 1e-3 * controller.preview_ms
    if not interface.has_controller:
        return 0.0
    period_s = 1e-9 * setup.grid.period_ns
    ways = (way.model_copy(update={"schedule": ()}) for way in (link.uplink, link.downlink))
    up_ns, down_ns = map(configured_delays_ns, ways)
    usual_ns = round_trip_ns(up_ns, down_ns, 0.5)
    round_trip_s = 1e-9 * max(usual_ns, link.playout_ns)
    goes_on = controller.between_answers == "linear" and interface.takes == "position"
    age_s = 0.0 if goes_on else controller.answer_age_s(period_s)
    return round_trip_s + age_s + robot_lag_s(setup)


def robot_lag_s(setup: CheckedScenario) -> float:
    """Return how far joints that move steadily are behind targets that have arrived.

    Raises:
        ConfigurationError: it is unknown.
    """
    interface = setup.scenario.plant.interface
    lag_s = interface.lag_s(1e-9 * setup.grid.period_ns)
    if lag_s is None:
        allowed = f"must be a time in ms where {_KEY} = {interface.kind} and targets come more"
        allowed += " slowly than its cycles: its lag has no closed form"
        raise ConfigurationError(_PREVIEW, "auto", allowed, ["rate_hz", f"{_SECTION}.rate_hz"])
    if not interface.has_controller or interface.settings.knows_arm:
        return lag_s
    drive = setup.drive  # which takes no velocities
    return lag_s + float((drive.damping_nm_s / drive.stiffness_nm_rad).mean())


def own_lag_s(setup: CheckedScenario) -> float:
    """Return `robot_lag_s` of a robot with a controller of its own that takes targets.

    It is 0 for others, and where it is unknown.
    """
    interface = setup.scenario.plant.interface
    if not interface.has_controller or interface.takes == TORQUE:
        return 0.0
    try:
        return robot_lag_s(setup)
    except ConfigurationError:
        return 0.0


def uncovered_lag_s(setup: CheckedScenario) -> float:
    """Return the part of `own_lag_s` for which the law does not make up by reading ahead."""
    controller, own_s = setup.scenario.controller, own_lag_s(setup)
    law = controller.law
    if law not in LAWS:  # whose code is not loaded to judge a recording, but for our own
        shipped = SHIPPED.get(law)
        acts_ahead = shipped is not None and shipped.acts_ahead(controller.gains.get("custom", {}))
        return 0.0 if acts_ahead else own_s
    if LAWS[law].gives == TORQUE:
        return own_s
    ahead_s = own_s if controller.preview_ms == "auto" else 1e-3 * controller.preview_ms
    return max(0.0, own_s - ahead_s)


def moves_model(scenario: ScenarioConfiguration) -> bool:
    """Whether a shipped law of torques drives a robot that takes targets.

    Its torque moves a nominal model, which the robot follows, so that friction is not in the loop.
    """
    law = scenario.controller.law
    gives_torque = law in LAWS and LAWS[law].gives == TORQUE
    return scenario.plant.interface.takes != TORQUE and gives_torque


def check_interface(setup: CheckedScenario) -> None:
    """Check that the law gives what the robot takes, over a link that can carry it.

    Raises:
        ConfigurationError: it does not.
    """
    scenario = setup.scenario
    controller, interface = scenario.controller, scenario.plant.interface
    takes, where = interface.takes, f"{_KEY} = {interface.kind}"
    gives = LAWS[controller.law].gives if controller.law in LAWS else TORQUE
    if takes == TORQUE and gives != TORQUE and not controller.drive_feedback.enabled:
        allowed = f"gives no torque, and {where} takes nothing else"
        raise ConfigurationError(_LAW, controller.law, allowed, [_KEY])
    if takes != TORQUE and gives not in (takes, "motion", TORQUE):
        allowed = f"gives {gives}, and {where} takes {takes}"
        raise ConfigurationError(_LAW, controller.law, allowed, [_KEY])
    if controller.process is not None:
        _check_no_preview(setup)
    _check_targets_arrive(scenario)
    if interface.has_controller:
        _check_link(scenario, reaches_it=setup.link_kind.reaches_robots)
        if takes == TORQUE and (lacking := _torque_lacking(setup.robot)):
            why = f"{setup.robot.path.name} {lacking}"
            allowed = f"must be of positions or velocities, such as servoj: {why}"
            raise ConfigurationError(_KEY, interface.kind, allowed)
    else:
        _check_no_controller(scenario)


def _torque_lacking(robot: RobotDescription) -> str:
    """Return what an arm's file says against a torque interface; empty for nothing."""
    driven, taken = set(robot.joint_names), set[str | None]()
    for joint in ET.fromstring(robot.text).findall("ros2_control/joint"):
        if joint.get("name") in driven:
            taken |= {each.get("name") for each in joint.findall("command_interface")}
    if taken and "effort" not in taken:
        return f"has command interfaces for {', '.join(sorted(map(str, taken)))} alone"
    if robot.drives.servo_stiffness_nm_rad.all():
        return "has position servos at all joints"
    limits_nm = robot.effort_limits_nm
    unknown = ~(np.isfinite(limits_nm) & (limits_nm > 0.0))
    if unknown.any():
        return f"gives no largest torque of {robot.joint_names[int(unknown.argmax())]}"
    return ""


def _check_no_preview(setup: CheckedScenario) -> None:
    """Check that no preview is given to a controller that has no use for it."""
    controller = setup.scenario.controller
    if controller.preview_ms != "auto":
        reads = "which reads the reference ahead itself (tracking.reference_at), if at all"
        if not is_custom(controller.law):
            reads = "which reads no reference ahead"
        allowed = f"must be auto with {controller.name}, {reads}"
        raise ConfigurationError(_PREVIEW, controller.preview_ms, allowed, [_LAW])


def _check_targets_arrive(scenario: ScenarioConfiguration) -> None:
    """Check that drives or a robot take the targets of a program or a policy server."""
    controller = scenario.controller
    if controller.drive_feedback.enabled or scenario.plant.interface.takes != TORQUE:
        return
    if is_address(controller.law):
        allowed = f"must not be a policy server, {_UNLESS}"
        raise ConfigurationError(_LAW, controller.law, allowed, [_KEY])
    if controller.law == EXTERNAL and controller.external and controller.external.targets:
        allowed = f"must be false, {_UNLESS}"
        raise ConfigurationError("controller.external.targets", True, allowed, [_KEY])


def _check_no_controller(scenario: ScenarioConfiguration) -> None:
    """Check that nothing is set of a controller that a robot does not have."""
    if ppm := scenario.controller.clock_ppm:
        allowed = f"must be 0 where {_KEY} = torque: there is no second clock"
        raise ConfigurationError("controller.clock_ppm", ppm, allowed, [_KEY])
    interface = scenario.plant.interface
    for name in _OF_ITS_CONTROLLER:
        value, usual = getattr(interface, name), type(interface).model_fields[name].default
        if value != usual:
            usual = "left out" if usual is None else f"{usual:g}"
            allowed = f"must be {usual} where {_KEY} = torque: the robot has no own controller"
            raise ConfigurationError(f"{_SECTION}.{name}", value, allowed, [_KEY])


def _check_link(scenario: ScenarioConfiguration, *, reaches_it: bool) -> None:
    """Check what does not go with a robot that has a controller of its own."""
    takes_torque = scenario.plant.interface.takes == TORQUE
    plant, controller = scenario.plant.drive_feedback, scenario.controller
    feedback = controller.drive_feedback.enabled
    compensation = controller.delay_compensation.enabled
    conflicts = {
        "link.kind": (scenario.link.kind, not reaches_it),
        "controller.drive_feedback.enabled": (True, feedback),
        "controller.delay_compensation.enabled": (True, compensation and not takes_torque),
        "plant.drive_feedback.enabled": (True, plant.enabled and takes_torque),
    }
    for key, (value, is_in_conflict) in conflicts.items():
        if is_in_conflict:
            kind = scenario.plant.interface.kind
            allowed = f"must be another value with {_KEY} = {kind}"
            raise ConfigurationError(key, value, allowed, [_KEY])
