"""Theoretical delay margins of a law, to compare with those that a search finds.

The loop is linear: the arm is the nominal one at its start, M q̈ = τ, without friction, gears and
limits, and all its joints are coupled. States are sampled with period h, torques are held. The law
is its slopes at zero error, u_k = P x_k + J (x_0 + … + x_(k−1)), with x = (e, ė); J is an integral
action. Two margins follow:

- The largest constant round trip: by Nyquist's criterion, no root of the sampled loop, with its
  fractional delay, lies outside the unit circle.
- A bound below which the loop is stable however the delay varies, as long as messages stay in order
  and none is lost: Kao and Lincoln, "Simple stability criteria for systems with time-varying
  delays", Automatica 40 (2004), theorem 3.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix
from controller.control_law import ControlLaw, Tracking
from controller.laws.custom import EXTERNAL
from deploy.scenario.setup import Setup

_SWITCHES = "it has no slope at zero error: it switches, or its gain depends on the error"
_LEARNS = "its torque depends on earlier errors, and not by an integral: it filters or learns"
_IDLE = "its torque does not depend on errors"
_UNSTABLE = "its linear loop is unstable without a delay"
_DEAD = "its linear loop is unstable with the actuators' dead time alone"
_WORKING_RANGE = 0.01
"""Of the funnel's final size, in which a law has to be linear."""
_AGREE = 0.01
_TICKS = 8
_RESOLUTION_S = 1e-5
_MOST_STEPS = 100_000
_ANGLES = np.geomspace(1e-8, np.pi, 2000)
_CIRCLE = (1.0 + 1e-6) * np.exp(1j * _ANGLES)
"""Just outside the unit circle: slower growth counts as stable."""


class SampledLoop:
    """A unit inertia per joint under a linear law that is sampled and held.

    Args:
        direct: P, shape (joints, 2 joints): torque over errors (1/s²) and error rates (1/s).
        memory: J, likewise: what an error adds to all later torques.
        period_s: h.
    """

    def __init__(self, direct: Matrix, memory: Matrix, period_s: float) -> None:
        self._h = period_s
        slopes = direct + memory / (_CIRCLE - 1.0)[:, None, None]
        self._over_error, self._over_rate = np.split(slopes, 2, axis=2)

    def largest_delay_s(self) -> float:
        """Return the largest constant delay with a stable loop, up to 1 s; below 0 for none."""
        unstable = bisect_left(
            range(_MOST_STEPS), True, key=lambda steps: not self._is_stable(steps * _RESOLUTION_S)
        )
        return (unstable - 1) * _RESOLUTION_S

    def bound_s(self) -> float:
        """Return the delay below which the loop is stable for every pattern, if it is without."""
        h = self._h
        # What any torque of unit energy within a period does to position and velocity.
        kick = np.linalg.cholesky([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]])
        kicked = np.concatenate([self._answer(*column) for column in kick.T], axis=2)
        closed = np.linalg.solve(self._differences(0.0), kicked)
        gains = np.linalg.norm(closed, 2, axis=(1, 2)) * abs(_CIRCLE - 1.0)
        squared = 1.0 / (h * gains.max() ** 2)
        whole = np.floor(np.sqrt(squared))
        return float(h * (whole + (squared - whole**2) / (2.0 * whole + 1.0)))

    def weakest(self, delay_s: float) -> int:
        """Return the joint that moves most in the oscillation that begins at this delay."""
        differences = self._differences(delay_s)
        critical = differences[np.argmin(abs(np.linalg.det(differences)))]
        return int(np.argmax(abs(np.linalg.svd(critical)[2][-1])))

    def _is_stable(self, delay_s: float) -> bool:
        found = self._differences(delay_s)
        # Of each mode by itself: several that turn at the same time would pass π in a step.
        turned = np.linalg.eigvals(np.linalg.solve(found[:-1], found[1:]))
        return bool(abs(np.angle(turned).sum()) < 0.5 * np.pi)  # π for each root outside

    def _differences(self, delay_s: float) -> Any:
        """Return the return differences I − L(z), shape (angles, joints, joints)."""
        h, (whole, rest) = self._h, divmod(delay_s, self._h)
        left = h - rest
        # The torque before acts until `rest`, the next one in what is left of the period.
        position = 0.5 * left**2 + (h * rest - 0.5 * rest**2) / _CIRCLE
        delayed = _CIRCLE**-whole
        looped = self._answer(delayed * position, delayed * (left + rest / _CIRCLE))
        return np.eye(looped.shape[1]) - looped

    def _answer(self, position: Any, velocity: Any) -> Any:
        """Return the law's answer to changes of position and velocity in each period."""
        rate = velocity / (_CIRCLE - 1.0)
        error = (position + self._h * rate) / (_CIRCLE - 1.0)
        return self._over_error * error[:, None, None] + self._over_rate * rate[:, None, None]


