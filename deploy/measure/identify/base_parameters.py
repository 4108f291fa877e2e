"""Base parameters, the combinations that torques depend on, and what is known of link masses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.fit import Fit
from deploy.measure.identify.problem import bodies_of
from deploy.measure.identify.regression import ROTOR

NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Mass, first moments and inertia about the joint's origin, in the frame of the joint."""
_MOTIONS, _NONE = 300, 1e-7
SEEN = 0.25
"""Of the prior's standard deviation, below which a value comes from the log."""
Z_95 = 1.96


class Grouping(NamedTuple):
    """Base parameters as combinations of the bodies' parameters.

    Attributes:
        names: of each, after the first parameter in it, as ``shoulder: mx``.
        matrix: base parameters per parameter, shape (base parameters, 10 × bodies).
        of_rotor: which of them act exactly as a joint's rotor does, shape (joints, base
            parameters): no motion tells both apart. It is so for the first joint of most arms.
    """

    names: list[str]
    matrix: Matrix
    of_rotor: NDArray[np.bool_]


def grouping(model: ManipulatorModel) -> Grouping:
    """Return the base parameters of an arm, from fixed random motions and Householder's QR."""
    random = np.random.default_rng(1)
    motion = random.uniform(-3.0, 3.0, (3, _MOTIONS, model.joints))
    stacked = model.torque_regressors(*motion).reshape(_MOTIONS * model.joints, -1)
    chosen = list[int]()
    basis = np.empty((len(stacked), 0))
    for column in range(stacked.shape[1]):  # the first of each group, in the order of the bodies
        left = stacked[:, column] - basis @ (basis.T @ stacked[:, column])
        left -= basis @ (basis.T @ left)
        size = float(np.linalg.norm(left))
        if size > _NONE * max(1.0, float(np.linalg.norm(stacked[:, column]))):
            chosen.append(column)
            basis = np.column_stack([basis, left / size])
    matrix = np.asarray(np.linalg.lstsq(stacked[:, chosen], stacked, rcond=None)[0], np.float64)
    matrix[np.abs(matrix) < 1e-9] = 0.0
    joints = model.body_joints
    rotors = np.einsum("nj,jk->njk", motion[2], np.eye(model.joints)).reshape(len(stacked), -1)
    base = stacked[:, chosen]
    shares = np.linalg.lstsq(base, rotors, rcond=None)[0]
    alike = np.linalg.norm(rotors - base @ shares, axis=0) < _NONE * len(stacked)
    of_rotor = (np.abs(shares) > 1e-6) & alike
    names = [f"{joints[c // 10]}: {NAMES[c % 10]}" for c in chosen]
    return Grouping(names, matrix, np.asarray(of_rotor.T))


class Interval(NamedTuple):
    """A value with half of its 95 % interval, the value before, and whether the log shows it."""

    value: float
    half: float
    before: float
    seen: bool


def base_values(fit: Fit, group: Grouping) -> list[Interval]:
    """Return the base parameters of a fit."""
    value, slopes = bodies_of(fit.bodies.ravel())
    before, slopes_before = bodies_of(fit.prior.bodies.ravel())
    size = fit.bodies.size
    sd = _deviations(group.matrix @ slopes, fit.covariance[:size, :size])
    prior = _deviations(group.matrix @ slopes_before, np.diag(fit.prior.bodies_sd.ravel() ** 2))
    alone = np.logical_not(group.of_rotor[fit.has_term[:, ROTOR]].any(axis=0, keepdims=True))[0]
    rows = zip(group.matrix @ value, sd, group.matrix @ before, prior, alone, strict=True)
    return [Interval(float(v), float(Z_95 * s), float(b), bool(s < SEEN * p and apart))
            for v, s, b, p, apart in rows]  # fmt: skip


def link_masses(fit: Fit) -> list[Interval]:
    """Return the mass of each body, kg.

    Torques show masses only as parts of base parameters: most keep the interval of the prior.
    """
    value, slopes = bodies_of(fit.bodies.ravel())
    before, slopes_before = bodies_of(fit.prior.bodies.ravel())
    size, masses = fit.bodies.size, slice(None, None, len(NAMES))
    sd = _deviations(slopes[masses], fit.covariance[:size, :size])
    prior = _deviations(slopes_before[masses], np.diag(fit.prior.bodies_sd.ravel() ** 2))
    rows = zip(value[masses], sd, before[masses], prior, strict=True)
    return [
        Interval(float(v), float(Z_95 * s), float(b), bool(s < SEEN * p)) for v, s, b, p in rows
    ]


def _deviations(matrix: Matrix, covariance: Matrix) -> Vector:
    return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", matrix, covariance, matrix)))
