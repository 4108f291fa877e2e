"""Current constants (N m/A) from what the arm weighs, and payloads from the change in torque."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InputError
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.fit import Fit
from deploy.measure.identify.noise import covariance_of_sums
from deploy.measure.identify.regression import LOAD, STRIBECK, Trial
from deploy.measure.identify.unknown_tool import Tool, unknown_tool

_UNSURE = 0.2
"""Half of an interval over its value, beyond which a constant is taken from the other joints."""
_Z_95 = 1.96
_LEAST_NOISE = 1e-6
"""Of the deviation of a current."""
_MASS, _FIRST_MOMENTS = 0, slice(1, 4)


class Constants(NamedTuple):
    """Torque per current of each joint.

    Attributes:
        nm_per_a: shape (joints,).
        half: half of each 95 % interval, same shape; NaN where the motion does not show it. Of
            noise alone for constants by weight: the file's masses may be wrong.
        by_weight: whether the weight of the robot's file is their scale.
        tool: beyond that weight; None for none that the logs show.
        fits: whether this weight, with that tool, explains the currents of all joints.
    """

    nm_per_a: Vector
    half: Vector
    by_weight: bool = False
    tool: Tool | None = None
    fits: bool = True

    @property
    def shown_half(self) -> Vector:
        """Half of each interval as `half`; NaN for all where the weight does not fit."""
        return self.half if self.fits else np.full_like(self.half, np.nan)


class Payload(NamedTuple):
    """Payload of a log beyond that of another one.

    Attributes:
        kg: mass, and half of its 95 % interval.
        centre_m: its centre in the frame of the last joint.
        nm_per_a: constants with which its known mass explains the change, shape (joints,); None
            where the mass is not known.
    """

    kg: tuple[float, float]
    centre_m: Vector
    nm_per_a: Vector | None


def constants_by_weight(trials: list[Trial], model: ManipulatorModel) -> Constants:
    """Return the current constants with which the arm weighs what its file says.

    Raises:
        InputError: no joint shows enough of its weight or inertia.
    """
    parameters = model.body_parameters().ravel()
    joints = range(trials[0].torque.shape[1])
    designs = [_design(trials, parameters, joint) for joint in joints]
    tool, fits = unknown_tool(designs, trials, model)
    if tool is not None:
        parameters[-10:] += tool.parameters
        designs = [_design(trials, parameters, joint) for joint in joints]
    value, half = np.empty((2, len(joints)))
    for joint, design in enumerate(designs):
        solved, sd = _per_torque(trials, design, joint)
        value[joint] = 1.0 / solved
        share = sd / abs(solved) if tool is None else tool.constant_sd[joint]
        half[joint] = _Z_95 * abs(value[joint]) * share
    is_sure = (value > 0.0) & (half < _UNSURE * value)
    if not is_sure.any():
        raise InputError(
            "currents: no joint moves enough of the arm's weight to find its current constant;"
            " --current-constants gives them in N m/A"
        )
    near = [int(np.flatnonzero(is_sure)[np.abs(np.flatnonzero(is_sure) - j).argmin()])
            for j in joints]  # fmt: skip
    value, half = np.where(is_sure, value, value[near]), np.where(is_sure, half, np.nan)
    return Constants(value, half, by_weight=True, tool=tool, fits=fits)


def _design(trials: list[Trial], parameters: Vector, joint: int) -> Matrix:
    """Return columns that explain a joint's current: torque of the bodies, friction, rotor, lag."""
    rows, speeds = list[Matrix](), np.full(trials[0].torque.shape[1], 0.02)
    for trial in trials:
        own = np.delete(trial.joint_columns(speeds, parameters)[:, joint], [STRIBECK, LOAD], axis=1)
        late = trial.samples.torque_rate[trial.kept][:, joint]
        rows.append(np.column_stack([trial.bodies[:, joint] @ parameters, own, late]))
    return np.concatenate(rows)


def _per_torque(trials: list[Trial], design: Matrix, joint: int) -> tuple[float, float]:
    """Return current per torque of a joint, and its standard deviation."""
    current = np.concatenate([trial.torque[:, joint] for trial in trials])
    solved = np.linalg.lstsq(design, current, rcond=None)[0]
    left = current - design @ solved
    noise = max(float(left.std()), _LEAST_NOISE * float(current.std()))
    design, times_s = design / noise, np.concatenate([trial.times_s for trial in trials])
    runs = np.repeat(np.arange(len(trials)), [len(trial.times_s) for trial in trials])
    sums = covariance_of_sums(
        design[:, None], left[:, None] / noise, times_s, runs, trials[0].samples.cutoff_hz
    )
    inverse = np.linalg.pinv(design.T @ design)
    return float(solved[0]), float(np.sqrt((inverse @ sums @ inverse)[0, 0]))


def payload_of(fit: Fit, trial: Trial, known_kg: float | None) -> Payload:
    """Return what a motion carries at the last body, beyond the identified arm.

    Args:
        fit: the arm without it.
        trial: motion with it.
        known_kg: its mass, to compare the constants.
    """
    design = _load_columns(fit, trial)
    left = trial.torque * fit.constants - fit.predicted(trial)
    noise = 1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0)
    flat = (design / noise[:, None]).reshape(-1, design.shape[2])
    ridge = np.diag(np.r_[np.zeros(4), np.full(design.shape[2] - 4, 1e-6)])
    inverse = np.linalg.inv(flat.T @ flat + ridge)
    solved = inverse @ (flat.T @ (left / noise).ravel())
    error = (left - design @ solved) / noise
    sums = covariance_of_sums(
        design / noise[:, None], error, trial.times_s, np.zeros(len(error), np.int64),
        trial.samples.cutoff_hz,
    )  # fmt: skip
    sd = float(np.sqrt((inverse @ sums @ inverse)[_MASS, _MASS]))
    mass = float(solved[_MASS])
    constants = None
    if known_kg is not None:
        of_load = design[:, :, :10] @ (solved[:10] * known_kg / mass)
        changed = left - design[:, :, 10:] @ solved[10:]  # friction of another day
        power = (of_load * changed).sum(axis=0)
        constants = fit.constants * (of_load**2).sum(axis=0) / np.where(power > 0.0, power, np.nan)
    return Payload((mass, _Z_95 * sd), solved[_FIRST_MOMENTS] / mass, constants)


def _load_columns(fit: Fit, trial: Trial) -> Matrix:
    """Return columns of the last body, and changes of each joint's friction and offset."""
    joints = trial.torque.shape[1]
    felt = trial.joint_columns(fit.smoothing_rad_s, fit.parameters)[:, :, :3]
    own = np.zeros((len(felt), joints, 3 * joints))
    for joint in range(joints):
        own[:, joint, 3 * joint : 3 * joint + 3] = felt[:, joint]
    return np.concatenate([trial.bodies[:, :, -10:], own], axis=2)