def theory_of(setup: Setup) -> dict[str, Any]:
    """Return the theoretical margins of a scenario's law, for a summary.

    Returns:
        ``constant_ms`` (1000 also beyond), ``any_pattern_ms`` and ``joint``, the weakest; or
        ``reason``, why there are none.
    """
    if (reason := _hindrance(setup)) is not None:
        return {"reason": reason}
    try:
        found = slopes(setup.control_task().law, setup)
    except Exception as error:  # noqa: BLE001 (a user's law may raise any exception)
        found = f"it raised {type(error).__name__}: {error}"
    return {"reason": found} if isinstance(found, str) else _margins(setup, *found)


def _margins(setup: Setup, direct: Matrix, memory: Matrix) -> dict[str, Any]:
    rotors = setup.scenario.plant.actuator.rotor_inertia(setup.robot.joints)
    model = setup.scenario.controller.nominal_model(setup.nominal, rotors)
    squares, axes = np.linalg.eigh(model.mass_matrix(setup.start_position_rad))
    scale = (axes / np.sqrt(squares)) @ axes.T  # to coordinates with unit inertia
    both = np.kron(np.eye(2), scale)
    loop = SampledLoop(scale @ direct @ both, scale @ memory @ both, 1e-9 * setup.grid.period_ns)
    if (longest_s := loop.largest_delay_s()) < 0.0:
        return {"reason": _UNSTABLE}
    if (left_ms := 1e3 * longest_s - setup.scenario.plant.actuator.delay_ms) < 0.0:
        return {"reason": _DEAD}
    any_ms = max(0.0, 1e3 * loop.bound_s() - setup.scenario.plant.actuator.delay_ms)
    return {
        "constant_ms": round(left_ms, 2),
        "any_pattern_ms": round(any_ms, 2),
        "joint": setup.robot.joint_names[loop.weakest(longest_s)],
    }


def _hindrance(setup: Setup) -> str | None:
    """Return what a scenario has that the linear loop has not."""
    controller, actuator = setup.scenario.controller, setup.scenario.plant.actuator
    found = {
        "it is a program of its own": controller.process or controller.law == EXTERNAL,
        "delay compensation predicts and learns": controller.delay_compensation.enabled,
        "the drives close a loop of their own": setup.drive.is_active,
        "it is slower than the control loop": controller.every > 1 or controller.inference_ms,
        "actuators lag": actuator.lag_s,
        "gears are elastic": actuator.gear_stiffness_nm_rad is not None,
    }
    return next((reason for reason, is_so in found.items() if is_so), None)


def slopes(law: ControlLaw, setup: Setup) -> tuple[Matrix, Matrix] | str:
    """Return P and J of a law by finite differences, N m per rad, rad/s; or why it has none."""
    steps = np.diag(_WORKING_RANGE * np.tile(setup.funnel.final_rad, 2))  # a rate: of 1/s
    still = _torques(law, setup, 0.0 * steps[0])
    found = [
        np.stack([(_torques(law, setup, row) - still) / row.sum() for row in part * steps], 2)
        for part in (1.0, -1.0, 0.1)
    ]
    if not (largest := abs(found[0]).max()):
        return _IDLE
    if any(abs(other - found[0]).max() > _AGREE * largest for other in found[1:]):
        return _SWITCHES
    direct, *later = found[0]
    if abs(later - later[0]).max() > _AGREE * abs(later[0]).max() + 1e-9 * largest:
        return _LEARNS
    return direct, later[0]


def _torques(law: ControlLaw, setup: Setup, error: Matrix) -> Matrix:
    """Return the torques from a tick on that has errors and rates, shape (2 joints,), all others 0.

    The funnel is that at the end of the run. Shape (ticks, joints).
    """
    law.reset()
    h, tracking, answers = 1e-9 * setup.grid.period_ns, Tracking(setup.robot.joints), []
    for tick in range(-1, _TICKS):
        time_s = setup.scenario.duration_s + h * tick
        tracking.update(time_s, 0.0 if tick < 0 else h, setup.reference, setup.funnel)
        now, rate = np.split(error * (tick == 0), 2)
        start = setup.start_position_rad
        tracking.motion[:] = start, 0.0 * start
        tracking.error[:], tracking.error_rate[:] = now, rate
        tracking.reference_position[:], tracking.reference_velocity[:] = start - now, -rate
        tracking.reference_acceleration[:] = 0.0
        answers.append(np.array(law.torque(tracking), dtype=np.float64))
    return np.array(answers[1:])
