"""Warnings for accepted but suspicious settings of a scenario."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import expand
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.checking.plausibility import damping_warnings, placeholder_warnings
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.setup import Setup
from deploy.scenario.starter import ESTIMATED
from deploy.scenario.yaml_files import ScenarioError, override
from plant_emulator.arm.drive_train import friction_table

ROTORS = "plant.actuator.rotor_inertia_kg_m2"
_TORQUE_SAMPLES = 400
_WEAK_SHARE = 0.1
"""Share of the time in which a margin lets the arm fall: the funnel may be wider than that."""


def all_warnings(setups: Iterable[Setup]) -> list[str]:
    """Return the warnings of several scenarios, each once."""
    return list(
        dict.fromkeys(sentences for setup in setups for sentences in scenario_warnings(setup))
    )


def scenario_warnings(setup: Setup) -> list[str]:
    """Return warnings about accepted but suspicious settings, a sentence each."""
    robot, scenario = setup.robot, setup.scenario
    sentences = [*robot.warnings, *setup.reference.warnings]
    saturation_nm = scenario.plant.actuator.saturation_nm
    for what, given, limits, quantity, remedy in (
        ("effort", scenario.limits.torque_nm if saturation_nm is None else saturation_nm,
         robot.effort_limits_nm, "torques", "limits.torque_nm or plant.actuator.saturation_nm"),
        ("velocity", scenario.limits.velocity_rad_s, robot.velocity_limits_rad_s, "speeds",
         "limits.velocity_rad_s"),
    ):  # fmt: skip
        if given is None and (lacking := _unlimited(robot.joint_names, limits)):
            sentences.append(
                f"no {what} limit in the URDF for {lacking}: {quantity} are UNLIMITED there;"
                f" set {remedy}"
            )
    actuator = scenario.plant.actuator
    if actuator.gear_stiffness_nm_rad is not None and actuator.encoder_side == "link":
        sentences.append(
            "plant.actuator.encoder_side: link measures on the output side of elastic gears. With"
            " this, no shipped law kept its bounds at a first resonance of 15 Hz; motor measures"
            " on the input side"
        )
    if ESTIMATED in (data := setup.drive_data):
        sentences.append(
            f"{data}: replace the estimates in the scenario (funnel-hil robot --scenario writes"
            " one)"
        )
    in_plant = scenario.plant.model_fields_set
    if not in_plant & {"friction", "actuator"} and robot.path.parent != ROBOTS:
        sentences.append(
            f"{robot.path.name}: the plant has neither rotors nor friction, which real arms have:"
            " funnel-hil robot --scenario writes a scenario with estimates of both"
        )
    sentences += _torque_warning(setup)
    most_nm = scenario.limits.of_plant(robot).torque_nm
    largest_nm = setup.largest_torques_nm
    sentences += placeholder_warnings(robot, largest_nm)
    viscous = friction_table(scenario.plant.friction, _rated_torques(setup))["viscous_nm_s"]
    of_file = np.isclose(viscous, robot.drives.damping_nm_s, rtol=1e-3)
    sentences += damping_warnings(robot, np.where(of_file, viscous, 0.0), largest_nm)
    return sentences + setup.link_kind.warnings(setup.link_run(lockstep=True), most_nm)


def estimated_rotor_warnings(setup: Setup) -> list[str]:
    """Return a warning about estimated rotors, with the option for a tenth of them."""
    if (tenth := tenth_of_rotors(setup)) is None:
        return []
    return [
        "rotor inertias are estimated, and margins depend on them: funnel-hil margin also searches"
        f" with a tenth of them; other commands take --set '{tenth}'"
    ]


def tenth_of_rotors(setup: Setup) -> str | None:
    """Return the override with a tenth of the estimated rotors; None if none are estimated."""
    robot, actuator = setup.robot, setup.scenario.plant.actuator
    is_estimated = re.search(rf"rotor inertia[^,;]*{ESTIMATED}", setup.drive_data)
    if not is_estimated or not actuator.has_rotors:
        return None
    rotors = actuator.rotor_inertia(robot.joints)
    of_file = np.isclose(rotors, robot.drives.rotor_inertia_kg_m2, rtol=1e-3) & (rotors > 0.0)
    tenth = [float(f"{each:.3g}") for each in np.where(of_file, rotors, 0.1 * rotors)]
    return override(ROTORS, tenth)


def _torque_warning(setup: Setup) -> list[str]:
    """Warn if the reference needs more than a joint's rated torque."""
    robot, limits = setup.robot, setup.largest_torques_nm
    times_s = np.linspace(0.0, setup.scenario.duration_s, _TORQUE_SAMPLES)
    torques = np.abs(reference_torques(setup, times_s))
    usage = torques / np.where(limits > 0.0, limits, np.inf)
    if not usage.max(initial=0.0) > 1.0:
        return []
    tick, joint = np.unravel_index(int(usage.argmax()), usage.shape)
    more = int((usage.max(axis=0) > 1.0).sum()) - 1
    others = f"; {more} more joint{'s' * (more > 1)} too" if more else ""
    return [
        f"the reference needs {robot.joint_names[joint]} to deliver {torques[tick, joint]:.3g} N m"
        f" at {times_s[tick]:.2f} s, {usage[tick, joint]:.2f} times its largest torque"
        f" {limits[joint]:g} N m{others}: no law can follow it"
    ]


