"""The lag of a robot that has a controller of its own, as a reason of a loss."""

from __future__ import annotations

from bus_schema.configuration import ConfigurationError
from controller.laws import LAWS
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.robot_interface import robot_lag_s
from deploy.scenario.setup import Setup
from plant_emulator.interfaces.settings import TORQUE


def own_lag_s(setup: Setup) -> float:
    """Return how far a robot is behind its targets at a constant speed, without any network, s.

    It is 0 for arms that take torques, and where it is unknown.
    """
    interface = setup.scenario.plant.interface
    if not interface.has_controller or interface.takes == TORQUE:
        return 0.0
    try:
        return robot_lag_s(setup)
    except ConfigurationError:
        return 0.0


def moves_model(scenario: ScenarioConfiguration) -> bool:
    """Whether a shipped law of torques drives a robot that takes targets.

    Its torque moves a nominal model, which the robot follows, so that friction is not in the loop.
    """
    law = scenario.controller.law
    gives_torque = law in LAWS and LAWS[law].gives == TORQUE
    return scenario.plant.interface.takes != TORQUE and gives_torque
