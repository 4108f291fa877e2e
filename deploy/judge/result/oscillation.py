"""Loops that are unstable within their bounds: errors that grow, and torques that swing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bus_schema.messages import topics
from deploy.judge.findings.growing import Growths, growths, longest_growth_time_s
from deploy.judge.findings.vibration import vibrations
from deploy.judge.result.section import Section
from deploy.judge.run_data import RunData


class Growing(Section):
    """A joint whose error grows exponentially over the last half of the run.

    Attributes:
        joint: its name
        rate_per_s: the error grows as e^(rate · t)
        frequency_hz: frequency of the oscillation; 0 for none
    """

    joint: str
    rate_per_s: float
    frequency_hz: float


class Vibrating(Section):
    """A joint whose torque swings between its limits over the last half of the run.

    Attributes:
        joint: its name
        frequency_hz: frequency of the swings
        saturated_fraction: share of saturated ticks
        torque_rms_share: RMS of the torque above 5 Hz, over the limit
    """

    joint: str
    frequency_hz: float
    saturated_fraction: float
    torque_rms_share: float


def growths_of(run: RunData, *, is_known: bool) -> Growths:
    """Return the growth of a run's errors; nothing is tested unless all ticks are known."""
    if not is_known:
        return Growths([None] * run.setup.robot.joints, None)
    positions = run.tables[topics.PLANT_TRUTH.name]["position"]
    return growths(run.true_errors_rad, positions, run.setup.scenario.rate_hz)


def growing(run: RunData, found: Growths) -> list[Growing]:
    """Return the joints whose error grows exponentially."""
    return [Growing(**each) for each in _by_joint(run, found.joints)]


def not_tested_slower_s(run: RunData, found: Growths) -> float | None:
    """Return the time for growth by e above which it is not seen; None if nothing was tested."""
    ticks = len(run.tables[topics.PLANT_TRUTH.name])
    is_tested = found.not_tested_below_hz is not None
    return longest_growth_time_s(ticks / run.setup.scenario.rate_hz) if is_tested else None


def vibrating(run: RunData, *, is_known: bool) -> list[Vibrating]:
    """Return the joints whose torque swings between its limits, if all ticks are known."""
    if not is_known:
        return []
    truth, setup = run.tables[topics.PLANT_TRUTH.name], run.setup
    found = vibrations(
        truth["torque"], truth["saturated"], setup.largest_torques_nm, setup.scenario.rate_hz
    )
    return [Vibrating(**each) for each in _by_joint(run, found)]


def _by_joint(run: RunData, found: Sequence[Any]) -> list[dict[str, Any]]:
    """Return the findings of joints with their names; None stands for a joint without one."""
    return [
        {"joint": joint, **asdict(each)}
        for joint, each in zip(run.setup.robot.joint_names, found, strict=True)
        if each is not None
    ]
