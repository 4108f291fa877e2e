"""The option ``--interface``: what a scenario needs so that a robot has a certain interface."""

from __future__ import annotations

from typing import Any, TypeGuard

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean
from deploy.scenario.study_keys import LAW
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.interfaces.configuration import INTERFACES, InterfaceConfiguration
from plant_emulator.interfaces.settings import TORQUE, Takes

KIND = "plant.interface.kind"
COMPENSATION = "controller.delay_compensation.enabled"
DRIVE_FEEDBACK = "controller.drive_feedback.enabled"
OFFSET = "robot.initial_offset_rad"
LOOPS: dict[Takes, str] = {"position": "position_correction", "velocity": "proportional_velocity"}
"""The shipped law that closes a loop around a robot, by what the robot takes."""


def takes_of(kind: str) -> Takes:
    """Return what a robot with a kind of interface takes.

    Raises:
        ScenarioError: there is no such kind, or its package cannot be loaded.
    """
    if kind not in (TORQUE, *INTERFACES):
        known = ", ".join((TORQUE, *INTERFACES))
        raise ScenarioError(
            f"--interface {kind}: must be one of {known}{did_you_mean(kind, INTERFACES)}"
        )
    try:
        return InterfaceConfiguration(kind=kind).takes
    except ConfigurationError as error:
        raise ScenarioError(f"--interface {kind}: {error}") from error


def has_controller(kind: str | None) -> TypeGuard[str]:
    """Whether robots of a kind have a controller of their own; raises as `takes_of`."""
    return kind is not None and bool(takes_of(kind)) and kind != TORQUE


def interface_values(kind: str | None, law: str | None = None) -> dict[str, Any]:
    """Return values of a scenario whose robot has an interface, by dotted key.

    A robot with a controller of its own starts on its reference: it refuses or ignores a jump. One
    that takes positions or velocities has a law that gives them, unless another one is named.

    Args:
        kind: the interface; None for that of the scenario.
        law: the law, if it is named; None for the interface's own.

    Raises:
        ScenarioError: as `takes_of`.
    """
    if kind is None:
        return {}
    takes = takes_of(kind)
    if kind == TORQUE:
        return {KIND: kind}
    values: dict[str, Any] = {KIND: kind, OFFSET: 0.0, DRIVE_FEEDBACK: False}
    if takes == TORQUE:
        return values
    return {**values, COMPENSATION: False, LAW: law or LOOPS[takes]}


def laws_for(kind: str | None) -> list[str] | None:
    """Return the laws that close a loop around a robot; None where all laws of torques do.

    Raises:
        ScenarioError: as `takes_of`.
    """
    takes = TORQUE if kind is None else takes_of(kind)
    return None if takes == TORQUE else [LOOPS[takes]]
