"""Quality of an identified arm: errors on data it has not seen, and findings in its residuals."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from deploy.measure.identify.fit import Fit
from deploy.measure.identify.noise import covariance_of_sums
from deploy.measure.identify.problem import bodies_of
from deploy.measure.identify.regression import COULOMB, Trial, columns_of

_BINS, _MUCH, _SURELY = 12, 0.25, 4.0
_LEAST_DRIFT = 0.05
_LEAST_PART, _ROUGH, _MOST_NOTES = 0.02, 0.1, 2
"""Error over the torque of a joint that is worth a note, and advice; and notes of each kind."""


def relative_errors(predicted: Matrix, measured: Matrix) -> Vector:
    """Return the RMS of the error over that of the measured torque, shape (joints,)."""
    power = (measured**2).mean(axis=0)
    return np.asarray(np.sqrt(((measured - predicted) ** 2).mean(axis=0) / power))


def predicted_before(fit: Fit, trial: Trial) -> Matrix:
    """Return the torques that the robot's file and the estimates predict, shape (samples, joints).

    N m; without the estimates' rotors where these are not in the measured torques.
    """
    parameters = bodies_of(fit.prior.bodies.ravel())[0]
    columns = columns_of(
        [trial], np.full(len(fit.constants), 0.02), fit.constants, fit.has_term, parameters
    )
    linear = np.concatenate([parameters, fit.prior.terms[fit.has_term], [0.0]])
    return np.asarray(columns.design @ linear)


def residual_notes(fit: Fit, trials: list[Trial], joints: tuple[str, ...]) -> list[str]:
    """Return sentences for the largest regularities that residuals of motions still have."""
    missing, drifts = dict[str, float](), dict[str, float]()
    for trial in trials:
        left = trial.torque * fit.constants - fit.predicted(trial)
        velocity = trial.samples.velocity[trial.kept]
        load = trial.bodies @ fit.parameters * np.sign(velocity)
        size = left.std(axis=0) / np.sqrt(((trial.torque * fit.constants) ** 2).mean(axis=0))
        for j, name in enumerate(joints):
            share = max(_explained(by[:, j], left[:, j]) for by in (velocity, load))
            if share > _MUCH:
                part = float(size[j] * np.sqrt(share))
                missing[name] = max(missing.get(name, _LEAST_PART), part)
            if (drift := _drift(fit, trial, left, j)) is not None:
                drifts[
                    f"{name}: dry friction changes by {drift:+.0%} over {trial.samples.name}, as"
                    " when the joint warms up; record when it is warm"
                ] = abs(drift)
    return [_of_friction(each, missing[each]) for each in _largest(missing)] + _largest(drifts)


def _of_friction(joint: str, part: float) -> str:
    if part < _ROUGH:
        matters = "a small error"
    else:
        matters = (
            "the scenario's friction errs by as much: fit a log with the speeds and loads of your"
            " task"
        )
    return (
        f"{joint}: its friction depends on speed or load in a way that the model does not have,"
        f" {100 * part:.2g} % of its torque: {matters}"
    )


def _largest(sizes: dict[str, float]) -> list[str]:
    sure = [each for each in sizes if sizes[each] > _LEAST_PART]
    return sorted(sure, key=lambda each: -sizes[each])[:_MOST_NOTES]


def _explained(by: Vector, left: Vector) -> float:
    """Return the share of the variance of residuals that the means over bins explain."""
    edges = np.quantile(by, np.linspace(0.0, 1.0, _BINS + 1)[1:-1])
    place = np.searchsorted(edges, by)
    counts = np.bincount(place, minlength=_BINS)
    means = np.bincount(place, left, _BINS) / np.maximum(counts, 1)
    return float((counts * (means - left.mean()) ** 2).sum() / max((left.size * left.var()), 1e-30))


def _drift(fit: Fit, trial: Trial, left: Matrix, joint: int) -> float | None:
    """Return the change of dry friction from the start to the end, as a share; None if unsure."""
    sign = trial.joint_columns(fit.smoothing_rad_s, fit.parameters)[:, joint, COULOMB]
    at = (trial.times_s - trial.times_s.mean()) / np.ptp(trial.times_s)
    design = np.column_stack([sign * at, sign, np.ones_like(sign)])
    solved = np.linalg.lstsq(design, left[:, joint], rcond=None)[0]
    error = left[:, joint] - design @ solved
    inverse, noise = np.linalg.pinv(design.T @ design), max(float(error.std()), 1e-12)
    sums = covariance_of_sums(
        design[:, None] / noise, error[:, None] / noise, trial.times_s,
        np.zeros(len(error), np.int64), trial.samples.cutoff_hz,
    )  # fmt: skip
    sd = noise**2 * np.sqrt((inverse @ sums @ inverse)[0, 0])
    coulomb = fit.terms[joint, COULOMB]
    share = float(solved[0] / max(coulomb, 1e-12))
    is_sure = abs(solved[0]) > _SURELY * sd and coulomb > 0.0 and abs(share) > _LEAST_DRIFT
    return share if is_sure else None
