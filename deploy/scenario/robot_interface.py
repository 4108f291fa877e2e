"""A controller for a robot that has a controller of its own."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from bus_schema.configuration import ConfigurationError
from controller.control_law import ABSENCE_STATES, ControlLaw
from controller.laws import LAWS
from controller.outer_laws.admittance import Admittance
from controller.outer_laws.outer_law import OuterLaw
from plant_emulator.interfaces.configuration import InterfaceConfiguration
from plant_emulator.interfaces.settings import TORQUE

if TYPE_CHECKING:
    from deploy.scenario.definition import ScenarioConfiguration
    from deploy.scenario.setup import Setup

_KEY = "plant.interface.kind"
_LAW = "controller.law"


def law_for_robot(setup: Setup) -> ControlLaw:
    """Return the scenario's law, asked as often as it says, with commands that the robot takes.

    A law of positions or velocities reads the reference ahead; the torque of another one moves the
    nominal model at each state, however seldom the law is asked.
    """
    controller = setup.scenario.controller
    rotors = setup.scenario.plant.actuator.rotor_inertia(setup.robot.joints)
    law = controller.build_law(setup.gains, setup.nominal, rotors)
    if isinstance(law, OuterLaw):
        law.follow(setup.reference.copied(), preview_s(setup))
    takes = setup.scenario.plant.interface.takes
    period_s, gives_targets = 1e-9 * setup.grid.period_ns, hasattr(law, "target")
    paced = controller.paced(law, period_s, setup.scenario.seed, takes if gives_targets else TORQUE)
    if takes == TORQUE or gives_targets:
        return paced
    model = controller.nominal_model(setup.nominal, rotors)
    return Admittance(paced, model, setup.largest_torques_nm)


def longest_step_s(setup: Setup) -> float:
    """Return the time between states over which a law integrates at most.

    The motion of a robot that takes targets would jump after an absence of states.
    """
    is_bounded = not takes_torque(setup)
    return 1e-9 * ABSENCE_STATES * setup.grid.period_ns if is_bounded else math.inf


def takes_torque(setup: Setup) -> bool:
    """Whether the robot's drives follow torques."""
    return setup.scenario.plant.interface.takes == TORQUE


def interface_in_force(setup: Setup) -> InterfaceConfiguration:
    """Return the robot's interface with its clock against that of the control loop's ticks."""
    interface, controller = setup.scenario.plant.interface, setup.scenario.controller
    ppm = interface.clock_ppm - controller.clock_ppm
    return interface.model_copy(update={"clock_ppm": ppm})


def preview_s(setup: Setup) -> float:
    """Return how far ahead of a state the reference is read.

    ``auto`` is the emulated round trip, or the play-out time if that is longer, and the lag of the
    robot's own controller.
    """
    wanted_ms = setup.scenario.controller.preview_ms
    if wanted_ms != "auto":
        return 1e-3 * wanted_ms
    link = setup.link
    round_trip_ns = max(link.emulated_round_trip_ns, link.playout_ns)
    return 1e-9 * round_trip_ns + robot_lag_s(setup)


def robot_lag_s(setup: Setup) -> float:
    """Return how far joints that move steadily are behind targets that have arrived."""
    interface = setup.scenario.plant.interface
    if not interface.has_controller or interface.settings.knows_arm:
        return interface.lag_s
    drive = setup.drive  # which takes no velocities
    return interface.lag_s + float((drive.damping_nm_s / drive.stiffness_nm_rad).mean())


def check_interface(setup: Setup) -> None:
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
    if interface.has_controller:
        _check_link(scenario, is_predicted=takes == TORQUE)
    elif controller.clock_ppm:
        allowed = f"must be 0 where {where}: there is no second clock"
        raise ConfigurationError("controller.clock_ppm", controller.clock_ppm, allowed, [_KEY])


def _check_link(scenario: ScenarioConfiguration, *, is_predicted: bool) -> None:
    """Check what does not go with a robot that has a controller of its own."""
    feedback, compensation = (
        section.enabled
        for section in (scenario.controller.drive_feedback, scenario.controller.delay_compensation)
    )
    conflicts = {
        "link.kind": (scenario.link.kind, scenario.link.kind == "can"),
        "controller.drive_feedback.enabled": (True, feedback),
        "controller.delay_compensation.enabled": (True, compensation and not is_predicted),
    }
    for key, (value, is_in_conflict) in conflicts.items():
        if is_in_conflict:
            kind = scenario.plant.interface.kind
            allowed = f"must be another value with {_KEY} = {kind}"
            raise ConfigurationError(key, value, allowed, [_KEY])
