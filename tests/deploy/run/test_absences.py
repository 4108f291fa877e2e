"""The plant's states stay away for a while: the arm is not thrown when they return."""

from __future__ import annotations

import numpy as np
import pytest

from bus_schema.messages import topics
from deploy.judge.bounds import bound_usage
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
AT_S, RETURN_S = 1.5, 1.0
MOST_BOUNDS = 3.0
MOST_BOUNDS_HELD_500_MS = 5.0
"""The last torque alone lets the Panda deviate by 3.5 bounds before the first new one acts."""


def usage_from(arm: str, absence_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times since the states returned, and the largest share of a bound that an error uses."""
    schedule = f"link.uplink.schedule=[{{kind: outage, at_s: {AT_S}, for_s: {absence_s}}}]"
    delays = [f"link.{side}.delay_ms=24" for side in ("uplink", "downlink")]
    length = f"duration_s={AT_S + absence_s + RETURN_S + 0.2}"
    timeout = "plant.command_timeout_ms=1500"
    run = simulate(load_setup(arm, [ON, *delays, schedule, timeout, length])).data()
    times_s = run.times_s(topics.PLANT_TRUTH) - AT_S - absence_s
    return times_s, bound_usage(run).max(axis=1)


@pytest.mark.parametrize("absence_s", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("arm", ["panda_motors", "ur5e_motors"])
def test_an_arm_returns_into_its_bounds_within_a_second_of_an_absence(arm, absence_s):
    """Panda: the law integrated over 500 ms in one step, and threw the arm by 19 bounds."""
    times_s, usage = usage_from(arm, absence_s)
    assert usage[times_s < -absence_s].max() < 1.0
    assert usage.max() < (MOST_BOUNDS_HELD_500_MS if absence_s == 0.5 else MOST_BOUNDS)
    assert usage[times_s >= RETURN_S].max() < 1.0
