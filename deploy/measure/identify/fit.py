"""Fits an arm to its motions: bodies that are physically possible, friction, rotors, a delay.

Bodies are in the coordinates of `controller.manipulator_model.log_cholesky`, where every value is a
possible body, with a prior at the values of the robot's file. What the motion does not show stays
there. Outliers get less weight (Huber).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from controller.manipulator_model import ManipulatorModel, log_cholesky
from deploy.measure.identify.noise import widening_of
from deploy.measure.identify.problem import Problem, bodies_of
from deploy.measure.identify.regression import (
    COULOMB,
    LOAD,
    OFFSET,
    ROTOR,
    SMOOTHING_RAD_S,
    STRIBECK,
    TERMS,
    VISCOUS,
    Trial,
    columns_of,
)
from deploy.scenario.starter import Drives

_BODY_SHARE, _LEAST_EXTENT_M = 0.3, 0.02
_ROUNDS, _HUBER = 3, 1.5
_DELAY_S = 0.02
_LEAST_NOISE = 0.005
"""Of the torque's own deviation: no model is better."""
_SURELY = 5.0
"""Standard errors from which a further friction term is believed."""
_PLAIN = (COULOMB, VISCOUS, OFFSET)


@dataclass(frozen=True)
class Prior:
    """Belief about parameters before the log.

    Attributes:
        bodies: coordinates, shape (bodies, 10), and their standard deviations.
        bodies_sd: same shape.
        terms: of each joint, shape (joints, terms).
        terms_sd: same shape.
    """

    bodies: Matrix
    bodies_sd: Matrix
    terms: Matrix
    terms_sd: Matrix


def prior_of(model: ManipulatorModel, drives: Drives) -> Prior:
    """Return the prior: the file's bodies, and friction and rotors as for an arm without data."""
    bodies = log_cholesky(model.body_parameters())
    extent = np.maximum(np.exp(bodies[:, 1:4]).max(axis=1, keepdims=True), _LEAST_EXTENT_M)
    sizes = np.hstack([np.ones((len(bodies), 4)), np.repeat(extent, 6, axis=1)])
    rated = drives.rated
    dry = np.broadcast_to(
        np.asarray(drives.friction.get("coulomb_nm", 0.0), float)
        + np.asarray(drives.friction.get("coulomb_share", 0.0), float) * rated, rated.shape,
    )  # fmt: skip
    viscous = np.broadcast_to(
        np.asarray(drives.friction.get("viscous_nm_s", 0.0), float)
        + np.asarray(drives.friction.get("viscous_share_s", 0.0), float) * rated, rated.shape,
    )  # fmt: skip
    zero = np.zeros_like(rated)
    terms = np.column_stack([dry, viscous, zero, drives.rotors, zero, zero])
    spread = np.column_stack([
        np.maximum(dry, 0.05 * rated), np.maximum(viscous, 0.1 * rated), 0.1 * rated,
        2.0 * drives.rotors, 0.05 * rated, zero + 0.2,
    ])  # fmt: skip
    return Prior(bodies, _BODY_SHARE * sizes, terms, spread)


@dataclass(frozen=True)
class Fit:
    """An identified arm.

    Attributes:
        bodies: coordinates, shape (bodies, 10).
        terms: of each joint, shape (joints, terms); 0 for terms that the joint does not have.
        has_term: which it has, same shape.
        delay_s: how far the torques are ahead of the motion, and its standard deviation.
        smoothing_rad_s: speed over which dry friction changes its sign, shape (joints,).
        covariance: of bodies, terms that joints have, and delay.
        constants: N m per unit of the logged torques, shape (joints,).
        prior: what was believed before.
        load_by: parameters of the bodies by which load-dependent friction was computed.
    """

    bodies: Matrix
    terms: Matrix
    has_term: NDArray[np.bool_]
    delay_s: tuple[float, float]
    smoothing_rad_s: Vector
    covariance: Matrix
    constants: Vector
    prior: Prior
    load_by: Vector

    @property
    def parameters(self) -> Vector:
        """Parameters of all bodies, shape (10 × bodies,)."""
        return bodies_of(self.bodies.ravel())[0]

    @property
    def terms_sd(self) -> Matrix:
        """Standard deviations of `terms`; NaN where a joint does not have it."""
        found = np.full(self.terms.shape, np.nan)
        start = self.bodies.size
        found[self.has_term] = np.sqrt(np.diag(self.covariance)[start:-1])
        return found

    def predicted(self, trial: Trial) -> Matrix:
        """Return the torques of a motion, shape (samples, joints), N m."""
        columns = columns_of(
            [trial], self.smoothing_rad_s, self.constants, self.has_term, self.load_by
        )
        linear = np.concatenate([self.parameters, self.terms[self.has_term]])
        torque = columns.design[:, :, :-1] @ linear
        rate = np.gradient(torque, trial.times_s, axis=0)  # not the measured one, which knows all
        return np.asarray(torque + self.delay_s[0] * rate)