def require_hold(setup: Setup) -> None:
    """Require that the arm can hold itself up on its reference.

    Raises:
        ScenarioError: it cannot; the message names the joint and both torques.
    """
    times_s = np.linspace(0.0, setup.scenario.duration_s, _TORQUE_SAMPLES)
    needed, most = np.abs(reference_torques(setup, times_s, at_rest=True)), setup.largest_torques_nm
    if (needed > most).mean(axis=0).max() > _WEAK_SHARE:
        at, joint = np.unravel_index(int((needed - most).argmax()), needed.shape)
        raise ScenarioError(
            f"no margin: {setup.robot.joint_names[joint]} cannot hold the arm up on its reference:"
            f" gravity needs {needed[at, joint]:.4g} N m at {times_s[at]:.2f} s, its largest torque"
            f" is {most[joint]:g} N m (limits.torque_nm, plant.actuator.saturation_nm)"
        )


def _rated_torques(setup: Setup) -> Vector:
    """Return the largest torques of which friction may be a share, shape (joints,), N m."""
    saturation_nm = setup.scenario.plant.actuator.saturation_nm
    if saturation_nm is None:
        return setup.robot.effort_limits_nm
    return expand(saturation_nm, setup.robot.joints, "plant.actuator.saturation_nm")


def reference_torques(setup: Setup, times_s: Vector, *, at_rest: bool = False) -> Matrix:
    """Return torques that move the arm along its reference, shape (times, joints), N m.

    Args:
        setup: the scenario.
        times_s: shape (times,).
        at_rest: only those of gravity.
    """
    plant, robot = setup.scenario.plant, setup.robot
    model = ManipulatorModel(
        robot,
        payload_kg=plant.payload_kg,
        rotor_inertia_kg_m2=plant.actuator.rotor_inertia(robot.joints),
    )
    friction = friction_table(plant.friction, _rated_torques(setup))
    dry, smooth = friction["coulomb_nm"], friction["smoothing_velocity_rad_s"]
    motion = np.empty((3, robot.joints))
    follow, torques = setup.reference.onto(*motion), []
    for time_s in times_s:
        follow(float(time_s))
        motion[1:] *= not at_rest
        resisting = dry * np.tanh(motion[1] / smooth) + friction["viscous_nm_s"] * motion[1]
        torques.append(model.inverse_dynamics(*motion) + resisting)
    return np.array(torques)


def _unlimited(names: Sequence[str], limits: Vector) -> str:
    """Return names of the joints without a limit; exporters write zero for an unknown one."""
    found = [name for name, limit in zip(names, limits, strict=True) if not np.isfinite(limit)]
    shown = ", ".join(found[:4])
    return f"{shown} and {len(found) - 4} more" if len(found) > 4 else shown
