"""Longest time for which an arm may be held at its start before its error leaves the funnel."""

from __future__ import annotations

from typing import Literal

import numpy as np

from controller.reference import sample_positions
from deploy.scenario.checked_scenario import CheckedScenario

Direction = Literal["both", "uplink", "downlink"]

_OTHER_DIRECTION = {"uplink": "downlink", "downlink": "uplink"}
_CEILING_STEP_S = 1e-4
_AT_A_TIME_S = 0.1
_LATEST_CEILING_S = 5.0


def held_arm_ceiling_ms(setup: CheckedScenario, direction: Direction = "both") -> float | None:
    """Return the delay at which an arm that is held at its start leaves the funnel, ms.

    No law can start with a longer delay: until the first command acts, one round trip after the
    start, the brakes hold the arm while reference and funnel move on.

    Args:
        setup: a scenario, for its reference, funnel and start.
        direction: direction of the delay; the scenario's delay of the other is included.

    Returns:
        The delay to 0.1 ms; None if it is beyond the end of the run, or 5 s.
    """
    last_s = min(setup.scenario.duration_s, _LATEST_CEILING_S)
    for from_s in np.arange(0.0, last_s, _AT_A_TIME_S):
        times = np.arange(from_s, min(from_s + _AT_A_TIME_S, last_s), _CEILING_STEP_S)
        reference = sample_positions(setup.reference, times, setup.robot.joints)
        error = setup.start_position_rad - reference
        upper, lower = setup.funnel.bounds(times)
        outside = ((error > upper) | (error < lower)).any(axis=1)
        if outside.any():
            ceiling = round(1e3 * float(times[np.argmax(outside)]), 1)
            if direction == "both":
                return ceiling
            other_ms: float = getattr(setup.scenario.link, _OTHER_DIRECTION[direction]).delay_ms
            return round(max(0.0, ceiling - other_ms), 1)
    return None
