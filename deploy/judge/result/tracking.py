"""Tracking: how precisely the joints follow the reference, and when they settle."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel, spread_positions
from deploy.judge.result.section import Column, PerJoint, Section
from deploy.judge.run_data import RunData
from deploy.scenario.setup import Setup

_largest_inertias: dict[tuple[str, float, bytes], float] = {}
"""By arm, payload and weights: the runs of a study mostly share them."""


class Tracking(Section):
    """Errors of the joints.

    Attributes:
        joint_names: driven joints; all lists per joint have this order
        rms_rad: RMS of the true error from ``metrics.from_s`` on, per joint
        max_abs_rad: largest true error from ``metrics.from_s`` on, per joint
        settling_time_s: time from which the error stays within the final bound, per joint; null for
            never
        settling_bound_s: theoretical bound on the settling time; null for laws without one
    """

    joint_names: Annotated[list[str], Column(of_any_part=True)]
    rms_rad: Annotated[PerJoint | None, Column()]
    max_abs_rad: Annotated[PerJoint | None, Column()]
    settling_time_s: Annotated[list[float | None], Column()]
    settling_bound_s: Annotated[float | None, Column(of_any_part=True, kind="list<double>")]


def tracking(run: RunData) -> Tracking:
    """Return the errors of the joints of a run."""
    errors, times_s = run.true_errors_rad, run.times_s(topics.PLANT_TRUTH)
    judged = errors[times_s >= run.setup.scenario.metrics.from_s]
    return Tracking(
        joint_names=list(run.setup.robot.joint_names),
        rms_rad=np.sqrt((judged**2).mean(axis=0)).tolist() if len(judged) else None,
        max_abs_rad=np.abs(judged).max(axis=0).tolist() if len(judged) else None,
        settling_time_s=settling_times_s(errors, times_s, run.setup.funnel.final_rad),
        settling_bound_s=settling_bound_s(run.setup),
    )


def settling_times_s(errors: Matrix, times_s: Vector, band_rad: Vector) -> list[float | None]:
    """Return the time when each joint's error last entered ±band to stay; null if it never did."""
    settled: list[float | None] = []
    for error, band in zip(errors.T, band_rad, strict=True):
        outside = np.flatnonzero(np.abs(error) > band)
        entered = outside[-1] + 1 if outside.size else 0
        settled.append(float(times_s[entered]) if entered < len(times_s) else None)
    return settled


def settling_bound_s(setup: Setup) -> float | None:
    """Return the law's bound for this arm with its payload, s; None for a law without one.

    It uses the largest inertia in positions spread over all joint ranges, not only on the
    reference: one bound for every start.
    """
    robot, payload_kg = setup.robot, setup.scenario.plant.payload_kg

    def largest_inertia(weights: Vector) -> float:
        arm = (robot.text, payload_kg, weights.tobytes())
        if arm not in _largest_inertias:
            model = ManipulatorModel(robot, payload_kg=payload_kg)
            _largest_inertias[arm] = model.largest_inertia(spread_positions(robot), weights)
        return _largest_inertias[arm]

    return setup.scenario.controller.settling_bound_s(setup.gains, largest_inertia)
