"""A controller for a robot that has a controller of its own."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from controller.control_law import ABSENCE_STATES, ControlLaw
from controller.outer_laws.admittance import Admittance
from controller.outer_laws.outer_law import OuterLaw
from plant_emulator.channel.delay_range import median_round_trip_ns
from plant_emulator.interfaces.configuration import InterfaceConfiguration
from plant_emulator.interfaces.settings import TORQUE

if TYPE_CHECKING:
    from deploy.scenario.setup import Setup


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

    ``auto`` is the median of the emulated round trip, or the play-out time if that is longer, the
    mean age of a slow law's answer, and the lag of the robot's own controller. It is 0 for drives
    that close a loop around targets: they move a target on with its velocity since its state.
    """
    controller, interface = setup.scenario.controller, setup.scenario.plant.interface
    if controller.preview_ms != "auto":
        return 1e-3 * controller.preview_ms
    if not interface.has_controller:
        return 0.0
    link, period_s = setup.link, 1e-9 * setup.grid.period_ns
    sides = (side.model_copy(update={"schedule": ()}) for side in (link.uplink, link.downlink))
    round_trip_ns = max(median_round_trip_ns(*sides), link.playout_ns)
    moves_on = controller.between_answers == "linear" and interface.takes == "position"
    age_s = 0.0 if moves_on else controller.answer_age_s(period_s)
    return 1e-9 * round_trip_ns + age_s + robot_lag_s(setup)


def robot_lag_s(setup: Setup) -> float:
    """Return how far joints that move steadily are behind targets that have arrived."""
    interface = setup.scenario.plant.interface
    if not interface.has_controller or interface.settings.knows_arm:
        return interface.lag_s
    drive = setup.drive  # which takes no velocities
    return interface.lag_s + float((drive.damping_nm_s / drive.stiffness_nm_rad).mean())
