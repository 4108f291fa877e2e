"""Theoretical delay margins of a law, to compare with those that a search finds.

The loop is linear: the arm at its start with gears, viscous friction and gravity, and the law as
it answers small errors there. States are sampled, torques are held. Two things follow:

- The constant round trips with which the loop is unstable.
- A bound below which it is stable however the delay varies, see `pattern_bound`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from controller.laws.custom import EXTERNAL
from deploy.scenario.setup import Setup
from deploy.study.theory.linear_plant import linear_plant
from deploy.study.theory.pattern_bound import pattern_bound_s
from deploy.study.theory.probe import linear_law
from deploy.study.theory.sampled_loop import SampledLoop
from deploy.study.theory.windows import telling_angles, unstable_windows

LONGEST_S = 1.0
"""The largest delay that theory looks at."""


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
    if (reason := _hindrance(setup)) is not None:
        return {"reason": reason}
    try:
        law = linear_law(setup.control_task().law, setup)
    except Exception as error:  # noqa: BLE001 (a user's law may raise any exception)
        law = f"it raised {type(error).__name__}: {error}"
    if isinstance(law, str):
        return {"reason": law}
    return _findings(SampledLoop(linear_plant(setup), law, 1e-9 * setup.grid.period_ns), setup)


def _hindrance(setup: Setup) -> str | None:
    """Return what a scenario has that the linear loop has not."""
    controller = setup.scenario.controller
    found = {
        "it is a program of its own": controller.process or controller.law == EXTERNAL,
        "delay compensation predicts and learns": controller.delay_compensation.enabled,
        "it is slower than the control loop": controller.every > 1 or controller.inference_ms,
    }
    return next((reason for reason, is_so in found.items() if is_so), None)


def _findings(loop: SampledLoop, setup: Setup) -> dict[str, Any]:
    names, h = setup.robot.joint_names, loop.period_s
    roots, shapes = np.linalg.eig(loop.closed())
    angles = telling_angles(loop, roots)
    windows = unstable_windows(loop, roots, angles, LONGEST_S)
    begin_s = windows[0].begin_s if windows else LONGEST_S
    found: dict[str, Any] = {
        "constant_ms": _ms(begin_s),
        "any_pattern_ms": None,
        "joint": None,
        "unstable_ms": [
            [_ms(each.begin_s), _ms(each.end_s) if each.end_s < LONGEST_S else None]
            for each in windows
        ],
        "unstable_without_delay": None,
    }
    if begin_s > 0.0:
        found["any_pattern_ms"] = _ms(min(pattern_bound_s(loop, angles), LONGEST_S))
        if windows:
            found["joint"] = names[loop.moving_most(loop.oscillation(windows[0].angle, begin_s))]
        return found
    fastest = np.argmax(abs(roots))
    growth = np.log(roots[fastest]) / h
    joint = names[loop.moving_most(shapes[: len(loop.transition), fastest])]
    without = {
        "rate_per_s": float(f"{growth.real:.3g}"),
        "frequency_hz": float(f"{abs(growth.imag) / (2.0 * np.pi):.3g}"),
        "joint": joint,
    }
    return found | {"constant_ms": None, "joint": joint, "unstable_without_delay": without}


def _ms(time_s: float) -> float:
    return round(1e3 * time_s, 2)
