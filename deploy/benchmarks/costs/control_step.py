"""What a control step costs beside a step of physics, and how both grow with joints."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from controller.control_law import Tracking
from controller.torque_guard import TorqueGuard
from deploy.benchmarks.costs.long_arm import write_long_arm
from deploy.benchmarks.costs.loop import physics_us
from deploy.benchmarks.measure import Section, cost_us, interleave, ratio
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

_LAW = "fixed_time_neural"
_LONG_JOINTS = 14
_SITUATIONS = 256
_SETTLED_S = 2.0
_ERROR_RAD, _ERROR_RATE_RAD_S = 1e-4, 1e-3


def measure_control_steps(steps: int, repetitions: int) -> Section:
    """Measure arms of 3, 7 and 14 joints.

    Args:
        steps: control steps, and steps of physics, in each measurement.
        repetitions: how often everything is measured.
    """
    with TemporaryDirectory() as folder:
        scenarios = ("paper_arm", "iiwa", str(write_long_arm(Path(folder), _LONG_JOINTS)))
        setups = [load_setup(name, [f"controller.law={_LAW}"]) for name in scenarios]
    candidates: dict[str, Callable[[], float]] = {}
    for setup in setups:
        bench = _StepBench(setup, steps)
        candidates |= {_step(setup): bench.control_step_us, _physics(setup): bench.physics_us}
    costs = interleave(candidates, repetitions)
    small, *larger = setups
    ratios = [ratio(costs, _step(setup), _physics(setup)) for setup in setups]
    ratios += [ratio(costs, _step(setup), _step(small)) for setup in larger]
    ratios += [ratio(costs, _physics(setup), _physics(small)) for setup in larger]
    note = f"A control step is reference, errors, bounds, law {_LAW} and torque limits; no message."
    return Section("Control step", costs, ratios, [note])


class _StepBench:
    """Both costs of one arm."""

    def __init__(self, setup: Setup, steps: int) -> None:
        self._setup, self._steps = setup, steps
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
        self._step()

    def control_step_us(self) -> float:
        """Cost of a control step, after a reset."""
        self._task.law.reset()
        self._guard.reset()
        return cost_us(self._step, self._steps)

    def physics_us(self) -> float:
        """Cost of a step of physics."""
        return physics_us(self._setup, 1, self._steps)

    def _step(self) -> None:
        tracking, task = self._tracking, self._task
        time_s, tracking.position[:], tracking.velocity[:] = next(self._situations)
        tracking.update(time_s, self._setup.grid.period_ns * 1e-9, task.reference, task.funnel)
        self._guard.admit(task.law.torque(tracking), 0, tracking.step_s)


def _step(setup: Setup) -> str:
    return f"control step, {setup.robot.joints} joints"


def _physics(setup: Setup) -> str:
    return f"step of physics, {setup.robot.joints} joints"
