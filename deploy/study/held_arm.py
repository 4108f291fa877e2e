"""The held-arm ceiling: a delay that no law can start under.

Until the first command acts, one round trip after the start, the brakes hold the arm where it is,
while reference and funnel move on.
"""

from __future__ import annotations

import numpy as np

from controller.reference import sample_positions
from deploy.scenario.setup import Setup
from deploy.study.margins.quantities import Direction

_OTHER = {"uplink": "downlink", "downlink": "uplink"}
_STEP_S = 1e-4
_AT_A_TIME_S = 0.5
_LONGEST_S = 5.0


def held_arm_ceiling_ms(setup: Setup) -> float | None:
    """When the error of an arm that is held at its start leaves the funnel, ms.

    Args:
        setup: a scenario, of which reference, funnel and start count.

    Returns:
        The time to 0.1 ms; None if it is beyond the end of the run, or 5 s.
    """
    last_s = min(setup.scenario.duration_s, _LONGEST_S)
    for from_s in np.arange(0.0, last_s, _AT_A_TIME_S):
        times = np.arange(from_s, min(from_s + _AT_A_TIME_S, last_s), _STEP_S)
        reference = sample_positions(setup.reference, times, setup.robot.joints)
        error = setup.start_position_rad - reference
        upper, lower = setup.funnel.bounds(times)
        outside = ((error > upper) | (error < lower)).any(axis=1)
        if outside.any():
            return round(1e3 * float(times[np.argmax(outside)]), 1)
    return None


def ceiling_of_value(setup: Setup, direction: Direction) -> float | None:
    """The ceiling of a delay in both directions together, or in one beside that of the other, ms.

    Args:
        setup: a scenario.
        direction: in which the delay is; what the other has in the scenario counts as well.
    """
    ceiling = held_arm_ceiling_ms(setup)
    if ceiling is None or direction == "both":
        return ceiling
    other_ms: float = getattr(setup.scenario.link, _OTHER[direction]).delay_ms
    return round(max(0.0, ceiling - other_ms), 1)
