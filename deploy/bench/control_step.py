"""What a control step of each law costs beside a step of physics, and how it grows with joints."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import numpy as np

from controller.control_law import Tracking
from controller.laws import LAWS
from controller.torque_guard import TorqueGuard
from deploy.bench.loop import physics_us
from deploy.bench.measure import Section, cost_us, interleave, ratio
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

_SCENARIOS = ("paper_arm", "iiwa")
_SITUATIONS = 256
_SETTLED_S = 2.0
_ERROR_RAD, _ERROR_RATE_RAD_S = 1e-4, 1e-3


def measure_control_steps(steps: int, repetitions: int) -> Section:
    """Measure every law on arms of 3 and 7 joints.

    Args:
        steps: control steps, and steps of physics, in each measurement.
        repetitions: how often everything is measured.
    """
    candidates: dict[str, Callable[[], float]] = {}
    pairs = []
    for scenario in _SCENARIOS:
        setup = load_setup(scenario)
        joints = f"{setup.robot.joints} joints"
        physics = f"step of physics, {joints}"
        candidates[physics] = partial(physics_us, setup, 1, steps)
        for law in LAWS:
            bench = _StepBench(load_setup(scenario, [f"controller.law={law}"]))
            candidates[f"{law}, {joints}"] = partial(bench.control_step_us, steps)
            pairs.append((f"{law}, {joints}", physics))
    costs = interleave(candidates, repetitions)
    ratios = [ratio(costs, step, physics) for step, physics in pairs]
    note = "A control step is reference, errors, bounds, law and torque limits; no message."
    return Section("Control step", costs, ratios, [note])


class _StepBench:
    """Control steps of one law for one arm."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._task = setup.control_task()
        self._tracking = Tracking(setup.robot.joints)
        task = self._task
        self._guard = TorqueGuard(task.law_name, task.limits, self._tracking.motion)
        waves = np.sin(np.arange(_SITUATIONS)[:, None] + np.arange(setup.robot.joints))
        times_s = _SETTLED_S + np.arange(_SITUATIONS) * setup.grid.period_ns * 1e-9
        situations = []
        for time_s, wave in zip(times_s.tolist(), waves, strict=True):
            self._tracking.update(time_s, 0.0, setup.reference, setup.funnel)
            position = self._tracking.reference_position + _ERROR_RAD * wave
            velocity = self._tracking.reference_velocity + _ERROR_RATE_RAD_S * wave
            situations.append((time_s, position, velocity))
        self._situations = itertools.cycle(situations)

    def control_step_us(self, steps: int) -> float:
        """Mean cost of a control step, after a reset."""
        self._task.law.reset()
        self._guard.reset()
        return cost_us(self._step, steps)

    def _step(self) -> None:
        tracking, task = self._tracking, self._task
        time_s, tracking.position[:], tracking.velocity[:] = next(self._situations)
        tracking.update(time_s, self._setup.grid.period_ns * 1e-9, task.reference, task.funnel)
        self._guard.admit(task.law.torque(tracking), 0, tracking.step_s)
