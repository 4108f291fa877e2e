"""A tool that the robot's file does not have, in logs of currents.

The file's weight is the scale of the currents. A tool at the last link makes the constants of all
joints too small, those of the wrist most: all joints together show both the constants and the tool.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.noise import covariance_of_sums, widening_of
from deploy.measure.identify.problem import scipy_parts
from deploy.measure.identify.regression import Trial

_SIZES = np.repeat([3.0, 0.3, 0.15], [1, 3, 6])
"""Deviations of a tool's mass, first moments and inertias before the log: kg, kg m, kg m²."""
_SURELY, _NOTABLE, _FALL = 3.0, 0.02, 1.5
"""Deviations of the mass, its share of the arm's, and how far the power of the residuals falls,
from which a tool is believed."""
_USEFUL = 0.1
"""Deviation of the best constant as a share of it, up to which a tool is of use."""
_FITS = 3.0
"""Power of a joint's residuals over that of its noise, below which they fit."""
_Z_95 = 1.96


class Tool(NamedTuple):
    """Mass and inertia of the last link beyond those of the file.

    Attributes:
        kg: its mass, and half of its 95 % interval.
        parameters: as of a body, shape (10,).
        constant_sd: deviation of each joint's constant as a share of it, shape (joints,).
    """

    kg: tuple[float, float]
    parameters: Vector
    constant_sd: Vector


def unknown_tool(
    designs: list[Matrix], trials: list[Trial], model: ManipulatorModel
) -> tuple[Tool | None, bool]:
    """Return the tool with which constants and weight explain the currents, and whether they do.

    Without a tool that is sure, the second value is whether the file's weight explains them.

    Args:
        designs: of each joint, columns by which its current is explained; the first one is the
            torque of the file's bodies.
        trials: the motions.
        model: the arm as its file has it.
    """
    widening = widening_of(
        np.concatenate([trial.times_s for trial in trials]), trials[0].samples.cutoff_hz
    )
    parts = np.array([_reduced(d, trials, j) / widening for j, d in enumerate(designs)])
    least_squares, _ = scipy_parts()

    def explained(tool: Vector) -> tuple[Matrix, Vector]:
        arm = parts[:, :, :10] @ (_SIZES * tool) + parts[:, :, 10]
        per_torque = (arm * parts[:, :, 11]).sum(axis=1) / (arm**2).sum(axis=1)
        return arm, np.maximum(per_torque, 0.0)

    def left(tool: Vector) -> Matrix:
        arm, per_torque = explained(tool)
        return np.asarray(parts[:, :, 11] - per_torque[:, None] * arm)

    def misfit(tool: Vector) -> float:
        """Return the largest power of a joint's residuals over that of its noise."""
        return float(((left(tool) ** 2).sum(axis=1) / parts[:, -1, -1] ** 2).max())

    none = np.zeros(10)
    tool = least_squares(lambda x: np.concatenate([left(x).ravel(), x]), none).x
    kg, model_kg = float(_SIZES[0] * tool[0]), float(model.body_parameters()[-1, 0])
    is_better = misfit(tool) < min(_FITS, misfit(none) / _FALL)
    is_better = is_better and abs(kg) > _NOTABLE * model.moved_kg and model_kg + kg > 0.0
    if is_better:
        sd, constant_sd = _deviations(designs, trials, _SIZES * tool)
        if abs(kg) > _SURELY * sd and constant_sd.min() < _USEFUL:
            return Tool((kg, _Z_95 * sd), _SIZES * tool, constant_sd), True
    return None, not is_better and misfit(none) < _FITS


def _deviations(designs: list[Matrix], trials: list[Trial], tool: Vector) -> tuple[float, Vector]:
    """Return standard deviations of a tool's mass, and of constants as shares of them.

    Under noise that is correlated in time.
    """
    bodies = np.concatenate([trial.bodies[:, :, -10:] for trial in trials])
    left = np.concatenate([trial.torque for trial in trials])
    joints, own = len(designs), designs[0].shape[1]
    slopes, per_torque = np.zeros((len(left), joints, 10 + joints * own)), np.empty(joints)
    for j, design in enumerate(designs):
        whole = np.column_stack([design[:, 0] + bodies[:, j] @ tool, design[:, 1:]])
        solved = np.linalg.lstsq(whole, left[:, j], rcond=None)[0]
        noise = 1e-6 * float(left[:, j].std())
        left[:, j] -= whole @ solved
        noise = max(noise, float(left[:, j].std()))
        per_torque[j] = solved[0]
        slopes[:, j, :10] = solved[0] * bodies[:, j] * _SIZES / noise
        slopes[:, j, 10 + j * own : 10 + (j + 1) * own] = whole / noise
        left[:, j] /= noise
    flat = slopes.reshape(-1, slopes.shape[2])
    prior = np.diag(np.r_[np.ones(10), np.zeros(joints * own)])
    inverse = np.linalg.pinv(flat.T @ flat + prior)
    times_s = np.concatenate([trial.times_s for trial in trials])
    runs = np.repeat(np.arange(len(trials)), [len(trial.times_s) for trial in trials])
    sums = covariance_of_sums(slopes, left, times_s, runs, trials[0].samples.cutoff_hz)
    sd = np.sqrt(np.diag(inverse @ (sums + prior) @ inverse))
    return float(_SIZES[0] * sd[0]), sd[10::own] / np.abs(per_torque)


def _reduced(design: Matrix, trials: list[Trial], joint: int) -> Matrix:
    """Return columns of tool, arm and current without what friction explains, shape (12, 12).

    In units of the joint's noise.
    """
    tool = np.concatenate([trial.bodies[:, joint, -10:] for trial in trials])
    current = np.concatenate([trial.torque[:, joint] for trial in trials])
    own = design.shape[1] - 1
    columns = np.column_stack([design[:, 1:], tool, design[:, 0], current])
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))
    noise = abs(float(triangle[-1, -1])) / np.sqrt(len(design))
    return np.asarray(triangle[own:, own:] / max(noise, 1e-6 * float(current.std())))
