"""What is understood of an arm, as tables."""

from __future__ import annotations

import numpy as np

from deploy.reports.tables import Column, Table, Value, number
from deploy.scenario.setup import Setup


def joints_table(setup: Setup) -> Table:
    """Driven joints in their order, with limits and inertias; in m and N where they slide."""
    robot = setup.robot
    rows: list[list[Value]] = []
    for i, name in enumerate(robot.joint_names):
        unit, force = ("m", "N") if robot.slides[i] else ("rad", "N m")
        rows.append(
            [
                f"{i + 1} {name}",
                "slides" if robot.slides[i] else "turns",
                _range(float(robot.lower_rad[i]), float(robot.upper_rad[i]), unit),
                _limit(robot.effort_limits_nm[i], force),
                _limit(robot.velocity_limits_rad_s[i], f"{unit}/s"),
                _limit(setup.governing_inertia_kg_m2[i], "kg" if robot.slides[i] else "kg m²"),
            ]
        )
    headings = ("Joint", "Kind", "Range", "Effort", "Speed", "Inertia")
    return Table("Driven joints", [Column(each, is_text=True) for each in headings], rows)


def other_joints_table(setup: Setup) -> Table:
    """Joints that follow others or are held, and why."""
    rows: list[list[Value]] = [
        [each.name, f"follows {each.leader}", f"× {each.multiplier:g} + {each.offset:g}"]
        for each in setup.robot.followers
    ]
    rows += [[each.name, "held", each.reason] for each in setup.robot.held]
    columns = [Column(each, is_text=True) for each in ("Joint", "What it does", "How or why")]
    return Table("Other joints", columns, rows)


def gains_table(setup: Setup) -> Table:
    """The gains that follow from the arm's inertia, for the scenario's law."""
    rows = [[name, _values(value)] for name, value in setup.gains._asdict().items()]
    columns = [Column("Gain", is_text=True), Column("Per joint", is_text=True)]
    return Table(f"Gains of {setup.scenario.controller.law}", columns, rows)


def funnel_line(setup: Setup) -> str:
    """How wide the funnel starts and ends, in words."""
    funnel = setup.funnel
    ends = sorted({number(float(value)) for value in funnel.final_rad})
    starts = sorted({number(float(value)) for value in funnel.initial_upper_rad})
    return (
        f"funnel: opens to {', '.join(starts)} rad (m where joints slide) from rest on the"
        f" reference, closes to {', '.join(ends)} at {funnel.rate_per_s:g} per second"
    )


def _range(low: float, high: float, unit: str) -> str:
    if not np.isfinite([low, high]).any():
        return "endless"
    return f"{number(low)} … {number(high)} {unit}"


def _limit(value: float, unit: str) -> str:
    return f"{number(float(value))} {unit}" if np.isfinite(value) else "none"


def _values(value: object) -> str:
    return ", ".join(number(float(each)) for each in np.atleast_1d(np.asarray(value, dtype=float)))
