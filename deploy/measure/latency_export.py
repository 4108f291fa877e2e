"""Writes a dead time and a lag as other programs read them, with the ranges to draw them from."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from enum import StrEnum

from deploy.measure.latency import Latency


class Export(StrEnum):
    """Programs that read a latency."""

    SCENARIO = "scenario"
    MUJOCO = "mujoco"
    ISAACLAB = "isaaclab"
    MJLAB = "mjlab"


ENDINGS = {Export.SCENARIO: ".yaml", Export.MUJOCO: ".xml", Export.ISAACLAB: "_isaaclab.py",
           Export.MJLAB: "_mjlab.py"}  # fmt: skip
"""Endings of the names of files."""
_LEAST_STEP_S = 5e-4
"""Shortest physics step for which MuJoCo's history is long enough."""
_NO_LAG_S = 1e-5

_SCENARIO = """\
# {summary}
# Add it to a scenario, or give it a line "extends: SCENARIO.yaml". The dead time of a whole round
# trip is all in the downlink. Studies with "uncertainty" draw from its 95 % interval.
link: {{downlink: {{delay_ms: {dead_ms:.4f}}}}}
plant: {{actuator: {{lag_ms: {lag_ms:.4f}}}}}
uncertainty:
  link.downlink.delay_ms: {{distribution: uniform, from: {dead_low_ms:.4f}, to: {dead_high_ms:.4f}}}
  plant.actuator.lag_ms: {{distribution: uniform, from: {lag_low_ms:.4f}, to: {lag_high_ms:.4f}}}
"""
_ROBOT = """\
# {summary}
# Add it to a scenario, or give it a line "extends: SCENARIO.yaml". The robot takes positions, as
# the laws streaming and position_correction send; the log's whole dead time is the robot's.
plant:
  interface: {{kind: servoj, servoj: {{dead_time_ms: {dead_ms:.4f}, lag_ms: {lag_ms:.4f}}}}}
"""
_MUJOCO = """\
<!-- {summary}
  Include this file, and give the class "measured_latency" to actuators of type position, velocity
  or general; a motor takes the delay, but no lag. Physics steps must be at least {step_ms:g} ms:
  MuJoCo shortens the delay without a word where nsample steps are shorter. The numerics have the
  95 % intervals, for models that draw. -->
<mujoco>
  <default>
    <default class="measured_latency">
      <position delay="{dead_s:.7f}" nsample="{samples}"{timeconst}/>
    </default>
  </default>
  <custom>
    <numeric name="measured_delay_s" data="{dead_low_s:.7f} {dead_high_s:.7f}"/>
    <numeric name="measured_timeconst_s" data="{lag_low_s:.7f} {lag_high_s:.7f}"/>
  </custom>
</mujoco>
"""
_PYTHON = '''\
"""{summary}

{how}
It has no lag of its own. Choose stiffness and damping so that the simulated joint has it, or add it
to the delay with `with_lag`.
"""

import math

DEAD_TIME_S = ({dead_low_s:.7f}, {dead_high_s:.7f})
LAG_S = ({lag_low_s:.7f}, {lag_high_s:.7f})


def delay(physics_step_s: float, *, with_lag: bool = False) -> dict[str, int]:
    """Return keywords for a configuration of actuators: the range in whole physics steps."""
    low_s, high_s = (d + with_lag * lag for d, lag in zip(DEAD_TIME_S, LAG_S))
    low, high = round(low_s / physics_step_s, 6), round(high_s / physics_step_s, 6)
    return {{{keywords}}}


def actuator(physics_step_s: float, *, with_lag: bool = False, **other: object):
    """Return a configuration with this delay; `other` has joints, stiffness, damping and so on."""
    from {module} import {configuration}

    return {configuration}(**delay(physics_step_s, with_lag=with_lag), **other)
'''
_ISAACLAB = {
    "how": "Isaac Lab draws a delay between min_delay and max_delay physics steps at each reset.",
    "keywords": '"min_delay": math.floor(low), "max_delay": math.ceil(high)',
    "module": "isaaclab.actuators",
    "configuration": "DelayedPDActuatorCfg",
}
_MJLAB = {
    "how": "mjlab draws a delay between delay_min_lag and delay_max_lag physics steps; the period"
    " of its\nupdates is longer than an episode, so that it is drawn at each reset.",
    "keywords": '\n        "delay_min_lag": math.floor(low), "delay_max_lag": math.ceil(high),\n'
    '        "delay_update_period": 10**9, "delay_per_env_phase": False,\n    ',
    "module": "mjlab.actuator",
    "configuration": "IdealPdActuatorCfg",
}
_TEMPLATES: dict[Export, Callable[..., str]] = {
    Export.SCENARIO: _SCENARIO.format,
    Export.MUJOCO: _MUJOCO.format,
    Export.ISAACLAB: lambda **values: _PYTHON.format(**_ISAACLAB, **values),
    Export.MJLAB: lambda **values: _PYTHON.format(**_MJLAB, **values),
}


def exported(found: Latency, export: Export, source: str, *, is_robot: bool = False) -> str:
    """Return a latency as a program reads it.

    Args:
        found: the latency, whose intervals become ranges.
        export: the program.
        source: name of the file in which it was found.
        is_robot: a scenario gets it as the response of a robot that takes positions.
    """
    values = {"summary": _summary(found, source), "step_ms": 1e3 * _LEAST_STEP_S}
    for name, (middle_s, half_s) in (("dead", found.dead_time_s), ("lag", found.lag_s)):
        for end, value_s in (
            ("", middle_s), ("_low", max(0.0, middle_s - half_s)), ("_high", middle_s + half_s),
        ):  # fmt: skip
            values |= {f"{name}{end}_s": value_s, f"{name}{end}_ms": 1e3 * value_s}
    lag_s = found.lag_s[0]
    timeconst = f' timeconst="{lag_s:.7f}"' if lag_s > _NO_LAG_S else ""
    samples = math.ceil(found.dead_time_s[0] / _LEAST_STEP_S) + 1
    template = _ROBOT.format if is_robot and export == Export.SCENARIO else _TEMPLATES[export]
    return template(**values, timeconst=timeconst, samples=samples)


def _summary(found: Latency, source: str) -> str:
    named = zip(("dead time", "lag"), (found.dead_time_s, found.lag_s), strict=True)
    parts = ", ".join(f"{name} {1e3 * m:.3f} ± {1e3 * h:.3f} ms" for name, (m, h) in named)
    name = re.sub(r"[^\w.]+", "-", source)  # which ends no comment
    return f"Latency that funnel-hil found in {name}: {parts} (95 %)."