def fit(trials: list[Trial], prior: Prior, constants: Vector, rotors: NDArray[np.bool_]) -> Fit:
    """Identify an arm.

    Args:
        trials: motions.
        prior: what is believed before.
        constants: N m per unit of the logged torques, shape (joints,).
        rotors: whether the torque of each joint acts on its rotor, shape (joints,), as that of a
            motor does and that of a link-side sensor does not.

    Raises:
        InputError: scipy is missing.
    """
    joints = len(constants)
    has_term = np.zeros((joints, len(TERMS)), bool)
    has_term[:, _PLAIN] = True
    has_term[:, ROTOR] = rotors
    smoothing = np.full(joints, 0.02)
    found = _fitted(trials, prior, constants, has_term, smoothing, is_draft=True)
    for is_draft in (True, False):
        smoothing = _smoothing(trials, found)
        found = _fitted(trials, prior, constants, has_term, smoothing, found, is_draft=is_draft)
    for term in (STRIBECK, LOAD):  # where the data show it
        wider = has_term.copy()
        wider[:, term] = True
        tried = _fitted(trials, prior, constants, wider, smoothing, found)
        sure = tried.terms[:, term] > _SURELY * tried.terms_sd[:, term]
        if sure.any():
            has_term = has_term.copy()
            has_term[:, term] = sure
            found = _fitted(trials, prior, constants, has_term, smoothing, tried)
    return found


def _smoothing(trials: list[Trial], found: Fit) -> Vector:
    """Return the smoothing speed with which each joint's own terms leave least, shape (joints,)."""
    costs = []
    rigid = np.concatenate([t.torque for t in trials]) * found.constants
    rigid = rigid - np.concatenate([t.bodies for t in trials]) @ found.parameters
    for speed in SMOOTHING_RAD_S:
        speeds = np.full(len(found.constants), speed)
        felt = np.concatenate([t.joint_columns(speeds, found.parameters) for t in trials])
        left = []
        for joint in range(len(speeds)):
            own = felt[:, joint, found.has_term[joint]]
            solved = np.linalg.lstsq(own, rigid[:, joint], rcond=None)[0]
            left.append(float(np.abs(rigid[:, joint] - own @ solved).sum()))
        costs.append(left)
    best: Vector = np.array(SMOOTHING_RAD_S)[np.argmin(costs, axis=0)]
    return best


def _fitted(
    trials: list[Trial], prior: Prior, constants: Vector, has_term: NDArray[np.bool_],
    smoothing: Vector, start: Fit | None = None, *, is_draft: bool = False,
) -> Fit:  # fmt: skip
    """Fit with given terms and smoothing; robust weights and noise in `_ROUNDS` rounds.

    The covariance of a draft is not computed, and zero.
    """
    load_by = bodies_of(prior.bodies.ravel())[0] if start is None else start.parameters
    columns = columns_of(trials, smoothing, constants, has_term, load_by)
    centre = np.concatenate([prior.bodies.ravel(), prior.terms[has_term], [0.0]])
    spread = np.concatenate([prior.bodies_sd.ravel(), prior.terms_sd[has_term], [_DELAY_S]])
    size = prior.bodies.size
    free = has_term & (np.arange(len(TERMS)) == OFFSET)
    lowest = np.concatenate([np.full(size, -np.inf), np.where(free[has_term], -np.inf, 0.0),
                             [-np.inf]])  # fmt: skip
    problem = Problem(columns, centre, spread, lowest, size)
    cutoff_hz = trials[0].samples.cutoff_hz
    widening = widening_of(columns.times_s, cutoff_hz)
    x, weights = _robust(
        problem, problem.start if start is None else _restart(start, has_term), widening
    )
    covariance = np.zeros((x.size, x.size))
    if not is_draft:
        covariance = problem.covariance(x, weights, cutoff_hz)
    terms = np.zeros(prior.terms.shape)
    terms[has_term] = np.maximum(x[size:-1], np.where(free[has_term], -np.inf, 0.0))
    delay = float(x[-1]), float(np.sqrt(covariance[-1, -1]))
    return Fit(
        x[:size].reshape(prior.bodies.shape), terms, has_term, delay, smoothing, covariance,
        constants, prior, load_by,
    )  # fmt: skip


def _robust(problem: Problem, x: Vector, widening: float) -> tuple[Vector, Matrix]:
    """Return the best parameters, and the weight of each sample and joint; outliers have less."""
    deviation = problem.torque.std(axis=0)
    noise, least = 0.05 * deviation, _LEAST_NOISE * deviation
    weights, left = np.ones_like(problem.torque), problem.torque
    for _ in range(_ROUNDS):
        x = problem.solve(x, weights / (widening * noise))
        left = problem.residuals(x)
        noise = np.maximum(1.4826 * np.median(np.abs(left), axis=0), least)
        weights = 1.0 / np.sqrt(np.maximum(np.abs(left) / (_HUBER * noise), 1.0))
    noise = np.maximum(np.sqrt((weights * left**2).mean(axis=0)), least)
    return x, weights / (widening * noise)


def _restart(start: Fit, has_term: NDArray[np.bool_]) -> Vector:
    return np.concatenate([start.bodies.ravel(), start.terms[has_term], start.delay_s[:1]])
