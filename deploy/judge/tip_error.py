"""The error of the tip: how far the arm's end is from where the reference has it."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from deploy.judge.run_data import RunData

_MM = 1e3
_models: dict[tuple[str, str], ManipulatorModel] = {}
"""By arm and tip: the runs of a study mostly share them."""


def tip_error_mm(run: RunData) -> dict[str, float | None]:
    """Return RMS and largest distance of the true tip from the reference's, mm.

    Both are from ``metrics.from_s`` on, and None without a finite position there.
    """
    judged = run.times_s(topics.PLANT_TRUTH) >= run.setup.scenario.metrics.from_s
    distances_m = _distances_m(run, judged)
    if not (len(distances_m) and np.isfinite(distances_m).all()):
        return {"rms": None, "largest": None}
    rms_m = float(np.sqrt((distances_m**2).mean()))
    return {"rms": _MM * rms_m, "largest": _MM * float(distances_m.max())}


def _distances_m(run: RunData, rows: np.ndarray) -> Vector:
    """Return the tip's distance from the reference at some ticks, shape (rows,)."""
    robot = run.setup.robot
    arm = (robot.text, robot.tip_link)
    if arm not in _models:
        _models[arm] = ManipulatorModel(robot)
    actual = run.tables[topics.PLANT_TRUTH.name]["position"][rows]
    wanted = actual - run.true_errors_rad[rows]
    with np.errstate(invalid="ignore", over="ignore"):
        tips = _models[arm].tip_positions(np.concatenate([actual, wanted]))
        away = tips[: len(actual)] - tips[len(actual) :]
        return np.asarray(np.sqrt((away**2).sum(axis=1)))
