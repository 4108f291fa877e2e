"""The error of the tip: how far the arm's end is from where the reference has it."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.judge.result.section import Column, Section
from deploy.judge.run_data import RunData

_MM = 1e3
_models: dict[tuple[str, str], ManipulatorModel] = {}
"""By arm and tip: the runs of a study mostly share them."""


class TipError(Section):
    """Distance of the true tip from where the reference has it, mm.

    Attributes:
        rms: RMS of the tip's distance from where the reference has it, from ``metrics.from_s`` on;
            null if no joint moves the tip
        largest: largest of these distances
        at_loss: distance as the run left its bounds; null if it did not
    """

    rms: Annotated[float | None, Column()]
    largest: Annotated[float | None, Column()]
    at_loss: float | None = None


def tip_error_mm(run: RunData, lost_s: float | None = None) -> TipError:
    """Return RMS and largest distance of the true tip from the reference's, mm, and that at a loss.

    The first two are from ``metrics.from_s`` on, and None without a finite position there, or if
    the tip is on the axes of all joints, so that no error of theirs moves it.

    Args:
        run: the run.
        lost_s: time at which it left its bounds; None if it did not.
    """
    judged = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    distances_m = _distances_m(run, judged)
    is_on_axes = not distances_m.any() and run.true_errors_rad[judged].any()
    at_loss = None if is_on_axes or lost_s is None else _distance_mm(run, lost_s)
    if is_on_axes or not (len(distances_m) and np.isfinite(distances_m).all()):
        return TipError(rms=None, largest=None, at_loss=at_loss)
    rms_m = float(np.sqrt((distances_m**2).mean()))
    return TipError(rms=_MM * rms_m, largest=_MM * float(distances_m.max()), at_loss=at_loss)


def _distance_mm(run: RunData, time_s: float) -> float | None:
    """Return the tip's distance from the reference at a recorded time; None if it is unknown."""
    (distance_m,) = _distances_m(run, run.times_s(topics.PLANT_TRUTH) == time_s)
    return _MM * float(distance_m) if np.isfinite(distance_m) else None


def _distances_m(run: RunData, rows: np.ndarray) -> Vector:
    """Return the tip's distance from the reference at some ticks, shape (rows,)."""
    actual = run.tables[topics.PLANT_TRUTH.name]["position"][rows]
    wanted = actual - run.true_errors_rad[rows]
    return tips_apart_m(run.setup.robot, actual, wanted)


def tips_apart_m(robot: RobotDescription, some: Matrix, others: Matrix) -> Vector:
    """Return the distances between tips, m, shape (rows,).

    Args:
        robot: the arm.
        some: positions of its joints, shape (rows, joints).
        others: likewise.
    """
    arm = (robot.text, robot.tip_link)
    if arm not in _models:
        _models[arm] = ManipulatorModel(robot)
    with np.errstate(invalid="ignore", over="ignore"):
        tips = _models[arm].tip_positions(np.concatenate([some, others]))
        away = tips[: len(some)] - tips[len(some) :]
        return np.asarray(np.sqrt((away**2).sum(axis=1)))
