"""A window of motion, over which the equation of motion is averaged to identify the arm.

Averages remove encoder noise and a law's chattering.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import assign, compiled
from controller.compensation.arm_belief import SMOOTHING_RAD_S

WINDOW_S = 0.016
_SATURATED = 0.999
"""Share of its limit above which an actuator may deliver less than requested."""


class Window(NamedTuple):
    """Sums over the motion since the last update; arrays of shape (joints,).

    Attributes:
        elapsed_s: shape (1,); 0 before the window begins.
        impulse: ∫ τ dt.
        sign: ∫ tanh(q̇ / v) dt.
        angle: ∫ q̇ dt.
        position: ∫ q dt.
        first_velocity: q̇ at its start.
        first_actuator: τ_a at its start.
        saturated: above 0 for joints whose actuator was at its limit.
        lowest_nm: smallest mean τ of a step.
        highest_nm: largest mean τ of a step.
    """

    elapsed_s: Vector
    impulse: Vector
    sign: Vector
    angle: Vector
    position: Vector
    first_velocity: Vector
    first_actuator: Vector
    saturated: Vector
    lowest_nm: Vector
    highest_nm: Vector


def empty_window(joints: int) -> Window:
    """Return a window that has not begun."""
    return Window(np.zeros(1), *(np.zeros(joints) for _ in Window._fields[1:]))


@compiled
def add_step(
    window: Window, limits_nm: Vector, before: Matrix, after: Matrix, actuator_before: Vector,
    impulse: Vector, step_s: float,
) -> None:  # fmt: skip
    """Add a step of motion; see `take_in` for the arguments."""
    if window.elapsed_s[0] == 0.0:
        _begin(window, before[1], actuator_before)
    window.elapsed_s[0] += step_s
    for i in range(impulse.size):
        position = 0.5 * (before[0, i] + after[0, i])
        velocity = 0.5 * (before[1, i] + after[1, i])
        torque_nm = impulse[i] / step_s
        if abs(torque_nm) >= _SATURATED * limits_nm[i]:
            window.saturated[i] = 1.0
        window.impulse[i] += impulse[i]
        window.sign[i] += step_s * math.tanh(velocity / SMOOTHING_RAD_S)
        window.angle[i] += step_s * velocity
        window.position[i] += step_s * position
        window.lowest_nm[i] = min(window.lowest_nm[i], torque_nm)
        window.highest_nm[i] = max(window.highest_nm[i], torque_nm)


@compiled
def _begin(window: Window, velocity: Vector, actuator_nm: Vector) -> None:
    for sums in (
        window.impulse, window.sign, window.angle, window.position, window.saturated
    ):  # fmt: skip
        sums[:] = 0.0
    window.lowest_nm[:], window.highest_nm[:] = math.inf, -math.inf
    assign(window.first_velocity, velocity)
    assign(window.first_actuator, actuator_nm)
