"""Checks of a robot's interface: what a law gives, what the robot takes, what has no effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bus_schema.configuration import ConfigurationError, StrictModel
from controller.configuration import ControllerConfiguration
from controller.laws import LAWS
from controller.laws.custom import EXTERNAL
from plant_emulator.interfaces.settings import TORQUE

if TYPE_CHECKING:
    from deploy.scenario.definition import ScenarioConfiguration
    from deploy.scenario.setup import Setup

_KEY = "plant.interface.kind"
_LAW = "controller.law"
_OF_ITS_CONTROLLER = ("rate_hz", "phase_ms", "clock_ppm")
_OF_DRIVES = ("enabled", "stiffness_nm_rad", "damping_nm_s")
_SAME_RATE = 1.01
"""Of periods that two clocks have: nearly each cycle reads a new message."""


def check_interface(setup: Setup) -> None:
    """Check that the law gives what the robot takes, over a link that can carry it.

    Raises:
        ConfigurationError: it does not.
    """
    scenario = setup.scenario
    controller, interface = scenario.controller, scenario.plant.interface
    takes, where = interface.takes, f"{_KEY} = {interface.kind}"
    gives, closes_loop = given_by(controller), controller.drive_feedback.enabled
    if takes == TORQUE and gives != TORQUE and not closes_loop and controller.law == EXTERNAL:
        allowed = f"must be false with {where}, unless controller.drive_feedback.enabled is true"
        raise ConfigurationError("controller.external.targets", True, allowed, [_KEY])
    if takes == TORQUE and gives != TORQUE and not closes_loop:
        allowed = f"gives no torque, and {where} takes nothing else"
        raise ConfigurationError(_LAW, controller.law, allowed, [_KEY])
    if takes != TORQUE and gives not in (takes, "motion", TORQUE):
        allowed = f"gives {gives}, and {where} takes {takes}"
        raise ConfigurationError(_LAW, controller.law, allowed, [_KEY])
    if interface.has_controller:
        _check_conflicts(setup)
    is_ahead = gives != TORQUE and controller.law in LAWS
    if is_ahead and interface.has_controller and controller.preview_ms == "auto":
        _check_automatic_preview(setup)
    _check_effects(scenario, reads_ahead=is_ahead)


def given_by(controller: ControllerConfiguration) -> str:
    """Return what a law's commands contain, as `controller.laws.LawEntry.gives` has it."""
    if controller.law == EXTERNAL and controller.external is not None:
        return "motion" if controller.external.targets else TORQUE
    return LAWS[controller.law].gives if controller.law in LAWS else TORQUE


def _check_conflicts(setup: Setup) -> None:
    """Check what does not go with a robot that has a controller of its own."""
    controller, interface = setup.scenario.controller, setup.scenario.plant.interface
    is_predicted = controller.delay_compensation.enabled and interface.takes != TORQUE
    conflicts: dict[str, tuple[object, bool, str]] = {
        "link.kind": (setup.scenario.link.kind, setup.link_kind.has_drives, "another value"),
        "controller.drive_feedback.enabled": (True, controller.drive_feedback.enabled, "false"),
        "controller.delay_compensation.enabled": (
            True, is_predicted, "false: controller.preview_ms reads the reference ahead instead,"
        ),
    }  # fmt: skip
    for key, (value, is_in_conflict, allowed) in conflicts.items():
        if is_in_conflict:
            allowed = f"must be {allowed} with {_KEY} = {interface.kind}"
            raise ConfigurationError(key, value, allowed, [_KEY])


def _check_automatic_preview(setup: Setup) -> None:
    """Check that the robot's lag is known."""
    interface = setup.scenario.plant.interface
    cycle_ms = 1e3 * interface.true_period_s
    if interface.settings.restarts and 1e-6 * setup.grid.period_ns > _SAME_RATE * cycle_ms:
        allowed = (
            f"must be a number with {_KEY} = {interface.kind}, whose joints lag and start each"
            f" message where they are: its lag is known for a message in each cycle of"
            f" {cycle_ms:g} ms"
        )
        raise ConfigurationError("controller.preview_ms", "auto", allowed, ["rate_hz", _KEY])


def _check_effects(scenario: ScenarioConfiguration, *, reads_ahead: bool) -> None:
    """Check that no setting of robot, drives or preview is without effect."""
    controller, plant = scenario.controller, scenario.plant
    interface = plant.interface
    is_known = interface.has_controller and interface.settings.knows_arm
    closes_loop = interface.has_controller and interface.takes != TORQUE
    no_clock, no_loop = "it has no controller of its own", "its own controller drives the joints"
    idle: list[tuple[StrictModel, str, tuple[str, ...], str]] = []
    if not interface.has_controller:
        idle.append((interface, "plant.interface", _OF_ITS_CONTROLLER, no_clock))
        idle.append((controller, "controller", ("clock_ppm",), "there is no second clock"))
    if not closes_loop:
        idle.append((interface, "plant.interface", ("bandwidth_rad_s",), "it closes no loop"))
    if is_known:
        idle.append((plant.drive_feedback, "plant.drive_feedback", _OF_DRIVES, no_loop))
    for section, name, fields, reason in idle:
        _require_default(section, name, fields, f"{_KEY} = {interface.kind}: {reason}", _KEY)
    if not reads_ahead:
        reason = f"{_LAW} = {controller.law}, which reads no reference ahead"
        _require_default(controller, "controller", ("preview_ms",), reason, _LAW)


def _require_default(
    section: StrictModel, name: str, fields: tuple[str, ...], reason: str, beside: str
) -> None:
    """Check that values of a section are those of a scenario that does not mention them."""
    for field in fields:
        value, default = getattr(section, field), type(section).model_fields[field].default
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if value != default:
            allowed = f"must be left out with {reason}"
            raise ConfigurationError(f"{name}.{field}", value, allowed, [beside])
