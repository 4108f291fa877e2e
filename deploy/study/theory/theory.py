"""Theoretical delay margins of a law, to compare with those that a search finds.

The loop is linear: the arm at its start with gears, viscous friction and gravity, and the law as
it answers small errors there. States are sampled, torques are held. Two things follow:

- The constant round trips with which the loop is unstable.
- A bound below which it is stable however the delay varies, see `pattern_bound`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from controller.control_law import ControlLaw
from controller.laws.custom import EXTERNAL
from controller.outer_laws.outer_law import OuterLaw
from controller.slow_law import SlowLaw
from deploy.scenario.setup import Setup
from deploy.study.theory.linear_law import LinearLaw
from deploy.study.theory.linear_plant import linear_plant
from deploy.study.theory.linear_robot import LinearRobot, linear_robot
from deploy.study.theory.pattern_bound import pattern_bound_s
from deploy.study.theory.probe import linear_law
from deploy.study.theory.sampled_loop import SampledLoop
from deploy.study.theory.windows import after_dead_time, unstable_windows
from plant_emulator.interfaces.settings import TORQUE

LONGEST_S = 1.0
"""The largest delay that theory looks at."""
_DEAD = "its linear loop is unstable with the dead time of the actuators alone"
_OWN_LOOPS = "the robot's own controller closes its loops"
_OWN_TORQUES = "the robot's own controller reads torques at its own rate"
_MOST_STATES = 1000
"""Of a law; more take minutes."""


def theory_of(setup: Setup) -> dict[str, Any]:
    """Return what theory says about constant and varying delays of a scenario, for a summary.

    It takes no run, and does not depend on the scenario's own delays.

    Returns:
        ``unstable_ms``: windows of constant round trips with which the loop is unstable, first and
        last (None: at least up to 1000), none if empty; ``constant_ms``: below it every constant
        delay is stable (1000 also beyond; None if unstable without a delay); ``any_pattern_ms``:
        below it every pattern is (likewise); ``joint``: the one that moves most in the first
        instability; ``unstable_without_delay``: None, or ``rate_per_s``, ``frequency_hz`` and
        ``joint`` of the fastest growth without a delay. Or only ``reason``, why there is no theory.
    """
    try:
        law = _law(setup)
    except Exception as error:  # noqa: BLE001 (a user's law may raise any exception)
        law = f"the law raised {type(error).__name__}: {error}"
    if isinstance(law, str):
        return {"reason": law}
    robot = _robot(setup)
    plant = linear_plant(setup) if robot is None else robot.plant
    loop = SampledLoop(plant, law, 1e-9 * setup.grid.period_ns)
    step_s = setup.grid.substep_s
    dead_s = setup.scenario.plant.actuator.delay_steps(step_s) * step_s
    dead_s += 0.0 if robot is None else robot.dead_s
    try:
        return _findings(loop, setup.robot.joint_names, dead_s)
    except ArithmeticError as error:
        return {"reason": f"of its linear loop, {error}"}


def _law(setup: Setup) -> LinearLaw | str:
    """Return the law as a linear one, or why a scenario has no linear loop."""
    controller = setup.scenario.controller
    if controller.process or controller.law == EXTERNAL:
        return "the law is a separate program"
    if controller.delay_compensation.enabled:
        return "delay compensation predicts and learns"
    law = setup.control_task().law
    if isinstance(law, SlowLaw):
        return "the law is slower than the control loop"
    if (interface := setup.scenario.plant.interface).has_controller:
        return _OWN_TORQUES if interface.takes == TORQUE else _outer_law(law, setup)
    if controller.drive_feedback.enabled and hasattr(law, "target"):
        return "the drives follow the law's own targets"
    found = linear_law(law, setup)
    if isinstance(found, LinearLaw) and found.states > _MOST_STATES:
        return f"its torque depends on errors of {len(found.taps) - 1} ticks before: it filters"
    return found


def _robot(setup: Setup) -> LinearRobot | None:
    return linear_robot(setup) if setup.scenario.plant.interface.has_controller else None


def _outer_law(law: ControlLaw, setup: Setup) -> LinearLaw | str:
    """Return a law of targets as a linear one; its loop is closed around the robot's own."""
    robot = _robot(setup)
    if robot is None or not isinstance(law, OuterLaw):
        return _OWN_LOOPS
    law.follow(setup.reference, 0.0)  # at rest, as the probe has it
    found = linear_law(law, setup, robot.row)
    if isinstance(found, LinearLaw) and not robot.shows_velocity:
        reads_velocity = bool(found.taps[:, :, setup.robot.joints :].any())
        return _OWN_LOOPS if reads_velocity else found
    return found


def _findings(loop: SampledLoop, names: Sequence[str], dead_s: float) -> dict[str, Any]:
    """Return what a loop tolerates beside the dead time of its actuators."""
    windows = after_dead_time(unstable_windows(loop, LONGEST_S + dead_s), dead_s)
    if dead_s > 0.0 and windows and windows[0].begin_s == 0.0:
        return {"reason": _DEAD}
    unstable_ms = [
        [_below_ms(each.begin_s), -_below_ms(-each.end_s) if each.end_s < LONGEST_S else None]
        for each in windows
    ]
    constant_ms = any_pattern_ms = joint = without = None
    if not windows or windows[0].begin_s > 0.0:
        constant_ms = _below_ms(windows[0].begin_s if windows else LONGEST_S)
        any_pattern_ms = _below_ms(min(max(0.0, pattern_bound_s(loop) - dead_s), LONGEST_S))
        if windows:
            joint = names[loop.moving_most(windows[0].angle, windows[0].begin_s + dead_s)]
    else:
        growth, number = loop.fastest_growth()
        joint = names[number]
        without = {
            "rate_per_s": _three_digits(growth.real),
            "frequency_hz": _three_digits(abs(growth.imag) / (2.0 * np.pi)),
            "joint": joint,
        }
    return {
        "constant_ms": constant_ms,
        "any_pattern_ms": any_pattern_ms,
        "joint": joint,
        "unstable_ms": unstable_ms,
        "unstable_without_delay": without,
    }


def _three_digits(value: float) -> float:
    return float(f"{value:.3g}")


def _below_ms(time_s: float) -> float:
    """Return a time in whole 0.01 ms, rounded down but for rounding errors."""
    return float(np.floor(1e5 * time_s + 1e-4) / 1e2)
