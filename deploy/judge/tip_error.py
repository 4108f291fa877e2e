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
    """

    rms: Annotated[float | None, Column()]
    largest: Annotated[float | None, Column()]


def tip_error_mm(run: RunData) -> TipError:
    """Return RMS and largest distance of the true tip from the reference's, mm.

    Both are from ``metrics.from_s`` on, and None without a finite position there, or if the tip is
    on the axes of all joints, so that no error of theirs moves it.
    """
    judged = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    distances_m = _distances_m(run, judged)
    is_on_axes = not distances_m.any() and run.true_errors_rad[judged].any()
    if is_on_axes or not (len(distances_m) and np.isfinite(distances_m).all()):
        return TipError(rms=None, largest=None)
    rms_m = float(np.sqrt((distances_m**2).mean()))
    return TipError(rms=_MM * rms_m, largest=_MM * float(distances_m.max()))


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
